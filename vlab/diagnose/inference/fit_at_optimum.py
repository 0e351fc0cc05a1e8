"""Fit at a descent's end: values, errors, standard deviations."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from vlab.diagnose.data.runs import Signals
from vlab.diagnose.inference.descent import Optimum
from vlab.diagnose.inference.jacobian import by_period
from vlab.diagnose.inference.parameter_vector import ParameterVector, is_logarithm
from vlab.diagnose.parameters.terms import Fit
from vlab.signals import Array


def fit_at(
    optimum: Optimum,
    runs: Sequence[Signals],
    sigma: Array,
    *,
    theta: Array,
    offsets: Array,
    starts: dict[str, Array],
    values: Sequence[Mapping[str, float]],
) -> Fit:
    """Return the fit at an optimum.

    Parameters
    ----------
    optimum : Optimum
        End of a descent.
    runs : sequence of Signals
        Runs.
    sigma : (n_runs, p) array
        Standard deviations of noise and model error.
    theta : (n_changes,) array
        Log factors.
    offsets : (p,) array
        Sensor offsets.
    starts : dict
        Estimated initial states by run.
    values : sequence of mapping
        Parameter values of every term.

    Returns
    -------
    Fit
        Fit.
    """
    vector, residual = optimum.vector, optimum.residual
    h = max(run.h for run in runs)
    fitted = tuple(
        replace(term, values=term.effect.taken(dict(own), h)) for term, own in zip(vector.terms, values, strict=True)
    )
    data = residual[vector.priors :]
    return Fit(
        terms=fitted,
        theta=theta,
        offsets=offsets,
        starts=starts,
        error=_errors(residual, vector.priors, runs, sigma),
        chi2=float(residual @ residual),
        cost=float(data @ data),
        sd=_deviations(vector, optimum.x, optimum.normal),
        departure=_departure(optimum),
        information=information_on(optimum.normal, vector.priors),
    )


def information_on(normal: Array, count: int) -> Array:
    """Return the shares of the prior variance that data remove.

    Parameters
    ----------
    normal : (n, n) array
        Normal matrix with the unit prior of the first entries.
    count : int
        Number of entries with a prior.

    Returns
    -------
    (count,) array
        Shares along principal directions, 0 to 1.
    """
    posterior = np.linalg.pinv(normal, hermitian=True)[:count, :count]
    return np.asarray(1.0 - np.clip(np.linalg.eigvalsh(posterior), 0.0, 1.0))


def _departure(optimum: Optimum) -> float:
    """Return the chi-squared statistic of the uncertain parameters, with their sampling error.

    The sandwich estimate of the sampling covariance holds for a residual of any colour: blocks longer than the memory of the
    noise have independent gradients.

    References
    ----------
    P. J. Huber, The behavior of maximum likelihood estimates under nonstandard conditions, Proc. 5th Berkeley Symp. 1
    (1967) 221-233. K.-Y. Liang and S. L. Zeger, Longitudinal data analysis using generalized linear models, Biometrika 73
    (1986) 13-22.
    """
    priors = optimum.vector.priors
    if not priors:
        return 0.0
    bread = np.linalg.pinv(optimum.normal, hermitian=True)[:priors]
    moves = optimum.scores @ bread.T
    deviation = optimum.residual[:priors]
    return float(deviation @ np.linalg.solve(np.eye(priors) + moves.T @ moves, deviation))


def _errors(residual: Array, priors: int, runs: Sequence[Signals], sigma: Array) -> Array:
    """Return the rms errors (n_runs, p) over the channels' rms."""
    at, error = priors, [np.zeros(0)] * len(runs)
    for i in by_period(runs):
        run = runs[i]
        part = residual[at : at + run.y.size].reshape(run.y.shape) * sigma[i]
        error[i] = np.sqrt(np.mean(part**2, axis=0)) / run.scale
        at += run.y.size
    return np.array(error)


def _deviations(vector: ParameterVector, x: Array, normal: Array) -> dict[str, float]:
    """Return the standard deviations of the effect parameters; relative for positive ones."""
    size = np.sqrt(np.diag(normal))  # a gap in metres must not push all others below the cutoff
    size = np.where(size > 0, size, 1.0)
    scaled = normal / np.outer(size, size) + 1e-12 * np.eye(len(size))
    covariance = np.linalg.pinv(scaled, hermitian=True) / np.outer(size, size)
    sd = {}
    for k, (i, p) in enumerate(vector.parameters, start=vector.first_effect):
        spread = float(np.sqrt(max(covariance[k, k], 0.0)))
        relative = spread / max(abs(float(x[k])), 1e-300)
        is_relative = not (p.signed or is_logarithm(p))
        sd[f"{vector.terms[i].label}:{p.name}"] = p.grain or (relative if is_relative else spread)
    return sd
