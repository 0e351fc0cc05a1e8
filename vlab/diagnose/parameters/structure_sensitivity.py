"""Reduced model of a structure as a function of its uncertain parameters.

The derivatives of M and K are those of the FE model, by central differences. Matching mode shapes map the derivatives to
the plant's modes.
"""

from collections.abc import Sequence

import numpy as np
from scipy import linalg

from vlab.diagnose.parameters.mjcf import Uncertain
from vlab.diagnose.parameters.mode_selection import as_stepped
from vlab.diagnose.parameters.reduced_model import CoilShift, ModalDamping, Part, ReducedModel, Shift
from vlab.diagnose.parameters.structure import ALL_DAMPING, FREQUENCY, PLACE, SCALED, StructureUncertain, edited
from vlab.diagnose.settings import STRUCTURE_PRIORS
from vlab.fe import build_fe_model
from vlab.fe.model import FeModel
from vlab.modal.mac import match_modes
from vlab.plants.base import Plant, named_sensors
from vlab.plants.fe_modes import measured_modes_of
from vlab.signals import Array, ModalModel
from vlab.structure.model import Structure


def common_scale_of_structure(
    structure: Structure, variant: str, parameters: Sequence[Uncertain], *, loaded: bool
) -> Array | None:
    """Return log factors that scale all impedances and gains.

    Damping is stated as ratios, which are invariant. The counterpart for MJCF is
    `vlab.diagnose.parameters.mjcf.common_scale`.

    Parameters
    ----------
    structure : Structure
        Structure.
    variant : str
        Variant of the model.
    parameters : sequence of Uncertain
        Uncertain parameters.
    loaded : bool
        Whether measured forces act.

    Returns
    -------
    (n_parameters,) array or None
        Log factors; None with measured forces or a certain parameter.
    """
    if loaded or any(p.sd <= 0 for p in parameters if p.kind in SCALED):
        return None
    scale = np.array([float(p.kind in SCALED) for p in parameters])
    alike = edited(structure, parameters, STRUCTURE_PRIORS.step * scale)
    larger, own = (build_fe_model(s, variant).linear for s in (alike, structure))
    heavier = np.allclose(larger.M, np.exp(STRUCTURE_PRIORS.step) * own.M, rtol=0, atol=1e-9 * np.abs(own.M).max())
    return scale if heavier and np.allclose(larger.eigen[0], own.eigen[0], rtol=1e-3 * STRUCTURE_PRIORS.step) else None


def frequencies_of_reduced_model(
    reduced_model: ReducedModel,
    plant: Plant,
    of: tuple[Structure, str],
    parameters: Sequence[Uncertain],
    theta: Array,
) -> Array:
    """Return log factors that give a rebuilt plant the reduced model's frequencies.

    Parameters
    ----------
    reduced_model : ReducedModel
        Reduced model.
    plant : Plant
        Plant rebuilt at `theta`.
    of : tuple of (Structure, str)
        Nominal structure and variant of its model.
    parameters : sequence of Uncertain
        Uncertain parameters.
    theta : (n_changes,) array
        Log factors of the reduced model.

    Returns
    -------
    (n_changes,) array
        Log factors for the plant.
    """
    structure, variant = of
    linear = plant.linearise()
    M, _, K, *_ = (part[0] for part in reduced_model.matrices(theta[None]))
    squares, modal = linalg.eigh(K, M)
    shapes = linear.eigen[1]
    same = np.argmax(np.abs((reduced_model.shapes @ modal).T @ linear.M @ shapes), axis=1)
    step = structure.tuning.at_step if structure.tuning is not None and structure.tuning.at_step else plant.timestep
    mass, _, stiffness = (np.diag(added) for added in as_stepped(plant, linear, shapes[:, same], step))
    shown = (linear.eigen[0][same] ** 2 + stiffness) / (1.0 + mass)
    driven = list(measured_modes_of(plant, edited(structure, parameters, theta), variant, linear.eigen[0], shapes))
    index, out = {p.name: i for i, p in enumerate(parameters)}, theta.copy()
    for mode, wanted, own in zip(same, squares, shown, strict=True):
        i = index.get(f"{FREQUENCY}{driven.index(mode) + 1}") if mode in driven else None
        if i is not None:
            out[i] += 0.5 * np.log(wanted / own)
    return out


def structure_parts(
    fe: FeModel,
    carry: Array,
    parameters: Sequence[Uncertain],
    omega: Array,
    driven: Sequence[int] = (),
) -> tuple[Part, ...]:
    """Return the matrix parts under a structure's parameters.

    The derivatives are those of the FE model. Matching shapes at the structure's points map the derivatives to the
    plant's modes.

    Parameters
    ----------
    fe : FeModel
        FE model.
    carry : (n, m) array
        FE coordinates per modal coordinate of the plant, from `carried`.
    parameters : sequence of Uncertain
        Uncertain parameters.
    omega : (m,) array
        Natural frequencies of the plant [rad/s].
    driven : sequence of int
        Indices of the driven modes in order; -1 for a missing one.

    Returns
    -------
    tuple of Part
        Parts of M and K.
    """
    structure, variant, out = fe.structure, fe.variant, []
    for i, parameter in enumerate(parameters):
        edit = parameter.edit if isinstance(parameter, StructureUncertain) else None
        if edit is None or parameter.kind in ("damping", "place"):
            continue
        if parameter.kind == "frequency":
            mode = driven[int(parameter.name.removeprefix(FREQUENCY)) - 1]
            own = np.zeros((len(omega), len(omega)))
            own[mode, mode] = 1.0 if mode >= 0 else 0.0
            out.append(Part(by=(i, i), K=omega[mode] ** 2 * own))  # stiffness is the square of a frequency
            continue
        high, low = (
            build_fe_model(edit(structure, np.exp(s)), variant).linear
            for s in (STRUCTURE_PRIORS.step, -STRUCTURE_PRIORS.step)
        )
        M, K = (
            carry.T @ ((a - b) / (2 * STRUCTURE_PRIORS.step)) @ carry for a, b in ((high.M, low.M), (high.K, low.K))
        )
        out.append(Part(by=(i,), M=M if np.abs(M).max() > 1e-9 else None, K=K))
    return tuple(out)


