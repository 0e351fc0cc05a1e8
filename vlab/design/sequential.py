"""Sequential quadratic programming from many starts, with penalty and trust region.

    minimise f(x)   subject to   c(x) >= 0   and   lower <= A x <= upper

Each step solves the quadratic subproblem of Fletcher's S-l1-QP method [1]_ with OSQP [2]_. Linear constraints hold
exactly. The linearised smooth constraints have slacks with a penalty, so a subproblem always has a solution. An
infeasible problem shows as remaining slacks. Damped BFGS updates approximate the Lagrangian's curvature. One call
evaluates the functions for all starts, which are independent.

References
----------
.. [1] J. Nocedal and S. J. Wright, Numerical Optimization, 2nd ed., Springer, 2006, sections 18.5 and 18.7.
.. [2] B. Stellato, G. Banjac, P. Goulart, A. Bemporad and S. Boyd, OSQP: an operator splitting solver for quadratic
       programs, Mathematical Programming Computation 12 (2020) 637-672.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import osqp
from scipy import sparse

from vlab.errors import BadDesign
from vlab.signals import Array

ACCEPT, GOOD = 0.05, 0.7
"""ACCEPT [1]: smallest share of the predicted decrease of an accepted step.
GOOD [1]: share from which the trust region grows."""
RETRIES = 3
"""RETRIES [1]: largest number of reductions of the trust region after a failure of OSQP."""
CONFINED = 1e-3
"""CONFINED [units of x]: trust-region radius below which convergence needs a small predicted decrease relative to the
radius."""
TINY = 1e-20
"""TINY [1]: smallest curvature along a step that updates the approximation."""
OSQP: dict[str, Any] = {
    "verbose": False,
    "polishing": True,
    "eps_abs": 1e-4,
    "eps_rel": 1e-4,
    "max_iter": 4000,
    "check_termination": 25,
    "adaptive_rho_interval": 100,  # a number of iterations instead of a time gives the same bits in each run
}
"""Options of OSQP. Polishing solves the active set exactly, so a coarse tolerance suffices; `OSQP_PRECISE` follows a
failed polish."""
OSQP_SOLVED = (osqp.SolverStatus.OSQP_SOLVED, osqp.SolverStatus.OSQP_SOLVED_INACCURATE)
"""Accepted states of OSQP."""
OSQP_PRECISE: dict[str, Any] = {"eps_abs": 1e-7, "eps_rel": 1e-7, "max_iter": 10000}
"""Options of OSQP after a failed polish."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Evaluation:
    """Functions and gradients at k points.

    Parameters
    ----------
    f : (k,) array
        Objective.
    f_gradient : (k, n) array
        Gradient of the objective.
    c : (k, m) array
        Constraints c >= 0.
    c_gradient : (k, m, n) array
        Gradients of the constraints.
    """

    f: Array
    f_gradient: Array
    c: Array
    c_gradient: Array


Evaluate = Callable[[Array, Array], Evaluation]
"""Points (k, n) and the indices of their starts, (k,), to an `Evaluation`."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearConstraints:
    """Linear constraints lower <= A x <= upper.

    Parameters
    ----------
    A : (p, n) array
        Coefficients.
    lower, upper : (p,) array
        Bounds, possibly infinite.
    """

    A: Array
    lower: Array
    upper: Array

    def __post_init__(self) -> None:
        rows = len(self.A)
        if np.ndim(self.A) != 2 or np.shape(self.lower) != (rows,) or np.shape(self.upper) != (rows,):
            raise BadDesign(
                f"linear constraints of shapes {np.shape(self.A)}, {np.shape(self.lower)}, {np.shape(self.upper)} do not fit together"
            )
        if np.any(self.lower > self.upper):
            raise BadDesign("a linear constraint has its lower bound above its upper one: nothing can satisfy it")


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of the search.

    Lengths are in units of x, so x should be of order one.

    Parameters
    ----------
    iterations : int
        Largest number of subproblems a start.
    curvature : float
        Initial curvature of the Lagrangian.
    radius, smallest_radius : float
        First and last half width of the trust region.
    tolerance : float
        Predicted decrease of the merit function, and violation, at convergence.
    penalty, largest_penalty : float
        Initial penalty per unit of violation, and the largest before a start counts as infeasible.
    """

    iterations: int = 80
    curvature: float = 0.01
    radius: float = 0.5
    smallest_radius: float = 1e-9
    tolerance: float = 1e-8
    penalty: float = 10.0
    largest_penalty: float = 1e5


