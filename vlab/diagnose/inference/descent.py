"""Damped Gauss-Newton descent to a maximum a posteriori estimate (Levenberg-Marquardt).

References
----------
D. W. Marquardt, An algorithm for least-squares estimation of nonlinear parameters, J. SIAM 11 (1963) 431-441.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from vlab.diagnose.data.runs import Signals
from vlab.diagnose.inference.impedance_scale import exponent, motion_scale
from vlab.diagnose.inference.jacobian import (
    Simulated,
    by_period,
    differences_by_strength,
    forward_differences,
    is_nonsmooth,
    update_broyden,
    with_scale,
)
from vlab.diagnose.inference.parameter_vector import ParameterVector, bounded_step, is_logarithm
from vlab.diagnose.problem import Problem
from vlab.diagnose.settings import FIT, TRAJECTORY_FIT
from vlab.signals import Array


class Objective(Simulated, Protocol):
    """Protocol of a weighted residual, as of `vlab.diagnose.inference.least_squares.LeastSquares`."""

    problem: Problem
    is_rough: bool
    effective_share: float
    unidentifiable: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Optimum:
    """End of a descent.

    Parameters
    ----------
    vector : ParameterVector
        Meaning of the entries, with the unidentifiable directions after an exact descent.
    x : (n,) array
        Parameter vector.
    residual : (rows,) array
        Residual at `x`.
    normal : (n, n) array
        Weighted normal matrix.
    scores : (n_blocks, n) array
        Weighted gradients of blocks of the data.
    """

    vector: ParameterVector
    x: Array
    residual: Array
    normal: Array
    scores: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class _Step:
    """Best of the trial steps of an iteration."""

    x: Array
    residual: Array
    cost: float
    promised: float
    damping: float


def descend(of: Objective, vector: ParameterVector, x: Array, iterations: int, tolerance: float) -> Optimum:
    """Descend from a parameter vector.

    Parameters
    ----------
    of : Objective
        Residual, weights and problem.
    vector : ParameterVector
        Meaning of the entries.
    x : (n,) array
        Start.
    iterations : int
        Most iterations.
    tolerance : float
        Cost decrease [nat] below which two successive steps end the descent. At `FIT.exact` and below, the Jacobian is
        renewed for intervals.

    Returns
    -------
    Optimum
        End of the descent.
    """
    damping, raw = FIT.damping, of.residual(vector, x[None])[0]
    if not x.size:  # without identifiable parameters there is nothing to fit
        return Optimum(vector=vector, x=x, residual=raw, normal=np.zeros((0, 0)), scores=np.zeros((0, 0)))
    slopes, age = np.zeros((raw.size, x.size)), FIT.reused
    small, done, last = 0, -1, iterations
    while (done := done + 1) < last:
        shapes_too = done >= FIT.frozen or iterations <= FIT.frozen
        weight = effective_weights(of.effective_share, vector, raw)
        weighted = raw * weight
        cost = float(weighted @ weighted)
        if age >= FIT.reused:
            slopes, age = forward_differences(of, vector, x, raw), 0
        step = _best_step(of, vector, x, slopes, raw, weight, damping, shapes_too=shapes_too)
        if not step.cost < cost:
            if age:  # an old Jacobian is renewed before smaller steps
                age = FIT.reused
                continue
            damping *= FIT.stiffened
            if damping > FIT.damping_range[1]:
                break
            continue
        small = small + 1 if step.cost > cost - tolerance else 0
        slopes = update_broyden(slopes, step.x - x, step.residual - raw)
        age = age + 1 if cost - step.cost > 0.5 * step.promised else FIT.reused
        x, raw, damping = step.x, step.residual, step.damping
        is_cheap = cost - step.cost < FIT.cheaper  # from here the parameters no longer approach their prior means
        if small >= 2 and shapes_too:
            break
        if tolerance <= FIT.exact:
            continue
        if is_cheap and is_noise(of.runs, vector, raw):
            break
        if not is_cheap and not of.is_rough and np.mean(raw[vector.priors :] ** 2) < FIT.explained:
            last = min(max(last, done + 2), iterations + FIT.more)
    if tolerance <= FIT.exact:
        vector, x, raw, slopes = _exact(of, vector, x, raw)
    weight = effective_weights(of.effective_share, vector, raw)
    scores = _scores(of.runs, vector, slopes, raw * weight**2)
    return Optimum(vector=vector, x=x, residual=raw, normal=_normal(vector, slopes, weight), scores=scores)


def _best_step(
    of: Objective,
    vector: ParameterVector,
    x: Array,
    slopes: Array,
    raw: Array,
    weight: Array,
    damping: float,
    *,
    shapes_too: bool,
) -> _Step:
    """Return the best of several damped and shortened Gauss-Newton steps."""
    normal, gradient = _normal(vector, slopes, weight), slopes.T @ (weight * (raw * weight))
    if not shapes_too:
        still = vector.shapes
        normal[still], normal[:, still], gradient[still] = 0.0, 0.0, 0.0
    scale = np.diag(normal) + 1e-12 * max(float(np.diag(normal).max()), 1.0)
    lams = damping * np.array(FIT.damped)
    room = vector.room(x)
    steps = [-bounded_step(normal + np.diag(lam * scale), gradient, room) for lam in (FIT.undamped, *lams)]
    trials = x - np.array([*(part * steps[0] for part in FIT.parts), *steps[1:]])
    if is_nonsmooth(vector):
        trials = np.vstack([trials, rescaled(of.problem, vector, x)])
    trials = vector.bounded(trials)
    residuals = of.residual(vector, trials)
    costs = np.einsum("ij,ij->i", residuals * weight, residuals * weight)
    pick = int(np.argmin(np.where(np.isfinite(costs), costs, np.inf)))
    step = trials[pick] - x
    is_damped = len(FIT.parts) <= pick < len(FIT.parts) + len(lams)
    return _Step(
        x=trials[pick],
        residual=residuals[pick],
        cost=costs[pick],
        promised=-float(step @ (2.0 * gradient + normal @ step)),
        damping=max(FIT.relaxed * (lams[pick - len(FIT.parts)] if is_damped else damping), FIT.damping_range[0]),
    )


def _exact(of: Objective, vector: ParameterVector, x: Array, raw: Array) -> tuple[ParameterVector, Array, Array, Array]:
    """Return vector, residual and a new Jacobian with the unidentifiable directions.

    An updated Jacobian suffices for steps, not for intervals. A common change of gains and impedances moves no channel,
    but every estimated force.
    """
    wide = replace(vector, directions=np.hstack([vector.directions, of.unidentifiable]))
    none = np.zeros(wide.r - vector.r)
    x, raw = np.insert(x, vector.r, none), np.insert(raw, vector.r, none)
    slopes = forward_differences(of, wide, x, raw)
    for _ in range(FIT.passes):
        slopes = differences_by_strength(of, wide, x, raw, slopes)
    common = of.problem.common_scale
    if common is not None:
        slopes = with_scale(wide, x, slopes, np.asarray(common / vector.prior))
    return wide, x, raw, slopes


def rescaled(problem: Problem, vector: ParameterVector, x: Array) -> Array:
    """Return a vector with the motion scale of largest prior density.

    Parameters
    ----------
    problem : Problem
        Problem.
    vector : ParameterVector
        Meaning of the entries.
    x : (n,) array
        Parameter vector.

    Returns
    -------
    (n,) array
        Rescaled vector.
    """
    direction, ours = vector.project(motion_scale(problem)), slice(0, vector.r)
    grown = -float(direction @ x[ours]) / max(float(direction @ direction), 1e-12)
    out = x.copy()
    out[ours] += grown * direction
    out[vector.priors : vector.first_effect] *= np.exp(grown)
    for k, (i, parameter) in enumerate(vector.parameters, start=vector.first_effect):
        power = grown * exponent(vector.terms[i].effect, parameter)
        out[k] = out[k] + power if is_logarithm(parameter) else out[k] * np.exp(power)
    return out


def _normal(vector: ParameterVector, slopes: Array, weight: Array) -> Array:
    """Return the weighted normal matrix of priors and data."""
    ours, data = slopes[: vector.priors], slopes[vector.priors :]
    return np.asarray(weight[0] ** 2 * ours.T @ ours + weight[-1] ** 2 * (data.T @ data))


def _scores(runs: Sequence[Signals], vector: ParameterVector, slopes: Array, weighted: Array) -> Array:
    """Return the gradients (n_blocks, n) of blocks of the data.

    No block spans two runs.
    """
    parts, at, out = int(np.ceil(TRAJECTORY_FIT.windows / len(runs))), vector.priors, []
    for size in (runs[i].y.size for i in by_period(runs)):
        for rows in np.array_split(np.arange(at, at + size), parts):
            block = slice(rows[0], rows[-1] + 1) if len(rows) else slice(0, 0)
            out.append(slopes[block].T @ weighted[block])
        at += size
    return np.array(out)


def is_noise(runs: Sequence[Signals], vector: ParameterVector, raw: Array) -> bool:
    """Return whether every run's residual is at noise level.

    The runs together may be while the loudest is not: most samples of an impact test belong to the decay.

    Parameters
    ----------
    runs : sequence of Signals
        Runs.
    vector : ParameterVector
        Meaning of the leading entries.
    raw : (rows,) array
        Residual of unit variance.

    Returns
    -------
    bool
        Whether no run's mean square exceeds the noise by four standard deviations.
    """
    at = vector.priors
    for size in (runs[i].y.size for i in by_period(runs)):
        if np.mean(raw[at : at + size] ** 2) > FIT.noise + 4.0 * np.sqrt(
            2.0 / size
        ):  # four standard deviations of the mean square
            return False
        at += size
    return True


def effective_weights(effective_share: float, vector: ParameterVector, raw: Array) -> Array:
    """Return weights that reduce the data to their effective sample size.

    The scale of the residual is estimated, so the priors stay active under any wrong hypothesis.

    Parameters
    ----------
    effective_share : float
        Effective sample size.
    vector : ParameterVector
        Meaning of the leading entries.
    raw : (rows,) array
        Residual.

    Returns
    -------
    (rows,) array
        Weights; 1 for the priors.
    """
    priors = vector.priors
    effective_samples = effective_share / max(raw.size - priors, 1)
    spread = max(float(np.mean(raw[priors:] ** 2)), 1.0)
    out = np.full(raw.size, np.sqrt(effective_samples / spread))
    out[:priors] = 1.0
    return out


def clip_diverged(residual: Array) -> None:
    """Clip a diverged residual, in place.

    Parameters
    ----------
    residual : array
        Residual of unit variance.
    """
    if residual.min() >= -FIT.largest and residual.max() <= FIT.largest:  # false for NaN
        return
    residual[:] = np.where(np.isfinite(residual), np.clip(residual, -FIT.largest, FIT.largest), FIT.largest)
