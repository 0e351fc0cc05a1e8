"""Uncertain parameters of a structure, and adjusted plants.

Parameters concern sections, fittings, tension, damping and gains. Sensitivities of M and K are those of the FE model,
by central differences.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from vlab.diagnose.parameters.mjcf import Uncertain
from vlab.diagnose.parameters.mode_selection import as_stepped
from vlab.diagnose.parameters.reduced_model import ModalDamping, Part, ReducedModel, Shift
from vlab.diagnose.settings import MJCF_PRIORS, STRUCTURE_PRIORS
from vlab.errors import unknown_name
from vlab.fe import build_fe_model
from vlab.fe.damping import driven_modes
from vlab.fe.model import FeModel
from vlab.modal.mac import match_modes
from vlab.plants.base import Plant, named_sensors
from vlab.plants.build import build_plant
from vlab.signals import Array, ModalModel
from vlab.structure.model import Structure, Tuning

Edit = Callable[[Structure, float], Structure]
"""Function of a structure and a factor, or of a structure and a sensor shift [m]."""
SCALED = ("stiffness", "mass", "tension", "gain")
"""Kinds that scale with the forces at equal motion."""
FREQUENCY, PLACE = "frequency:mode", "place:"
"""Prefixes of parameters for a mode's frequency and for a sensor's position."""
ALL_DAMPING = "damping"
"""Name of the factor on all damping ratios; a mode's own factor appends ``:mode`` and its number."""


@dataclass(frozen=True, kw_only=True)
class StructureUncertain(Uncertain):
    """Uncertain parameter of a structure.

    Parameters
    ----------
    edit : callable
        Function that applies the parameter; None for gains.
    beside : int or None
        Channel of a shifted sensor; the parameter is then a distance [m] instead of a log factor.
    """

    edit: Edit | None = None
    beside: int | None = None

    def applied(self, structure: Structure, value: float) -> Structure:
        """Return a structure at a log factor or distance of the parameter."""
        if self.edit is None or value == 0.0:
            return structure
        return self.edit(structure, value if self.beside is not None else float(np.exp(value)))


def structure_parameters(
    structure: Structure,
    given: Mapping[str, float],
    channels: Sequence[str],
    actuators: Sequence[int],
    tuned: int = 0,
    sensors: Sequence[int | None] = (),
) -> list[StructureUncertain]:
    """Return the uncertain parameters of a structure.

    Parameters
    ----------
    structure : Structure
        Structure.
    given : mapping
        ``[model.uncertain]`` of the case.
    channels : sequence of str
        Names of the compared channels.
    actuators : sequence of int
        Driven coils.
    tuned : int
        Number of first driven modes with an uncertain frequency each.
    sensors : sequence of int or None
        Sensor or probe of the structure for every channel.

    Returns
    -------
    list of StructureUncertain
        Parameters.

    Raises
    ------
    UnknownName
        ``[model.uncertain]`` names a parameter that does not exist.
    """
    usual = {**MJCF_PRIORS.default_sd, **STRUCTURE_PRIORS.structure_sd}
    if structure.tuning is not None and structure.tuning.of_fe:
        usual["frequency"] = STRUCTURE_PRIORS.of_fe_sd
    sd = {kind: given.get(kind, default) for kind, default in usual.items()}
    out = []
    for name in structure.section:
        out.append(
            StructureUncertain(
                name=f"section:{name}:stiffness", kind="stiffness", sd=sd["stiffness"], edit=_stiffness(name)
            )
        )
        if structure.section[name].mass_per_length > 0:
            out.append(StructureUncertain(name=f"section:{name}:mass", kind="mass", sd=sd["mass"], edit=_mass(name)))
    if structure.mass or structure.clamp or structure.coil:
        out.append(StructureUncertain(name="fittings:mass", kind="mass", sd=sd["mass"], edit=_fittings))
    if any(cable.tension for cable in structure.cable):
        out.append(StructureUncertain(name="tension", kind="tension", sd=sd["tension"], edit=_tension))
    if any(cable.density for cable in structure.cable):
        out.append(StructureUncertain(name="cables:mass", kind="mass", sd=sd["mass"], edit=_cables))
    if structure.plate:
        out.append(StructureUncertain(name="plates:weight", kind="tension", sd=sd["tension"], edit=_plates))
        out.append(StructureUncertain(name="plates:inertia", kind="mass", sd=sd["mass"], edit=_inertia))
    out.append(
        StructureUncertain(name=ALL_DAMPING, kind="damping", sd=MJCF_PRIORS.common * sd["damping"], edit=_damping(None))
    )
    out += [
        StructureUncertain(
            name=f"{ALL_DAMPING}:mode{i + 1}", kind="damping", sd=MJCF_PRIORS.own * sd["damping"], edit=_damping(i)
        )
        for i in range(len(structure.damping.ratios))
    ]
    out += [
        StructureUncertain(name=f"{FREQUENCY}{i + 1}", kind="frequency", sd=sd["frequency"], edit=_frequency(i))
        for i in range(tuned)
    ]
    for i in actuators:
        out.append(StructureUncertain(name=f"gain:{structure.coil[i].name}", kind="gain", sd=sd["gain"], actuator=i))
    for i, name in enumerate(channels):
        out.append(
            StructureUncertain(name=f"sensor:{name.removeprefix('sensor:')}", kind="sensor", sd=sd["sensor"], sensor=i)
        )
    if structure.tuning is not None and structure.tuning.of_fe:
        out += _places(structure, sensors, sd["place"])
    unknown = [name for name in given if ":" in name and name not in {p.name for p in out}]
    if unknown:
        raise unknown_name("parameter", unknown[0], [p.name for p in out], where="[model.uncertain]")
    return [replace(p, sd=given.get(p.name, p.sd)) for p in out]


