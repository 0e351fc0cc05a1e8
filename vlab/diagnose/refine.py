"""Fits in simulation: a hypothesis with everything uncertain beside it, on all fit runs at once.

The twin is simulated from its initial states with the effects of the hypothesis inside the loop, for many parameter sets
side by side, and Gauss and Newton's method brings the difference to the recordings down. The uncertain parameters enter
in the few directions that the recordings say something of; initial states and channel offsets are fitted along.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy import linalg

from vlab.diagnose.hypothesis import WORTH, independent_values
from vlab.diagnose.problem import INTEGRATION_ERROR
from vlab.diagnose.scales import exponent, motion_scale
from vlab.diagnose.screen import Screen
from vlab.diagnose.signals import POINTS_PER_CYCLE, Signals
from vlab.diagnose.simulation import EDGED, channels, mix
from vlab.diagnose.terms import Candidate, Fit, Term, of_element
from vlab.physics.effect import SETTLING, Parameter, PickUp, SensorEffect
from vlab.signals import Array

ITERATIONS = 12
FROZEN = 2
"""Steps in which a law keeps its shape while its size and the uncertain parameters find each other: a gap or a slip that moves
at once moves to where the law does nothing."""
EXPLAINED, DISTANT = 1.7, 1.5
"""Mean square of the weighted difference below which a fit needs no second start, and square of the uncertain parameters' distance
from their priors' means over what is usual, above which it has one all the same."""
NEAR_ENOUGH, EXACT = 1.0, 0.02
"""Decrease of the cost, in squared standard deviations, below which steps are too small to go on: for a comparison of hypotheses,
and for the values of parameters."""
CHEAPER = 0.5
"""Decrease of the cost above which a descent goes on although what is left is noise."""
MORE = 12
"""Steps that such a descent may take beyond those it was given."""
NOISE = 0.95
"""Mean square of what is left below which it is noise, in its squared standard deviations."""
UNDAMPED, PARTS = 1e-10, (1.0, 0.3, 0.1)
"""Damping of a step that goes all the way, and the parts of it that are tried: where parameters make up for each other, damped
ones leave them as far from their priors' means as the first steps took them; and such valleys bend."""
PASSES = 2
"""The last slopes are taken anew so often, along directions that the ones before show."""
MOVED, WIDEST = 0.25, (100.0, 5.0)
"""Root mean square of the weighted difference by which their steps move it, and how much wider than usual they may be: of uncertain
parameters up to a standard deviation, of a law's to a twentieth."""
REUSED = 3
"""Steps for which slopes are carried on while they keep half of their promise."""
LOOSE_START = 0.03
"""Spread of the states that windows start from, as a share of their rms over all windows."""
MOST_DIRECTIONS = 100
MOST_STARTED = 6
"""Modes whose first state is fitted."""
PRIOR_BOUND = 6.0
"""Uncertain parameters stay within this many standard deviations: what lies further off is a finding, no calibration. Their priors
alone are what a score counts; a bound at work stops a descent."""
INFORMED = 0.005
"""Directions of the uncertain parameters whose prior spread moves the channels by less than this share of noise and model
error, root mean square, stay at the prior's mean."""
PROBE = 0.3
SMOOTH_STEP = 1e-4
"""Step of slopes along uncertain parameters, in their standard deviations, where no law has edges."""
LARGEST = 1e8
"""What residuals that ran away are cut off at."""


@dataclass(eq=False)
class _Layout:
    """Which entry of the fitted vector is what."""

    directions: Array  # (n_changes, r)
    n_channels: int
    n_start: int  # fitted start entries a run: 2 m_active, or 0
    runs: list[Signals]
    free: list[int]  # runs that do not start at rest
    effects: list[tuple[int, Parameter]] = field(default_factory=list)
    limits: list[tuple[float, float]] = field(default_factory=list)  # of the effects' entries

    @property
    def r(self) -> int:
        return self.directions.shape[1]

    @property
    def size(self) -> int:
        return self.r + self.n_channels + self.n_start * len(self.free) + len(self.effects)


