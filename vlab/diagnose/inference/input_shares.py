"""Shares of other inputs and a time skew in innovations."""

from collections.abc import Sequence

import numpy as np

from vlab.cases.timestamps import between_samples
from vlab.diagnose.data.runs import Signals
from vlab.diagnose.inference.score_test import ScoreTest
from vlab.diagnose.predictors.innovations import Group
from vlab.diagnose.predictors.kalman import stack_runs
from vlab.signals import Array


def input_shares(
    screen: ScoreTest, others: Sequence[Sequence[Signals]], skewed: Sequence[int] = (), skew_s: float = 0.0
) -> tuple[Array, float, float]:
    """Estimate other inputs and a time skew from the innovations.

    Parameters
    ----------
    screen : ScoreTest
        Screening.
    others : sequence of sequences of Signals
        The same runs with other inputs.
    skewed : sequence of int
        Channels with a common time skew.
    skew_s : float
        Unit of the skew [s].

    Returns
    -------
    shares : (n_others,) or (n_others + 1,) array
        Joint shares of the other inputs, and of the skew; 1 where they are correct.
    gain : float
        Log-likelihood gain [nat].
    explained : float
        Explained share of the residual [1].
    """
    by_name = [{s.name: s for s in signals} for signals in others]
    columns = np.concatenate([group.rows(_response(screen, group, by_name, skewed, skew_s)) for group in screen.groups])
    regression = screen.regression
    along = regression.nuisance.T @ columns
    normal, pull = regression.normal_matrix(columns, along), columns.T @ regression.base
    if not np.all(np.diag(normal) > 1e-12):
        return np.zeros(len(pull)), 0.0, 0.0
    shares = np.linalg.solve(normal + 1e-9 * np.diag(np.diag(normal)), pull)
    won, whole = float(pull @ shares), float(regression.base @ regression.base)
    return shares, 0.5 * won / regression.variance, won / max(whole, 1e-300)


def _response(
    screen: ScoreTest, group: Group, by_name: Sequence[dict[str, Signals]], skewed: Sequence[int], skew_s: float
) -> Array:
    """Return innovations (n, n_runs, p, k) of other inputs and a skew."""
    forces, readings = [], []
    for named in by_name:
        runs = [named[run.name].first(len(run)) for run in group.runs]
        y, _ = stack_runs(runs, [run.y / screen.sensor_gain for run in runs])
        forces.append(screen.input_difference(group, runs))
        readings.append(group.y - y)
    if skewed:
        forces.append(np.zeros_like(group.forces))
        readings.append(_moved(group.y, skewed, skew_s / group.h))
    left = screen.through(group, np.stack(forces, axis=-1), np.stack(readings, axis=-1))
    if skewed:  # of their own samples only the prediction counts
        left[..., -1] -= _moved(group.e, skewed, skew_s / group.h)
    return left


def _moved(y: Array, channels: Sequence[int], samples: float) -> Array:
    """Return the change of channels (n, n_runs, p) under a time skew."""
    out = np.zeros_like(y)
    for run in range(y.shape[1]):
        for channel in channels:
            out[:, run, channel] = y[:, run, channel] - between_samples(y[:, run, channel], -samples)
    return out