def _places(structure: Structure, sensors: Sequence[int | None], sd: float) -> list[StructureUncertain]:
    """Return position parameters of the sensors on bars."""
    named = named_sensors(structure)
    on_bars = {point for bar in structure.bar for point in bar.points}
    return [
        StructureUncertain(name=f"{PLACE}{named[k][0]}", kind="place", sd=sd, edit=_beside(k), beside=i)
        for i, k in enumerate(sensors)
        if k is not None and named[k][1].at in on_bars
    ]


def _stiffness(name: str) -> Edit:
    def edit(structure: Structure, factor: float) -> Structure:
        old = structure.section[name]
        new = replace(
            old,
            bending_stiffness=old.bending_stiffness * factor,
            torsion_stiffness=old.torsion_stiffness * factor,
            shear_stiffness=old.shear_stiffness * factor,
        )
        return replace(structure, section={**structure.section, name: new})

    return edit


def _mass(name: str) -> Edit:
    def edit(structure: Structure, factor: float) -> Structure:
        old = structure.section[name]
        new = replace(
            old,
            mass_per_length=old.mass_per_length * factor,
            polar_inertia_per_length=old.polar_inertia_per_length * factor,
        )
        return replace(structure, section={**structure.section, name: new})

    return edit


def _fittings(structure: Structure, factor: float) -> Structure:
    return replace(
        structure,
        mass=tuple(replace(m, mass=m.mass * factor, rotary_inertia=m.rotary_inertia * factor) for m in structure.mass),
        clamp=tuple(replace(c, mass=c.mass * factor) for c in structure.clamp),
        coil=tuple(replace(c, mass=c.mass * factor) for c in structure.coil),
    )


def _tension(structure: Structure, factor: float) -> Structure:
    return replace(
        structure, cable=tuple(replace(c, tension=c.tension * factor) if c.tension else c for c in structure.cable)
    )


def _plates(structure: Structure, factor: float) -> Structure:
    return replace(structure, plate=tuple(replace(p, weight_moment=p.weight_moment * factor) for p in structure.plate))


def _cables(structure: Structure, factor: float) -> Structure:
    return replace(structure, cable=tuple(replace(c, density=c.density * factor) for c in structure.cable))


