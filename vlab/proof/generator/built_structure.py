"""Beam and hanging grid as built, by an FE code of their own.

Stiffness and mass vary along the bars. Masses, cable lengths and positions of coils and sensors deviate one by one. The
nominal model has no parameters for these deviations. The case states what an engineer would state: rounded standard
deviations of sections, fittings, tension, damping and gains.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache, partial

import numpy as np
from scipy.optimize import linear_sum_assignment

from vlab.proof.generator.bench import Bench, Benign, Blueprint, Place, Sensor
from vlab.proof.generator.places import beside, neighbours, span_name
from vlab.proof.generator.statement import COLOURED, STRAY, WRONG
from vlab.proof.generator.structure_fe import BuiltStructure, Variation, assemble
from vlab.signals import Array
from vlab.structure import load_structure
from vlab.structure.model import Bar, Structure
from vlab.structure.model import Sensor as StatedSensor

STATED = {"stiffness": 0.03, "mass": 0.02, "damping": 0.3, "tension": 0.03, "gain": 0.01, "sensor": 0.01}
"""STATED [-]: relative standard deviations in the table of the case; rounded, and larger than those drawn."""
FREQUENCY = 0.003
"""FREQUENCY [-]: standard deviation of single natural frequencies that a calibration takes up, as `vlab diagnose` does
by default; nothing is drawn, because the deviations along the bars move the frequencies."""
DRAWN = {"stiffness": 0.02, "mass": 0.01, "tension": 0.02, "damping": 0.1, "mode": 0.17, "gain": 0.005, "sensor": 0.005}
"""DRAWN [-]: standard deviations of whole sections, tension, dampings and gains. ``damping`` is common to all modes and
``mode`` is of each, together 0.2."""
ALONG = {"stiffness": 0.015, "density": 0.01}
"""ALONG [-]: standard deviations of local stiffness and mass along a bar, of rolled strip."""
WAVES = 5
"""WAVES [-]: cosines along a bar with equal variances."""
LUMP, HEIGHT, PLACE = 0.005, 0.003, 1e-3
"""LUMP, HEIGHT [-], PLACE [m]: standard deviations of a weighed mass, of the height of a cable and of the place of a
coil or sensor along its bar."""
HIGHEST_HZ = {"beam": 400.0, "grid": 60.0}
"""HIGHEST_HZ [Hz]: highest integrated mode; commands and noise reach 45 Hz and 15 Hz."""
DAMPED = 4.0
"""DAMPED [-]: range of modes with damping, over the highest integrated one."""
SILENT = 1e-6
"""SILENT [-]: motion at the coils, over the largest of all modes, below which a mode has no measured damping ratio."""
NOISE_DB = (20.0, 60.0)
"""NOISE_DB [dB]: range of the ratio of signal to noise."""
FITS = 4
"""FITS [-]: fit recordings of a case."""
COMMAND_STEP = 1.0 / 2**15
"""COMMAND_STEP [-]: step of a converter with 16 bits, over its range. The range is four times the rms of the loudest
command."""
PER_PERIOD, REFIT = 6, 2.0
"""PER_PERIOD, REFIT [-]: samples per period of the highest excited frequency in the calibration, and its highest mode
over that frequency. Both sides of a difference are thinned alike."""
LOUDEST = 2.5
"""LOUDEST [-]: bound of the levels of a plan."""


def _local(structure: Structure) -> list[Benign]:
    """Return the deviations that are not parameters of the nominal model."""
    sd = {kind: value * np.sqrt(2.0 / WAVES) for kind, value in ALONG.items()}
    names = {f"along:{kind}:{bar.name}:{j + 1}": sd[kind] for kind in sd for bar in structure.bar for j in range(WAVES)}
    for kind, parts in (("mass", structure.mass), ("coil", structure.coil), ("clamp", structure.clamp)):
        names |= {f"lump:{kind}:{part.name}": LUMP for part in parts}
    names |= {f"height:{cable.name}": HEIGHT for cable in structure.cable}
    names |= {f"place:coil:{c.name}": PLACE for c in structure.coil}
    on_bars = {point for bar in structure.bar for point in bar.points}
    names |= {f"place:{_label(s)}": PLACE for s in (*structure.sensor, *structure.probe) if s.at in on_bars}
    return [Benign(name=name, kind="local", sd=float(value), stated=0.0) for name, value in names.items()]


def _benign(structure: Structure) -> tuple[Benign, ...]:
    def stated(name: str, kind: str, sd: float) -> Benign:
        return Benign(name=name, kind=kind, sd=sd, stated=STATED[kind])

    out = [stated(f"stiffness:{name}", "stiffness", DRAWN["stiffness"]) for name in structure.section]
    out += [stated(f"mass:{name}", "mass", DRAWN["mass"]) for name in structure.section]
    out.append(stated("mass:fittings", "mass", DRAWN["mass"]))
    if structure.cable:
        out.append(stated("mass:cables", "mass", DRAWN["mass"]))
        out.append(stated("tension:all", "tension", DRAWN["tension"]))
    if structure.plate:
        out.append(stated("mass:plates", "mass", DRAWN["mass"]))
        out.append(stated("tension:plates", "tension", DRAWN["tension"]))
    modes = range(1, len(structure.damping.ratios) + 1)
    out.append(stated("damping:all", "damping", DRAWN["damping"]))
    out += [stated(f"damping:{i}", "damping", DRAWN["mode"]) for i in modes]
    out += [Benign(name=f"frequency:{i}", kind="frequency", sd=0.0, stated=FREQUENCY) for i in modes]
    out += [stated(f"gain:{c.name}", "gain", DRAWN["gain"]) for c in structure.coil]
    out += [stated(f"sensor:{s.name}", "sensor", DRAWN["sensor"]) for s in (*structure.sensor, *structure.probe)]
    return (*out, *_local(structure))


def _label(sensor: StatedSensor) -> str:
    return f"{'sensor' if sensor.kind == 'velocity' else 'probe'}:{sensor.name}"


@lru_cache(maxsize=8)
def _structure(name: str) -> Structure:
    return load_structure(name)


@lru_cache(maxsize=8)
def _nominal(name: str) -> tuple[BuiltStructure, Array, Array]:
    """Return the nominal structure, its shapes, and their numbers.

    Coil-driven shapes count from 1, all others are 0.
    """
    fe = assemble(_structure(name), Variation({}))
    shapes = fe.modes(DAMPED * HIGHEST_HZ[name])[1]
    motion = np.abs(np.array([fe.rows[c.at][0] for c in fe.structure.coil]) @ shapes).max(axis=0)
    is_driven = motion > SILENT * motion.max()
    return fe, shapes, np.where(is_driven, np.cumsum(is_driven), 0)


def modal_properties(name: str, factors: Mapping[str, float]) -> tuple[BuiltStructure, Array, Array, Array]:
    """Return a structure as built with its modes and damping ratios.

    A mode has the measured ratio of the most similar nominal mode.

    Parameters
    ----------
    name : str
        Name of the structure.
    factors : mapping of str to float
        Deviations.

    Returns
    -------
    tuple of (BuiltStructure, (m,) array, (n, m) array, (m,) array)
        Structure, circular frequencies [rad/s], shapes of unit modal mass, damping ratios.
    """
    fe = assemble(_structure(name), Variation(factors))
    omega, shapes = fe.modes(DAMPED * HIGHEST_HZ[name])
    _, before, number = _nominal(name)
    alike = (before.T @ fe.M @ shapes) ** 2
    old, new = linear_sum_assignment(alike, maximize=True)
    of_mode = np.zeros(len(omega), dtype=int)
    of_mode[new] = number[old]
    damping, vary = fe.structure.damping, Variation(factors)
    zeta, omega = np.full(len(omega), damping.higher * vary.factor("damping:all")), omega.copy()
    for i, k in enumerate(of_mode):
        if 1 <= k <= len(damping.ratios):
            zeta[i] = damping.ratios[k - 1] * vary.factor("damping:all", f"damping:{k}")
            omega[i] *= vary.factor(f"frequency:{k}")
    return fe, omega, shapes, zeta


def _matrices(name: str, factors: Mapping[str, float]) -> tuple[Array, Array, Array]:
    fe, omega, shapes, zeta = modal_properties(name, factors)
    loads = fe.M @ shapes
    K = fe.K
    if any(key.startswith("frequency:") for key in factors):
        before = np.einsum("ij,ij->j", shapes, K @ shapes)
        K = K + (loads * (omega**2 - before)) @ loads.T
    return fe.M, (loads * (2 * zeta * omega)) @ loads.T, K


def _built(name: str, factors: Mapping[str, float], shifts: Mapping[str, float]) -> Bench:
    """Return the bench in its modes; `shifts` add to the places of the sensors."""
    fe, omega, shapes, zeta = modal_properties(name, factors)
    keep = omega < 2 * np.pi * HIGHEST_HZ[name]
    T, omega, zeta, structure = shapes[:, keep], omega[keep], zeta[keep], fe.structure
    vary = Variation(factors)

    def row(at: str, shift: float) -> Array:
        bar = next(b for b in structure.bar if at in b.points)
        return np.asarray(fe.rows[at][0] + shift * fe.slope(bar, at))

    actuators = {
        c.name: vary.factor(f"gain:{c.name}") * T.T @ row(c.at, factors.get(f"place:coil:{c.name}", 0.0))
        for c in structure.coil
    }
    sensors = {}
    for s in (*structure.sensor, *structure.probe):
        plate = next((p for p in structure.plate if p.name == s.at), None)
        if plate is None:
            seen = row(s.at, factors.get(f"place:{_label(s)}", 0.0) + shifts.get(s.name, 0.0))
        else:
            seen = fe.rows[plate.at][0] + plate.offset * fe.rows[plate.at][1]
        order = int(s.kind == "velocity")
        gain = vary.factor(f"sensor:{s.name}")
        sensors[_label(s)] = Sensor(row=gain * seen @ T, order=order, kind=s.kind, unit="m/s" if order else "m")
    M, C, K = np.eye(len(omega)), np.diag(2 * zeta * omega), np.diag(omega**2)
    return Bench(M=M, C=C, K=K, places=_places(fe, T), actuators=actuators, sensors=sensors, basis=T)


def _is_attached(structure: Structure, bar: Bar, point: str) -> bool:
    """Return whether a point of a bar has an attachment."""
    others = any(point in other.points for other in structure.bar if other.name != bar.name)
    held = [*(plate.at for plate in structure.plate), *(support.at for support in structure.support)]
    return others or point in held


def _places(fe: BuiltStructure, T: Array) -> dict[str, Place]:
    """Return points and spans as places in modal coordinates.

    The nominal model has no joints at bare points of a carrying bar, so that spans beside them are no places.
    """
    structure, places = fe.structure, {}
    coils = {c.at: c.name for c in structure.coil}
    for point, rows in fe.rows.items():
        cable = next((c for c in structure.cable if c.at == point), None)
        if np.any(rows[0]):
            places[point] = Place(
                row=rows[0] @ T,
                stiffness=fe.cable_stiffness[cable.name] if cable else 0.0,
                alike=(cable.name,) if cable else (),
                near=neighbours(structure, point),
                actuator=coils.get(point, ""),
            )
    for span in fe.spans:
        row = fe.slope(span.bar, span.end) - fe.slope(span.bar, span.start)
        shapes, ends = T[span.columns], (span.start, span.end)
        if np.any(row) and (not span.bar.carries or all(_is_attached(structure, span.bar, p) for p in ends)):
            places[span_name(structure, span.bar, span.start, span.end)] = Place(
                row=row @ T,
                angular=True,
                stiffness=span.stiffness,
                K=shapes.T @ span.bending @ shapes,
                near=ends,
            )
    near = beside(places)
    return {name: replace(p, near=tuple(x for x in p.near if x in near)) for name, p in near.items()}


def _blueprint(name: str, title: str, *, seconds: float, band_hz: tuple[float, float], force: float) -> Blueprint:
    structure = _structure(name)
    return Blueprint(
        name=name,
        title=title,
        build=partial(_built, name),
        matrices=partial(_matrices, name),
        benign=_benign(structure),
        model={"structure": name, "plant": "composite", "variant": "physical"},
        uncertain=STATED,
        rate_hz=2000.0,
        substeps=5,
        seconds=seconds,
        band_hz=band_hz,
        force=force,
        input_kind="command",
        input_unit="N",
        noise_db=NOISE_DB,
        fits=FITS,
        per_period=PER_PERIOD,
        refit_hz=REFIT * band_hz[1],
        command_step=COMMAND_STEP * 4 * LOUDEST * force,
        exciters=tuple(c.name for c in structure.coil),
        wrong=WRONG,
        coloured=COLOURED,
        stray=STRAY,
    )


def beam() -> Blueprint:
    """Return the beam: three coil velocities, one displacement probe, 2 kHz.

    The loudest recording moves the coils by 1.5 mm, within the linear range of 3.2 mm.
    """
    return _blueprint("beam", "Beam", seconds=12.0, band_hz=(0.8, 45.0), force=0.04)


def grid() -> Blueprint:
    """Return the hanging grid: twelve joint velocities, two plate displacements, 2 kHz.

    The largest motion is 3 mm.
    """
    return _blueprint("grid", "Hanging grid", seconds=16.0, band_hz=(0.3, 15.0), force=0.015)