def damping_of_structure(
    structure: Structure, parameters: Sequence[Uncertain], M: Array, K: Array, at_coils: Array, places: Sequence[int]
) -> ModalDamping:
    """Return the modal damping of a structure's reduced model.

    Parameters
    ----------
    structure : Structure
        Structure with the damping ratios.
    parameters : sequence of Uncertain
        Uncertain parameters.
    M, K : (m, m) array
        Nominal modal matrices.
    at_coils : (n_coils, m) array
        Coil motion per modal coordinate.
    places : sequence of int
        Numbers of the modes among all driven modes.

    Returns
    -------
    ModalDamping
        Damping.
    """
    index = {p.name: i for i, p in enumerate(parameters)}
    count = len(structure.damping.ratios)
    own = {k: index[name] for k in range(count) if (name := f"{ALL_DAMPING}:mode{k + 1}") in index}
    return ModalDamping(
        M=M,
        K=K,
        at_coils=at_coils,
        places=np.asarray(places, dtype=int),
        ratios=np.array(structure.damping.ratios),
        higher=structure.damping.higher,
        common=(index[ALL_DAMPING],) if ALL_DAMPING in index else (),
        own=own,
    )


def structure_shifts(fe: FeModel, carry: Array, parameters: Sequence[Uncertain]) -> tuple[Shift, ...]:
    """Return the additional rows of shifted sensors.

    Parameters
    ----------
    fe : FeModel
        FE model.
    carry : (n, m) array
        FE coordinates per modal coordinate of the plant.
    parameters : sequence of Uncertain
        Uncertain parameters.

    Returns
    -------
    tuple of Shift
        Rows per metre of shift.
    """
    sensors, out = dict(named_sensors(fe.structure)), []
    for i, parameter in enumerate(parameters):
        if not isinstance(parameter, StructureUncertain) or parameter.beside is None:
            continue
        sensor = sensors[parameter.name.removeprefix(PLACE)]
        slope, is_rate = fe.slope(sensor.at), sensor.kind == "velocity"
        if slope is not None:
            row, none = slope @ carry, np.zeros(carry.shape[1])
            out.append(
                Shift(by=i, sensor=parameter.beside, at_q=none if is_rate else row, at_v=row if is_rate else none)
            )
    return tuple(out)


def coil_shifts(fe: FeModel, carry: Array, parameters: Sequence[Uncertain]) -> tuple[CoilShift, ...]:
    """Return the additional modal forces of shifted coils.

    Parameters
    ----------
    fe : FeModel
        FE model.
    carry : (n, m) array
        FE coordinates per modal coordinate of the plant.
    parameters : sequence of Uncertain
        Uncertain parameters.

    Returns
    -------
    tuple of CoilShift
        Modal forces per metre of shift.
    """
    out = []
    for i, parameter in enumerate(parameters):
        if isinstance(parameter, StructureUncertain) and parameter.pushed is not None:
            slope = fe.slope(fe.structure.coil[parameter.pushed].at)
            if slope is not None:
                out.append(CoilShift(by=i, actuator=parameter.pushed, force=slope @ carry))
    return tuple(out)


def carried(fe: FeModel, shapes_at_points: Array, omega: Array, points: Sequence[str]) -> Array:
    """Return FE coordinates per modal coordinate of a plant.

    Parameters
    ----------
    fe : FeModel
        FE model.
    shapes_at_points : (n_points, m) array
        Mass-normalised modes of the plant at the structure's points.
    omega : (m,) array
        Natural frequencies of the plant [rad/s].
    points : sequence of str
        Points of the structure.

    Returns
    -------
    (n, m) array
        FE mode shapes in the order and sign of the plant's modes.
    """
    all_omega, all_shapes = fe.linear.eigen
    rows = fe.deflections(points) @ all_shapes
    visible = np.flatnonzero(np.abs(rows).max(axis=0) > 1e-6 * np.abs(rows).max())
    visible = visible[: max(2 * len(omega), len(omega) + 4)]
    a, b = (
        ModalModel(freq=w / (2 * np.pi), zeta=np.zeros(len(w)), shapes=r, coordinates=tuple(points))
        for w, r in ((all_omega[visible], rows[:, visible]), (omega, shapes_at_points))
    )
    pairing = match_modes(a, b)
    out = np.zeros((fe.linear.n, len(omega)))
    for i, j in zip(pairing.a, pairing.b, strict=True):
        sign = np.sign(rows[:, visible[i]] @ shapes_at_points[:, j]) or 1.0
        out[:, j] = sign * all_shapes[:, visible[i]]
    return out
