"""Maximum a posteriori fits of hypotheses in time, by the Levenberg-Marquardt method.

The reduced model is simulated with the effects in the loop, for many parameter sets at once. Uncertain parameters enter
in their identifiable subspace; initial states and sensor offsets are nuisance parameters. Derivatives are finite
differences with Broyden updates.

References
----------
D. W. Marquardt, An algorithm for least-squares estimation of nonlinear parameters, J. SIAM 11 (1963) 431-441.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property, partial

import numpy as np

from vlab.diagnose.data.runs import Signals
from vlab.diagnose.inference.descent import clip_diverged, descend
from vlab.diagnose.inference.evidence import effective_sample_size
from vlab.diagnose.inference.fit_at_optimum import fit_at
from vlab.diagnose.inference.identifiable_subspace import identifiable_subspace, information
from vlab.diagnose.inference.parameter_vector import ParameterVector, limits_of
from vlab.diagnose.inference.ridge_regression import ridge_inverse
from vlab.diagnose.inference.score_test import ScoreTest
from vlab.diagnose.inference.starting_vectors import starting_vectors
from vlab.diagnose.parameters.terms import Fit, Term
from vlab.diagnose.predictors.modal import channels, mix, sense
from vlab.diagnose.settings import EVIDENCE, FIT, PROBLEM, RUNS
from vlab.physics.effect import PickUp, SensorEffect
from vlab.signals import Array


class LeastSquares:
    """Fits of hypotheses to a problem's runs.

    Parameters
    ----------
    screen : ScoreTest
        Screening with the identifiable subspace and initial states.
    runs : sequence of Signals or None
        Runs; those of the screening by default.
    model_error : float or None
        Allowed simulation error over a channel's rms; that of the problem by default.
    is_rough : bool
        Whether to take coarser steps, for first fits.
    """

    is_rough = False
    directions: Array
    """Identifiable directions (n_changes, r) of the uncertain parameters, of unit prior variance."""
    unidentifiable: Array
    """Unidentifiable directions (n_changes, n_changes - r) of the uncertain parameters."""

    def __init__(
        self,
        screen: ScoreTest,
        runs: Sequence[Signals] | None = None,
        model_error: float | None = None,
        *,
        is_rough: bool = False,
    ) -> None:
        self.is_rough = is_rough
        self.screen, self.problem, self.reduced_model = screen, screen.problem, screen.reduced_model
        self.runs = list(runs if runs is not None else screen.runs)
        self._weigh(model_error)
        self.highest = max(
            min(float(np.abs(self.reduced_model.omega).max()) / (2 * np.pi), self.problem.highest_hz),
            FIT.least_highest_hz,
        )
        self.active = self._active()
        self.free_starts: dict[int, tuple[Array, Array, Array]] = {}
        self.directions = self._identifiable()
        self.free_starts = self.initial_condition_nuisance()

    def _weigh(self, model_error: float | None = None) -> None:
        """Set the samples' weights and effective sample sizes."""
        self.model_error = self.problem.model_error if model_error is None else model_error
        self.sigma = np.array([np.hypot(run.noise, self.model_error * run.scale) for run in self.runs])
        self.effective_samples = self.n_values * min(1.0, 2.0 / RUNS.points_per_cycle)
        noise = np.array([run.noise for run in self.runs])
        scale = np.array([run.scale for run in self.runs])
        self.noise_share = float(np.mean((noise / self.sigma) ** 2))
        self.error_share = float(np.mean((self.problem.model_kind.own_error * scale / self.sigma) ** 2))
        self.integration_share = float(np.mean((PROBLEM.integration_error * scale / self.sigma) ** 2))
        correlated = float(np.mean((self.correlated_error * scale / self.sigma) ** 2))
        self.effective_share = self.effective_samples
        if correlated and self.effective_samples > EVIDENCE.model_error_samples:
            # full weight would bias the uncertain parameters far from their priors
            self.effective_share = effective_sample_size(self.noise_share, correlated, self.effective_samples)

    @property
    def correlated_error(self) -> float:
        """Relative model error that is correlated over samples."""
        return self.problem.model_kind.correlated_error

    @cached_property
    def weights(self) -> list[Array]:
        """Weights (n, n_channels) of every run's samples.

        A weight is one over the standard deviation of noise and model error, zero for lost samples.
        """
        return [run.usable / sigma for run, sigma in zip(self.runs, self.sigma, strict=True)]

    def _identifiable(self) -> Array:
        """Return the identifiable directions of unit prior variance."""
        sd, scale = self.reduced_model.prior, self.problem.common_scale
        unknown = np.vstack([self.problem.redundant, *([] if scale is None else [np.asarray(scale / sd)])])
        informed, self.unidentifiable = identifiable_subspace(*information(self), sd, unknown)
        return informed

    def initial_condition_nuisance(self) -> dict[int, tuple[Array, Array, Array]]:
        """Return every window's free responses, their solver, and the start's spread.

        Window starts are smoothed without the missing physics. Every residual is projected off the free responses
        within that spread, by linear least squares.
        """
        out: dict[int, tuple[Array, Array, Array]] = {}
        m2 = 2 * self.reduced_model.m
        for h in sorted({run.h for run in self.runs}):
            index = [i for i, run in enumerate(self.runs) if run.h == h and run.start is not None and not run.at_rest]
            if not index:
                continue
            longest = max((self.runs[i] for i in index), key=len)
            quiet = replace(longest, u=0 * longest.u, load=0 * longest.load, t0=0.0, before=None)
            starts = np.eye(m2)[:, None, :]
            theta = np.repeat(self.screen.theta[None], m2, axis=0)
            free = self.simulate([quiet], (), theta, (), starts)[:, :, 0]  # (n, 2m, p)
            states = np.array([self.runs[i].start for i in index])
            spread = FIT.loose_start * np.maximum(np.sqrt(np.mean(states**2, axis=0)), 1e-12)
            for i in index:
                n = len(self.runs[i])
                seen = free[:n] * self.runs[i].usable[:, None, :]
                response = (seen / self.sigma[i]).transpose(0, 2, 1).reshape(-1, m2) * spread
                out[i] = (response, ridge_inverse(response), spread)
        return out

    def _active(self) -> Array:
        """Return the modes with an estimated initial state, by initial energy."""
        if not self._free:
            return np.zeros(0, dtype=int)
        size = np.zeros(self.reduced_model.m)
        for run in self._free:
            x = self.first_state(self.runs[run])
            m = self.reduced_model.m
            energy = x[m:] ** 2 + (self.reduced_model.omega * x[:m]) ** 2
            size = np.maximum(size, energy / max(energy.max(), 1e-300))
        largest = np.argsort(-size, kind="stable")[: FIT.most_started]
        return np.sort(largest[size[largest] > 1e-6])

    def first_state(self, run: Signals) -> Array:
        """Return a run's smoothed initial modal state from the screening.

        Parameters
        ----------
        run : Signals
            Run.

        Returns
        -------
        (2m,) array
            State.
        """
        if run.start is not None:
            return run.start
        for group in self.screen.groups:
            for i, other in enumerate(group.runs):
                if other.name == run.name:  # the screening may have shortened the run
                    return np.asarray(group.smoothed.x[0, i])
        return np.zeros(2 * self.reduced_model.m)

    def beside(self, terms: Sequence[Term]) -> "LeastSquares":
        """Return the fits for given terms; subclasses take other windows."""
        return self

    @property
    def recordings(self) -> list[str]:
        """Names of the recordings of the runs."""
        return [run.name for run in self.runs]

    @property
    def sample_times(self) -> list[Array]:
        """Times of the samples of every run in its recording [s]."""
        return [run.t0 + run.h * np.arange(len(run)) for run in self.runs]

    # ---- simulation -------------------------------------------------------------------------------------------------

    def simulate(
        self,
        runs: list[Signals],
        terms: Sequence[Term],
        theta: Array,
        values: Sequence[Mapping[str, Array]],
        starts: Array,
    ) -> Array:
        """Simulate parameter sets over runs of one sample period.

        Parameters
        ----------
        runs : list of Signals
            Runs.
        terms : sequence of Term
            Effects.
        theta : (n_sets, n_changes) array
            Log factors.
        values : sequence of mapping
            Parameter values (n_sets,) of every term.
        starts : (n_sets, n_runs, 2m) array
            Initial states.

        Returns
        -------
        (n, n_sets, n_runs, n_channels) array
            Channels, zero beyond a run's end.
        """
        terms, values = self.problem.beside_known(terms, values, len(theta))
        y = channels(self.reduced_model, self.highest, runs, terms, theta, values, starts, self.is_rough)
        return self._read(y, runs, terms, theta, values)

    def _read(
        self,
        y: Array,
        runs: Sequence[Signals],
        terms: Sequence[Term],
        theta: Array,
        values: Sequence[Mapping[str, Array]],
    ) -> Array:
        """Return channels (n, n_sets, n_runs, p) after sensor gains and sensor effects."""
        gains = self.reduced_model.gains(theta)[1]
        with np.errstate(over="ignore", invalid="ignore"):  # the residual of a diverged trial is clipped
            y *= gains[:, None, :]
            for term, own in zip(terms, values, strict=True):
                if isinstance(term.effect, PickUp):
                    mix(y, term, own, runs)
                elif isinstance(term.effect, SensorEffect):
                    self._sense(y, term.effect, term.place.index, gains, own, runs)
        return y

    def _sense(
        self,
        y: Array,
        effect: SensorEffect,
        index: int,
        gains: Array,
        given: Mapping[str, Array],
        runs: Sequence[Signals],
    ) -> None:
        """Apply a sensor effect to its channel, in place."""
        sense(y, effect, index, gains, given, runs)

    # ---- fitting ----------------------------------------------------------------------------------------------------

    def fit(
        self,
        terms: Sequence[Term] = (),
        start: Fit | None = None,
        iterations: int = FIT.iterations,
        thetas: Sequence[Array] = (),
        tolerance: float = FIT.near_enough,
    ) -> Fit:
        """Fit a hypothesis.

        The fit starts from the screening, or from `start` with new terms at several sizes, whichever has the least
        cost.

        Parameters
        ----------
        terms : sequence of Term
            Effects with starting values.
        start : Fit or None
            Earlier fit.
        iterations : int
            Most iterations.
        thetas : sequence of (n_changes,) arrays
            Further starts of the uncertain parameters, where `start` has all terms.
        tolerance : float
            Cost decrease [nat] below which two successive steps end the fit.

        Returns
        -------
        Fit
            Fit of least negative log posterior.
        """
        self.forget_starts()
        vector = self.vector(terms)
        first, *others = starting_vectors(self, vector, start, thetas)
        best = self.descend(vector, first, iterations, tolerance)
        for x in (
            others
        ):  # further starts only where the first one missed the noise level, or ended far from the prior means
            if best.cost < FIT.explained * self.n_values and best.prior_cost < FIT.distant * vector.r:
                break
            best = min(best, self.descend(vector, x, iterations, tolerance), key=self.negative_log_posterior)
        return best

    def forget_starts(self) -> None:
        """Forget the initial states of an earlier fit; here the parameter vector holds them."""

    @property
    def n_values(self) -> int:
        """Number of values in a fit's cost."""
        return sum(run.y.size for run in self.runs)

    def about(self, fit: Fit) -> "LeastSquares":
        """Return the least squares whose residuals are exact at a fit.

        Simulations of the reduced model need no correction.
        """
        return self

    def cheapest(self, term: Term, values: Sequence[Mapping[str, float]], start: Fit) -> tuple[float, Term]:
        """Return the best of some values of a term, without a fit.

        Parameters
        ----------
        term : Term
            Term.
        values : sequence of mapping
            Trial values.
        start : Fit
            All other parameters.

        Returns
        -------
        cost : float
            Least cost with priors.
        term : Term
            Term with the best values.
        """
        terms = [replace(term, values=dict(own)) for own in values]
        vector = self.vector(terms[:1])
        costs = self.costs(vector, np.array([self.initial(vector, [own], start.theta, start) for own in values]))
        best = int(np.argmin(costs))
        return float(costs[best]), terms[best]

    def negative_log_posterior(self, fit: Fit) -> float:
        """Return the objective of a descent [nat].

        The objective is the effective sample size times the log cost, plus the prior terms.
        """
        return self.effective_share * float(np.log(max(fit.cost, 1e-300))) + fit.prior_cost

    def descend(self, vector: ParameterVector, x: Array, iterations: int, tolerance: float = FIT.near_enough) -> Fit:
        """Fit a hypothesis from one start.

        A model class whose residual depends on the start overrides the method.

        Parameters
        ----------
        vector : ParameterVector
            Meaning of the entries.
        x : (n,) array
            Start.
        iterations : int
            Most iterations.
        tolerance : float
            Cost decrease [nat] below which two successive steps end the fit.

        Returns
        -------
        Fit
            Fit.
        """
        optimum = descend(self, vector, x, iterations, tolerance)
        theta, offsets, starts, values = self._unpacked(optimum.vector, optimum.x[None])
        return fit_at(
            optimum,
            self.runs,
            self.sigma,
            theta=theta[0],
            offsets=offsets[0],
            starts={self.runs[i].name: starts[0, i] for i in self._free},
            values=[{k: float(v[0]) for k, v in own.items()} for own in values],
        )

    def costs(self, vector: ParameterVector, X: Array) -> Array:
        """Return the costs (n_sets,) of parameter vectors (n_sets, n), with priors."""
        residuals = self.residual(vector, X)
        return np.asarray(np.einsum("ij,ij->i", residuals, residuals))

    def vector(self, terms: Sequence[Term]) -> ParameterVector:
        """Return the parameter vector of a fit.

        Parameters
        ----------
        terms : sequence of Term
            Effects.

        Returns
        -------
        ParameterVector
            Meaning, bounds and scales of the entries.
        """
        firsts = [self.first_state(self.runs[i]) for i in self._free]
        return ParameterVector(
            terms=terms,
            limits=[
                limits_of(p, t.values[p.name], partial(self.screen.reference, place=t.place))
                for t in terms
                for p in t.effect.parameters
            ],
            directions=self.directions,
            prior=self.reduced_model.prior,
            offset_sd=self.screen.offset_sd,
            omega=self.reduced_model.omega,
            active=self.active,
            firsts=np.array(firsts).reshape(len(firsts), 2 * self.reduced_model.m),
            may_vanish=self.problem.may_vanish,
        )

    @property
    def _free(self) -> list[int]:
        """Runs with an estimated initial state."""
        return [i for i, run in enumerate(self.runs) if run.start is None and not run.at_rest]

    def initial(
        self, vector: ParameterVector, values: Sequence[Mapping[str, float]], theta: Array, start: Fit | None
    ) -> Array:
        """Return the vector of values with a fit's offsets and states.

        Parameters
        ----------
        vector : ParameterVector
            Meaning of the entries.
        values : sequence of mapping
            Parameter values of every term.
        theta : (n_changes,) array
            Log factors.
        start : Fit or None
            Fit with offsets and initial states.

        Returns
        -------
        (n,) array
            Vector.
        """
        known = {} if start is None else start.starts
        names = [self.runs[i].name for i in self._free]
        states = [known.get(name, first) for name, first in zip(names, vector.firsts, strict=True)]
        offsets = np.zeros(len(vector.offset_sd)) if start is None else start.offsets
        return vector.packed(theta, offsets, states, values)

    def _unpacked(self, vector: ParameterVector, X: Array) -> tuple[Array, Array, Array, list[dict[str, Array]]]:
        """Return factors, offsets, states (n_sets, n_runs, 2m) and values of vectors."""
        theta, offsets, states, values = vector.unpacked(X)
        starts = np.zeros((len(X), len(self.runs), 2 * self.reduced_model.m))
        for i, run in enumerate(self.runs):
            if run.start is not None and not run.at_rest:
                starts[:, i] = run.start
        starts[:, self._free] = states
        return theta, offsets, starts, values

    def residual(self, vector: ParameterVector, X: Array) -> Array:
        """Return the residuals of parameter vectors, of unit variance.

        The rows are prior deviations, weighted residuals of the runs in the order of `by_period`, and moves of window
        starts.

        Parameters
        ----------
        vector : ParameterVector
            Meaning of the entries.
        X : (n_sets, n) array
            Parameter vectors.

        Returns
        -------
        (n_sets, rows) array
            Residuals.
        """
        theta, offsets, starts, values = self._unpacked(vector, X)
        priors = vector.priors
        samples = self.n_values
        out = np.empty((len(X), priors + samples + 2 * self.reduced_model.m * len(self.free_starts)))
        out[:, :priors] = X[:, :priors]  # of unit variance
        if not len(X):
            return out
        at, moved_at = priors, priors + samples
        for h in sorted({run.h for run in self.runs}):
            index = [i for i, run in enumerate(self.runs) if run.h == h]
            y = self.simulate([self.runs[i] for i in index], vector.terms, theta, values, starts[:, index])
            for j, i in enumerate(index):
                run = self.runs[i]
                block = out[:, at : at + run.y.size]
                at += run.y.size
                difference = block.reshape(len(X), *run.y.shape)
                with np.errstate(over="ignore", invalid="ignore"):  # diverged trials are clipped below
                    np.subtract(y[: len(run), :, j].transpose(1, 0, 2), run.y, out=difference)
                    difference += offsets[:, None]
                    difference *= self.weights[i]
                if i in self.free_starts:
                    response, solve, _ = self.free_starts[i]
                    clip_diverged(block)
                    moved = block @ solve.T
                    block -= moved @ response.T
                    out[:, moved_at : moved_at + moved.shape[1]] = moved
                    moved_at += moved.shape[1]
        clip_diverged(out)
        return out
