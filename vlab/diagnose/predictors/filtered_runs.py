"""Filtered and smoothed runs of one sample period."""

from collections.abc import Mapping, Sequence

import numpy as np

from vlab.diagnose.data.runs import Signals
from vlab.diagnose.parameters.discrete import discretise
from vlab.diagnose.parameters.locations import Place
from vlab.diagnose.parameters.reduced_model import ReducedModel
from vlab.diagnose.predictors.innovations import Group, impulses_of, middles
from vlab.diagnose.predictors.kalman import FilterGains, filter_gains, run_filter, stack_runs, start_covariance, tune
from vlab.diagnose.settings import KALMAN
from vlab.physics.effect import SensorEffect
from vlab.signals import Array


def filter_runs(
    runs: Sequence[Signals], reduced_model: ReducedModel, sensor_gain: Array, near: float, trust: float
) -> tuple[Group, float]:
    """Filter and smooth runs of one sample period.

    Parameters
    ----------
    runs : sequence of Signals
        Runs.
    reduced_model : ReducedModel
        Reduced model at its present parameters.
    sensor_gain : (p,) array
        Gains of the sensors.
    near : float
        Intensity near which to search [N^2/kg]; 0 for a full search.
    trust : float
        Factor on the intensity. With another factor than 1 a known intensity is kept.

    Returns
    -------
    group : Group
        Filtered runs.
    intensity : float
        Intensity without the factor [N^2/kg].
    """
    m, h = reduced_model.m, runs[0].h
    system = discretise(
        reduced_model.M[None], reduced_model.C[None], reduced_model.K[None], np.eye(m), reduced_model.rows, h
    )
    u, lengths = stack_runs(runs, [run.u for run in runs])
    load, _ = stack_runs(runs, [run.load for run in runs])
    y, _ = stack_runs(runs, [run.y / sensor_gain for run in runs])
    if reduced_model.read_commands is not None:
        y = y - stack_runs(runs, [run.seen for run in runs])[0] @ reduced_model.read_commands.T
    usable = None
    if any(run.valid is not None for run in runs):
        usable, _ = stack_runs(runs, [run.usable for run in runs])
    forces = u @ reduced_model.forces.T + load @ reduced_model.loads.T
    noise = np.sqrt(np.mean([run.noise**2 for run in runs], axis=0)) / sensor_gain
    if trust == 1.0:
        intensity, gains = tune(system, noise, forces, y, lengths, usable, near)
    else:
        intensity = near or tune(system, noise, forces, y, lengths, usable)[0]
        gains = filter_gains(system, noise, intensity * trust, start_covariance(system, y))
    if usable is None and all(run.at_rest for run in runs):  # a known start makes every sample count
        gains = FilterGains(K=gains.K[-1:], S=gains.S[-1:], P=gains.P[-1:])
    smoothed = run_filter(system, gains, forces, y, lengths, usable=usable)
    group = Group(list(runs), system, gains, smoothed, u, forces, y, lengths, usable, e=smoothed.e)
    group.motion = middles(reduced_model, group)
    group.first = min(_converged(gains), int(lengths.min()) // 4)
    group.white = np.linalg.inv(np.linalg.cholesky(gains.S[-1]))
    group.impulses = impulses_of(system, gains.K[-1], len(y))
    return group, intensity


def smoothed_without(
    groups: Sequence[Group], effects: Sequence[tuple[SensorEffect, Place, Mapping[str, float]]] = ()
) -> list[tuple[Signals, Array, Array]]:
    """Return every run with its smoothed states and channels.

    Parameters
    ----------
    groups : sequence of Group
        Filtered runs.
    effects : sequence of (SensorEffect, Place, mapping)
        Sensor effects to remove from the recordings first.

    Returns
    -------
    list of (Signals, (n, 2m) array, (n, n_channels) array)
        Run, smoothed modal states, and channels of unit gain.
    """
    out = []
    for group in groups:
        smoothed = group.smoothed
        if effects:
            y = group.y.copy()
            for effect, place, values in effects:
                y[..., place.index] = effect.correct(y[..., place.index], values, group.h, group.times)
            smoothed = run_filter(group.system, group.gains, group.forces, y, group.lengths, usable=group.usable)
        shown = smoothed.x @ group.system.C[0].T + group.forces @ group.system.D[0].T
        out += [(run, smoothed.x[: len(run), i], shown[: len(run), i]) for i, run in enumerate(group.runs)]
    return out


def _converged(gains: FilterGains) -> int:
    """Return the first sample whose innovations have nearly the stationary covariance."""
    steady = np.trace(gains.S[-1])
    converged = [i for i in range(len(gains.S)) if np.trace(gains.S[i]) < KALMAN.converged * steady]
    return converged[0] if converged else 0
