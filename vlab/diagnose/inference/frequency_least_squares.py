"""Maximum a posteriori fits in frequency by the Levenberg-Marquardt method.

References
----------
D. W. Marquardt, An algorithm for least-squares estimation of nonlinear parameters, J. SIAM 11 (1963) 431-441.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vlab.diagnose.data.responses import Measured, Response
from vlab.diagnose.inference.fit_at_optimum import information_on
from vlab.diagnose.parameters.terms import Fit, Term
from vlab.diagnose.predictors.frequency import Shared
from vlab.diagnose.predictors.frequency_problem import FrequencyProblem
from vlab.diagnose.predictors.frequency_residual import Residual, residual
from vlab.diagnose.settings import FREQUENCY_FIT, RESPONSES
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Point:
    """Current parameters of a fit.

    Parameters
    ----------
    theta : (n_parameters,) array
        Log factors of the uncertain parameters.
    terms : tuple of Term
        Effects with values.
    """

    theta: Array
    terms: tuple[Term, ...]


class Fitter:
    """Fits of hypotheses to frequency data.

    Parameters
    ----------
    problem : FrequencyProblem
        Problem.
    measured : sequence of Response or Modes, optional
        Data; those of the problem by default.
    """

    def __init__(self, problem: FrequencyProblem, measured: Sequence[Measured] | None = None) -> None:
        self.problem = problem
        self.measured = list(problem.measured if measured is None else measured)
        self.sd = problem.prior

    @property
    def floor(self) -> float:
        """Normalised residual of noise alone, below 1 for very accurate data."""
        shares, counts = [], []
        for data in self.measured:
            if isinstance(data, Response):
                seen = np.isfinite(data.H)
                size = data.spread**2 + RESPONSES.model_error**2 * np.abs(data.H) ** 2
                shares.append(float(np.mean(data.noise[seen] ** 2 / np.maximum(size[seen], 1e-300))))
                counts.append(int(seen.sum()))
            else:
                shares.append(1.0)
                counts.append(data.freq.size)
        return float(np.sqrt(min(np.average(shares, weights=counts), 1.0)))

    def differences(self, point: Point, *, bands: float = 0.0, with_derivatives: bool = False) -> list[Residual]:
        """Return the residual of every data set.

        Parameters
        ----------
        point : Point
            Parameters.
        bands : float
            Relative bandwidth of the coarse residual; 0 for single lines.
        with_derivatives : bool
            Whether to compute derivatives.

        Returns
        -------
        list of Residual
            Residuals.
        """
        problem, state = self.problem, self.problem.state(point.theta)
        shared: Shared = {}
        return [
            residual(
                problem.view,
                state,
                data,
                problem.wires,
                point.terms,
                gains=problem.gains,
                bands=bands if isinstance(data, Response) else 0.0,
                with_derivatives=with_derivatives,
                shared=shared,
            )
            for data in self.measured
        ]

    def fit(
        self, terms: Sequence[Term] = (), start: Array | None = None, *, iterations: int = FREQUENCY_FIT.iterations
    ) -> Fit:
        """Fit a hypothesis from its terms' values.

        Without a start the fit begins at the nominal model with coarse residuals.

        Parameters
        ----------
        terms : sequence of Term
            Effects with starting values.
        start : (n_parameters,) array or None
            Initial log factors.
        iterations : int
            Most iterations.

        Returns
        -------
        Fit
            Fit.
        """
        theta = np.zeros(len(self.sd)) if start is None else np.array(start)
        point = Point(theta=theta, terms=tuple(terms))
        if start is None and any(isinstance(d, Response) for d in self.measured):
            for bands in FREQUENCY_FIT.coarse:
                point = self._descend(point, FREQUENCY_FIT.coarse_iterations, bands)
        return self._result(self._descend(point, iterations, 0.0))

    def _descend(self, point: Point, iterations: int, bands: float) -> Point:
        damping = FREQUENCY_FIT.damping
        least, most = FREQUENCY_FIT.damping_range
        cost = self._cost(point, bands)
        for _ in range(iterations):
            e, jacobian = self._stacked(point, bands)
            normal, gradient = jacobian.T @ jacobian, jacobian.T @ e
            scale = np.diag(normal) + 1e-9 * max(float(np.diag(normal).max(initial=0.0)), 1.0)
            better = False
            while damping < most:
                step = -np.linalg.solve(normal + np.diag(damping * scale), gradient)
                trial = self._moved(point, np.clip(step, -FREQUENCY_FIT.most_step, FREQUENCY_FIT.most_step))
                new = self._cost(trial, bands)
                if np.isfinite(new) and new < cost:
                    better = True
                    break
                damping *= FREQUENCY_FIT.stiffened
            if not better:
                break
            fallen, cost, point = cost - new, new, trial
            damping = max(damping * FREQUENCY_FIT.relaxed, least)
            if fallen < FREQUENCY_FIT.still * max(cost, 1e-9):
                break
        return point

    def _cost(self, point: Point, bands: float) -> float:
        with np.errstate(all="ignore"):
            try:
                parts = self.differences(point, bands=bands)
            except np.linalg.LinAlgError:  # a diverged trial has singular matrices
                return float("inf")
        return float(sum(r.e @ r.e for r in parts) + np.sum((point.theta / self.sd) ** 2))

    def _stacked(self, point: Point, bands: float) -> tuple[Array, Array]:
        """Return residual and Jacobian with the prior appended, in standard deviations."""
        parts = self.differences(point, bands=bands, with_derivatives=True)
        e = np.concatenate([*(r.e for r in parts), point.theta / self.sd])
        own = np.vstack([*(r.by_theta * self.sd for r in parts), np.eye(len(self.sd))])
        values = np.vstack([r.by_term for r in parts])
        values = np.vstack([values, np.zeros((len(self.sd), values.shape[1]))])
        return e, np.hstack([own, values * self._sizes(point)])

    def _sizes(self, point: Point) -> Array:
        """Return effect parameters' step: one log unit, or a value."""
        return np.array(
            [
                max(abs(float(t.values[p.name])), 1e-12) if p.signed else 1.0
                for t in point.terms
                for p in t.effect.parameters
            ]
        )

    def _moved(self, point: Point, step: Array) -> Point:
        n = len(self.sd)
        theta = np.clip(
            point.theta + self.sd * step[:n], -FREQUENCY_FIT.prior_bound * self.sd, FREQUENCY_FIT.prior_bound * self.sd
        )
        moves = iter(step[n:])
        terms = []
        for term in point.terms:
            values = {}
            for p in term.effect.parameters:
                value, by = float(term.values[p.name]), float(next(moves))
                if p.signed:
                    values[p.name] = value + by * max(abs(value), 1e-12)
                else:
                    values[p.name] = value * float(np.exp(by))
                values[p.name] = bounded(term, p.name, values[p.name])
            terms.append(Term(effect=term.effect, place=term.place, values=values))
        return Point(theta=theta, terms=tuple(terms))

    def _result(self, point: Point) -> Fit:
        parts = self.differences(point, with_derivatives=True)
        whole = float(sum(r.e @ r.e for r in parts))
        cost = whole - sum(r.penalty for r in parts)
        effective_samples = sum(r.effective_samples for r in parts)
        _, jacobian = self._stacked(point, 0.0)
        n = len(self.sd)
        normal = jacobian.T @ jacobian
        normal[n:, n:] += np.eye(len(normal) - n) / FREQUENCY_FIT.loose**2
        level = max(float(np.sqrt(cost / effective_samples)), 1.0)
        spread = np.sqrt(np.maximum(np.diag(np.linalg.inv(normal)), 0.0))[n:] * level * self._sizes(point)
        labels = [f"{t.label}:{p.name}" for t in point.terms for p in t.effect.parameters]
        return Fit(
            terms=point.terms,
            theta=point.theta,
            offsets=np.zeros(len(self.problem.names)),
            starts={},
            error=np.array([[np.sqrt(r.e @ r.e / r.effective_samples)] for r in parts]),
            chi2=whole + float(np.sum((point.theta / self.sd) ** 2)),
            cost=cost,
            sd=dict(zip(labels, spread.tolist(), strict=True)),
            information=information_on(normal, n),
        )

    @property
    def effective_samples(self) -> float:
        """Effective sample size of the data."""
        point = Point(theta=np.zeros(len(self.sd)), terms=())
        return float(sum(r.effective_samples for r in self.differences(point)))


def bounded(term: Term, name: str, value: float) -> float:
    """Return a parameter's value within its prior range.

    Ranges relative to recorded quantities do not apply.

    Parameters
    ----------
    term : Term
        Term.
    name : str
        Parameter.
    value : float
        Value.

    Returns
    -------
    float
        Bounded value.
    """
    p = term.effect.parameter(name)
    if p.reference:
        return value
    if p.signed:
        return float(np.clip(value, -p.high, p.high))
    return float(np.clip(value, p.low, p.high))
