"""Uncertain inertia and geometry of the bodies of an MJCF model.

The mass cancels in the frequency of a pendulum. The ratio of the moment of inertia to the static moment remains uncertain:
the inertia about the centre of mass, and the distance of the centre.
"""

import copy
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from vlab.diagnose.parameters.centre_of_mass import centres_of_mass
from vlab.diagnose.parameters.mjcf import Number, Uncertain, of_kind, with_model
from vlab.diagnose.parameters.reduced_model import Part
from vlab.diagnose.settings import GEOMETRY, MJCF_PRIORS
from vlab.errors import BadStructure
from vlab.plants.base import Plant
from vlab.signals import Array

LENGTH = "length"
"""Kind of the distances along a body."""


def geometry_parameters(plant: Plant, given: Mapping[str, float]) -> list[Uncertain]:
    """Return inertias, lengths and stated centres of mass of all bodies, for large motion.

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


def geometry_about_rest(plant: Plant, given: Mapping[str, float], basis: Array) -> list[Uncertain]:
    """Return inertias and lengths for small motion about rest.

    They belong to the model where the case states them, or where gravity is the spring of a mode. They are then as
    uncertain as the stiffness of a spring. A length is the distance of the centre of mass alone.

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
    stated = {name.rpartition(":")[2] for name in given}
    hangs = bool(np.any(gravity_shares(plant, basis) > GEOMETRY.hanging))
    usual = MJCF_PRIORS.default_sd["stiffness"]
    sd = {kind: usual for kind in GEOMETRY.sd if hangs or kind in stated}
    return _of_bodies(_bodies(plant.model), given, sd, lambda body: (("body_ipos", body),))


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


def parts_of_lengths(plant: Plant, parameters: Sequence[Uncertain], basis: Array) -> tuple[Part, ...]:
    """Return the modal matrix parts under the distances of centres of mass.

    The mass matrix is quadratic in a distance, and the stiffness by gravity linear. Three values of the distance give both
    coefficients exactly.

    Parameters
    ----------
    plant : Plant
        Nominal plant.
    parameters : sequence of Uncertain
        Uncertain parameters; only those of the kind `LENGTH` have such parts.
    basis : (nv, m) array
        Mode shapes.

    Returns
    -------
    tuple of Part
        Parts of M and K.
    """
    by: dict[tuple[int, ...], list[Number]] = {}
    numbers = {number for p in parameters if p.kind == LENGTH for number in p.fields}
    for number in sorted(numbers, key=str):
        multiplied = tuple(i for i, p in enumerate(parameters) if number in p.fields)
        by.setdefault(multiplied, []).append(number)
    return tuple(part for own, fields in by.items() for part in _parts_of_length(plant, fields, own, basis))


def _parts_of_length(plant: Plant, fields: Sequence[Number], by: tuple[int, ...], basis: Array) -> list[Part]:
    def matrices(factor: float) -> tuple[Array, Array]:
        model = copy.copy(plant.model)
        for name, index in fields:
            getattr(model, name)[index] *= factor
        linear = with_model(plant, model).linearise()
        return basis.T @ linear.M @ basis, basis.T @ linear.K @ basis

    (low_m, low_k), (mass, _), (high_m, high_k) = (matrices(1.0 + step) for step in (-GEOMETRY.step, 0, GEOMETRY.step))
    square = (high_m - 2.0 * mass + low_m) / (2.0 * GEOMETRY.step**2)
    line = (high_m - low_m) / (2.0 * GEOMETRY.step) - 2.0 * square
    return [Part(by=by, M=line, K=(high_k - low_k) / (2.0 * GEOMETRY.step)), Part(by=by + by, M=square)]


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
