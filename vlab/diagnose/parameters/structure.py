"""Uncertain parameters of a structure, and adjusted plants.

Parameters concern sections, fittings, tension, damping and gains.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from vlab.diagnose.parameters.mjcf import Uncertain
from vlab.diagnose.settings import MJCF_PRIORS, STRUCTURE_PRIORS
from vlab.errors import unknown_name
from vlab.plants.base import Plant, named_sensors
from vlab.plants.build import build_plant
from vlab.signals import Array
from vlab.structure.discretisation import Tuning
from vlab.structure.model import Structure

Edit = Callable[[Structure, float], Structure]
"""Function of a structure and a factor, or of a structure and a sensor shift [m]."""
SCALED = ("stiffness", "mass", "tension", "gain")
"""Kinds that scale with the forces at equal motion."""
FREQUENCY, PLACE, COIL_PLACE = "frequency:mode", "place:", "place:coil:"
"""Prefixes of parameters for a mode's frequency, and for the positions of a sensor and of a coil."""
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
    pushed : int or None
        Shifted coil; the parameter is then a distance [m], too.
    """

    edit: Edit | None = None
    beside: int | None = None
    pushed: int | None = None

    @property
    def is_distance(self) -> bool:
        """Whether the parameter is a distance [m] instead of a log factor."""
        return self.beside is not None or self.pushed is not None

    def applied(self, structure: Structure, value: float) -> Structure:
        """Return a structure at a log factor or distance of the parameter."""
        if self.edit is None or value == 0.0:
            return structure
        return self.edit(structure, value if self.is_distance else float(np.exp(value)))


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
    if structure.has_modes_of_fe:
        usual["frequency"] = STRUCTURE_PRIORS.of_fe_sd
    sd = {kind: given.get(kind, default) for kind, default in usual.items()}
    out = [*_sections(structure, sd), *_masses_and_tensions(structure, sd), *_dampings(structure, sd["damping"])]
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
    if structure.has_modes_of_fe:
        out += _places(structure, sensors, sd["place"])
        out += _coil_places(structure, actuators, sd["place"])
        out += _spans(structure, sd)
    unknown = [name for name in given if ":" in name and name not in {p.name for p in out}]
    if unknown:
        raise unknown_name("parameter", unknown[0], [p.name for p in out], where="[model.uncertain]")
    return [replace(p, sd=given.get(p.name, p.sd)) for p in out]


def _sections(structure: Structure, sd: Mapping[str, float]) -> Iterator[StructureUncertain]:
    """Yield stiffness and mass of every section."""
    for name, section in structure.section.items():
        edit = _stiffness(name)
        yield StructureUncertain(name=f"section:{name}:stiffness", kind="stiffness", sd=sd["stiffness"], edit=edit)
        if section.mass_per_length > 0:
            yield StructureUncertain(name=f"section:{name}:mass", kind="mass", sd=sd["mass"], edit=_mass(name))


def _masses_and_tensions(structure: Structure, sd: Mapping[str, float]) -> Iterator[StructureUncertain]:
    """Yield the parameters of fittings, cables and plates that the structure has."""
    cables = structure.cable
    for is_there, name, kind, edit in (
        (structure.mass or structure.clamp or structure.coil, "fittings:mass", "mass", _fittings),
        (any(cable.tension for cable in cables), "tension", "tension", _tension),
        (any(cable.density for cable in cables), "cables:mass", "mass", _cables),
        (structure.plate, "plates:weight", "tension", _plates),
        (structure.plate, "plates:inertia", "mass", _inertia),
    ):
        if is_there:
            yield StructureUncertain(name=name, kind=kind, sd=sd[kind], edit=edit)


def _dampings(structure: Structure, sd: float) -> Iterator[StructureUncertain]:
    """Yield the factors on all damping ratios and on each."""
    yield StructureUncertain(name=ALL_DAMPING, kind="damping", sd=MJCF_PRIORS.common * sd, edit=_damping(None))
    for i in range(len(structure.damping.ratios)):
        name = f"{ALL_DAMPING}:mode{i + 1}"
        yield StructureUncertain(name=name, kind="damping", sd=MJCF_PRIORS.own * sd, edit=_damping(i))


def _places(structure: Structure, sensors: Sequence[int | None], sd: float) -> list[StructureUncertain]:
    """Return position parameters of the sensors on bars."""
    named = named_sensors(structure)
    on_bars = {point for bar in structure.bar for point in bar.points}
    return [
        StructureUncertain(name=f"{PLACE}{named[k][0]}", kind="place", sd=sd, edit=_beside("beside", k), beside=i)
        for i, k in enumerate(sensors)
        if k is not None and named[k][1].at in on_bars
    ]


def _coil_places(structure: Structure, actuators: Sequence[int], sd: float) -> list[StructureUncertain]:
    """Return position parameters of the driven coils on bars."""
    on_bars = {point for bar in structure.bar for point in bar.points}
    return [
        StructureUncertain(
            name=f"{COIL_PLACE}{coil.name}", kind="place", sd=sd, edit=_beside("coils_beside", i), pushed=i
        )
        for i, coil in enumerate(structure.coil)
        if i in actuators and coil.at in on_bars
    ]


def _spans(structure: Structure, sd: Mapping[str, float]) -> list[StructureUncertain]:
    """Return parameters of the stiffness and the mass between neighbouring points of the bars.

    Equal arms are a stationary point of the residual: how they couple the modes is of second order in their difference.
    The search therefore begins with uneven spans.
    """
    uneven = STRUCTURE_PRIORS.uneven
    return [
        StructureUncertain(
            name=f"{bar.name}:{a}-{b}:{what}",
            kind=f"span-{what}",
            sd=sd[f"span-{what}"],
            edit=_span(bar.name, a, b, what),
            start=(-1) ** k * uneven * sd["span-stiffness"] if what == "stiffness" else 0.0,
        )
        for bar in structure.bar
        for k, (a, b) in enumerate(pairwise(bar.points))
        for what in ("stiffness", "mass")
    ]


def _span(bar: str, a: str, b: str, what: str) -> Edit:
    def edit(structure: Structure, factor: float) -> Structure:
        old = structure.deviation(bar, a, b)
        new = replace(old, **{what: getattr(old, what) * factor})
        return replace(structure, span=(*(s for s in structure.span if s is not old), new))

    return edit


def _stiffness(name: str) -> Edit:
    def edit(structure: Structure, factor: float) -> Structure:
        old = structure.section[name]
        return replace(structure, section={**structure.section, name: old.scaled(stiffness=factor)})

    return edit


def _mass(name: str) -> Edit:
    def edit(structure: Structure, factor: float) -> Structure:
        old = structure.section[name]
        return replace(structure, section={**structure.section, name: old.scaled(mass=factor)})

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


def _beside(key: str, index: int) -> Edit:
    """Return the edit that moves a sensor or coil along its bar."""

    def edit(structure: Structure, distance: float) -> Structure:
        tuning = structure.tuning or Tuning()
        old = [*getattr(tuning, key)]
        old += [0.0] * (index + 1 - len(old))
        old[index] += distance
        moved: dict[str, Any] = {key: tuple(old)}
        return replace(structure, tuning=replace(tuning, **moved))

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
