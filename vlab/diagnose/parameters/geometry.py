"""Uncertain inertia and geometry of the bodies of an MJCF model.

The mass cancels in the frequency of a pendulum. The ratio of the moment of inertia to the static moment remains uncertain:
the inertia about the centre of mass, and the distance of the centre.
"""

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np

from vlab.diagnose.parameters.centre_of_mass import centres_of_mass
from vlab.diagnose.parameters.mjcf import Number, Uncertain, adjusted, of_kind, with_model
from vlab.diagnose.parameters.mjcf_sensitivity import parts_of
from vlab.diagnose.parameters.reduced_model import Part
from vlab.diagnose.settings import GEOMETRY, MJCF_PRIORS
from vlab.errors import BadStructure
from vlab.plants.base import Plant
from vlab.signals import Array

LENGTH = "length"
"""Kind of the distances along a body."""


def geometry_parameters(plant: Plant, given: Mapping[str, float]) -> list[Uncertain]:
    """Return uncertain inertias, lengths and stated centres of mass.

    Parameters
    ----------
    plant : Plant
        Plant.
    given : mapping
        ``[model.uncertain]`` of the case.

    Returns
    -------
    list of Uncertain
        Parameters.
    """
    bodies = _bodies(plant.model)
    out = _of_bodies(bodies, given, GEOMETRY.sd, lambda body: _lengths(plant.model, body))
    return out + centres_of_mass(plant.model, bodies, given)


def stated_kinds(given: Mapping[str, float]) -> set[str]:
    """Return the kinds that ``[model.uncertain]`` states, for all elements or one."""
    return {name.rpartition(":")[2] for name in given}


def geometry_about_rest(plant: Plant, given: Mapping[str, float], basis: Array) -> list[Uncertain]:
    """Return inertias and lengths for small motion about rest.

    The parameters belong to the model where the case states them, or where gravity is the spring of a mode. The
    parameters are then as uncertain as the stiffness of a spring. A length is the distance of a centre of mass from the
    axis of its joint.

    Parameters
    ----------
    plant : Plant
        Plant.
    given : mapping
        ``[model.uncertain]`` of the case.
    basis : (nv, m) array
        Mode shapes of unit modal mass.

    Returns
    -------
    list of Uncertain
        Parameters.
    """
    stated = stated_kinds(given)
    hangs = bool(np.any(gravity_shares(plant, basis) > GEOMETRY.hanging))
    usual = MJCF_PRIORS.default_sd["stiffness"]
    sd = {kind: usual for kind in GEOMETRY.sd if hangs or kind in stated}
    distances = _distances(plant)
    every = _of_bodies(_bodies(plant.model), given, sd, lambda body: tuple(distances.get(body, {})))
    fixed = {number: end for own in distances.values() for number, end in own.items()}
    return [
        p if p.kind != LENGTH else replace(p, fields=(), stretched=tuple((n, fixed[n]) for n in p.fields))
        for p in every
        if hangs or p.kind in given or p.name in given
    ]


def _distances(plant: Plant) -> dict[int, dict[Number, float]]:
    """Return the centres' coordinates with their values on the axes.

    A body that is welded to another one turns about the joint of that body. Coordinates are those of the body's frame.
    """
    model, data = plant.model, plant.new_data()
    mujoco.mj_forward(model, data)
    turning = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_BALL))
    out: dict[int, dict[Number, float]] = {}
    for body in _bodies(model).values():
        root = int(model.body_weldid[body])
        joints = range(model.body_jntadr[root], model.body_jntadr[root] + model.body_jntnum[root])
        joint = next((j for j in joints if int(model.jnt_type[j]) in turning), None)
        if joint is None:
            continue
        arm, axis = data.xipos[body] - data.xanchor[joint], data.xaxis[joint]
        if model.jnt_type[joint] == turning[0]:
            arm = arm - (arm @ axis) * axis
        own = data.xmat[body].reshape(3, 3).T @ arm
        on_axis = model.body_ipos[body] - own
        out[body] = {("body_ipos", (body, k)): float(on_axis[k]) for k in range(3) if abs(own[k]) > GEOMETRY.least}
    return out


def gravity_shares(plant: Plant, basis: Array) -> Array:
    """Return the shares of gravity in the stiffness of modes.

    Parameters
    ----------
    plant : Plant
        Plant.
    basis : (nv, m) array
        Mode shapes of unit modal mass.

    Returns
    -------
    (m,) array
        Shares [1]; zero without gravity or equilibrium, and of modes without stiffness.
    """
    if not np.any(plant.model.opt.gravity):
        return np.zeros(basis.shape[1])

    def stiffness(factor: float) -> Array:
        model = copy.copy(plant.model)
        model.opt.gravity *= factor
        return np.einsum("im,ij,jm->m", basis, with_model(plant, model).linearise().K, basis)

    try:
        high, whole, low = (stiffness(1.0 + step) for step in (GEOMETRY.step, 0.0, -GEOMETRY.step))
    except BadStructure:
        return np.zeros(basis.shape[1])
    share = (high - low) / (2.0 * GEOMETRY.step)
    return np.divide(share, whole, out=np.zeros_like(share), where=np.abs(whole) > 0.0)


