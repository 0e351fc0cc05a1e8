"""Restoring force of a missing effect, with and without law."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from vlab.diagnose.inference.trajectory_score_test import TrajectoryScoreTest
from vlab.diagnose.parameters.discrete import discretise
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.pipeline import Diagnosed
from vlab.diagnose.predictors.innovations import Group
from vlab.diagnose.predictors.unit_effects import port_series
from vlab.diagnose.search.restoring_force import estimate_restoring_force
from vlab.physics.effect import ActuatorEffect, LinearPortEffect, PortEffect, SensorEffect
from vlab.signals import Array

SHOWN = 400
"""SHOWN [samples]: length of the stretch drawn over time."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Missing:
    """Fitted law of a finding along the fit recordings.

    Parameters
    ----------
    curves : tuple of (name, unit, x, free, law)
        Variable of the law, estimate without a law (or None), and law, one value per sample.
    label : str
        Quantity and unit of the law.
    series : (time [s], law, free or None)
        Stretch of one recording.
    words : str
        Explanation of the figure.
    """

    curves: tuple[tuple[str, str, Array, Array | None, Array], ...]
    label: str
    series: tuple[Array, Array, Array | None]
    words: str


def restoring_force(done: Diagnosed, term: Term) -> Missing:
    """Return the action of a fitted effect.

    Parameters
    ----------
    done : Diagnosed
        Completed diagnosis.
    term : Term
        Fitted effect at its place.

    Returns
    -------
    Missing
        Law and estimate.
    """
    if isinstance(term.effect, ActuatorEffect):
        return _at_actuator(done, term, term.effect)
    if isinstance(term.effect, SensorEffect):
        return _at_sensor(done, term, term.effect)
    return _at_port(done, term)


def _at_port(done: Diagnosed, term: Term) -> Missing:
    force, length, moment = ("moment", "rad", "N m") if term.place.angular else ("force", "m", "N")
    parts: list[tuple[Array, Array, Array, Array]] = []
    for group in done.found.screen.groups:
        free, z, v, a, u = _motion(done, group, term)
        law = _along(term, z, v, a, u, group)
        for i, count in enumerate(group.lengths):
            keep = slice(group.first, int(count) - 1)
            parts.append((z[keep, i], v[keep, i], free[keep, i], law[keep, i]))
    z, v, free, law = (np.concatenate([p[k] for p in parts]) for k in range(4))
    loudest = max(parts, key=lambda p: float(np.abs(p[3]).max(initial=0.0)))
    h = done.found.screen.groups[0].h
    keep = _around(loudest[3])
    return Missing(
        curves=(
            ("displacement" if length == "m" else "angle", length, z, free, law),
            ("velocity" if length == "m" else "angular velocity", f"{length}/s", v, free, law),
        ),
        label=f"{force} [{moment}]",
        series=(np.arange(len(loudest[3]))[keep] * h, loudest[3][keep], loudest[2][keep]),
        words=f"The {force} of {term.effect.name} at {term.place.name} along the smoothed motion of the fit recordings (colour), and the {force} "
        "estimated there without a law (grey, with medians). The estimate is noisy, and shrinks towards zero where the sensors see little.",
    )


