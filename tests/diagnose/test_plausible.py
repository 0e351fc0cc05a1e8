"""Plausible parameters beside coloured noise: the sandwich covariance against a closed form."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import signal

from vlab.diagnose.inference.descent import Optimum
from vlab.diagnose.inference.fit_at_optimum import _departure


def level(noise, blocks):
    """Return the fit of a constant of value zero to noise, with a prior of unit variance."""
    n, weight = len(noise), 0.05
    normal = np.array([[n * weight**2 + 1.0]])
    x = weight**2 * np.sum(noise, keepdims=True) / normal[0, 0]
    residual = np.concatenate([x, x - noise])
    scores = np.array([[np.sum(weight**2 * part)] for part in np.array_split(x - noise, blocks)])
    vector = SimpleNamespace(priors=1)
    return Optimum(vector=vector, x=x, residual=residual, normal=normal, scores=scores)


def test_sampling_variance_is_that_of_coloured_noise():
    """The mean of AR(1) noise has the variance s^2 (1 + a)/(1 - a)/n; the prior shrinks it by N^-1 n w^2."""
    a, n, rng = 0.98, 20_000, np.random.default_rng(5)
    ratios = []
    for _ in range(40):
        noise = signal.lfilter([1.0], [1.0, -a], rng.standard_normal(n + 2000))[2000:]
        fit = level(noise, 12)
        own = float(fit.x[0] ** 2 / _departure(fit)) - 1.0  # departure = x^2/(1 + variance)
        ratios.append(own)
    variance = 1.0 / (1.0 - a**2) * (1.0 + a) / (1.0 - a) / n * (n * 0.05**2 / fit.normal[0, 0]) ** 2
    assert np.mean(ratios) == pytest.approx(variance, rel=0.15)


def test_departure_without_sampling_error_is_the_prior_cost():
    fit = level(np.full(1000, 3.0), 1)
    still = Optimum(vector=fit.vector, x=fit.x, residual=fit.residual, normal=fit.normal, scores=np.zeros((4, 1)))
    assert _departure(still) == pytest.approx(float(fit.x[0] ** 2))
