"""What is missing besides: a second screening with a fitted effect at work, on a filter that knows of it.

A wrong sensor or a strong force makes the first filter see everything in a bent mirror, and what is left of the innovations
beside its columns still does. So the effect is built in as it was fitted - into the twin's matrices, the commands, the
recordings, or as a known force along the smoothed motion - and the screening starts over.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from vlab.cases.playback import before
from vlab.diagnose.causes import port_series
from vlab.diagnose.group import Group
from vlab.diagnose.prepare import Problem
from vlab.diagnose.screen import Screen
from vlab.diagnose.signals import Signals
from vlab.diagnose.terms import Candidate, Fit, Term
from vlab.diagnose.twin import Twin
from vlab.physics.effect import ActuatorEffect, Effect, LinearPortEffect, PickUp, PortEffect, SensorEffect
from vlab.signals import Array

ZOOMED = 3
"""Candidates whose shapes are sought between the values of their grids, one a family."""
ROWS = 0.5
"""The second screening looks at this share of the first one's samples."""


def besides(
    screen: Screen, fit: Fit, effects: list[Effect], trust: float = 1.0, among: Collection[str] | None = None
) -> list[Candidate]:
    """Return every effect at every place by what it gains beside a fitted hypothesis, best first.

    Parameters
    ----------
    trust : float
        See `Screen`: a slower observer sees what only adds up over many cycles.
    among : collection of str or None
        Labels of the candidates to look at; all by default.
    """
    problem = with_effects(screen, fit)
    most = max(int(ROWS * len(run)) for run in screen.runs)
    runs = [run.first(most) for run in problem.in_role("fit")]
    second = Screen(problem, runs, like=screen, theta=fit.theta, trust=trust)
    table = second.candidates(effects, among=among)
    sharp = {c.label: second.zoomed(c) for c in best_of_families(table, fit.terms[0].effect.name)[:ZOOMED]}
    return [sharp.get(c.label, c) for c in table]


def best_of_families(table: Sequence[Candidate], first: str) -> list[Candidate]:
    """Return the best candidates of every family beside an effect, best first; at two places that is one effect, placed badly."""
    best: dict[str, Candidate] = {}
    for candidate in table:
        if candidate.effect.name != first:
            best.setdefault(candidate.effect.family, candidate)
    return list(best.values())


def with_effects(screen: Screen, fit: Fit) -> Problem:
    """Return a problem with a fitted hypothesis built in; its signals are the screening's runs."""
    problem, twin, runs = screen.problem, screen.twin, list(screen.runs)
    for term in fit.terms:
        if isinstance(term.effect, LinearPortEffect):
            twin = _stiffened(twin, term)
        elif isinstance(term.effect, ActuatorEffect):
            runs = [_actuated(run, term) for run in runs]
        elif isinstance(term.effect, SensorEffect):
            runs = [_corrected(run, term) for run in runs]
        else:
            twin = replace(twin, loads=np.hstack([twin.loads, term.place.rows[:1].T]))
            forces = {id(run): f for group in screen.groups for run, f in _forces(screen, group, term)}
            runs = [
                replace(now, load=np.hstack([now.load, forces[id(run)][: len(now), None]]))
                for now, run in zip(runs, screen.runs, strict=True)
            ]
    return replace(problem, twin=twin, signals=tuple(runs))


def _stiffened(twin: Twin, term: Term) -> Twin:
    assert isinstance(term.effect, LinearPortEffect)
    parts = term.effect.impedance({k: np.asarray(v) for k, v in term.values.items()}, term.place.stiffness)
    M, C, K = twin.M, twin.C, twin.K
    for row in term.place.rows:
        M, C, K = (x + float(part) * np.outer(row, row) for x, part in zip((M, C, K), parts, strict=True))
    return replace(twin, M=M, C=C, K=K)


def _actuated(run: Signals, term: Term) -> Signals:
    assert isinstance(term.effect, ActuatorEffect)
    u = run.u.copy()
    for i in term.place.indices:
        u[:, i] = term.effect.actuate(u[:, i], dict(term.values), run.h)
    return replace(run, u=u)


def _corrected(run: Signals, term: Term) -> Signals:
    assert isinstance(term.effect, SensorEffect)
    y, i, k = run.y.copy(), term.place.index, term.place.other
    if isinstance(term.effect, PickUp):
        other = before(run.u[:, k]) if term.place.tag == "command" else run.y[:, k]
        y[:, i] = 2 * y[:, i] - term.effect.mix(y[:, i], other, dict(term.values))  # small: taken off once
    else:
        y[:, i] = term.effect.correct(y[:, i], dict(term.values), run.h, run.t)
    return replace(run, y=y)


def _forces(screen: Screen, group: Group, term: Term) -> list[tuple[Signals, Array]]:
    """Return every run of a group with the force of a law along its smoothed motion, (n,)."""
    assert isinstance(term.effect, PortEffect)
    m, h, row = screen.twin.m, group.h, term.place.rows[0]
    z, v = group.smoothed.x[..., :m] @ row, group.smoothed.x[..., m:] @ row
    after = np.vstack([v[1:], v[-1:]])
    command = group.u[..., term.place.coil] if term.place.coil is not None else 0.0
    force = port_series(term.effect, z + 0.5 * h * v, 0.5 * (v + after), dict(term.values), h, command, group.starts)
    return [(run, force[:, i]) for i, run in enumerate(group.runs)]
