"""Jacobian of the residual: forward differences, differences along singular vectors, Broyden updates.

References
----------
C. G. Broyden, A class of methods for solving nonlinear simultaneous equations, Math. Comp. 19 (1965) 577-593.
"""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from scipy.linalg import blas

from vlab.diagnose.data.runs import Signals
from vlab.diagnose.inference.parameter_vector import ParameterVector, is_logarithm
from vlab.diagnose.settings import JACOBIAN
from vlab.signals import Array


class Simulated(Protocol):
    """Protocol of a residual, as of `vlab.diagnose.inference.least_squares.LeastSquares`."""

    runs: list[Signals]
    sigma: Array
    free_starts: dict[int, tuple[Array, Array, Array]]

    def residual(self, vector: ParameterVector, X: Array) -> Array:
        """Return the residuals (n_sets, rows) of parameter vectors."""


def is_nonsmooth(vector: ParameterVector) -> bool:
    """Return whether a term has a nonsmooth law."""
    return any(t.effect.traits.is_nonsmooth for t in vector.terms)


def forward_differences(of: Simulated, vector: ParameterVector, x: Array, raw: Array) -> Array:
    """Return the Jacobian by forward differences.

    Columns of sensor offsets are exact. Long lightly damped records need small steps in frequency, nonsmooth laws large
    ones.

    Parameters
    ----------
    of : Simulated
        Residual.
    vector : ParameterVector
        Meaning of the entries.
    x : (n,) array
        Parameter vector.
    raw : (rows,) array
        Residual at `x`.

    Returns
    -------
    (rows, n) array
        Jacobian.
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
    """Return the Jacobian by differences along singular vectors.

    Dry friction and stops scatter more than small steps move the residual. Parameters that cancel in combination, as
    forces and gains do, would be lost. The steps follow the singular vectors of a first Jacobian, wide where the
    singular values are small.

    Parameters
    ----------
    of : Simulated
        Residual.
    vector : ParameterVector
        Meaning of the entries.
    x : (n,) array
        Parameter vector.
    raw : (rows,) array
        Residual at `x`.
    slopes : (rows, n) array
        First Jacobian.

    Returns
    -------
    (rows, n) array
        Jacobian.
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
    """Return a Jacobian that is exact along the common scale.

    Along the common scale of impedances and gains only the laws' relative forces, masses and stiffnesses change.

    Parameters
    ----------
    vector : ParameterVector
        Meaning of the entries.
    x : (n,) array
        Parameter vector.
    slopes : (rows, n) array
        Jacobian.
    scale : (n_changes,) array
        Common scale in standard deviations of the uncertain parameters.

    Returns
    -------
    (rows, n) array
        Corrected Jacobian.
    """
    size = float(np.linalg.norm(scale))
    direction = np.zeros(x.size)
    direction[: vector.r] = (vector.directions / vector.prior[:, None]).T @ scale / size
    exact = np.zeros(len(slopes))
    for k, (i, parameter) in enumerate(vector.parameters, start=vector.first_effect):
        if vector.terms[i].effect.kind == "port" and parameter.unit.startswith(("N", "kg")):
            exact -= slopes[:, k] * (1.0 if is_logarithm(parameter) else x[k]) / size
    exact[: vector.priors] = direction[: vector.priors]
    return np.asarray(slopes + np.outer(exact - slopes @ direction, direction))


def update_broyden(slopes: Array, step: Array, change: Array) -> Array:
    """Return a Jacobian that matches a step's change (Broyden 1965, eq. 4.5).

    The update of rank one overwrites a Jacobian in column order, without a copy.
    """
    missed = change - slopes @ step
    scaled = step / max(float(step @ step), 1e-300)
    return np.asarray(blas.dger(1.0, missed, scaled, a=slopes, overwrite_a=1))


def by_period(runs: Sequence[Signals]) -> list[int]:
    """Return the runs in the order of a residual, by sample period."""
    return sorted(range(len(runs)), key=lambda i: runs[i].h)
