"""Refinement of an initial state on the model itself."""

from dataclasses import replace

import numpy as np

from vlab.cases.linear_start import StartProblem
from vlab.cases.replay import play
from vlab.cases.replay_bench import Bench, bench_for
from vlab.errors import Diverged
from vlab.signals import Array

REFINEMENTS, HALVINGS = 8, 4
"""REFINEMENTS [1]: largest number of Gauss-Newton iterations.
HALVINGS [1]: largest number of times that a step without gain is halved."""


def window_residual(problem: StartProblem, x: Array, offset: Array, bench: Bench | None = None) -> Array:
    """Return the weighted residual of a window.

    Parameters
    ----------
    problem : StartProblem
        Model and window.
    x : (2 m,) array
        Coordinates of the initial state.
    offset : (n_channels,) array
        Values of the channels at rest.
    bench : Bench, optional
        Bench of the simulation; that of the problem by default.

    Returns
    -------
    (samples * n_channels,) array
        Residual.

    Raises
    ------
    Diverged
        The simulation diverges.
    """
    run, clock = problem.run, problem.clock
    replayed = play(bench or problem.bench, run, clock, problem.state(x), None)
    time = run.measured.time - run.measured.time[0]
    model = np.column_stack([replayed.at(time, clock, i) for i in range(len(run.compared))])
    return np.asarray(((model - offset - problem.measured) * problem.weight).ravel())


def refine(problem: StartProblem, x: Array, left: Array, offset: Array) -> tuple[Array, Array]:
    """Improve the linear estimate by Gauss-Newton iterations.

    A Jacobian takes a simulation per state. The first one is that of the plant without attached effects, which runs in
    MuJoCo's own loop, and Broyden's rank-one updates keep it. After a step without gain, the Jacobian of the model itself
    is computed, and its steps are halved until they gain. A failed iteration keeps the preceding estimate.

    Parameters
    ----------
    problem : StartProblem
        Model and window.
    x : (2 m,) array
        First estimate.
    left : array
        Its residual.
    offset : (n_channels,) array
        Values of the channels at rest.

    Returns
    -------
    tuple of (array, array)
        Estimate and its residual.
    """
    try:
        slopes, is_exact = _first_slopes(problem, x, left, offset)
        for _ in range(REFINEMENTS):
            if not np.any(left):  # a recording of the model itself
                break
            held = problem.held * np.eye(x.size)
            rows, wanted = np.vstack([slopes, held]), np.concatenate([left, problem.held * x])
            step = -np.linalg.lstsq(rows, wanted, rcond=1e-9)[0]
            try:
                step, trial = _gaining(problem, x, step, left, offset, halvings=HALVINGS if is_exact else 0)
            except Diverged:
                if is_exact:
                    break
                slopes, is_exact = _slopes(problem, x, left, offset, problem.bench), True
                continue
            gained = 1.0 - float(trial @ trial) / float(left @ left)
            if not gained > 0 and is_exact:
                break
            if not gained > 0:
                slopes, is_exact = _slopes(problem, x, left, offset, problem.bench), True
                continue
            slopes, is_exact = slopes + np.outer(trial - left - slopes @ step, step) / float(step @ step), False
            x, left = x + step, trial
            if gained < 1e-3:
                break
    except Diverged:
        pass  # the step was too long; the preceding estimate stands
    return x, left


def _gaining(
    problem: StartProblem, x: Array, step: Array, left: Array, offset: Array, *, halvings: int
) -> tuple[Array, Array]:
    """Return a step, halved until it gains, and its residual."""
    for halved in range(halvings + 1):
        try:
            trial = window_residual(problem, x + step, offset)
        except Diverged:
            if halved == halvings:
                raise
        else:
            if halved == halvings or float(trial @ trial) < float(left @ left):
                break
        step = step / 2
    return step, trial


def _first_slopes(problem: StartProblem, x: Array, left: Array, offset: Array) -> tuple[Array, bool]:
    """Return a Jacobian of the residual, and whether it is exact."""
    plant = problem.bench.plant
    if plant.physics:
        bare = bench_for(replace(plant, physics=()), problem.run)
        try:
            return _slopes(problem, x, window_residual(problem, x, offset, bare), offset, bare), False
        except Diverged:  # effects may stabilise a plant
            pass
    return _slopes(problem, x, left, offset, problem.bench), True


def _slopes(problem: StartProblem, x: Array, left: Array, offset: Array, bench: Bench) -> Array:
    """Return the residual's Jacobian by finite differences, (n_residuals, n_states)."""
    step = 1e-4 * max(float(np.abs(x).max()), 1e-9 if problem.origin is None else 0.1)
    moved = x + step * np.eye(x.size)
    return np.column_stack([(window_residual(problem, point, offset, bench) - left) / step for point in moved])
