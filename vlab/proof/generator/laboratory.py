"""Beam and hanging grid on a fine mesh of `vlab.fe`.

The diagnosed plants come from the same FE code. New cases are made by `vlab.proof.generator.built_structure`, which
shares no code with the plants. This source remains because sealed cases must be regenerated bit for bit. The mesh is at
least three times as fine as those of the diagnosed models.
"""

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise

import numpy as np

from vlab.fe import build_fe_model
from vlab.fe.model import FeModel
from vlab.fe.statics import cable_tensions
from vlab.proof.generator.bench import Bench, Benign, Blueprint, Place, Sensor
from vlab.proof.generator.places import beside, neighbours, span_name
from vlab.signals import Array
from vlab.structure import load_structure
from vlab.structure.model import Bar, Structure

SD = {"stiffness": 0.02, "mass": 0.02, "damping": 0.2, "tension": 0.03, "gain": 0.02, "sensor": 0.005}
"""SD [-]: relative standard deviations of the built parameters, stated by the case."""
REFINE = {"beam": 3, "grid": 2}
"""REFINE [-]: refinement of the physical variant's four elements per span. The beam has 96 elements, a bar of the grid
8; the MuJoCo models have 16 links and 2."""
HIGHEST_HZ = {"beam": 400.0, "grid": 60.0}
"""HIGHEST_HZ [Hz]: highest integrated mode; commands and noise reach 45 Hz and 15 Hz."""
PLACE_SD = 1e-3
"""PLACE_SD [m]: standard deviation of a sensor height."""


def _edited(structure: Structure, factors: Mapping[str, float]) -> Structure:
    def factor(name: str) -> float:
        return float(np.exp(factors.get(name, 0.0)))

    sections = {
        name: replace(
            s,
            bending_stiffness=s.bending_stiffness * factor(f"stiffness:{name}"),
            torsion_stiffness=s.torsion_stiffness * factor(f"stiffness:{name}"),
            shear_stiffness=s.shear_stiffness * factor(f"stiffness:{name}"),
            mass_per_length=s.mass_per_length * factor(f"mass:{name}"),
            polar_inertia_per_length=s.polar_inertia_per_length * factor(f"mass:{name}"),
        )
        for name, s in structure.section.items()
    }
    fittings = factor("mass:fittings")
    damping = structure.damping
    ratios = tuple(r * factor("damping:all") * factor(f"damping:{i + 1}") for i, r in enumerate(damping.ratios))
    return replace(
        structure,
        section=sections,
        mass=tuple(replace(m, mass=m.mass * fittings) for m in structure.mass),
        coil=tuple(replace(c, mass=c.mass * fittings) for c in structure.coil),
        clamp=tuple(replace(c, mass=c.mass * fittings) for c in structure.clamp),
        cable=tuple(replace(c, tension=c.tension * factor("tension:all")) if c.tension else c for c in structure.cable),
        plate=tuple(replace(p, weight_moment=p.weight_moment * factor("tension:plates")) for p in structure.plate),
        damping=replace(damping, ratios=ratios, higher=damping.higher * factor("damping:all")),
    )


def _benign(structure: Structure) -> tuple[Benign, ...]:
    out = [Benign(name=f"stiffness:{name}", kind="stiffness", sd=SD["stiffness"]) for name in structure.section]
    out += [Benign(name=f"mass:{name}", kind="mass", sd=SD["mass"]) for name in structure.section]
    out.append(Benign(name="mass:fittings", kind="mass", sd=SD["mass"]))
    if structure.cable:
        out.append(Benign(name="tension:all", kind="tension", sd=SD["tension"]))
    if structure.plate:
        out.append(Benign(name="tension:plates", kind="tension", sd=SD["tension"]))
    out.append(Benign(name="damping:all", kind="damping", sd=SD["damping"]))
    out += [
        Benign(name=f"damping:{i + 1}", kind="damping", sd=SD["damping"]) for i in range(len(structure.damping.ratios))
    ]
    out += [Benign(name=f"gain:{c.name}", kind="gain", sd=SD["gain"]) for c in structure.coil]
    out += [
        Benign(name=f"sensor:{s.name}", kind="sensor", sd=SD["sensor"]) for s in (*structure.sensor, *structure.probe)
    ]
    return tuple(out)


def _slope(fe: FeModel, bar: Bar, point: str) -> Array:
    """Return the row of the slope along a bar at a point."""
    (x0, z0), (x1, z1) = (fe.structure.position(bar.points[i]) for i in (0, -1))
    length = np.hypot(x1 - x0, z1 - z0)
    node = 3 * fe.mesh.node(point)
    return np.asarray((x1 - x0) / length * fe.expand[node + 2] - (z1 - z0) / length * fe.expand[node + 1])


def _spans(fe: FeModel) -> dict[str, Place]:
    """Return the spans between points as places, by slope differences."""
    out: dict[str, Place] = {}
    for bar in fe.structure.bar:
        section = fe.structure.section[bar.section]
        for a, b in pairwise(bar.points):
            length = float(np.hypot(*np.subtract(fe.structure.position(a), fe.structure.position(b))))
            flexible = length - fe.structure.clamp_length(a) - fe.structure.clamp_length(b)
            out[span_name(fe.structure, bar, a, b)] = Place(
                row=_slope(fe, bar, b) - _slope(fe, bar, a),
                angular=True,
                stiffness=section.bending_stiffness / flexible,
                K=_bending(fe, bar, a, b),
                near=(a, b),
            )
    return out


