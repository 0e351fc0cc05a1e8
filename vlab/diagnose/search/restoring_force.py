"""Estimated restoring force along the recorded motion."""

from typing import Any

import numpy as np

from vlab.diagnose.inference.trajectory_score_test import TrajectoryScoreTest
from vlab.diagnose.parameters.mjcf import relative_changes
from vlab.diagnose.parameters.terms import Fit, Term
from vlab.diagnose.predictors.trajectory import pad_and_stack
from vlab.diagnose.predictors.unit_effects import forces_on_trajectory
from vlab.physics.effect import LinearPortEffect, PortEffect
from vlab.signals import Array


def estimate_restoring_force(
    screen: TrajectoryScoreTest, fit: Fit, term: Term
) -> tuple[Array, Array, Array, Array, Any]:
    """Estimate the missing force at a term's location.

    The force moves the smoothed state from sample to sample beyond the calibrated model. Other fitted effects are
    subtracted. Of a body the coordinate of largest motion is returned.

    Parameters
    ----------
    screen : TrajectoryScoreTest
        Screening along the motion.
    fit : Fit
        Fit with the term.
    term : Term
        Term whose location is evaluated.

    Returns
    -------
    force, z, v, a : (n - 1, n_runs) array
        Force, displacement, velocity and acceleration at mid-step [SI].
    command : (n - 1, n_runs) array or float
        Command at the location.
    """
    s = screen.stack
    x = screen.smooth
    left = s.defect[:-1] + x[1:] - np.einsum("krab,krb->kra", s.A[:-1], x[:-1])
    required = np.einsum("kran,kra->krn", s.G[:-1], left)
    gram = np.einsum("kran,kram->krnm", s.G[:-1], s.G[:-1])
    dead = ~(s.alive[1:] & s.alive[:-1])
    gram[dead] = np.eye(gram.shape[-1])
    required = np.linalg.solve(gram, required[..., None])[..., 0]
    own = relative_changes(screen.problem.parameters, fit.theta - screen.theta)
    required = required - screen.changes[:-1] @ own
    for other in fit.terms:
        if other is not term and other.effect.kind == "port":
            rows, force = _law(screen, other)
            required = required - np.einsum("lkr,lkrn->krn", force, rows)
    rows, z, v, a = _along(screen, term)
    most = int(np.argmax(np.abs(z).max(axis=(1, 2))))
    row = rows[most]
    size = np.maximum(np.einsum("krn,krn->kr", row, row), 1e-300)
    command = screen.groups[0].u[:-1, :, term.place.coil] if term.place.coil is not None else 0.0
    return np.einsum("krn,krn->kr", required, row) / size, z[most], v[most], a[most], command


def _along(screen: TrajectoryScoreTest, term: Term) -> tuple[Array, Array, Array, Array]:
    """Return a location's rows and smoothed motion at mid-step."""
    lines, nv = screen.lines_of(term.place), screen.reduced_model.m
    x = screen.smooth
    rates = pad_and_stack([a.motion.v for a in screen.systems]) + x[..., nv:]
    z = lines.z + np.einsum("lkrn,krn->lkr", lines.rows, x[..., :nv])
    v = np.einsum("lkrn,krn->lkr", lines.rows, rates)
    h = np.where(screen.stack.h > 0, screen.stack.h, 1.0)[:-1]
    middle = 0.5 * (lines.rows[:, 1:] + lines.rows[:, :-1])
    return middle, 0.5 * (z[:, 1:] + z[:, :-1]), 0.5 * (v[:, 1:] + v[:, :-1]), np.diff(v, axis=1) / h


def _law(screen: TrajectoryScoreTest, term: Term) -> tuple[Array, Array]:
    rows, z, v, a = _along(screen, term)
    if isinstance(term.effect, LinearPortEffect):
        mass, damping, stiffness = term.effect.impedance(term.values, term.place.stiffness)
        weight = screen.lines_of(term.place).weight[:, None, None]
        return rows, np.asarray(-(mass * (a - weight) + damping * v + stiffness * z))
    assert isinstance(term.effect, PortEffect)
    command = screen.groups[0].u[:-1, :, term.place.coil] if term.place.coil is not None else 0.0
    t = pad_and_stack([c.time for c in screen.moving.trajectories])[:-1] + 0.5 * screen.stack.h[:-1]
    return rows[:1], forces_on_trajectory(term.effect, z[0], v[0], dict(term.values), screen.stack.h[:-1], t, command)[
        None
    ]