@dataclass(frozen=True, kw_only=True, eq=False)
class Solution:
    """End points of every start.

    Parameters
    ----------
    x : (k, n) array
        End points.
    f, violation : (k,) array
        Objective, and sum of violations.
    multipliers : (k, m) array
        Multipliers of the smooth constraints: increase of f per unit demanded of c.
    linear_multipliers : (k, p) array
        Multipliers of the linear constraints; positive at the upper bound, negative at the lower.
    predicted : (k,) array
        Decrease of the merit function predicted by the last subproblem, an estimate of the distance from the local
        minimum.
    converged : (k,) bool array
        Whether the last predicted decrease is within the tolerance. A kink prevents convergence.
    iterations : (k,) int array
        Number of subproblems.
    accepted : float
        Largest violation that counts as feasible.
    """

    x: Array
    f: Array
    violation: Array
    multipliers: Array
    linear_multipliers: Array
    predicted: Array
    converged: Array
    iterations: Array
    accepted: float

    @cached_property
    def feasible(self) -> Array:
        """Whether the end point satisfies the constraints, (k,)."""
        return self.violation <= self.accepted

    @cached_property
    def best(self) -> int:
        """Start with the smallest feasible objective.

        Without a feasible start: the smallest violation.
        """
        if self.feasible.any():
            return int(np.where(self.feasible, self.f, np.inf).argmin())
        return int(self.violation.argmin())

    def reached(self, within: float) -> int:
        """Return the number of starts within a distance of the best.

        The distance is in units of the objective.
        """
        return int(np.count_nonzero(self.feasible & (self.f <= self.f[self.best] + within)))


def minimise(
    evaluate: Evaluate, starts: Array, linear: LinearConstraints, settings: Settings | None = None
) -> Solution:
    """Run the search from every start.

    Parameters
    ----------
    evaluate : callable
        Functions and gradients, see `Evaluate`.
    starts : (k, n) array
        Points within the linear constraints.
    linear : LinearConstraints
        Linear constraints.
    settings : Settings or None
        Settings; defaults if None.

    Returns
    -------
    Solution
        End points.

    Raises
    ------
    BadDesign
        A start violates a linear constraint, or shapes do not fit.
    """
    settings = settings or Settings()
    starts = np.atleast_2d(np.asarray(starts, dtype=float))
    if starts.shape[1] != linear.A.shape[1]:
        raise BadDesign(f"starts with {starts.shape[1]} variables do not fit constraints on {linear.A.shape[1]}")
    slack = np.minimum(starts @ linear.A.T - linear.lower, linear.upper - starts @ linear.A.T)
    if slack.size and slack.min() < -1e-9:
        raise BadDesign(
            f"start {int(slack.min(axis=1).argmin()) + 1} violates a linear constraint by {-slack.min():.2g}"
        )
    first = evaluate(starts, np.arange(len(starts)))
    searches = [_Search(x, first, k, linear, settings) for k, x in enumerate(starts)]
    for _ in range(settings.iterations):
        going = [s for s in searches if not s.done]
        for search in going:
            search.propose()
        going = [s for s in going if not s.done]
        if not going:
            break
        trial = evaluate(np.array([s.trial for s in going]), np.array([s.number for s in going]))
        for row, search in enumerate(going):
            search.judge(trial, row)
    return Solution(
        x=np.array([s.x for s in searches]),
        f=np.array([s.f for s in searches]),
        violation=np.array([_lack(s.c) for s in searches]),
        multipliers=np.array([s.multipliers for s in searches]),
        linear_multipliers=np.array([s.linear_multipliers for s in searches]),
        predicted=np.array([s.predicted for s in searches]),
        converged=np.array([s.converged for s in searches]),
        iterations=np.array([s.steps for s in searches]),
        accepted=100 * settings.tolerance,
    )


