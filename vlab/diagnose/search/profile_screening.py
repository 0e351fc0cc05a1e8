"""Screening on whole recordings by the profile likelihood.

A score test on filter innovations sees a law within the memory of its observer. Weak dissipation and slow drifts of phase
show over many periods only. Here every candidate is simulated over the whole recordings, beside the effects that are
there. All other parameters are profiled out linearly: with Jacobian J of the fit, the residual r of a candidate counts as
(I - J J^+) r. One simulation at a small amplitude gives the linear optimum of the amplitude, and simulations about this
optimum give the start of a fit.

References
----------
G. A. F. Seber, C. J. Wild, Nonlinear Regression, Wiley, 1989, section 2.2 (concentrated likelihood).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from vlab.diagnose.inference.jacobian import forward_differences
from vlab.diagnose.inference.least_squares import LeastSquares
from vlab.diagnose.inference.parameter_vector import ParameterVector
from vlab.diagnose.kernels.parallel import side_by_side
from vlab.diagnose.parameters.terms import Candidate, Fit
from vlab.diagnose.settings import PROFILE_SCREENING
from vlab.signals import Array

Values = dict[str, float]


def profile(whole: LeastSquares, fit: Fit, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return candidates beside a fit, with profiled values and gains.

    Parameters
    ----------
    whole : LeastSquares
        Fits to whole runs.
    fit : Fit
        Fit to which the candidates are added.
    candidates : sequence of Candidate
        Candidates with the shapes of an earlier screening.

    Returns
    -------
    list of Candidate
        Candidates by log-likelihood gain [nat], with the values of least profiled cost.
    """
    base = _Base.of(whole, fit)
    known = {term.label for term in fit.terms}
    others = [c for c in candidates if c.label not in known]
    found = side_by_side(lambda c: _profiled(base, c), others)
    return sorted(found, key=lambda c: (-c.log_likelihood_gain, c.label))


class _Base:
    """Fit with an orthonormal basis of its Jacobian."""

    def __init__(self, whole: LeastSquares, fit: Fit, basis: Array, residual: Array) -> None:
        self.whole, self.fit, self.basis, self.residual = whole, fit, basis, residual
        self.cost = self.costs(residual[None])[0]

    @classmethod
    def of(cls, whole: LeastSquares, fit: Fit) -> "_Base":
        """Return the base of a fit."""
        vector = whole.vector(fit.terms)
        x = whole.initial(vector, [t.values for t in fit.terms], fit.theta, fit)
        raw = whole.residual(vector, x[None])[0]
        slopes = forward_differences(whole, vector, x, raw)
        left, size, _ = np.linalg.svd(slopes, full_matrices=False)
        keep = size > PROFILE_SCREENING.rank * max(float(size.max(initial=0.0)), 1e-300)
        return cls(whole, fit, left[:, keep], raw)

    def residuals(self, candidate: Candidate, values: Sequence[Values]) -> Array:
        """Return the residuals (n_sets, rows) of a candidate's values."""
        terms = [*self.fit.terms, candidate]
        vector: ParameterVector = self.whole.vector(terms)
        own = [t.values for t in self.fit.terms]
        start = [self.whole.initial(vector, [*own, v], self.fit.theta, self.fit) for v in values]
        return self.whole.residual(vector, np.array(start))

    def project(self, residuals: Array) -> Array:
        """Return residuals (n_sets, rows) without their part along the Jacobian."""
        return residuals - (residuals @ self.basis) @ self.basis.T

    def costs(self, residuals: Array) -> Array:
        """Return the profiled costs (n_sets,) of residuals."""
        left = self.project(residuals)
        return np.asarray(np.einsum("ij,ij->i", left, left))


def _profiled(base: _Base, candidate: Candidate) -> Candidate:
    """Return a candidate with the values of least profiled cost."""
    trials = _shapes(candidate)
    if candidate.effect.amplitudes:
        trials = [scaled for shape in trials for scaled in _amplitudes(base, candidate, shape)]
    if not trials:
        return replace(candidate, log_likelihood_gain=0.0)
    costs = base.costs(base.residuals(candidate, trials))
    best = int(np.argmin(np.where(np.isfinite(costs), costs, np.inf)))
    ratio = min(float(costs[best]) / max(base.cost, 1e-300), 1.0)
    gain = -0.5 * base.whole.effective_samples * float(np.log(max(ratio, 1e-300)))
    return replace(candidate, values=trials[best], log_likelihood_gain=gain)


def _shapes(candidate: Candidate) -> list[Values]:
    """Return values with every shape at and about that of the earlier screening."""
    out = [dict(candidate.values)]
    for parameter in candidate.effect.shapes:
        factors = (1.0,) if parameter.signed else PROFILE_SCREENING.shape_factors
        out = [{**values, parameter.name: factor * values[parameter.name]} for values in out for factor in factors]
    return out[: PROFILE_SCREENING.most_shapes]


def _amplitudes(base: _Base, candidate: Candidate, shape: Values) -> list[Values]:
    """Return values about the linear optimum of the amplitudes.

    Parameters
    ----------
    base : _Base
        Fit.
    candidate : Candidate
        Candidate.
    shape : dict
        Values with the shape.
    """
    names = [p.name for p in candidate.effect.amplitudes]
    unit = {p.name: _unit(p.high, shape[p.name]) for p in candidate.effect.amplitudes}
    columns = []
    for name in names:
        alone = {**shape, **dict.fromkeys(names, 0.0)}
        column = _column(base, candidate, alone, name, unit[name])
        if column is None:
            return []
        columns.append(column)
    A = base.project(np.array(columns))
    size = np.linalg.norm(A, axis=1)
    if not np.all(size > 0):
        return []
    wanted = -np.linalg.lstsq((A / size[:, None]).T, base.project(base.residual[None])[0], rcond=1e-6)[0] / size
    optimum = {name: float(v) for name, v in zip(names, wanted, strict=True)}
    for p in candidate.effect.amplitudes:
        if not p.signed:
            optimum[p.name] = max(optimum[p.name], 0.0)
    if not any(optimum.values()):
        return []
    return [
        {**shape, **{name: factor * value for name, value in optimum.items()}}
        for factor in PROFILE_SCREENING.amplitude_factors
    ]


def _unit(high: float, value: float) -> float:
    """Return a first amplitude for a finite difference."""
    size = abs(value)
    return size if size > PROFILE_SCREENING.least_share * high else PROFILE_SCREENING.least_share * high


def _column(base: _Base, candidate: Candidate, values: Values, name: str, unit: float) -> Array | None:
    """Return the change of the residual per unit of an amplitude, or None.

    The amplitude is reduced until the residual changes little, and raised until the change exceeds rounding.
    """
    low, high = (share * float(np.linalg.norm(base.residual)) for share in PROFILE_SCREENING.moved)
    for _ in range(PROFILE_SCREENING.rescalings):
        (moved,) = base.residuals(candidate, [{**values, name: unit}]) - base.residual
        size = float(np.linalg.norm(moved))
        if not np.isfinite(size) or size > high:
            unit *= min(0.3 * high / size, 0.1) if np.isfinite(size) else 1e-3
        elif size < low:
            unit *= 0.3 * high / max(size, 1e-3 * low)
        else:
            return np.asarray(moved / unit)
    return None
