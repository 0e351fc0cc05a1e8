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
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from vlab.diagnose.inference.jacobian import forward_differences
from vlab.diagnose.inference.least_squares import LeastSquares
from vlab.diagnose.inference.parameter_vector import ParameterVector
from vlab.diagnose.inference.trial_scan import Scales, best_values, scan_values
from vlab.diagnose.parameters.terms import Candidate, Fit
from vlab.diagnose.settings import PROFILE_SCREENING
from vlab.parallel import side_by_side
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
        """Return the base of a fit.

        Nonsmooth laws take the coarse steps of first fits.
        """
        coarse = copy(whole)
        coarse.is_rough = True
        vector = coarse.vector(fit.terms)
        x = coarse.initial(vector, [t.values for t in fit.terms], fit.theta, fit)
        raw = coarse.residual(vector, x[None])[0]
        slopes = forward_differences(coarse, vector, x, raw)
        left, size, _ = np.linalg.svd(slopes, full_matrices=False)
        keep = size > PROFILE_SCREENING.rank * max(float(size.max(initial=0.0)), 1e-300)
        return cls(coarse, fit, left[:, keep], raw)

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
    trials = [*_shapes(candidate), *_resonances(base, candidate)]
    if candidate.effect.amplitudes:
        trials = _amplitudes(base, candidate, trials)
    if not trials:
        return replace(candidate, log_likelihood_gain=0.0)
    costs = base.costs(base.residuals(candidate, trials))
    best = int(np.argmin(np.where(np.isfinite(costs), costs, np.inf)))
    ratio = min(float(costs[best]) / max(base.cost, 1e-300), 1.0)
    gain = -0.5 * base.whole.effective_samples * float(np.log(max(ratio, 1e-300)))
    return replace(candidate, values=trials[best], log_likelihood_gain=gain)


def _shapes(candidate: Candidate) -> list[Values]:
    """Return values with every shape about that of the screening."""
    out = [dict(candidate.values)]
    for parameter in candidate.effect.shapes:
        factors = (1.0,) if parameter.signed else PROFILE_SCREENING.shape_factors
        out = [{**values, parameter.name: factor * values[parameter.name]} for values in out for factor in factors]
    return out[: PROFILE_SCREENING.most_shapes]


def _resonances(base: _Base, candidate: Candidate) -> list[Values]:
    """Return values at the resonances of largest profiled gain.

    Filter innovations show a resonance within the memory of the observer only, and its likelihood has a narrow peak.
    """
    amplitudes = candidate.effect.amplitudes
    scanned = next((p for p in candidate.effect.shapes if p.scan == "resonance"), None)
    if scanned is None or len(amplitudes) != 1:
        return []
    amplitude, runs = amplitudes[0], base.whole.runs
    scales = Scales(
        step=max(run.h for run in runs),
        duration=max(len(run) * run.h for run in runs),
        highest_hz=base.whole.problem.highest_hz,
    )
    target = base.project(base.residual[None])[0]

    def gains(values: Sequence[float]) -> list[float]:
        trials = [{**candidate.values, scanned.name: value, amplitude.name: 0.0} for value in values]
        unit = _unit(amplitude.high, candidate.values[amplitude.name])
        columns = _columns(base, candidate, [_Step(trial, amplitude.name, unit) for trial in trials])
        return [0.0 if column is None else _linear_gain(base, column, target) for column in columns]

    return [{**candidate.values, scanned.name: value} for value in best_values(scan_values(scanned, scales), gains)]


def _linear_gain(base: _Base, column: Array, target: Array) -> float:
    """Return the first-order decrease of the cost by an unsigned amplitude."""
    across = base.project(column[None])[0]
    return float(max(-(across @ target), 0.0) ** 2 / max(float(across @ across), 1e-300))


def _amplitudes(base: _Base, candidate: Candidate, shapes: Sequence[Values]) -> list[Values]:
    """Return values about the linear optimum of the amplitudes, for every shape.

    Parameters
    ----------
    base : _Base
        Fit.
    candidate : Candidate
        Candidate.
    shapes : sequence of dict
        Values with the shapes.

    Returns
    -------
    list of dict
        Values in the order of the shapes; shapes without effect are left out.
    """
    amplitudes = candidate.effect.amplitudes
    names = [p.name for p in amplitudes]
    steps = [
        _Step({**shape, **dict.fromkeys(names, 0.0)}, p.name, _unit(p.high, shape[p.name]))
        for shape in shapes
        for p in amplitudes
    ]
    columns = _columns(base, candidate, steps)
    target, out = base.project(base.residual[None])[0], []
    for i, shape in enumerate(shapes):
        own = [column for column in columns[i * len(names) : (i + 1) * len(names)] if column is not None]
        if len(own) < len(names):
            continue
        A = base.project(np.array(own))
        size = np.linalg.norm(A, axis=1)
        if not np.all(size > 0):
            continue
        wanted = -np.linalg.lstsq((A / size[:, None]).T, target, rcond=1e-6)[0] / size
        optimum = {
            p.name: float(v) if p.signed else max(float(v), 0.0) for p, v in zip(amplitudes, wanted, strict=True)
        }
        if any(optimum.values()):
            out += [
                {**shape, **{name: factor * value for name, value in optimum.items()}}
                for factor in PROFILE_SCREENING.amplitude_factors
            ]
    return out


def _unit(high: float, value: float) -> float:
    """Return a first amplitude for a finite difference.

    A change of the residual as large as the residual itself would then lie in the middle of the accepted range.
    """
    return float(np.sqrt(np.prod(PROFILE_SCREENING.moved))) * max(abs(value), PROFILE_SCREENING.least_share * high)


@dataclass
class _Step:
    """Finite difference by one amplitude.

    Parameters
    ----------
    values : dict
        Values with all amplitudes at zero.
    name : str
        Amplitude that is moved.
    unit : float
        Value of the moved amplitude, rescaled in place.
    """

    values: Values
    name: str
    unit: float


def _columns(base: _Base, candidate: Candidate, steps: Sequence[_Step]) -> list[Array | None]:
    """Return changes of the residual per unit of every step's amplitude.

    All steps are simulated as one batch. The amplitude of a step is reduced until the residual changes little, and raised
    until the change exceeds rounding.
    """
    low, high = (share * float(np.linalg.norm(base.residual)) for share in PROFILE_SCREENING.moved)
    found: list[Array | None] = [None] * len(steps)
    open_steps = list(range(len(steps)))
    for _ in range(PROFILE_SCREENING.rescalings):
        if not open_steps:
            break
        trials = [{**steps[i].values, steps[i].name: steps[i].unit} for i in open_steps]
        missed = []
        for i, residual in zip(open_steps, base.residuals(candidate, trials), strict=True):
            step, moved = steps[i], residual - base.residual
            size = float(np.linalg.norm(moved))
            if not np.isfinite(size) or size > high:
                step.unit *= (
                    min(PROFILE_SCREENING.target * high / size, PROFILE_SCREENING.most_shrink)
                    if np.isfinite(size)
                    else PROFILE_SCREENING.after_divergence
                )
            elif size < low:
                step.unit *= PROFILE_SCREENING.target * high / max(size, PROFILE_SCREENING.most_growth * low)
            else:
                found[i] = np.asarray(moved / step.unit)
                continue
            missed.append(i)
        open_steps = missed
    return found