def _inertia(structure: Structure, factor: float) -> Structure:
    # a separate parameter: a mode of plates alone would follow the fittings' error
    return replace(
        structure,
        plate=tuple(
            replace(
                p,
                inertia_about_beam=p.inertia_about_beam * factor,
                inertia_about_vertical=p.inertia_about_vertical * factor,
            )
            for p in structure.plate
        ),
    )


def _damping(mode: int | None) -> Edit:
    def edit(structure: Structure, factor: float) -> Structure:
        damping = structure.damping
        ratios = tuple(z * (factor if mode in (None, i) else 1.0) for i, z in enumerate(damping.ratios))
        higher = damping.higher * (factor if mode is None else 1.0)
        return replace(structure, damping=replace(damping, ratios=ratios, higher=higher))

    return edit


def _frequency(mode: int) -> Edit:
    def edit(structure: Structure, factor: float) -> Structure:
        tuning = structure.tuning or Tuning()
        old = tuning.frequencies
        factors = [*old, *(1.0 for _ in range(mode + 1 - len(old)))]
        factors[mode] *= factor
        return replace(structure, tuning=replace(tuning, frequencies=tuple(factors)))

    return edit


def _beside(sensor: int) -> Edit:
    def edit(structure: Structure, distance: float) -> Structure:
        tuning = structure.tuning or Tuning()
        old = [*tuning.beside, *(0.0 for _ in range(sensor + 1 - len(tuning.beside)))]
        old[sensor] += distance
        return replace(structure, tuning=replace(tuning, beside=tuple(old)))

    return edit


def edited(structure: Structure, parameters: Sequence[Uncertain], theta: Array) -> Structure:
    """Return a structure at given log factors, without gains."""
    for parameter, value in zip(parameters, theta, strict=True):
        if isinstance(parameter, StructureUncertain):
            structure = parameter.applied(structure, float(value))
    return structure


def adjusted_structure(
    structure: Structure, plant: Plant, variant: str, parameters: Sequence[Uncertain], theta: Array
) -> Plant:
    """Return a structure's plant at given log factors.

    Coil gains multiply the gear of the coils' controls.

    Parameters
    ----------
    structure : Structure
        Nominal structure.
    plant : Plant
        Nominal plant.
    variant : str
        Variant of the model.
    parameters : sequence of Uncertain
        Uncertain parameters.
    theta : (n_parameters,) array
        Log factors; of positions the distance [m].

    Returns
    -------
    Plant
        Rebuilt plant.
    """
    out = build_plant(edited(structure, parameters, theta), plant.name, variant).with_physics_of(plant)
    for parameter, value in zip(parameters, theta, strict=True):
        if parameter.actuator is not None:
            for control in out.actuators[parameter.actuator].controls:
                out.model.actuator_gear[control] *= float(np.exp(value))
    return out


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
    reduced_model: ReducedModel, plant: Plant, structure: Structure, parameters: Sequence[Uncertain], theta: Array
) -> Array:
    """Return log factors that give a rebuilt plant the reduced model's frequencies.

    Parameters
    ----------
    reduced_model : ReducedModel
        Reduced model.
    plant : Plant
        Plant rebuilt at `theta`.
    structure : Structure
        Nominal structure.
    parameters : sequence of Uncertain
        Uncertain parameters.
    theta : (n_changes,) array
        Log factors of the reduced model.

    Returns
    -------
    (n_changes,) array
        Log factors for the plant.
    """
    linear = plant.linearise()
    M, _, K, *_ = (part[0] for part in reduced_model.matrices(theta[None]))
    squares, modal = linalg.eigh(K, M)
    shapes = linear.eigen[1]
    same = np.argmax(np.abs((reduced_model.shapes @ modal).T @ linear.M @ shapes), axis=1)
    step = structure.tuning.at_step if structure.tuning is not None and structure.tuning.at_step else plant.timestep
    mass, _, stiffness = (np.diag(added) for added in as_stepped(plant, linear, shapes[:, same], step))
    shown = (linear.eigen[0][same] ** 2 + stiffness) / (1.0 + mass)
    driven = list(driven_modes(plant.port_rows(structure.coil_places) @ shapes))
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