class _Search:
    """State of one start: point, curvature, penalty, trust region."""

    def __init__(self, x: Array, at: Evaluation, number: int, linear: LinearConstraints, settings: Settings) -> None:
        self.x, self.number, self.linear, self.settings = x.copy(), number, linear, settings
        self._take(at, number)
        self.H = settings.curvature * np.eye(x.size)
        self.radius, self.penalty = settings.radius, settings.penalty
        self.multipliers, self.linear_multipliers = np.zeros(self.c.size), np.zeros(len(linear.A))
        self.predicted, self.steps, self.done, self.converged = np.inf, 0, False, False
        self.step, self.trial = np.zeros(x.size), self.x
        self.curved: Array | None = None
        self.subproblem = _Subproblem(x.size, self.c.size, linear.A)

    def _take(self, at: Evaluation, row: int) -> None:
        self.f, self.g = float(at.f[row]), at.f_gradient[row]
        self.c, self.J = at.c[row], at.c_gradient[row]

    def merit(self, f: float, c: Array) -> float:
        """Return objective plus penalty."""
        return f + self.penalty * _lack(c)

    def propose(self) -> None:
        """Solve the subproblem and set the trial point.

        A small predicted decrease ends the search.
        """
        self.steps += 1
        if self.curved is not None:  # second-order correction with the constraints at the rejected point
            correction = self.subproblem.solve(self, self.curved)[0]
            self.trial = self.x + (correction if np.all(np.isfinite(correction)) else self.step)
            return
        violation, tolerance = _lack(self.c), self.settings.tolerance
        gain = self._solve(violation)
        if violation > tolerance and gain < 0.1 * violation:
            self._raise_penalty(violation, gain)
            gain = violation - _lack(self.c + self.J @ self.step)
        if not np.all(np.isfinite(self.step)):
            self.done = True
            return
        needed = max(float(self.multipliers.max(initial=0.0)), 0.1)
        if violation < 0.1 and self.penalty > 4 * needed:
            self.penalty = 2 * needed  # a large penalty over-weights constraint curvature and shortens steps
        decrease = -(self.g @ self.step) - 0.5 * self.step @ self.H @ self.step
        self.predicted = max(0.0, decrease + self.penalty * gain)
        self.trial = self.x + self.step
        confined = min(1.0, self.radius / CONFINED)  # a tiny trust region predicts a small decrease everywhere
        arrived = self.predicted <= tolerance * confined * max(1.0, abs(self.f))
        if arrived or self.radius < self.settings.smallest_radius:
            self.done, self.converged = True, arrived

    def _solve(self, violation: float) -> float:
        """Solve the subproblem.

        Return the decrease of the linearised violation.
        """
        self.step, multipliers, linear_multipliers = self.subproblem.solve(self, self.c)
        for _ in range(RETRIES):
            if np.all(np.isfinite(self.step)):
                self.multipliers, self.linear_multipliers = multipliers, linear_multipliers
                break
            self.radius *= 0.1
            self.step, multipliers, linear_multipliers = self.subproblem.solve(self, self.c)
        return violation - _lack(self.c + self.J @ self.step)

    def _raise_penalty(self, violation: float, gain: float) -> None:
        """Raise the penalty until a step reduces the violation enough.

        The reference is the largest reduction within the trust region.
        """
        given, most = self.penalty, self.settings.largest_penalty
        self.penalty = most
        possible = self._solve(violation)
        if possible <= 2 * gain + self.settings.tolerance:  # no reduction is possible here, whatever the penalty
            self.penalty = given
            self._solve(violation)
            return
        self.penalty = given
        while gain < 0.3 * possible and self.penalty < most:
            self.penalty = min(10 * self.penalty, most)
            gain = self._solve(violation)

    def judge(self, at: Evaluation, row: int) -> None:
        """Accept or reject the trial point and set the trust region."""
        ratio = (self.merit(self.f, self.c) - self.merit(float(at.f[row]), at.c[row])) / self.predicted
        length = float(np.abs(self.step).max())
        if not np.isfinite(ratio) or ratio < ACCEPT:
            if self.curved is None and np.all(np.isfinite(at.c[row])):
                self.curved = at.c[row] - self.J @ self.step
            else:
                self.curved, self.radius = None, 0.25 * min(length, self.radius)
            return
        self.curved = None
        step, before = self.trial - self.x, self.g - self.J.T @ self.multipliers
        self.x = self.trial
        self._take(at, row)
        self._learn(step, self.g - self.J.T @ self.multipliers - before)
        if ratio > GOOD and length > 0.8 * self.radius:
            self.radius = 2.0 * self.radius
        elif ratio < 0.25:
            self.radius = 0.5 * length

    def _learn(self, step: Array, change: Array) -> None:
        """Update the curvature by Powell's damped BFGS.

        The update keeps the matrix positive definite.
        """
        Hs = self.H @ step
        sHs = float(step @ Hs)
        if sHs <= TINY:
            return
        sy = float(step @ change)
        share = 1.0 if sy >= 0.2 * sHs else 0.8 * sHs / (sHs - sy)
        y = share * change + (1 - share) * Hs
        self.H = self.H - np.outer(Hs, Hs) / sHs + np.outer(y, y) / float(step @ y)