def parts_about_rest(plant: Plant, parameters: Sequence[Uncertain], basis: Array) -> tuple[Part, ...]:
    """Return the modal matrix parts of parameters with distances.

    The part of a body's mass in the mass matrix is quadratic in the distance, and the stiffness by gravity linear. Values at
    three distances give all coefficients exactly while the equilibrium stays.

    Parameters
    ----------
    plant : Plant
        Nominal plant.
    parameters : sequence of Uncertain
        Uncertain parameters.
    basis : (nv, m) array
        Mode shapes.

    Returns
    -------
    tuple of Part
        Parts of M, C and K.
    """
    groups: dict[tuple[tuple[int, ...], tuple[int, ...]], list[int]] = {}
    for body in _bodies(plant.model).values():
        by_mass = tuple(i for i, p in enumerate(parameters) if ("body_mass", body) in p.fields)
        by_length = tuple(i for i, p in enumerate(parameters) if _is_stretched(p, body))
        if by_length:
            groups.setdefault((by_mass, by_length), []).append(body)
    masses = {("body_mass", body) for bodies in groups.values() for body in bodies}
    others = [replace(p, fields=tuple(n for n in p.fields if n not in masses)) for p in parameters]
    parts = list(parts_of(plant, others, basis))
    for (by_mass, by_length), bodies in groups.items():
        ends = [(n, end) for n, end in parameters[by_length[0]].stretched if _body_of(n) in bodies]
        parts += _parts_of_mass(plant, bodies, ends, (by_mass, by_length), basis)
    return tuple(parts)


def _is_stretched(parameter: Uncertain, body: int) -> bool:
    return any(_body_of(number) == body for number, _ in parameter.stretched)


def _body_of(number: Number) -> int:
    """Return the body of a coordinate."""
    _, index = number
    return index[0] if isinstance(index, tuple) else index


def _parts_of_mass(
    plant: Plant,
    bodies: Sequence[int],
    ends: Sequence[tuple[Number, float]],
    by: tuple[tuple[int, ...], tuple[int, ...]],
    basis: Array,
) -> list[Part]:
    """Return the parts of bodies' masses by powers of the distance.

    Parameters
    ----------
    plant : Plant
        Nominal plant.
    bodies : sequence of int
        Bodies under the same parameters.
    ends : sequence of tuple
        Coordinates of their centres of mass, with the values on the axis.
    by : tuple of tuple of int
        Parameters of the masses, and of the distances.
    basis : (nv, m) array
        Mode shapes.
    """
    step, fields = GEOMETRY.step, tuple(("body_mass", body) for body in bodies)
    both = [
        Uncertain(name="", kind="mass", sd=1.0, fields=fields),
        Uncertain(name="", kind=LENGTH, sd=1.0, stretched=tuple(ends)),
    ]

    def matrices(mass: float, distance: float) -> tuple[Array, Array]:
        linear = adjusted(plant, both, np.log([mass, distance])).linearise()
        return basis.T @ linear.M @ basis, basis.T @ linear.K @ basis

    def by_mass(distance: float) -> tuple[Array, Array]:
        high, low = matrices(1.0 + step, distance), matrices(1.0 - step, distance)
        return (high[0] - low[0]) / (2.0 * step), (high[1] - low[1]) / (2.0 * step)

    (low_m, low_k), (mass, stiffness), (high_m, high_k) = (by_mass(1.0 + change) for change in (-step, 0.0, step))
    square = (high_m - 2.0 * mass + low_m) / (2.0 * step**2)
    line, line_k = (high_m - low_m) / (2.0 * step) - 2.0 * square, (high_k - low_k) / (2.0 * step)
    masses, lengths = by
    return [
        Part(by=masses, M=mass - line - square, K=stiffness - line_k),
        Part(by=masses + lengths, M=line, K=line_k),
        Part(by=masses + lengths + lengths, M=square),
    ]


def _bodies(model: Any) -> dict[str, int]:
    """Return the numbers of moving bodies with mass, by name."""
    numbers = [i for i in range(1, model.nbody) if model.body_mass[i] > 0 and model.body_weldid[i] != 0]
    return {f"body:{model.body(i).name or f'body{i}'}": i for i in numbers}


def _of_bodies(
    bodies: Mapping[str, int],
    given: Mapping[str, float],
    sd: Mapping[str, float],
    lengths: Callable[[int], tuple[Number, ...]],
) -> list[Uncertain]:
    """Return the common and individual parameters of the kinds in `sd`."""
    out = []
    for kind, usual in sd.items():
        each = {name: lengths(i) if kind == LENGTH else (("body_inertia", i),) for name, i in bodies.items()}
        out += of_kind(kind, each, given.get(kind, usual), given, kind)
    return out


def _lengths(model: Any, body: int) -> tuple[Number, ...]:
    """Return the values that scale with a body's length.

    These are its centre of mass, its sites, and the positions of attached bodies.
    """
    out: list[Number] = [("body_ipos", body)]
    out += [("site_pos", i) for i in range(model.nsite) if model.site_bodyid[i] == body]
    out += [("body_pos", i) for i in range(1, model.nbody) if model.body_parentid[i] == body]
    return tuple(out)
