"""Search for a gain matrix D > 0 with damping bounds.

The bounds concern exact closed-loop damping ratios. The laws of equations (4.32) and (4.38) add their objectives.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vlab.design.closed_loop import ClosedLoop, RateFeedbackLoop, TrackedModes
from vlab.design.sequential import Evaluation, LinearConstraints, Settings, Solution, minimise
from vlab.errors import BadDesign
from vlab.fe.damping import driven_modes
from vlab.fe.model import FeModel
from vlab.signals import Array

LEAST = 1e-6
"""LEAST [1]: smallest eigenvalue of D, relative to the gain scale, that counts as D > 0."""
SAME = 1e-3
"""SAME [1]: relative difference of objectives below which two starts reached the same optimum."""
ACTIVE = 1e-6
"""ACTIVE [1]: multiplier, relative to the objective per unit of the bound, above which a constraint is active."""

Objective = Callable[[ClosedLoop, Array], tuple[Array, Array, Array, Sequence[str]]]
"""Closed loops and extra variables (k, n_extra) to smooth constraints. The result has constraints >= 0 (k, m) with
their names. Their derivatives are by D (k, m, n_coils, n_coils) and by the extra variables (k, m, n_extra)."""


@dataclass(frozen=True, kw_only=True)
class Search:
    """Report of a search and its reliability.

    Parameters
    ----------
    starts, reached : int
        Number of starts, and number within 0.1 % of the best objective.
    unseen_share : float
        Upper limit, with 95 % probability, on the share of random starts attracted by an undiscovered better optimum.
    local_minima : tuple of float
        Objectives of the distinct optima, best first.
    active : dict of str to float
        Active constraints with multipliers: relative decrease of the objective per relative relaxation of the bound.
    converged : bool
        Whether the best start converged. A kink prevents convergence, for example a double pole where damping ratios
        have no gradient. `active` and `local_gap` are then meaningless.
    local_gap : float
        Relative decrease of the objective predicted by the last subproblem.
    lower_bound : float or None
        Lower bound of every gain matrix in the objective's unit, if known.
    iterations : int
        Total number of subproblems.
    """

    starts: int
    reached: int
    unseen_share: float
    local_minima: tuple[float, ...]
    active: dict[str, float]
    converged: bool
    local_gap: float
    lower_bound: float | None
    iterations: int


@dataclass(frozen=True, kw_only=True, eq=False)
class GainSearch:
    """Symmetric gain matrices with damping bounds.

    Parameters
    ----------
    loop : RateFeedbackLoop
        Structure with coils.
    damping : float
        Smallest damping ratio zeta_L of the bounded modes.
    modes : tuple of int
        Bounded modes of the open loop, from 0.
    diagonal : bool
        Whether each coil uses its own sensor only.

    Raises
    ------
    BadDesign
        The bound is no damping ratio, or a mode is not in the model or not driven by any coil.
    """

    loop: RateFeedbackLoop
    damping: float
    modes: tuple[int, ...]
    diagonal: bool = False

    def __post_init__(self) -> None:
        if not (np.isfinite(self.damping) and 0 < self.damping < 1):
            raise BadDesign(f"the damping bound {self.damping} is not a ratio between 0 and 1")
        n = self.loop.model.n
        if not self.modes or len(set(self.modes)) != len(self.modes) or not all(0 <= m < n for m in self.modes):
            raise BadDesign(f"the bounded modes {[m + 1 for m in self.modes]} are not distinct numbers from 1 to {n}")
        driven = set(driven_modes(self.loop.at_coils.T).tolist())
        for mode in self.modes:
            if mode not in driven and self.loop.model.zeta[mode] < self.damping:
                raise BadDesign(
                    f"mode {mode + 1} at {self.loop.model.freq[mode]:.4g} Hz cannot reach the damping ratio {self.damping:g}: no coil "
                    f"moves it, it stays at {self.loop.model.zeta[mode]:.4g}; leave it out of the bounded modes"
                )

    @cached_property
    def entries(self) -> tuple[Array, Array]:
        """Rows and columns of the searched entries of D.

        The entries are the upper triangle, or the diagonal.
        """
        coils = self.loop.at_coils.shape[1]
        return (np.arange(coils), np.arange(coils)) if self.diagonal else np.triu_indices(coils)

    @property
    def count(self) -> int:
        """Number of searched entries."""
        return len(self.entries[0])

    @cached_property
    def scale(self) -> float:
        """Gain scale [N s/m].

        Equal dashpots of that gain at all coils give the most demanding mode its damping to first order.
        """
        modes = list(self.modes)
        moved = (self.loop.at_coils[modes] ** 2).sum(axis=1)
        return float((2 * self.loop.omega[modes] * self.damping / np.maximum(moved, 1e-6 * moved.max())).max())

    def gains(self, x: Array) -> Array:
        """Return D [N s/m] from searched entries.

        Parameters
        ----------
        x : array
            Entries in units of the scale, (k, count).

        Returns
        -------
        array
            D, (k, n_coils, n_coils).
        """
        rows, columns = self.entries
        coils = self.loop.at_coils.shape[1]
        D = np.zeros((len(x), coils, coils))
        D[:, rows, columns] = D[:, columns, rows] = self.scale * x[:, : self.count]
        return D

    def along_entries(self, gradient: Array) -> Array:
        """Return derivatives by the searched entries, (..., count).

        `gradient` holds the derivatives by d_ij.
        """
        rows, columns = self.entries
        both = gradient[..., rows, columns] + gradient[..., columns, rows]
        return self.scale * np.where(rows == columns, 0.5, 1.0) * both

    def random_gains(self, count: int, seed: int) -> Array:
        """Return random positive definite D in units of the scale.

        Parameters
        ----------
        count : int
            Number of matrices.
        seed : int
            Seed.

        Returns
        -------
        array
            D, (count, n_coils, n_coils).
        """
        if count < 1:
            raise BadDesign(f"{count} starts cannot be searched from; accepted: whole numbers from 1")
        rng, coils = np.random.default_rng(seed), self.loop.at_coils.shape[1]
        X = rng.standard_normal((count, coils, coils))
        D = np.einsum("ki,ij->kij", X[:, 0] ** 2, np.eye(coils)) if self.diagonal else X @ X.transpose(0, 2, 1)
        D = D + 1e-3 * np.eye(coils)  # keeps starts off the boundary of D > 0
        return D / np.abs(D).sum(axis=2).max(axis=1)[:, None, None] * rng.uniform(0.3, 2.0, count)[:, None, None]

    def evaluator(self, objective: Objective, extra: int) -> "_Evaluator":
        """Return the functions of the search.

        The last of the `extra` variables is minimised.
        """
        return _Evaluator(self, objective, extra)

    def no_constraints(self, extra: int) -> LinearConstraints:
        """Return the linear constraints common to all searches.

        A diagonal D has linear bounds; a full D has bounds on eigenvalues instead.
        """
        n = self.count + extra
        rows = np.eye(n)[: self.count] if self.diagonal else np.zeros((0, n))
        return LinearConstraints(A=rows, lower=np.full(len(rows), LEAST), upper=np.full(len(rows), np.inf))

    def run(self, objective: Objective, starts: Array, linear: LinearConstraints) -> tuple[Solution, "_Evaluator"]:
        """Search from every start for the smallest last variable.

        Parameters
        ----------
        objective : Objective
            Smooth constraints of the law.
        starts : array
            Start points, (k, count + extra).
        linear : LinearConstraints
            Linear constraints.

        Returns
        -------
        tuple of (Solution, _Evaluator)
            Solution, and the functions.

        Raises
        ------
        BadDesign
            The damping bounds cannot be met; the message names the mode and its highest damping.
        """
        evaluator = self.evaluator(objective, starts.shape[1] - self.count)
        solution = minimise(evaluator, starts, linear, Settings())
        if not solution.feasible.any():
            raise self._infeasible(solution)
        return solution, evaluator

    def _infeasible(self, solution: Solution) -> BadDesign:
        best = self.gains(solution.x[[solution.best]])
        zeta = self.loop.track(best, max(self.modes) + 1).zeta[0]
        short = [mode for mode in self.modes if zeta[mode] < self.damping * (1 - 1e-6)]
        words = []
        for mode in short:
            highest = max(self.highest_damping(mode), zeta[mode])
            alone = "cannot reach it" if highest < self.damping else "reaches it only at the cost of others"
            words.append(
                f"mode {mode + 1} at {self.loop.model.freq[mode]:.4g} Hz {alone} (highest ratio found {highest:.4g})"
            )
        return BadDesign(
            f"no gain matrix gives modes {', '.join(str(m + 1) for m in self.modes)} the damping ratio {self.damping:g}: "
            f"{'; '.join(words) or 'the search found no positive definite D'}; lower the bound or bound fewer modes"
        )

    def highest_damping(self, mode: int, starts: int = 4, seed: int = 0) -> float:
        """Return the highest damping ratio found for one mode.

        The search is over all D >= 0.

        Parameters
        ----------
        mode : int
            Mode, from 0.
        starts : int
            Number of random starts.
        seed : int
            Seed of the random starts.

        Returns
        -------
        float
            Damping ratio.
        """
        alone = GainSearch(loop=self.loop, damping=self.damping, modes=(mode,), diagonal=self.diagonal)
        random = self.random_gains(starts, seed)[:, self.entries[0], self.entries[1]]

        def lack(closed: ClosedLoop, z: Array) -> tuple[Array, Array, Array, Sequence[str]]:
            return np.zeros((len(z), 0)), np.zeros((len(z), 0, *closed.gains.shape[1:])), np.zeros((len(z), 0, 1)), ()

        # the constraint zeta / zeta_L - 1 + z >= 0 becomes the objective, with z the largest deficit
        evaluator = _Evaluator(alone, lack, 1, elastic=True)
        points = np.hstack([random, np.ones((starts, 1))])
        solution = minimise(evaluator, points, self.no_constraints(1), Settings(iterations=60))
        return float(self.damping * (1 - solution.f.min()))

    def report(
        self,
        solution: Solution,
        evaluator: "_Evaluator",
        *,
        linear_names: Sequence[str],
        values: Array,
        price: float,
        lower_bound: float | None = None,
    ) -> Search:
        """Return the report on the best start.

        Parameters
        ----------
        solution : Solution
            Result of the search.
        evaluator : _Evaluator
            Functions of the search.
        linear_names : sequence of str
            Names of the linear constraints; unnamed ones are not reported.
        values : (n_starts,) array
            Reported objectives.
        price : float
            Relative change of the reported objective per unit of the searched one, at the best start.
        lower_bound : float or None
            Lower bound of every gain matrix in the objective's unit, if known.

        Returns
        -------
        Search
            Report.
        """
        best, reached = solution.best, solution.feasible
        prices = price * np.concatenate([solution.multipliers[best], np.abs(solution.linear_multipliers[best])])
        minima = [float(values[best])]
        for value in np.sort(values[reached]):
            if value > minima[-1] * (1 + SAME):
                minima.append(float(value))
        names = [*evaluator.names, *linear_names]
        return Search(
            starts=len(values),
            reached=solution.reached(SAME / price),
            unseen_share=1 - 0.05 ** (1 / len(values)),
            local_minima=tuple(minima),
            active={name: float(p) for name, p in zip(names, prices, strict=True) if name and p > ACTIVE},
            converged=bool(solution.converged[best]),
            local_gap=float(price * solution.predicted[best]),
            lower_bound=lower_bound,
            iterations=int(solution.iterations.sum()),
        )


class _Evaluator:
    """Functions for `minimise` with mode tracking.

    The modes of each start's last point are stored and followed from there.
    """

    def __init__(self, search: GainSearch, objective: Objective, extra: int, *, elastic: bool = False) -> None:
        self.search, self.objective, self.extra, self.elastic = search, objective, extra, elastic
        self.last: dict[int, TrackedModes] = {}
        self.names: tuple[str, ...] = ()

    def tracked(self, closed: ClosedLoop, which: Array) -> TrackedModes:
        """Follow the bounded modes from each start's last point.

        The open loop is the first point.
        """
        count = max(self.search.modes) + 1
        known = [self.last.get(int(w)) for w in which]
        if any(last is None for last in known):
            found = self.search.loop.open_modes(count).repeated(len(which)).follow(closed)
        else:
            found = TrackedModes.joined([last for last in known if last is not None]).follow(closed)
        for row, start in enumerate(which):
            self.last[int(start)] = found.chosen(np.array([row]))
        return found

    def __call__(self, x: Array, which: Array) -> Evaluation:
        search, k = self.search, len(x)
        z = x[:, search.count :]
        closed = search.loop.closed(search.gains(x))
        modes = self.tracked(closed, which)
        chosen = list(search.modes)
        zeta = modes.zeta[:, chosen] / search.damping - 1
        zeta_slopes = search.along_entries(modes.zeta_gradients[:, chosen]) / search.damping
        own, own_slopes, own_extra, names = self.objective(closed, z)
        parts, slopes = [zeta, own], [zeta_slopes, search.along_entries(own_slopes)]
        labels = [f"damping of mode {mode + 1}" for mode in chosen] + list(names)
        if not search.diagonal:
            values, vectors = np.linalg.eigh(closed.gains / search.scale)
            rows, columns = search.entries
            parts.append(values - LEAST)
            slopes.append(
                (vectors[:, rows] * vectors[:, columns] * np.where(rows == columns, 1.0, 2.0)[:, None]).transpose(
                    0, 2, 1
                )
            )
            labels += [f"D > 0, eigenvalue {i + 1}" for i in range(values.shape[1])]
        self.names = tuple(labels)
        c = np.concatenate(parts, axis=1)
        gradient = np.zeros((k, c.shape[1], x.shape[1]))
        gradient[:, :, : search.count] = np.concatenate(slopes, axis=1)
        gradient[:, len(chosen) : len(chosen) + own.shape[1], search.count :] = own_extra
        if self.elastic:
            c[:, : len(chosen)] += z[:, -1:]
            gradient[:, : len(chosen), -1] = 1.0
        objective = np.zeros_like(x)
        objective[:, -1] = 1.0
        return Evaluation(f=x[:, -1].copy(), f_gradient=objective, c=c, c_gradient=gradient)


def bounded_modes(fe: FeModel, modes: int | Sequence[int]) -> tuple[int, ...]:
    """Return the bounded modes, from 0.

    Parameters
    ----------
    fe : FeModel
        FE model.
    modes : int or sequence of int
        Number of first coil-driven modes, or mode numbers from 0.

    Returns
    -------
    tuple of int
        Mode numbers.

    Raises
    ------
    BadDesign
        The coils drive fewer modes.
    """
    if not isinstance(modes, (int, np.integer)):
        return tuple(int(mode) for mode in modes)
    driven = fe.measured
    if not 1 <= modes <= len(driven):
        raise BadDesign(f"{modes} modes cannot be bounded; the coils drive {len(driven)} modes of this model")
    return tuple(int(mode) for mode in driven[:modes])