class _Subproblem:
    """Quadratic program of one start for OSQP.

    Lengths are in units of the trust region; every smooth constraint has a slack.
    """

    def __init__(self, n: int, m: int, A: Array) -> None:
        self.n, self.m, self.A = n, m, A
        columns, rows = np.tril_indices(n)  # upper triangle, column by column
        self.triangle = rows, columns
        self.pattern = np.concatenate([rows, range(n, n + m)]), np.concatenate([columns, range(n, n + m)])

    def solve(self, at: _Search, c: Array) -> tuple[Array, Array, Array]:
        """Return step and multipliers of smooth and linear constraints.

        The step is NaN if OSQP fails.
        """
        n, m, p, radius = self.n, self.m, len(self.A), at.radius
        rows = np.zeros((m + p + n + m, n + m))
        rows[:m, :n], rows[:m, n:] = at.J, np.eye(m)
        rows[m : m + p, :n] = self.A
        rows[m + p :] = np.eye(n + m)
        value = self.A @ at.x
        lower = np.concatenate([-c / radius, (at.linear.lower - value) / radius, np.full(n, -1.0), np.zeros(m)])
        upper = np.full(len(lower), np.inf)
        upper[m : m + p], upper[m + p : m + p + n] = (at.linear.upper - value) / radius, 1.0
        reach = 1.01 * np.abs(rows[: m + p, :n]).sum(axis=1)  # drops unreachable constraints
        lower[: m + p] = np.where(lower[: m + p] < -reach, -np.inf, np.minimum(lower[: m + p], upper[: m + p]))
        upper[: m + p] = np.where(upper[: m + p] > reach, np.inf, upper[: m + p])
        curvature = np.concatenate([radius * at.H[self.triangle], np.zeros(m)])
        solver = osqp.OSQP()
        solver.setup(
            sparse.csc_matrix((curvature, self.pattern), shape=(n + m, n + m)),
            np.concatenate([at.g, np.full(m, at.penalty)]),
            sparse.csc_matrix(rows),
            lower,
            upper,
            **OSQP,
        )
        found = solver.solve(raise_error=False)
        if found.info.status_polish != 1:
            solver.update_settings(**OSQP_PRECISE)
            found = solver.solve(raise_error=False)
        if found.info.status_val not in OSQP_SOLVED or not np.all(np.isfinite(found.x)):
            return np.full(n, np.nan), np.zeros(m), np.zeros(p)
        return radius * found.x[:n], np.maximum(0.0, -found.y[:m]), found.y[m : m + p]


def _lack(c: Array) -> float:
    return float(np.maximum(0.0, -c).sum())
