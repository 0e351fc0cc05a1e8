"""Identifiable and unidentifiable directions of uncertain parameters."""

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
from scipy import linalg

from vlab.diagnose.data.runs import Signals
from vlab.diagnose.inference.score_test import ScoreTest
from vlab.diagnose.parameters.reduced_model import ReducedModel
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.settings import FIT
from vlab.signals import Array


class Probed(Protocol):
    """Protocol of simulated runs, as of `vlab.diagnose.inference.least_squares.LeastSquares`."""

    screen: ScoreTest
    reduced_model: ReducedModel
    runs: list[Signals]
    sigma: Array

    def first_state(self, run: Signals) -> Array:
        """Return a run's smoothed initial modal state (2m,)."""

    def simulate(
        self,
        runs: list[Signals],
        terms: Sequence[Term],
        theta: Array,
        values: Sequence[Mapping[str, Array]],
        starts: Array,
    ) -> Array:
        """Return the channels (n, n_sets, n_runs, n_channels) of parameter sets."""


def information(of: Probed) -> tuple[Array, int]:
    """Return the information of runs on the uncertain parameters.

    Every parameter is moved by a part of its prior standard deviation in a simulation.

    Parameters
    ----------
    of : Probed
        Simulated runs.

    Returns
    -------
    gram : (n, n) array
        Sum of squared normalised changes of the channels per prior standard deviation of the parameters.
    samples : int
        Number of summed values.
    """
    sd, n = of.reduced_model.prior, len(of.reduced_model.prior)
    theta = np.vstack([of.screen.theta, of.screen.theta + FIT.probe * np.diag(sd)])
    starts = np.zeros((n + 1, len(of.runs), 2 * of.reduced_model.m))
    for i, run in enumerate(of.runs):
        if not run.at_rest:
            starts[:, i] = of.first_state(run)
    gram, samples = np.zeros((n, n)), 0
    for h in sorted({run.h for run in of.runs}):
        index = [i for i, run in enumerate(of.runs) if run.h == h]
        y = of.simulate([of.runs[i] for i in index], (), theta, (), starts[:, index])
        for j, i in enumerate(index):
            run = of.runs[i]
            part = y[: len(run), :, j] / of.sigma[i]
            columns = ((part[:, 1:] - part[:, :1]) / FIT.probe).transpose(0, 2, 1).reshape(-1, n)
            gram += columns.T @ columns
            samples += run.y.size
    return gram, samples


def identifiable_subspace(gram: Array, samples: int, sd: Array, unknown: Array) -> tuple[Array, Array]:
    """Return the identifiable and the unidentifiable directions.

    Directions that move the channels little, relative to noise and model error, stay at the prior mean.

    Parameters
    ----------
    gram : (n, n) array
        Sum of squared normalised changes of the channels per prior standard deviation of the parameters.
    samples : int
        Number of summed values.
    sd : (n,) array
        Prior standard deviations.
    unknown : (k, n) array
        Directions that no recording can inform, in prior standard deviations.

    Returns
    -------
    identifiable : (n, r) array
        Directions of unit prior variance, the best informed first.
    unidentifiable : (n, n - r) array
        All others.
    """
    if len(unknown):  # apparent information there is derivative error
        known = linalg.null_space(unknown)
        gram = known @ (known.T @ gram @ known) @ known.T
    size, vectors = np.linalg.eigh(gram / samples)
    order = np.argsort(-size)[: FIT.most_directions]
    keep = order[np.sqrt(np.maximum(size[order], 0.0)) > FIT.informed]
    return np.asarray(sd[:, None] * vectors[:, keep]), sd[:, None] * np.delete(vectors, keep, axis=1)