def _bending(fe: FeModel, bar: Bar, a: str, b: str) -> Array:
    """Return the bending stiffness matrix of a span."""
    stations = [np.hypot(*np.subtract(fe.structure.position(p), fe.structure.position(bar.points[0]))) for p in (a, b)]
    low, high = min(stations) - 1e-6, max(stations) + 1e-6
    K = np.zeros((fe.linear.n, fe.linear.n))
    for e in fe.mesh.elements:
        if e.bar != bar.name or e.station < low or e.station + e.length > high:
            continue
        tx, tz = fe.mesh.direction(e)
        ends = [fe.expand[3 * node : 3 * node + 3] for node in (e.start, e.end)]
        v1, v2 = ends[0][0], ends[1][0]
        s1, s2 = (end[2] * tx - end[1] * tz for end in ends)
        L, EI = e.flexible, e.section.bending_stiffness
        v1, v2 = v1 + e.rigid_start * s1, v2 - e.rigid_end * s2
        chord = (v2 - v1) / L
        even, odd = s2 - s1, s1 + s2 - 2 * chord  # constant curvature, and linear curvature with zero in the middle
        K += EI / L * (np.outer(even, even) + 3 * np.outer(odd, odd))
    return K


def _built(name: str, factors: Mapping[str, float], shifts: Mapping[str, float], refine: int) -> Bench:
    structure = _edited(load_structure(name), factors)
    fe = build_fe_model(structure, "physical", refine=refine)
    tensions = cable_tensions(structure)
    coils = {c.at: c.name for c in structure.coil}
    places: dict[str, Place] = {}
    used = {node.name for node in fe.mesh.nodes}
    for point in structure.point:
        if point.name not in used or not np.any(fe.deflection(point.name)):
            continue
        cable = next((c for c in structure.cable if c.at == point.name), None)
        places[point.name] = Place(
            row=fe.deflection(point.name),
            stiffness=tensions[cable.name] / abs(cable.height) if cable else 0.0,
            alike=(cable.name,) if cable else (),
            near=neighbours(structure, point.name),
            actuator=coils.get(point.name, ""),
        )
    places |= {k: p for k, p in _spans(fe).items() if np.any(p.row)}
    places = beside(places)

    def factor(key: str) -> float:
        return float(np.exp(factors.get(key, 0.0)))

    actuators = {c.name: fe.deflection(c.at) * factor(f"gain:{c.name}") for c in structure.coil}
    sensors = {}
    for s in (*structure.sensor, *structure.probe):
        order = int(s.kind == "velocity")
        row = _shifted(fe, s.at, shifts.get(s.name, 0.0)) * factor(f"sensor:{s.name}")
        label = f"{'sensor' if order else 'probe'}:{s.name}"
        sensors[label] = Sensor(row=row, order=order, kind=s.kind, unit="m/s" if order else "m")
    return Bench(
        M=fe.linear.M, C=fe.linear.C, K=fe.linear.K, places=places, actuators=actuators, sensors=sensors
    ).in_modes(HIGHEST_HZ[name])


def _matrices(name: str, factors: Mapping[str, float], refine: int) -> tuple[Array, Array, Array]:
    linear = build_fe_model(_edited(load_structure(name), factors), "physical", refine=refine).linear
    return linear.M, linear.C, linear.K


def _shifted(fe: FeModel, at: str, shift: float) -> Array:
    """Return the deflection beside a point along its first bar."""
    bar = next((b for b in fe.structure.bar if at in b.points), None)
    if bar is None or shift == 0.0:
        return fe.deflection(at)
    return fe.deflection(at) + shift * _slope(fe, bar, at)


def _blueprint(name: str, title: str, **settings: object) -> Blueprint:
    structure = load_structure(name)
    return Blueprint(
        name=name,
        title=title,
        build=lambda factors, shifts: _built(name, factors, shifts, REFINE[name]),
        matrices=lambda factors: _matrices(name, factors, REFINE[name]),
        benign=_benign(structure),
        model={"structure": name, "plant": "composite", "variant": "physical"},
        uncertain=SD,
        input_kind="command",
        input_unit="N",
        place_sd=PLACE_SD,
        exciters=tuple(c.name for c in structure.coil),
        **settings,  # type: ignore[arg-type]
    )


def beam() -> Blueprint:
    """Return the beam: three coil velocities, one displacement probe, 2 kHz.

    The loudest recording moves the coils by 1.5 mm, within the linear range of 3.2 mm.
    """
    return _blueprint("beam", "Beam", rate_hz=2000.0, substeps=5, seconds=16.0, band_hz=(0.8, 45.0), force=0.04)


def grid() -> Blueprint:
    """Return the hanging grid: twelve joint and two plate velocities, 2 kHz.

    The largest motion is 3 mm.
    """
    return _blueprint(
        "grid", "Hanging grid", rate_hz=2000.0, substeps=5, seconds=20.0, band_hz=(0.3, 15.0), force=0.015
    )
