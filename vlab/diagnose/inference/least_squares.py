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
from scipy import linalg

from vlab.diagnose.data.runs import Signals
from vlab.diagnose.inference.evidence import effective_sample_size
from vlab.diagnose.inference.impedance_scale import exponent, motion_scale
from vlab.diagnose.inference.jacobian import (
    by_period,
    differences_by_strength,
    forward_differences,
    is_nonsmooth,
    update_broyden,
    with_scale,
)
from vlab.diagnose.inference.parameter_vector import ParameterVector, bounded_step, is_logarithm, limits_of
from vlab.diagnose.inference.score_test import ScoreTest
from vlab.diagnose.parameters.terms import Candidate, Fit, Term, of_element
from vlab.diagnose.predictors.modal import channels, mix
from vlab.diagnose.settings import EVIDENCE, FIT, PROBLEM, RUNS
from vlab.physics.effect import SETTLING, PickUp, SensorEffect
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
            min(float(np.abs(self.reduced_model.omega).max()) / (2 * np.pi), self.problem.highest_hz), 5e-4
        )
        self.active = self._active()
        self.free_starts: dict[int, tuple[Array, Array, Array]] = {}
        self.directions = self._identifiable()
        self.free_starts = self._initial_condition_nuisance()

    def _weigh(self, model_error: float | None = None) -> None:
        """Set the samples' weights and effective sample sizes."""
        self.model_error = self.problem.model_error if model_error is None else model_error
        self.sigma = np.array([np.hypot(run.noise, self.model_error * run.scale) for run in self.runs])
        samples = sum(run.y.size for run in self.runs)
        self.effective_samples = samples * min(1.0, 2.0 / RUNS.points_per_cycle)
        noise = np.array([run.noise for run in self.runs])
        scale = np.array([run.scale for run in self.runs])
        self.noise_share = float(np.mean((noise / self.sigma) ** 2))
        self.error_share = float(np.mean((self.problem.own_error * scale / self.sigma) ** 2))
        self.integration_share = float(np.mean((PROBLEM.integration_error * scale / self.sigma) ** 2))
        self.effective_share = self.effective_samples
        if self.problem.case.structure is not None and self.effective_samples > EVIDENCE.model_error_samples:
            # mesh error is correlated over samples: full weight would bias the uncertain parameters far from their priors
            self.effective_share = effective_sample_size(self.noise_share, self.error_share, self.effective_samples)

    @cached_property
    def weights(self) -> list[Array]:
        """Weights (n, n_channels) of every run's samples.

        A weight is one over the standard deviation of noise and model error, zero for lost samples.
        """
        return [run.usable / sigma for run, sigma in zip(self.runs, self.sigma, strict=True)]

    def _identifiable(self) -> Array:
        """Return the identifiable directions of unit prior variance.

        Every parameter is moved by a part of its standard deviation in a simulation. Directions that move the channels
        little, relative to noise and model error, stay at the prior mean.
        """
        sd, n = self.reduced_model.prior, len(self.reduced_model.prior)
        theta = np.vstack([self.screen.theta, self.screen.theta + FIT.probe * np.diag(sd)])
        starts = np.zeros((n + 1, len(self.runs), 2 * self.reduced_model.m))
        for i, run in enumerate(self.runs):
            if not run.at_rest:
                starts[:, i] = self.first_state(run)
        gram, samples = np.zeros((n, n)), 0
        for h in sorted({run.h for run in self.runs}):
            index = [i for i, run in enumerate(self.runs) if run.h == h]
            y = self.simulate([self.runs[i] for i in index], (), theta, (), starts[:, index])
            for j, i in enumerate(index):
                run = self.runs[i]
                part = y[: len(run), :, j] / self.sigma[i]
                columns = ((part[:, 1:] - part[:, :1]) / FIT.probe).transpose(0, 2, 1).reshape(-1, n)
                gram += columns.T @ columns
                samples += run.y.size
        scale = self._common_scale()
        unknown = np.vstack([self.problem.redundant, *([] if scale is None else [scale])])
        if len(unknown):  # apparent information there is derivative error
            known = linalg.null_space(unknown)
            gram = known @ (known.T @ gram @ known) @ known.T
        size, vectors = np.linalg.eigh(gram / samples)
        order = np.argsort(-size)[: FIT.most_directions]
        keep = order[np.sqrt(np.maximum(size[order], 0.0)) > FIT.informed]
        self.unidentifiable = sd[:, None] * np.delete(vectors, keep, axis=1)
        return np.asarray(sd[:, None] * vectors[:, keep])

    def _common_scale(self) -> Array | None:
        """Return the common scale (n_changes,) in standard deviations, or None."""
        scale = self.problem.common_scale
        return None if scale is None else np.asarray(scale / self.reduced_model.prior)

    def _initial_condition_nuisance(self) -> dict[int, tuple[Array, Array, Array]]:
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
                gram = response.T @ response + np.eye(m2)
                out[i] = (response, np.linalg.solve(gram, response.T), spread)
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
        """Return the fits for given terms.

        Subclasses return other windows where a sensor effect contradicts the smoothed starts.
        """
        return self

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
        with np.errstate(over="ignore"):  # a diverged trial
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
        """Apply a sensor effect to its channel, by set and run.

        A window needs the motion before its start for a sensor with dynamics. An odd extension replaces unknown motion.
        """
        for s in range(y.shape[1]):
            p = {k: float(v[s]) for k, v in given.items()}
            for j, run in enumerate(runs):
                column, before = y[:, s, j, index], y[:0, s, j, index]
                if run.shown is not None and len(run.shown):
                    before = gains[s, index] * run.shown[-effect.settling_samples(p, run.h) :, index]
                elif not run.at_rest:
                    before = 2.0 * column[0] - column[SETTLING:0:-1]
                lead = len(before)
                t = run.t0 + np.arange(-lead, len(y)) * run.h
                y[:, s, j, index] = effect.sense(np.concatenate([before, column]), p, run.h, t)[lead:]

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
        vector = self.vector(terms)
        first, *others = self._starts(vector, start, thetas)
        best = self._descend(vector, first, iterations, tolerance)
        samples = sum(run.y.size for run in self.runs)
        for x in (
            others
        ):  # further starts only where the first one missed the noise level, or ended far from the prior means
            if best.cost < FIT.explained * samples and best.chi2 - best.cost < FIT.distant * vector.r:
                break
            best = min(best, self._descend(vector, x, iterations, tolerance), key=self.negative_log_posterior)
        return best

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
        costs = self._costs(vector, np.array([self.initial(vector, [own], start.theta, start) for own in values]))
        best = int(np.argmin(costs))
        return float(costs[best]), terms[best]

    def negative_log_posterior(self, fit: Fit) -> float:
        """Return the objective of a descent [nat].

        The objective is the effective sample size times the log cost, plus the prior terms.
        """
        return self.effective_share * float(np.log(max(fit.cost, 1e-300))) + fit.chi2 - fit.cost

    def _descend(self, vector: ParameterVector, x: Array, iterations: int, tolerance: float = FIT.near_enough) -> Fit:
        damping, raw = 1e-3, self.residual(vector, x[None])[0]
        if not x.size:  # without identifiable parameters there is nothing to fit
            return self._result(vector, x, raw, np.zeros((0, 0)))
        slopes, age = np.zeros((raw.size, x.size)), FIT.reused
        small, done, last = 0, -1, iterations
        while (done := done + 1) < last:
            shapes_too = done >= FIT.frozen or iterations <= FIT.frozen
            weight = self._weight(vector, raw)
            best = raw * weight
            cost = float(best @ best)
            if age >= FIT.reused:
                slopes, age = forward_differences(self, vector, x, raw), 0
            normal, gradient = self._normal(vector, slopes, weight), slopes.T @ (weight * best)
            if not shapes_too:
                still = vector.shapes
                normal[still], normal[:, still], gradient[still] = 0.0, 0.0, 0.0
            scale = np.diag(normal) + 1e-12 * max(float(np.diag(normal).max()), 1.0)
            lams = damping * np.array([1.0, 1e2, 1e5])
            room = vector.room(x)
            steps = [-bounded_step(normal + np.diag(lam * scale), gradient, room) for lam in (FIT.undamped, *lams)]
            trials = x - np.array([*(part * steps[0] for part in FIT.parts), *steps[1:]])
            if is_nonsmooth(vector):
                trials = np.vstack([trials, self._rescaled(vector, x)])
            trials = vector.bounded(trials)
            residuals = self.residual(vector, trials)
            costs = np.einsum("ij,ij->i", residuals * weight, residuals * weight)
            pick = int(np.argmin(np.where(np.isfinite(costs), costs, np.inf)))
            if not costs[pick] < cost:
                if age:  # an old Jacobian is renewed before smaller steps
                    age = FIT.reused
                    continue
                damping *= 1e4
                if damping > 1e6:
                    break
                continue
            small = small + 1 if costs[pick] > cost - tolerance else 0
            step, change = trials[pick] - x, residuals[pick] - raw
            promised = -float(step @ (2.0 * gradient + normal @ step))
            slopes = update_broyden(slopes, step, change)
            age = age + 1 if cost - costs[pick] > 0.5 * promised else FIT.reused
            x, raw = trials[pick], residuals[pick]
            is_damped = len(FIT.parts) <= pick < len(FIT.parts) + len(lams)
            damping = max(0.1 * (lams[pick - len(FIT.parts)] if is_damped else damping), 1e-8)
            is_cheap = (
                cost - costs[pick] < FIT.cheaper
            )  # from here the uncertain parameters no longer approach their prior means
            if small >= 2 and shapes_too:
                break
            if tolerance <= FIT.exact:
                continue
            if is_cheap and self._is_noise(vector, raw):
                break
            if not is_cheap and not self.is_rough and np.mean(raw[vector.priors :] ** 2) < FIT.explained:
                last = min(max(last, done + 2), iterations + FIT.more)
        if tolerance <= FIT.exact:  # an updated Jacobian suffices for steps, not for intervals
            vector, x, raw = self._with_unidentifiable(vector, x, raw)
            slopes = forward_differences(self, vector, x, raw)
            for _ in range(FIT.passes):
                slopes = differences_by_strength(self, vector, x, raw, slopes)
            common = self._common_scale()
            if common is not None:
                slopes = with_scale(vector, x, slopes, common)
        return self._result(vector, x, raw, self._normal(vector, slopes, self._weight(vector, raw)))

    def _rescaled(self, vector: ParameterVector, x: Array) -> Array:
        """Return a vector with the motion scale of largest prior density."""
        direction, ours = vector.project(motion_scale(self.problem)), slice(0, vector.r)
        grown = -float(direction @ x[ours]) / max(float(direction @ direction), 1e-12)
        out = x.copy()
        out[ours] += grown * direction
        out[vector.priors : vector.first_effect] *= np.exp(grown)
        for k, (i, parameter) in enumerate(vector.parameters, start=vector.first_effect):
            power = grown * exponent(vector.terms[i].effect, parameter)
            out[k] = out[k] + power if is_logarithm(parameter) else out[k] * np.exp(power)
        return out

    def _normal(self, vector: ParameterVector, slopes: Array, weight: Array) -> Array:
        """Return the weighted normal matrix of priors and data."""
        ours, data = slopes[: vector.priors], slopes[vector.priors :]
        return np.asarray(weight[0] ** 2 * ours.T @ ours + weight[-1] ** 2 * (data.T @ data))

    def _with_unidentifiable(
        self, vector: ParameterVector, x: Array, raw: Array
    ) -> tuple[ParameterVector, Array, Array]:
        """Return vector and residual with the unidentifiable directions added.

        A common change of gains and impedances moves no channel, but every estimated force.
        """
        wide = replace(vector, directions=np.hstack([vector.directions, self.unidentifiable]))
        none = np.zeros(wide.r - vector.r)
        return wide, np.insert(x, vector.r, none), np.insert(raw, vector.r, none)

    def _is_noise(self, vector: ParameterVector, raw: Array) -> bool:
        """Return whether every run's residual is at noise level.

        The runs together may be while the loudest is not: most samples of an impact test belong to the decay.
        """
        at = vector.priors
        for size in (self.runs[i].y.size for i in by_period(self.runs)):
            if np.mean(raw[at : at + size] ** 2) > FIT.noise + 4.0 * np.sqrt(
                2.0 / size
            ):  # four standard deviations of the mean square
                return False
            at += size
        return True

    def _weight(self, vector: ParameterVector, raw: Array) -> Array:
        """Return weights that reduce the data to their effective sample size.

        The scale of the residual is estimated, so the priors stay active under any wrong hypothesis.
        """
        priors = vector.priors
        effective_samples = self.effective_share / max(raw.size - priors, 1)
        spread = max(float(np.mean(raw[priors:] ** 2)), 1.0)
        out = np.full(raw.size, np.sqrt(effective_samples / spread))
        out[:priors] = 1.0
        return out

    def _starts(self, vector: ParameterVector, start: Fit | None, thetas: Sequence[Array]) -> list[Array]:
        """Return starting vectors: the screening's estimate, and a fit with small new terms."""
        terms = vector.terms
        known = {} if start is None else {t.label: t for t in start.terms}
        theta = self.screen.theta if start is None else start.theta
        if all(t.label in known for t in terms):
            own = [known[t.label].values for t in terms]
            return self._ordered(vector, [self.initial(vector, own, x, start) for x in (theta, *thetas)])
        candidates = [
            Candidate(effect=t.effect, place=t.place, values=dict(t.values), log_likelihood_gain=0.0) for t in terms
        ]
        given = [screen.given(candidates) for screen in (self.screen, *self.screen.slower)]
        out = [
            self.initial(vector, values, joint, start)
            for joint, values in (estimate for g in given for estimate in (g.estimate, g.cautious))
        ]
        options = []
        for size in (1.0, 0.3, 0.05):
            small = [{p.name: t.values[p.name] * size for p in t.effect.amplitudes} for t in terms]
            own = [
                known[t.label].values if t.label in known else {**t.values, **less}
                for t, less in zip(terms, small, strict=True)
            ]
            options.append(self.initial(vector, own, theta, start))
        natural = [known.get(term.label, of_element(term)) for term in terms]
        if any(there is not here for there, here in zip(natural, terms, strict=True)):
            options.append(self.initial(vector, [t.values for t in natural], theta, start))
        X = np.array([*out, *options])
        costs = self._costs(vector, X)
        together, apart = int(np.argmin(costs[: len(out)])), len(out) + int(np.argmin(costs[len(out) :]))
        first = [X[together], X[apart]] if costs[together] <= costs[apart] else [X[apart], X[together]]
        if start is None or start.chi2 - start.cost < FIT.distant * vector.r:
            return first
        # far from its priors the other fit has absorbed the missing physics
        own = [known.get(term.label, term).values for term in terms]
        return [*first, self.initial(vector, own, np.zeros_like(theta), start)]

    def _ordered(self, vector: ParameterVector, starts: list[Array]) -> list[Array]:
        """Return starts in order of cost; with a law the best alone."""
        if len(starts) == 1:
            return starts
        costs = self._costs(vector, np.array(starts))
        return [starts[i] for i in np.argsort(costs, kind="stable")][: 1 if vector.terms else None]

    def _costs(self, vector: ParameterVector, X: Array) -> Array:
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
        """Return the vector of given values, with a fit's offsets and initial states."""
        known = {} if start is None else start.starts
        names = [self.runs[i].name for i in self._free]
        states = [known.get(name, first) for name, first in zip(names, vector.firsts, strict=True)]
        offsets = np.zeros(len(vector.offset_sd)) if start is None else start.offsets
        return vector.packed(theta, offsets, states, values)

    def _unpacked(self, vector: ParameterVector, X: Array) -> tuple[Array, Array, Array, list[dict[str, Array]]]:
        """Return log factors, offsets, initial states (n_sets, n_runs, 2m) and values of vectors."""
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
        samples = sum(run.y.size for run in self.runs)
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
                    _cut_off(block)
                    moved = block @ solve.T
                    block -= moved @ response.T
                    out[:, moved_at : moved_at + moved.shape[1]] = moved
                    moved_at += moved.shape[1]
        _cut_off(out)
        return out

    def _result(self, vector: ParameterVector, x: Array, residual: Array, normal: Array) -> Fit:
        theta, offsets, starts, values = self._unpacked(vector, x[None])
        terms = vector.terms
        h = max(run.h for run in self.runs)
        fitted = tuple(
            replace(term, values=term.effect.taken({k: float(v[0]) for k, v in own.items()}, h))
            for term, own in zip(terms, values, strict=True)
        )
        priors = vector.priors
        at, error = priors, [np.zeros(0)] * len(self.runs)
        for i in by_period(self.runs):
            run = self.runs[i]
            part = residual[at : at + run.y.size].reshape(run.y.shape) * self.sigma[i]
            error[i] = np.sqrt(np.mean(part**2, axis=0)) / run.scale
            at += run.y.size
        data = float(residual[priors:] @ residual[priors:])
        size = np.sqrt(np.diag(normal))  # a gap in metres must not push all others below the cutoff
        size = np.where(size > 0, size, 1.0)
        scaled = normal / np.outer(size, size) + 1e-12 * np.eye(len(size))
        covariance = np.linalg.pinv(scaled, hermitian=True) / np.outer(size, size)
        sd = {}
        for k, (i, p) in enumerate(vector.parameters, start=vector.first_effect):
            spread = float(np.sqrt(max(covariance[k, k], 0.0)))
            relative = spread / max(abs(float(x[k])), 1e-300)
            is_relative = not (p.signed or is_logarithm(p))
            sd[f"{terms[i].label}:{p.name}"] = p.grain or (relative if is_relative else spread)
        return Fit(
            terms=fitted,
            theta=theta[0],
            offsets=offsets[0],
            starts={self.runs[i].name: starts[0, i] for i in self._free},
            error=np.array(error),
            chi2=float(residual @ residual),
            cost=data,
            sd=sd,
        )


def _cut_off(residual: Array) -> None:
    """Clip a diverged residual, in place."""
    if residual.min() >= -FIT.largest and residual.max() <= FIT.largest:  # false for NaN
        return
    residual[:] = np.where(np.isfinite(residual), np.clip(residual, -FIT.largest, FIT.largest), FIT.largest)
