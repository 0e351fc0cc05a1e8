"""Derivatives of what a fit in simulation leaves: by steps of every parameter, by what moves it alike, along what is known exactly."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from vlab.diagnose.data.runs import Signals
from vlab.diagnose.inference.parameter_vector import ParameterVector
from vlab.diagnose.settings import JACOBIAN
from vlab.signals import Array


class Simulated(Protocol):
    """What leaves a residual; see `vlab.diagnose.inference.least_squares.LeastSquares`."""

    runs: list[Signals]
    sigma: Array
    free_starts: dict[int, tuple[Array, Array, Array]]

    def residual(self, vector: ParameterVector, X: Array) -> Array:
        """Return the residuals of vectors, (n_sets, rows)."""


def is_nonsmooth(vector: ParameterVector) -> bool:
    """Return whether a law among the terms has edges, so that small steps of slopes are noise."""
    return any(t.effect.traits.is_nonsmooth for t in vector.terms)


def forward_differences(of: Simulated, vector: ParameterVector, x: Array, raw: Array) -> Array:
    """Return the derivatives of the residual by forward differences, (rows, n); those by channel offsets are known.

    In a long lightly damped record a hundredth of a standard deviation of a frequency bends the slope along it by more than the
    slope along directions that the recordings say little of; of laws with edges smaller steps are noise.

    Parameters
    ----------
    raw : (rows,) array
        The residual at `x`.
    """
    steps = vector.steps(x)
    if not is_nonsmooth(vector):
        steps[: vector.priors] = JACOBIAN.smooth_step
    offsets = np.arange(vector.r, vector.priors) if not of.free_starts else np.zeros(0, dtype=int)
    others = np.setdiff1d(np.arange(x.size), offsets)
    moved = of.residual(vector, x + np.diag(steps)[others])
    moved -= raw
    moved /= steps[others, None]
    if not offsets.size:
        return np.asarray(moved.T)
    out = np.zeros((x.size, raw.size)).T
    out[:, others] = moved.T
    out[offsets, offsets] = 1.0
    at = vector.priors
    for i in by_period(of.runs):
        run = of.runs[i]
        block = out[at : at + run.y.size].reshape(len(run), run.y.shape[1], -1)
        for c, column in enumerate(offsets):
            block[:, c, column] = vector.offset_sd[c] / of.sigma[i][c] * run.usable[:, c]
        at += run.y.size
    return out


def differences_by_strength(of: Simulated, vector: ParameterVector, x: Array, raw: Array, slopes: Array) -> Array:
    """Return the derivatives of the residual by differences along the directions that move it as much as each other, (rows, n).

    Dry friction and stops chatter by more than small steps do. What is strong in every single parameter and cancels in a sum of
    them, as larger forces do with larger gains and impedances, would drown in that, and is what is least known; so the steps
    go along the singular vectors of what is known of the slopes, wide where these are weak.

    Parameters
    ----------
    slopes : (rows, n) array
        Derivatives to begin with.
    """
    steps = vector.steps(x)
    _, _, across = np.linalg.svd(np.linalg.qr(slopes * steps, mode="r"))
    data = (slopes * steps)[vector.priors :] @ across.T
    widest = np.full(x.size, JACOBIAN.widest[1])
    widest[: vector.r] = JACOBIAN.widest[0]
    most = np.min(widest / np.maximum(np.abs(across), 1e-300), axis=1)
    size = np.clip(JACOBIAN.moved / np.maximum(np.sqrt(np.mean(data**2, axis=0)), 1e-300), 1.0, most)
    moved = of.residual(vector, x + size[:, None] * across * steps)
    return np.asarray(((moved - raw) / size[:, None]).T @ across / steps)


def with_scale(vector: ParameterVector, x: Array, slopes: Array, scale: Array) -> Array:
    """Return derivatives whose part along the common scale of impedances and gains is exact: what changes with it is only how large
    the laws' forces, masses and stiffnesses are beside all others.

    Parameters
    ----------
    scale : (n_changes,) array
        That scale, in standard deviations of the uncertain parameters.
    """
    size = float(np.linalg.norm(scale))
    project_prior = np.zeros(x.size)
    project_prior[: vector.r] = (vector.directions / vector.prior[:, None]).T @ scale / size
    exact = np.zeros(len(slopes))
    for k, (i, parameter) in enumerate(vector.parameters, start=vector.first_effect):
        if vector.terms[i].effect.kind == "port" and parameter.unit.startswith(("N", "kg")):
            exact -= slopes[:, k] * (x[k] if parameter.signed else 1.0) / size
    exact[: vector.priors] = project_prior[: vector.priors]
    return np.asarray(slopes + np.outer(exact - slopes @ project_prior, project_prior))


def update_broyden(slopes: Array, step: Array, change: Array) -> Array:
    """Return slopes that agree with the change that a step made, by Broyden's update.

    Source: A class of methods for solving nonlinear simultaneous equations, Mathematics of Computation 19, 1965, eq. 4.5.
    """
    return np.asarray(slopes + np.outer(change - slopes @ step, step / max(float(step @ step), 1e-300)))


def by_period(runs: Sequence[Signals]) -> list[int]:
    """Return the runs in the order that a residual has them: by sample period, then as they come."""
    return sorted(range(len(runs)), key=lambda i: runs[i].h)