class Refiner:
    """Fits hypotheses to a problem's runs.

    Parameters
    ----------
    screen : Screen
        Gives the uncertain parameters' informed directions and the first states.
    model_error : float or None
        Error of the simulation itself that the weights allow for, as a share of a channel's rms; the problem's by default.
    is_rough : bool
        For first fits, with coarser steps.
    """

    is_rough = False
    directions: Array
    """Of the uncertain parameters, that the runs inform, (n_changes, r), in their prior's standard deviations."""
    silent: Array
    """The other ones, (n_changes, n_changes - r)."""

    def __init__(
        self,
        screen: Screen,
        runs: Sequence[Signals] | None = None,
        model_error: float | None = None,
        *,
        is_rough: bool = False,
    ) -> None:
        self.is_rough = is_rough
        self.screen, self.problem, self.twin = screen, screen.problem, screen.twin
        self.runs = list(runs if runs is not None else screen.runs)
        self.model_error = self.problem.model_error if model_error is None else model_error
        self.sigma = np.array([np.hypot(run.noise, self.model_error * run.scale) for run in self.runs])
        samples = sum(run.y.size for run in self.runs)
        self.worth = samples * min(1.0, 2.0 / POINTS_PER_CYCLE)
        noise = np.array([run.noise for run in self.runs])
        scale = np.array([run.scale for run in self.runs])
        self.noise_share = float(np.mean((noise / self.sigma) ** 2))
        self.error_share = float(np.mean((self.problem.own_error * scale / self.sigma) ** 2))
        self.integration_share = float(np.mean((INTEGRATION_ERROR * scale / self.sigma) ** 2))
        self.believed = self.worth
        if self.problem.case.structure is not None and self.worth > WORTH:
            # a mesh errs everywhere a little: believed to the last sample it would bend what is uncertain far from its prior
            self.believed = independent_values(self.noise_share, self.error_share, self.worth)
        self.highest = max(min(float(np.abs(self.twin.omega).max()) / (2 * np.pi), self.problem.highest_hz), 5e-4)
        self.active = self._active()
        self.loose: dict[int, tuple[Array, Array, Array]] = {}
        self.directions = self._informed()
        self.loose = self._loose_starts()

    @cached_property
    def weights(self) -> list[Array]:
        """Of every run's samples, (n, n_channels) each: one over the standard deviation of noise and model error, zero where lost."""
        return [run.usable / sigma for run, sigma in zip(self.runs, self.sigma, strict=True)]

    def _informed(self) -> Array:
        """Return the directions of the uncertain parameters that the runs inform, scaled to unit prior variance.

        Every parameter is moved by a part of its standard deviation in a simulation; directions in which all of them
        together move the channels by little beside noise and model error stay at the prior's mean.
        """
        sd, n = self.twin.prior, len(self.twin.prior)
        theta = np.vstack([self.screen.theta, self.screen.theta + PROBE * np.diag(sd)])
        starts = np.zeros((n + 1, len(self.runs), 2 * self.twin.m))
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
                columns = ((part[:, 1:] - part[:, :1]) / PROBE).transpose(0, 2, 1).reshape(-1, n)
                gram += columns.T @ columns
                samples += run.y.size
        scale = self._common_scale()
        unknown = np.vstack([self.problem.redundant, *([] if scale is None else [scale])])
        if len(unknown):  # what seems to be known of these is an error of the derivatives
            known = linalg.null_space(unknown)
            gram = known @ (known.T @ gram @ known) @ known.T
        size, vectors = np.linalg.eigh(gram / samples)
        order = np.argsort(-size)[:MOST_DIRECTIONS]
        keep = order[np.sqrt(np.maximum(size[order], 0.0)) > INFORMED]
        self.silent = sd[:, None] * np.delete(vectors, keep, axis=1)
        return np.asarray(sd[:, None] * vectors[:, keep])

    def _common_scale(self) -> Array | None:
        """Return the common scale of impedances and gains in standard deviations of its priors, (n_changes,); None without one."""
        scale = self.problem.common_scale
        return None if scale is None else np.asarray(scale / self.twin.prior)

    def along(self, theta: Array) -> Array:
        """Return log-factors along the informed directions, in standard deviations of their prior; the rest is left out."""
        return np.asarray((self.directions / self.twin.prior[:, None] ** 2).T @ theta)

    def _loose_starts(self) -> dict[int, tuple[Array, Array, Array]]:
        """Return for every window what its start can explain: free responses, the solver for them, the starts' spread.

        The states that windows start from are smoothed with a model that lacks the physics sought, so they are off by a
        little; every residual is freed of what a start within that spread makes up for, by linear least squares.
        """
        out: dict[int, tuple[Array, Array, Array]] = {}
        m2 = 2 * self.twin.m
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
            spread = LOOSE_START * np.maximum(np.sqrt(np.mean(states**2, axis=0)), 1e-12)
            for i in index:
                n = len(self.runs[i])
                seen = free[:n] * self.runs[i].usable[:, None, :]
                response = (seen / self.sigma[i]).transpose(0, 2, 1).reshape(-1, m2) * spread
                gram = response.T @ response + np.eye(m2)
                out[i] = (response, np.linalg.solve(gram, response.T), spread)
        return out

    def _active(self) -> Array:
        """Return the modes whose first state is fitted: those that carry the first motion."""
        free = [i for i, run in enumerate(self.runs) if run.start is None and not run.at_rest]
        if not free:
            return np.zeros(0, dtype=int)
        size = np.zeros(self.twin.m)
        for run in free:
            x = self.first_state(self.runs[run])
            m = self.twin.m
            energy = x[m:] ** 2 + (self.twin.omega * x[:m]) ** 2
            size = np.maximum(size, energy / max(energy.max(), 1e-300))
        largest = np.argsort(-size, kind="stable")[:MOST_STARTED]
        return np.sort(largest[size[largest] > 1e-6])

    def first_state(self, run: Signals) -> Array:
        """Return the smoothed modal state at the first sample of a run that the screening filtered."""
        if run.start is not None:
            return run.start
        for group in self.screen.groups:
            for i, other in enumerate(group.runs):
                if other.name == run.name:  # the screening may have looked at its first part only
                    return np.asarray(group.smoothed.x[0, i])
        return np.zeros(2 * self.twin.m)

    def beside(self, terms: Sequence[Term]) -> "Refiner":
        """Return the refiner of a hypothesis: this one, or another where its runs start from states that the hypothesis denies."""
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
        """Simulate parameter sets side by side over runs of one sample period.

        Parameters
        ----------
        theta : (n_sets, n_changes) array
        values : sequence of mappings
            Of every term its parameter values, (n_sets,) arrays.
        starts : (n_sets, n_runs, 2m) array

        Returns
        -------
        (n, n_sets, n_runs, n_channels) array
            Channels, zero beyond a run's end.
        """
        y = channels(self.twin, self.highest, runs, terms, theta, values, starts, self.is_rough)
        return self._read(y, runs, terms, theta, values)

    def _read(
        self,
        y: Array,
        runs: Sequence[Signals],
        terms: Sequence[Term],
        theta: Array,
        values: Sequence[Mapping[str, Array]],
    ) -> Array:
        """Return what the sensors make of channels (n, n_sets, n_runs, p): their gains, then the terms that act on them."""
        gains = self.twin.gains(theta)[1]
        with np.errstate(over="ignore"):  # of a trial that ran away
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
        """Let a sensor effect act on its channel, set by set and run by run.

        A window begins in the middle of a motion that the sensor's own dynamics have followed before: where that is not known, it is
        the beginning turned round.
        """
        for s in range(y.shape[1]):
            p = {k: float(v[s]) for k, v in given.items()}
            for j, run in enumerate(runs):
                column, before = y[:, s, j, index], y[:0, s, j, index]
                if run.shown is not None and len(run.shown):
                    before = gains[s, index] * run.shown[-effect.settling(p, run.h) :, index]
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
        iterations: int = ITERATIONS,
        thetas: Sequence[Array] = (),
        settled: float = NEAR_ENOUGH,
    ) -> Fit:
        """Fit a hypothesis.

        It starts from the screening's values and uncertain parameters, or those of `start` for what both know, with new
        terms at several sizes, whichever simulates best.

        Parameters
        ----------
        thetas : sequence of (n_changes,) arrays
            Other log-factors of the uncertain parameters to start from where `start` knows all terms.
        settled : float
            The descent ends where two steps in a row lower the cost by less.
        """
        layout = self._layout(terms)
        first, *others = self._starts(layout, terms, start, thetas)
        best = self._descend(layout, terms, first, iterations, settled)
        samples = sum(run.y.size for run in self.runs)
        for x in (
            others
        ):  # only worth the time where the first one led no way down to the noise, or only far from the priors
            if best.cost < EXPLAINED * samples and best.chi2 - best.cost < DISTANT * layout.r:
                break
            best = min(best, self._descend(layout, terms, x, iterations, settled), key=self.unlikeliness)
        return best

    def cheapest(self, term: Term, values: Sequence[Mapping[str, float]], start: Fit) -> tuple[float, Term]:
        """Return the least that a term leaves with any of some values, as a fit's `cost` with its priors, and the term with these.

        All else is as `start` has it; nothing is fitted.
        """
        terms = [replace(term, values=dict(own)) for own in values]
        layout = self._layout(terms[:1])
        costs = self._costs(
            layout, terms[:1], np.array([self._initial(layout, [t], start.theta, start) for t in terms])
        )
        best = int(np.argmin(costs))
        return float(costs[best]), terms[best]

    def unlikeliness(self, fit: Fit) -> float:
        """Return what a descent brings down: the logarithm of what is left, as many values as it is worth, and the priors."""
        return self.believed * float(np.log(max(fit.cost, 1e-300))) + fit.chi2 - fit.cost

    def _descend(
        self, layout: _Layout, terms: Sequence[Term], x: Array, iterations: int, settled: float = NEAR_ENOUGH
    ) -> Fit:
        damping, raw = 1e-3, self._residual(layout, terms, x[None])[0]
        is_edged = any(t.effect.family in EDGED for t in terms)
        slopes, age = np.zeros((raw.size, x.size)), REUSED
        small, done, last = 0, -1, iterations
        while (done := done + 1) < last:
            shapes_too = done >= FROZEN or iterations <= FROZEN
            weight = self._weight(layout, raw)
            best = raw * weight
            cost = float(best @ best)
            if age >= REUSED:
                slopes, age = self._jacobian(layout, terms, x, raw), 0
            normal, gradient = self._normal(layout, slopes, weight), slopes.T @ (weight * best)
            if not shapes_too:
                still = self._shape_entries(layout, terms)
                normal[still], normal[:, still], gradient[still] = 0.0, 0.0, 0.0
            scale = np.diag(normal) + 1e-12 * max(float(np.diag(normal).max()), 1.0)
            lams = damping * np.array([1.0, 1e2, 1e5])
            steps = [np.linalg.solve(normal + np.diag(lam * scale), gradient) for lam in (UNDAMPED, *lams)]
            trials = x - np.array([*(part * steps[0] for part in PARTS), *steps[1:]])
            if is_edged:
                trials = np.vstack([trials, self._rescaled(layout, terms, x)])
            trials = self._bounded(layout, trials)
            residuals = self._residual(layout, terms, trials)
            costs = np.einsum("ij,ij->i", residuals * weight, residuals * weight)
            pick = int(np.argmin(np.where(np.isfinite(costs), costs, np.inf)))
            if not costs[pick] < cost:
                if age:  # the slopes are old: new ones before smaller steps
                    age = REUSED
                    continue
                damping *= 1e4
                if damping > 1e6:
                    break
                continue
            small = small + 1 if costs[pick] > cost - settled else 0
            step, change = trials[pick] - x, residuals[pick] - raw
            promised = -float(step @ (2.0 * gradient + normal @ step))
            slopes = carried_on(slopes, step, change)
            age = age + 1 if cost - costs[pick] > 0.5 * promised else REUSED
            x, raw = trials[pick], residuals[pick]
            is_damped = len(PARTS) <= pick < len(PARTS) + len(lams)
            damping = max(0.1 * (lams[pick - len(PARTS)] if is_damped else damping), 1e-8)
            is_cheap = cost - costs[pick] < CHEAPER  # no longer do the uncertain parameters come nearer to their priors
            if small >= 2 and shapes_too:
                break
            if settled <= EXACT:
                continue
            if is_cheap and self._is_noise(layout, raw):
                break
            if not is_cheap and not self.is_rough and np.mean(raw[layout.r + layout.n_channels :] ** 2) < EXPLAINED:
                last = min(max(last, done + 2), iterations + MORE)
        if settled <= EXACT:  # what is carried on is good for steps, not for intervals
            layout, x, raw = self._with_silent(layout, x, raw)
            slopes = self._jacobian(layout, terms, x, raw)
            for _ in range(PASSES):
                slopes = self._jacobian_by_strength(layout, terms, x, raw, slopes)
            slopes = self._with_scale(layout, terms, x, slopes)
        return self._result(layout, terms, x, raw, self._normal(layout, slopes, self._weight(layout, raw)))

    def _rescaled(self, layout: _Layout, terms: Sequence[Term], x: Array) -> Array:
        """Return an entry with all motions on the scale that the priors like best; see `scales`."""
        along, ours = self.along(motion_scale(self.problem)), slice(0, layout.r)
        grown = -float(along @ x[ours]) / max(float(along @ along), 1e-12)
        out, first = x.copy(), x.size - len(layout.effects)
        out[ours] += grown * along
        out[layout.r + layout.n_channels : first] *= np.exp(grown)
        for k, (i, parameter) in enumerate(layout.effects, start=first):
            power = grown * exponent(terms[i].effect, parameter)
            out[k] = out[k] * np.exp(power) if parameter.signed else out[k] + power
        return out

    def _normal(self, layout: _Layout, slopes: Array, weight: Array) -> Array:
        """Return the matrix of Gauss and Newton's method for slopes of a residual with its weights: one for priors, one for data."""
        priors = layout.r + layout.n_channels
        ours, data = slopes[:priors], slopes[priors:]
        return np.asarray(weight[0] ** 2 * ours.T @ ours + weight[-1] ** 2 * (data.T @ data))

    def _with_silent(self, layout: _Layout, x: Array, raw: Array) -> tuple[_Layout, Array, Array]:
        """Return a layout, an entry and its residual with the directions that the runs say nothing of beside the informed ones.

        All gains and impedances a hundredth larger change no channel, but every force that a law is found to have.
        """
        wide = replace(layout, directions=np.hstack([layout.directions, self.silent]))
        none = np.zeros(wide.r - layout.r)
        return wide, np.insert(x, layout.r, none), np.insert(raw, layout.r, none)

    def _is_noise(self, layout: _Layout, raw: Array) -> bool:
        """Return whether what remains of every run is as small as the noise: a better fit means nothing.

        All together may be while the loudest run still asks for another value: most samples of a blow are of its fading out.
        """
        at = layout.r + layout.n_channels
        for run in sorted(self.runs, key=lambda run: run.h):
            size = run.y.size
            if np.mean(raw[at : at + size] ** 2) > NOISE + 4.0 * np.sqrt(2.0 / size):  # four standard deviations of it
                return False
            at += size
        return True

    def _shape_entries(self, layout: _Layout, terms: Sequence[Term]) -> list[int]:
        """Return the entries of parameters that a law is not linear in, of laws that have others."""
        first = layout.r + layout.n_channels + layout.n_start * len(layout.free)
        return [
            first + k
            for k, (i, parameter) in enumerate(layout.effects)
            if parameter.role == "shape" and terms[i].effect.amplitudes
        ]

    def _jacobian(self, layout: _Layout, terms: Sequence[Term], x: Array, raw: Array) -> Array:
        """Return the derivatives of the residual by forward differences; those by channel offsets are known.

        In a long lightly damped record a hundredth of a standard deviation of a frequency bends the slope along it by more than the
        slope along directions that the recordings say little of; of laws with edges smaller steps are noise.
        """
        steps = self._steps(layout, x)
        if not any(t.effect.family in EDGED for t in terms):
            steps[: layout.r + layout.n_channels] = SMOOTH_STEP
        offsets = np.arange(layout.r, layout.r + layout.n_channels) if not self.loose else np.zeros(0, dtype=int)
        others = np.setdiff1d(np.arange(x.size), offsets)
        moved = self._residual(layout, terms, x + np.diag(steps)[others])
        moved -= raw
        moved /= steps[others, None]
        if not offsets.size:
            return np.asarray(moved.T)
        out = np.zeros((x.size, raw.size)).T
        out[:, others] = moved.T
        out[offsets, offsets] = 1.0
        at = layout.r + layout.n_channels
        for h in sorted({run.h for run in self.runs}):
            for i, run in enumerate(self.runs):
                if run.h == h:
                    block = out[at : at + run.y.size].reshape(len(run), run.y.shape[1], -1)
                    for c, column in enumerate(offsets):
                        block[:, c, column] = self.screen.offset_sd[c] / self.sigma[i][c] * run.usable[:, c]
                    at += run.y.size
        return out

    def _jacobian_by_strength(
        self, layout: _Layout, terms: Sequence[Term], x: Array, raw: Array, slopes: Array
    ) -> Array:
        """Return the derivatives of the residual by differences along the directions that move it as much as each other.

        Dry friction and stops chatter by more than small steps do. What is strong in every single parameter and cancels in a sum of
        them, as larger forces do with larger gains and impedances, would drown in that, and is what is least known; so the steps
        go along the singular vectors of what is known of the slopes, wide where these are weak.

        Parameters
        ----------
        slopes : (rows, n) array
            Derivatives to begin with.
        """
        steps = self._steps(layout, x)
        _, _, across = np.linalg.svd(np.linalg.qr(slopes * steps, mode="r"))
        data = (slopes * steps)[layout.r + layout.n_channels :] @ across.T
        widest = np.full(x.size, WIDEST[1])
        widest[: layout.r] = WIDEST[0]
        most = np.min(widest / np.maximum(np.abs(across), 1e-300), axis=1)
        size = np.clip(MOVED / np.maximum(np.sqrt(np.mean(data**2, axis=0)), 1e-300), 1.0, most)
        moved = self._residual(layout, terms, x + size[:, None] * across * steps)
        return np.asarray(((moved - raw) / size[:, None]).T @ across / steps)

    def _with_scale(self, layout: _Layout, terms: Sequence[Term], x: Array, slopes: Array) -> Array:
        """Return derivatives whose part along the common scale of impedances and gains is exact: what changes with it is only how large
        the laws' forces, masses and stiffnesses are beside all others."""
        scale = self._common_scale()
        if scale is None:
            return slopes
        size = float(np.linalg.norm(scale))
        along = np.zeros(x.size)
        along[: layout.r] = (layout.directions / self.twin.prior[:, None]).T @ scale / size
        first, exact = x.size - len(layout.effects), np.zeros(len(slopes))
        for k, (i, parameter) in enumerate(layout.effects, start=first):
            if terms[i].effect.kind == "port" and parameter.unit.startswith(("N", "kg")):
                exact -= slopes[:, k] * (x[k] if parameter.signed else 1.0) / size
        priors = layout.r + layout.n_channels
        exact[:priors] = along[:priors]
        return np.asarray(slopes + np.outer(exact - slopes @ along, along))

    def _weight(self, layout: _Layout, raw: Array) -> Array:
        """Return the weights of residuals: one for priors, and for data what makes their sum of squares the samples' worth.

        The scale of what no parameter explains is unknown; taking it as found keeps the priors in force however wrong a
        hypothesis is.
        """
        priors = layout.r + layout.n_channels
        worth = self.believed / max(raw.size - priors, 1)
        spread = max(float(np.mean(raw[priors:] ** 2)), 1.0)
        out = np.full(raw.size, np.sqrt(worth / spread))
        out[:priors] = 1.0
        return out

    def _starts(
        self, layout: _Layout, terms: Sequence[Term], start: Fit | None, thetas: Sequence[Array]
    ) -> list[Array]:
        """Return where to start from: the screening's joint estimate, and another fit with the new terms added small."""
        known = {} if start is None else {t.label: t for t in start.terms}
        theta = self.screen.theta if start is None else start.theta
        if all(t.label in known for t in terms):
            own = [known[t.label] for t in terms]
            return self._ordered(layout, terms, [self._initial(layout, own, x, start) for x in (theta, *thetas)])
        candidates = [Candidate(effect=t.effect, place=t.place, values=dict(t.values), gain=0.0) for t in terms]
        given = [screen.given(candidates) for screen in (self.screen, *self.screen.slower)]
        out = [
            self._initial(layout, [replace(t, values=v) for t, v in zip(terms, values, strict=True)], joint, start)
            for joint, values in (estimate for g in given for estimate in (g.estimate, g.cautious))
        ]
        options = []
        for size in (1.0, 0.3, 0.05):
            own = []
            for term in terms:
                amplitudes = {p.name: term.values[p.name] * size for p in term.effect.amplitudes}
                own.append(known.get(term.label, replace(term, values={**term.values, **amplitudes})))
            options.append(self._initial(layout, own, theta, start))
        natural = [known.get(term.label, of_element(term)) for term in terms]
        if any(there is not here for there, here in zip(natural, terms, strict=True)):
            options.append(self._initial(layout, natural, theta, start))
        X = np.array([*out, *options])
        costs = self._costs(layout, terms, X)
        together, small = int(np.argmin(costs[: len(out)])), len(out) + int(np.argmin(costs[len(out) :]))
        first = [X[together], X[small]] if costs[together] <= costs[small] else [X[small], X[together]]
        if start is None or start.chi2 - start.cost < DISTANT * layout.r:
            return first
        # far from its priors the other fit has made up for what is missing
        own = [known.get(term.label, term) for term in terms]
        return [*first, self._initial(layout, own, np.zeros_like(theta), start)]

    def _ordered(self, layout: _Layout, terms: Sequence[Term], starts: list[Array]) -> list[Array]:
        """Return starts by what they leave, the least first; with a law that alone."""
        if len(starts) == 1:
            return starts
        costs = self._costs(layout, terms, np.array(starts))
        return [starts[i] for i in np.argsort(costs, kind="stable")][: 1 if terms else None]

    def _costs(self, layout: _Layout, terms: Sequence[Term], X: Array) -> Array:
        residuals = self._residual(layout, terms, X)
        return np.asarray(np.einsum("ij,ij->i", residuals, residuals))

    def _layout(self, terms: Sequence[Term]) -> _Layout:
        free = [i for i, run in enumerate(self.runs) if run.start is None and not run.at_rest]
        layout = _Layout(
            directions=self.directions,
            n_channels=self.twin.rows.at_q.shape[0],
            n_start=2 * len(self.active),
            runs=self.runs,
            free=free,
        )
        layout.effects = [(i, p) for i, term in enumerate(terms) for p in term.effect.parameters]
        layout.limits = [self._limits(terms[i], p) for i, p in layout.effects]
        return layout

    def _limits(self, term: Term, parameter: Parameter) -> tuple[float, float]:
        """Return the least and the largest entry of a parameter: within a factor of e^9 of where it starts, and a shape within its range,
        which says what it is: a damping ratio; a slip or a gap that is a share of the motion, for others are other laws."""
        if parameter.signed:
            return -np.inf, np.inf
        centre = inward(parameter, term.values[parameter.name])
        low, high = centre - 9.0, centre + 9.0
        if parameter.reference in ("displacement", "velocity"):
            of = self.screen.reference(parameter.reference, term.place)
            low, high = max(low, np.log(0.5 * parameter.low * of)), min(high, np.log(2.0 * parameter.high * of))
        elif parameter.role == "shape" and not parameter.reference:
            low, high = max(low, np.log(parameter.low)), min(high, np.log(parameter.high))
        return min(low, centre), max(high, centre)

    def _initial(self, layout: _Layout, terms: Sequence[Term], theta: Array, start: Fit | None) -> Array:
        xi = self.along(theta)
        offsets = np.zeros(layout.n_channels) if start is None else start.offsets
        parts = [xi, offsets / self.screen.offset_sd]
        for i in layout.free:
            run = self.runs[i]
            state = self.first_state(run) if start is None or run.name not in start.starts else start.starts[run.name]
            parts.append(self._pack(state))
        parts.append(np.array([inward(p, terms[i].values[p.name]) for i, p in layout.effects]))
        return np.asarray(self._bounded(layout, np.concatenate(parts)[None])[0])

    def _pack(self, state: Array) -> Array:
        m = self.twin.m
        return np.concatenate([state[self.active], state[m + self.active]]) / self._start_scale()

    def _start_scale(self) -> Array:
        """Return the sizes that modal states are fitted in: a hundredth of the largest first state."""
        m, a = self.twin.m, self.active
        omega = np.maximum(np.abs(self.twin.omega[a]), 1.0)
        if not len(a):
            return np.zeros(0)
        energy = max(
            float(np.max(np.abs(np.concatenate([x[a] * omega, x[m + a]]))))
            for x in (self.first_state(run) for run in self.runs if run.start is None and not run.at_rest)
        )
        energy = max(energy, 1e-9)
        return 0.01 * np.concatenate([energy / omega, np.full(len(a), energy)])

    def _unpack(self, layout: _Layout, X: Array) -> tuple[Array, Array, Array, Array]:
        """Return theta, offsets, starts (n_sets, n_runs, 2m) and effect entries of fitted vectors."""
        r, p, m = layout.r, layout.n_channels, self.twin.m
        theta = X[:, :r] @ layout.directions.T
        offsets = X[:, r : r + p] * self.screen.offset_sd
        starts = np.zeros((len(X), len(self.runs), 2 * m))
        for i, run in enumerate(self.runs):
            if run.start is not None and not run.at_rest:
                starts[:, i] = run.start
        at = r + p
        for i in layout.free:
            part = X[:, at : at + layout.n_start] * self._start_scale()
            full = np.repeat(self.first_state(self.runs[i])[None], len(X), axis=0)
            half = len(self.active)
            full[:, self.active], full[:, m + self.active] = part[:, :half], part[:, half:]
            starts[:, i] = full
            at += layout.n_start
        return theta, offsets, starts, X[:, at:]

    def _steps(self, layout: _Layout, x: Array) -> Array:
        steps = np.full(x.size, 1e-2)
        at = layout.r + layout.n_channels
        steps[at : at + layout.n_start * len(layout.free)] = 0.1
        first = x.size - len(layout.effects)
        for k, (_, parameter) in enumerate(layout.effects):
            steps[first + k] = 1e-2 if not parameter.signed else max(1e-2 * abs(x[first + k]), 1e-12)
        return steps

    def _bounded(self, layout: _Layout, X: Array) -> Array:
        out = X.copy()
        first = X.shape[1] - len(layout.effects)
        for k, (low, high) in enumerate(layout.limits, start=first):
            out[:, k] = np.clip(out[:, k], low, high)
        out[:, : layout.r] = np.clip(out[:, : layout.r], -PRIOR_BOUND, PRIOR_BOUND)
        return out

    def _values(self, layout: _Layout, terms: Sequence[Term], entries: Array) -> list[dict[str, Array]]:
        out: list[dict[str, Array]] = [{} for _ in terms]
        for k, (i, parameter) in enumerate(layout.effects):
            out[i][parameter.name] = outward(parameter, entries[:, k])
        return out

    def _residual(self, layout: _Layout, terms: Sequence[Term], X: Array) -> Array:
        theta, offsets, starts, entries = self._unpack(layout, X)
        values = self._values(layout, terms, entries)
        priors = layout.r + layout.n_channels
        samples = sum(run.y.size for run in self.runs)
        out = np.empty((len(X), priors + samples + 2 * self.twin.m * len(self.loose)))
        out[:, :priors] = X[:, :priors]  # of unit variance
        at, moved_at = priors, priors + samples
        for h in sorted({run.h for run in self.runs}):
            index = [i for i, run in enumerate(self.runs) if run.h == h]
            y = self.simulate([self.runs[i] for i in index], terms, theta, values, starts[:, index])
            for j, i in enumerate(index):
                run = self.runs[i]
                block = out[:, at : at + run.y.size]
                at += run.y.size
                difference = block.reshape(len(X), *run.y.shape)
                with np.errstate(over="ignore", invalid="ignore"):  # what ran away is cut off below
                    np.subtract(y[: len(run), :, j].transpose(1, 0, 2), run.y, out=difference)
                    difference += offsets[:, None]
                    difference *= self.weights[i]
                if i in self.loose:
                    response, solve, _ = self.loose[i]
                    _cut_off(block)
                    moved = block @ solve.T
                    block -= moved @ response.T
                    out[:, moved_at : moved_at + moved.shape[1]] = moved
                    moved_at += moved.shape[1]
        _cut_off(out)
        return out

    def _result(self, layout: _Layout, terms: Sequence[Term], x: Array, residual: Array, normal: Array) -> Fit:
        theta, offsets, starts, entries = self._unpack(layout, x[None])
        values = self._values(layout, terms, entries)
        h = max(run.h for run in self.runs)
        fitted = tuple(
            replace(term, values=term.effect.taken({k: float(v[0]) for k, v in own.items()}, h))
            for term, own in zip(terms, values, strict=True)
        )
        priors = layout.r + layout.n_channels
        at, error = priors, [np.zeros(0)] * len(self.runs)
        for i in sorted(range(len(self.runs)), key=lambda i: self.runs[i].h):
            run = self.runs[i]
            part = residual[at : at + run.y.size].reshape(run.y.shape) * self.sigma[i]
            error[i] = np.sqrt(np.mean(part**2, axis=0)) / run.scale
            at += run.y.size
        data = float(residual[priors:] @ residual[priors:])
        size = np.sqrt(np.diag(normal))  # a gap in metres must not push all others below the cutoff
        size = np.where(size > 0, size, 1.0)
        scaled = normal / np.outer(size, size) + 1e-12 * np.eye(len(size))
        covariance = np.linalg.pinv(scaled, hermitian=True) / np.outer(size, size)
        first = x.size - len(layout.effects)
        sd = {
            f"{terms[i].label}:{p.name}": p.grain or float(np.sqrt(max(covariance[first + k, first + k], 0.0)))
            for k, (i, p) in enumerate(layout.effects)
        }
        return Fit(
            terms=fitted,
            theta=theta[0],
            offsets=offsets[0],
            starts={self.runs[i].name: starts[0, i] for i in layout.free},
            error=np.array(error),
            chi2=float(residual @ residual),
            cost=data,
            sd=sd,
        )


def _cut_off(residual: Array) -> None:
    """Bring a residual that ran away back to large numbers, in place."""
    if residual.min() >= -LARGEST and residual.max() <= LARGEST:  # not of what is no number
        return
    residual[:] = np.where(np.isfinite(residual), np.clip(residual, -LARGEST, LARGEST), LARGEST)


def carried_on(slopes: Array, step: Array, change: Array) -> Array:
    """Return slopes that agree with the change that a step made, by Broyden's update.

    Source: A class of methods for solving nonlinear simultaneous equations, Mathematics of Computation 19, 1965, eq. 4.5.
    """
    return np.asarray(slopes + np.outer(change - slopes @ step, step / max(float(step @ step), 1e-300)))


def inward(parameter: Parameter, value: float) -> float:
    """Return the entry that is fitted for a parameter's value: itself where it has a sign, else its logarithm."""
    return float(value) if parameter.signed else float(np.log(max(value, 1e-300)))


def outward(parameter: Parameter, x: Array) -> Array:
    """Return the values of fitted entries."""
    return x if parameter.signed else np.exp(np.clip(x, -80, 80))