def _motion(done: Diagnosed, group: Group, term: Term) -> tuple[Array, Array, Array, Array, Any]:
    """Return estimated force, motion and command at a port.

    The force takes the smoothed state from one sample to the next, beyond the calibrated model under known forces.
    Modal forces are projected on the row of the port. Forces of other fitted effects are subtracted.
    """
    screen, reduced_model = done.found.screen, done.problem.reduced_model
    if isinstance(screen, TrajectoryScoreTest):
        return estimate_restoring_force(screen, done.fit, term)
    M, C, K, gain, _ = (part[0] for part in reduced_model.matrices(done.fit.theta[None]))
    system = discretise(M[None], C[None], K[None], np.eye(reduced_model.m), reduced_model.rows, group.h)
    known = group.forces + group.u @ (reduced_model.forces * gain - screen.now.forces).T
    x, m = group.smoothed.x, reduced_model.m
    asked = (x[1:] - x[:-1] @ system.A[0].T) @ np.linalg.pinv(system.B[0]).T - known[:-1]
    middle, rate = 0.5 * (x[1:] + x[:-1]), np.diff(x[..., m:], axis=0) / group.h

    def port(other: Term) -> tuple[Array, Array, Array, Array, Any]:
        row = other.place.rows[int(np.argmax(np.abs(other.place.rows).sum(axis=1)))]
        command = group.u[:-1, :, other.place.coil] if other.place.coil is not None else 0.0
        return row, middle[..., :m] @ row, middle[..., m:] @ row, rate @ row, command

    for other in done.fit.terms:
        if other is not term and other.effect.kind == "port":
            row, z, v, a, u = port(other)
            asked = asked - _along(other, z, v, a, u, group)[..., None] * row
    row, z, v, a, u = port(term)
    return asked @ row / float(row @ row), z, v, a, u


def _along(term: Term, z: Array, v: Array, a: Array, command: Any, group: Group) -> Array:
    if isinstance(term.effect, LinearPortEffect):
        mass, damping, stiffness = term.effect.impedance(term.values, term.place.stiffness)
        return np.asarray(-(mass * a + damping * v + stiffness * z))
    assert isinstance(term.effect, PortEffect)
    return port_series(term.effect, z, v, term.values, group.h, command, group.starts)


def _around(values: Array) -> slice:
    count = min(SHOWN, len(values))
    first = int(np.clip(int(np.argmax(np.abs(values))) - count // 2, 0, len(values) - count))
    return slice(first, first + count)


def _at_actuator(done: Diagnosed, term: Term, effect: ActuatorEffect) -> Missing:
    tap = done.problem.plant.actuators[term.place.index]
    unit = "" if tap.unit == "command" else tap.unit
    before, after, h = [], [], 1.0
    for group in done.found.screen.groups:
        h = group.h
        for i, count in enumerate(group.lengths):
            u = group.u[: int(count), i, term.place.index]
            before.append(u)
            stood = float(group.commands_before[i, term.place.index])
            after.append(np.asarray(effect.follow(u, term.values, h, stood)))
    return _changed(
        before,
        after,
        h,
        "command",
        unit,
        "what acts",
        f"What {effect.name} makes of the command of {tap.name}; grey: the command.",
    )


def _at_sensor(done: Diagnosed, term: Term, effect: SensorEffect) -> Missing:
    name = done.problem.names[term.place.index]
    channel = next(r.measured.channels[r.measured.index(name)] for r in done.problem.runs if name in r.measured.names)
    before, after, h = [], [], 1.0
    for group in done.found.screen.groups:
        h = group.h
        for i, count in enumerate(group.lengths):
            y = group.y[: int(count), i, term.place.index]
            after.append(y)
            before.append(np.asarray(effect.correct(y, term.values, h, group.times[: int(count), i])))
    words = f"What the sensor {name} would give without {effect.name} (grey), and what it gave."
    return _changed(before, after, h, "without the effect", channel.unit, "recorded", words)


def _changed(before: list[Array], after: list[Array], h: float, x: str, unit: str, y: str, words: str) -> Missing:
    loudest = int(np.argmax([np.abs(b - a).max(initial=0.0) for b, a in zip(before, after, strict=True)]))
    keep = _around(after[loudest] - before[loudest])
    all_before, all_after = np.concatenate(before), np.concatenate(after)
    return Missing(
        curves=((x, unit, all_before, None, all_after),),
        label=f"{y} [{unit or '-'}]",
        series=(np.arange(len(after[loudest]))[keep] * h, after[loudest][keep], before[loudest][keep]),
        words=words,
    )
