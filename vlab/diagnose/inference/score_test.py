"""Score test of every effect at every location, on the innovations of a Kalman filter.

The innovations of the nominal model are white where nothing is missing. A missing force leaves its response through the
observer, which forgets quickly even where the structure rings for minutes. No phase drifts, and free decays serve as
well as driven records. Every law is evaluated along the smoothed motion, and linear regression gives its amplitude next
to the uncertain parameters with their priors. The score test (Rao 1948) gives a log-likelihood gain for each effect and
location.

References
----------
C. R. Rao, Large sample tests of statistical hypotheses concerning several parameters, Proc. Camb. Phil. Soc. 44 (1948)
50-57.
"""

import copy
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, ClassVar

import numpy as np
from scipy.fft import next_fast_len

from vlab.cases.replay import before
from vlab.cases.timestamps import between_samples
from vlab.diagnose.data.runs import Signals
from vlab.diagnose.inference.trial_scan import Scales, best_values, scan_values
from vlab.diagnose.kernels.parallel import side_by_side
from vlab.diagnose.parameters.locations import Place, admissible, at_place
from vlab.diagnose.parameters.reduced_model import discretise
from vlab.diagnose.parameters.terms import Candidate
from vlab.diagnose.predictors.innovations import Cause, Group, convolved, impulses_of, middles
from vlab.diagnose.predictors.kalman import FilterGains, filter_gains, run_filter, stack_runs, start_covariance, tune
from vlab.diagnose.predictors.unit_effects import commands_changed, port_series, unit_amplitudes
from vlab.diagnose.problem import Problem
from vlab.diagnose.settings import SCORE_TEST
from vlab.physics.effect import (
    ActuatorEffect,
    Effect,
    LinearPortEffect,
    Parameter,
    PickUp,
    PortEffect,
    SensorEffect,
)
from vlab.signals import Array


def _inverse(normal: Array) -> Array:
    """Return the pseudo-inverse of a normal matrix, scaled by its diagonal."""
    size = np.sqrt(np.diag(normal))
    return np.asarray(np.linalg.pinv(normal / np.outer(size, size), hermitian=True) / np.outer(size, size))


@dataclass(frozen=True, eq=False)
class _Plan:
    """Whitened columns (rows, sum of widths) of all effects and shapes at a location."""

    effects: list[tuple[Effect, dict[str, float]]]
    widths: list[int]
    rows: Array


class ScoreTest:
    """Screening of a problem's fit runs.

    Parameters
    ----------
    problem : Problem
        Problem.
    signals : sequence of Signals or None
        Runs; the fit runs of the problem by default.
    trust : float
        Factor on the unknown-force intensity; below 1 the filter forgets more slowly.
    like : ScoreTest or None
        Screening whose uncertain parameters and intensities are taken over.
    theta : (n_changes,) array or None
        Initial log factors of the uncertain parameters.
    """

    keeps_plans: ClassVar[bool] = False
    """Whether the columns of all locations are cached, which needs a single process."""
    slower: "tuple[ScoreTest, ...]" = ()
    """Screenings by slower observers."""
    theta: Array
    """Log factors of the uncertain parameters in the filters."""
    estimate: tuple[Array, list[dict[str, float]]]
    """Joint estimate of uncertain parameters and candidates, set by `given`."""
    cautious: tuple[Array, list[dict[str, float]]]
    """Joint estimate at a small effective sample size, with stronger priors."""

    def __init__(
        self,
        problem: Problem,
        signals: Sequence[Signals] | None = None,
        *,
        trust: float = 1.0,
        like: "ScoreTest | None" = None,
        theta: Array | None = None,
    ) -> None:
        self.problem, self.reduced_model, self.trust = problem, problem.reduced_model, trust
        self._intensity: dict[float, float] = dict(problem.intensity if like is None else like._intensity)
        self.runs = list(signals if signals is not None else problem.in_role("fit"))
        self.runs = self._shortened(self.runs)
        self._cache: dict[str, _Plan] = {}
        self._integrated: dict[tuple[Any, ...], Array] = {}
        self._spectra: tuple[Group, Array, Any] | None = None
        self._tones: dict[str, tuple[tuple[float, bool], ...]] = {}
        self._scans: dict[tuple[str, str, str], list[float]] = {}
        start = np.zeros(len(self.reduced_model.changes)) if like is None else like.theta
        self.theta = start if theta is None else theta
        for _ in range(SCORE_TEST.refits if like is None else 1):
            self._linearise()
            step = self._step
            if np.all(np.abs(step) <= 0.02 * self.reduced_model.prior + 1e-4):
                break
            self.theta = np.clip(self.theta + step, -2.0, 2.0)
        else:
            self._linearise()

    def _shortened(self, runs: list[Signals]) -> list[Signals]:
        """Return the first parts of runs within `SCORE_TEST.most_rows` values."""
        most = SCORE_TEST.most_rows // (len(runs) * len(self.reduced_model.rows.at_q))
        return [run if len(run) <= most else run.first(most) for run in runs]

    def _linearise(self) -> None:
        """Filter all runs at the current parameters and regress the innovations."""
        periods = sorted({run.h for run in self.runs})
        M, C, K, self.actuator_gain, self.sensor_gain = (
            part[0] for part in self.reduced_model.matrices(self.theta[None])
        )
        forces, rows = self.reduced_model.forces * self.actuator_gain, self.reduced_model.rows_at(self.theta)
        self.now = replace(self.reduced_model, M=M, C=C, K=K, forces=forces, rows=rows)
        self.groups = [self._group([run for run in self.runs if run.h == h]) for h in periods]
        self.e = np.concatenate([g.rows(g.e[..., None])[:, 0] for g in self.groups])
        self.nuisance = np.hstack([self._nuisance(), self._offsets()])
        precision = np.concatenate([1.0 / np.maximum(self.reduced_model.prior, 1e-9) ** 2, 1.0 / self.offset_sd**2])
        self._gram = np.linalg.inv(self.nuisance.T @ self.nuisance + np.diag(precision))
        present = np.concatenate([self.theta, np.zeros(len(self.offset_sd))])
        step = self._gram @ (self.nuisance.T @ self.e - precision * present)
        self.base = self.e - self.nuisance @ step
        self.variance = float(np.mean(self.base**2))
        self._step = self._estimate_changes(precision, precision * present)[: len(self.theta)]
        self._plain = (self.nuisance, precision)

    def _estimate_changes(self, precision: Array, pull: Array) -> Array:
        """Return the uncertain parameters at a small effective sample size.

        The innovations' model error does not average out over samples. Full weight would let weakly identified
        directions drift many standard deviations.
        """
        share = SCORE_TEST.model_error_samples / len(self.e) / max(self.variance, 1.0)
        normal = share * self.nuisance.T @ self.nuisance + np.diag(precision)
        return np.asarray(_inverse(normal) @ (share * (self.nuisance.T @ self.e) - pull))

    def given(self, candidates: Sequence[Candidate]) -> "ScoreTest":
        """Return the screening with free amplitudes of some candidates.

        Parameters
        ----------
        candidates : sequence of Candidate
            Candidates taken as present.

        Returns
        -------
        ScoreTest
            Conditional screening.
        """
        other = copy.copy(self)
        other._spectra, other._tones = None, {}
        columns = [self.columns_of(candidate) for candidate in candidates]
        nuisance, precision = self._plain
        other.nuisance = np.hstack([nuisance, *columns])
        free = np.concatenate([precision, np.full(other.nuisance.shape[1] - nuisance.shape[1], 1e-12)])
        whole = other.nuisance.T @ other.nuisance + np.diag(free)
        other._gram = _inverse(whole)
        pull = np.zeros(len(free))
        pull[: len(self.theta)] = precision[: len(self.theta)] * self.theta
        solution = other._gram @ (other.nuisance.T @ self.e - pull)
        other.base = self.e - other.nuisance @ solution
        other.variance = float(np.mean(other.base**2))
        other.estimate = self._estimate(candidates, solution)
        other.cautious = self._estimate(candidates, other._estimate_changes(free, pull))
        return other

    def _estimate(self, candidates: Sequence[Candidate], solution: Array) -> tuple[Array, list[dict[str, float]]]:
        """Return the joint estimate of uncertain parameters and candidates."""
        at, values = len(self.theta) + len(self.offset_sd), []
        theta = np.clip(self.theta + solution[: len(self.theta)], -2.0, 2.0)
        for candidate in candidates:
            own = dict(candidate.values)
            for parameter in candidate.effect.amplitudes:
                found = float(solution[at])
                own[parameter.name] = found if parameter.signed else max(found, 0.02 * abs(own[parameter.name]), 1e-300)
                at += 1
            values.append(own)
            at += not candidate.effect.amplitudes
        return theta, values

    def states(
        self, effects: Sequence[tuple[SensorEffect, Place, Mapping[str, float]]] = ()
    ) -> list[tuple[Signals, Array, Array]]:
        """Return every run with its smoothed states and channels.

        Parameters
        ----------
        effects : sequence of (SensorEffect, Place, mapping)
            Sensor effects to remove from the recordings first.

        Returns
        -------
        list of (Signals, (n, 2m) array, (n, n_channels) array)
            Run, smoothed modal states, and channels of unit gain.
        """
        out = []
        for group in self.groups:
            smoothed = group.smoothed
            if effects:
                y = group.y.copy()
                for effect, place, values in effects:
                    y[..., place.index] = effect.correct(y[..., place.index], values, group.h, group.times)
                smoothed = run_filter(group.system, group.gains, group.forces, y, group.lengths, usable=group.usable)
            shown = smoothed.x @ group.system.C[0].T + group.forces @ group.system.D[0].T
            out += [(run, smoothed.x[: len(run), i], shown[: len(run), i]) for i, run in enumerate(group.runs)]
        return out

    def forget(self) -> None:
        """Drop the caches of the candidates."""
        self._integrated.clear()
        if not self.keeps_plans:
            self._cache.clear()

    def columns_of(self, candidate: Candidate) -> Array:
        """Return the whitened columns (rows, k) of a candidate's amplitudes.

        Parameters
        ----------
        candidate : Candidate
            Candidate.

        Returns
        -------
        (rows, k) array
            Columns.
        """
        blocks = []
        shape = {p.name: candidate.values[p.name] for p in candidate.effect.shapes}
        plan = self._cache.get(candidate.place.name)
        start = 0
        for (effect, values), width in zip(plan.effects, plan.widths, strict=True) if plan is not None else ():
            if effect.name == candidate.effect.name and values == shape:
                assert plan is not None
                return plan.rows[:, start : start + width].astype(float)
            start += width
        for group in self.groups:
            left, _ = self._left_by(group, candidate.place, [(candidate.effect, shape)])
            blocks.append(group.rows(left))
        return np.concatenate(blocks)

    def _foreseen(
        self, group: Group, place: Place, effect: Effect, values: Mapping[str, float], columns: Array
    ) -> None:
        """Subtract the innovations from the columns of a pick-up, in place.

        Of their own sample only the predicted part of signals counts. Otherwise one sensor's innovation would explain
        another's.
        """
        if not isinstance(effect, PickUp):
            return
        other = 0.0 if place.tag == "command" else group.e[..., place.other]
        (unit,) = unit_amplitudes(effect, dict(values))
        columns[..., place.index, 0] -= effect.mix(group.e[..., place.index], other, unit) - group.e[..., place.index]

    def _group(self, runs: list[Signals]) -> Group:
        reduced_model = self.now
        m = reduced_model.m
        system = discretise(
            reduced_model.M[None],
            reduced_model.C[None],
            reduced_model.K[None],
            np.eye(m),
            reduced_model.rows,
            runs[0].h,
        )
        u, lengths = stack_runs(runs, [run.u for run in runs])
        load, _ = stack_runs(runs, [run.load for run in runs])
        y, _ = stack_runs(runs, [run.y / self.sensor_gain for run in runs])
        usable = None
        if any(run.valid is not None for run in runs):
            usable, _ = stack_runs(runs, [run.usable for run in runs])
        forces = u @ reduced_model.forces.T + load @ reduced_model.loads.T
        noise = np.sqrt(np.mean([run.noise**2 for run in runs], axis=0)) / self.sensor_gain
        near = self._intensity.get(runs[0].h, 0.0)
        if self.trust == 1.0:
            self._intensity[runs[0].h], gains = tune(system, noise, forces, y, lengths, usable, near)
        else:
            intensity = near or tune(system, noise, forces, y, lengths, usable)[0]
            gains = filter_gains(system, noise, intensity * self.trust, start_covariance(system, y))
        if usable is None and all(run.at_rest for run in runs):  # a known start makes every sample count
            gains = FilterGains(K=gains.K[-1:], S=gains.S[-1:], P=gains.P[-1:])
        smoothed = run_filter(system, gains, forces, y, lengths, usable=usable)
        steady = np.trace(gains.S[-1])
        converged = [i for i in range(len(gains.S)) if np.trace(gains.S[i]) < 1.5 * steady]
        group = Group(runs, system, gains, smoothed, u, forces, y, lengths, usable, e=smoothed.e)
        group.motion = middles(reduced_model, group)
        group.first = min(converged[0] if converged else 0, int(lengths.min()) // 4)
        group.white = np.linalg.inv(np.linalg.cholesky(gains.S[-1]))
        group.impulses = impulses_of(system, gains.K[-1], len(y))
        return group

    # ---- innovations' response to signals ---------------------------------------------------------------------------

    def through(self, group: Group, modal: Array | None, reading: Array | None) -> Array:
        """Return the innovations' response to forces and channel additions.

        Parameters
        ----------
        group : Group
            Filtered runs.
        modal : (n, n_runs, m, k) array or None
            Modal forces.
        reading : (n, n_runs, p, k) array or None
            Additions to the channels.

        Returns
        -------
        (n, n_runs, p, k) array
            Innovations.
        """
        parts = []
        if modal is not None:
            parts.append(convolved(group.impulses[:, :, : self.reduced_model.m], modal.astype(np.float32)))
        if reading is not None:
            parts.append(convolved(group.impulses[:, :, self.reduced_model.m :], reading.astype(np.float32)))
        return np.asarray(sum(parts))

    def _nuisance(self) -> Array:
        """Return the whitened columns (rows, n_changes) of the uncertain parameters."""
        blocks = []
        sensors = [
            (i, change.sensor) for i, change in enumerate(self.reduced_model.changes) if change.sensor is not None
        ]
        for group in self.groups:
            reading = np.zeros((*group.y.shape, len(self.reduced_model.changes)))
            for i, sensor in sensors:
                reading[..., sensor, i] = group.y[..., sensor]
            for shift in self.reduced_model.shifts:
                p, v = np.split(group.smoothed.x, 2, axis=-1)
                reading[..., shift.sensor, shift.by] = p @ shift.at_q + v @ shift.at_v
            left = self.through(group, self._changed_forces(group), reading)
            for i, sensor in sensors:  # of its own sample only the prediction counts, not the innovation
                left[..., sensor, i] -= group.e[..., sensor]
            blocks.append(group.rows(left))
        return np.concatenate(blocks)

    def _changed_forces(self, group: Group) -> Array:
        """Return modal forces (n, n_runs, m, n_changes) per unit uncertain parameter."""
        p, v, a = group.motion
        modal = np.zeros((*p.shape, len(self.reduced_model.changes)))
        slopes = self.reduced_model.slopes(self.theta)
        for i, change in enumerate(self.reduced_model.changes):
            for matrix, motion in zip(slopes[i], (a, v, p), strict=True):
                if matrix is not None:
                    modal[..., i] -= motion @ matrix.T
            if change.actuator is not None:
                modal[..., i] += group.u[..., change.actuator, None] * self.now.forces[:, change.actuator]
        return modal

    def _offsets(self) -> Array:
        """Return the columns of the sensor offsets."""
        blocks = []
        for group in self.groups:
            reading = np.zeros((*group.y.shape, group.y.shape[2]))
            for i in range(group.y.shape[2]):
                reading[..., i, i] = 1.0
            blocks.append(group.rows(self.through(group, None, reading)))
        return np.concatenate(blocks)

    @property
    def offset_sd(self) -> Array:
        """Prior standard deviations (n_channels,) of the sensor offsets."""
        share = np.array([SCORE_TEST.offset_sd[order] for order in self.problem.orders])
        return np.asarray(share * np.max([run.scale for run in self.runs], axis=0))

    def _left(self, columns: Array) -> Array:
        """Return columns projected off the uncertain parameters."""
        return np.asarray(columns - self.nuisance @ (self._gram @ (self.nuisance.T @ columns)))

    def asked(
        self, others: Sequence[Sequence[Signals]], skewed: Sequence[int] = (), skew_s: float = 0.0
    ) -> tuple[Array, float, float]:
        """Estimate other inputs and a time skew from the innovations.

        Parameters
        ----------
        others : sequence of sequences of Signals
            The same runs with other inputs.
        skewed : sequence of int
            Channels with a common time skew.
        skew_s : float
            Unit of the skew [s].

        Returns
        -------
        shares : (n_others,) or (n_others + 1,) array
            Joint shares of the other inputs, and of the skew; 1 where they are correct.
        gain : float
            Log-likelihood gain [nat].
        explained : float
            Explained share of the residual [1].
        """
        by_name, blocks = [{s.name: s for s in signals} for signals in others], []
        for group in self.groups:
            forces, readings = [], []
            for named in by_name:
                runs = [named[run.name].first(len(run)) for run in group.runs]
                y, _ = stack_runs(runs, [run.y / self.sensor_gain for run in runs])
                forces.append(self._of_inputs(group, runs))
                readings.append(group.y - y)
            if skewed:
                forces.append(np.zeros_like(group.forces))
                readings.append(_moved(group.y, skewed, skew_s / group.h))
            left = self.through(group, np.stack(forces, axis=-1), np.stack(readings, axis=-1))
            if skewed:  # of their own samples only the prediction counts
                left[..., -1] -= _moved(group.e, skewed, skew_s / group.h)
            blocks.append(group.rows(left))
        columns = np.concatenate(blocks)
        normal, pull = columns.T @ self._left(columns), columns.T @ self.base
        if not np.all(np.diag(normal) > 1e-12):
            return np.zeros(len(pull)), 0.0, 0.0
        shares = np.linalg.solve(normal + 1e-9 * np.diag(np.diag(normal)), pull)
        won = float(pull @ shares)
        return shares, 0.5 * won / self.variance, won / max(float(self.base @ self.base), 1e-300)

    def _of_inputs(self, group: Group, runs: Sequence[Signals]) -> Array:
        """Return the difference (n, n_runs, m) of modal forces under other inputs."""
        u, _ = stack_runs(runs, [run.u for run in runs])
        load, _ = stack_runs(runs, [run.load for run in runs])
        return np.asarray(u @ self.now.forces.T + load @ self.now.loads.T - group.forces)

    # ---- the candidates ---------------------------------------------------------------------------------------------

    def candidates(
        self,
        effects: Sequence[Effect],
        among: Collection[str] | None = None,
    ) -> list[Candidate]:
        """Return every effect at every admissible location, best first.

        Parameters
        ----------
        effects : sequence of Effect
            Effects.
        among : collection of str or None
            Labels of the candidates to test; all by default.

        Returns
        -------
        list of Candidate
            Candidates by log-likelihood gain.
        """

        def at(places: Sequence[Place]) -> list[Candidate]:
            out: list[Candidate] = []
            for place in places:
                mine = [
                    at_place(effect, place)
                    for effect in effects
                    if admissible(effect, place) and (among is None or f"{effect.name}@{place.name}" in among)
                ]
                out += self._at(place, mine) if mine else []
            return out

        places = self.problem.places
        if self.keeps_plans:
            found = [at([place]) for place in places]
        else:
            found = side_by_side(at, [places[i :: SCORE_TEST.shares] for i in range(SCORE_TEST.shares)])
        return sorted((c for part in found for c in part), key=lambda c: (-c.log_likelihood_gain, c.label))

    def _plan(self, place: Place, effects: Sequence[Effect]) -> "_Plan":
        """Return the columns of effects at a location, by effect and shape."""
        return self._columns(place, [(effect, values) for effect in effects for values in self._shapes(effect, place)])

    def _columns(self, place: Place, plans: list[tuple[Effect, dict[str, float]]]) -> "_Plan":
        """Return the columns of effects with given shapes at a location."""
        parts: list[Array] = []
        widths: list[int] = []
        for group in self.groups:
            left, widths = self._left_by(group, place, plans)
            parts.append(group.rows(left))
        return _Plan(plans, widths, np.concatenate(parts).astype(np.float32))

    def _left_by(
        self, group: Group, place: Place, plans: Sequence[tuple[Effect, dict[str, float]]]
    ) -> tuple[Array, list[int]]:
        """Return the innovations' response to effects, and its widths."""
        left, widths = self._carried(group, [self._causes(group, place, effect, values) for effect, values in plans])
        start = 0
        for (effect, values), width in zip(plans, widths, strict=True):
            self._foreseen(group, place, effect, values, left[..., start : start + width])
            start += width
        return left, widths

    def _carried(self, group: Group, causes: Sequence[Sequence[Cause]]) -> tuple[Array, list[int]]:
        """Return the innovations' response to causes, and its widths.

        Every entrance has one impulse response, so columns are convolutions with it.
        """
        widths = [own[0].series.shape[-1] for own in causes]
        starts = [sum(widths[:i]) for i in range(len(widths) + 1)]
        ways: dict[bytes | int, list[tuple[int, Cause]]] = {}
        for start, own in zip(starts, causes, strict=False):
            for cause in own:
                ways.setdefault(cause.way, []).append((start, cause))
        columns, order = [], []
        for entering in ways.values():
            series = np.concatenate([c.series.astype(np.float32) for _, c in entering], axis=-1)
            columns.append(convolved(self._impulse(group, entering[0][1]), series[:, :, None]))
            order += [start + i for start, c in entering for i in range(c.series.shape[-1])]
        if order == list(range(starts[-1])):
            return np.concatenate(columns, axis=-1), widths
        out = np.zeros((*group.y.shape, starts[-1]), dtype=np.float32)
        for i, column in zip(order, np.moveaxis(np.concatenate(columns, axis=-1), -1, 0), strict=True):
            out[..., i] += column
        return out, widths

    def _impulse(self, group: Group, cause: Cause) -> Array:
        """Return the innovations' impulse response (n, p, 1) of a cause."""
        m = self.reduced_model.m
        if cause.force is None:
            return group.impulses[:, :, m + cause.channel, None]
        return np.asarray(group.impulses[:, :, :m] @ cause.force[:, None])

    def _at(self, place: Place, effects: Sequence[Effect]) -> list[Candidate]:
        if place.name not in self._cache:
            self._cache[place.name] = self._plan(place, effects)
        best: dict[str, Candidate] = {}
        for candidate in self._regressed(place, self._cache[place.name]):
            name = candidate.effect.name
            if name not in best or candidate.log_likelihood_gain > best[name].log_likelihood_gain:
                best[name] = candidate
        return list(best.values())

    def zoomed(self, candidate: Candidate) -> Candidate:
        """Return a candidate with its shape refined between grid values.

        A nonsmooth law has useful derivatives only near the correct shape, so a fit between coarse grid values fails.

        Parameters
        ----------
        candidate : Candidate
            Candidate.

        Returns
        -------
        Candidate
            Refined candidate.
        """
        best = candidate
        shapes = [p for p in candidate.effect.shapes if p.name != "frequency"]  # frequencies come from the recordings
        has_state = candidate.effect.has_state
        widths = (
            SCORE_TEST.zoom[: SCORE_TEST.coarse_zoom] if has_state else SCORE_TEST.zoom
        )  # such laws are smooth in their shapes, and slow to evaluate
        for width in widths if shapes else ():
            values = {p.name: best.values[p.name] for p in candidate.effect.shapes}
            tried = [
                (candidate.effect, {**values, p.name: values[p.name] * f}) for p in shapes for f in (width, 1 / width)
            ]
            found = self._regressed(candidate.place, self._columns(candidate.place, tried))
            other = max(found, key=lambda c: c.log_likelihood_gain)
            best = other if other.log_likelihood_gain > best.log_likelihood_gain + SCORE_TEST.no_gain else best
        return best

    def _regressed(self, place: Place, plan: "_Plan") -> list[Candidate]:
        """Return the candidates of a plan with amplitudes and gains."""
        rows = np.asfortranarray(plan.rows, dtype=float)  # columns are contiguous
        left = np.asfortranarray(self._left(rows))
        out: list[Candidate] = []
        start = 0
        for (effect, values), width in zip(plan.effects, plan.widths, strict=True):
            part = slice(start, start + width)
            if isinstance(effect, SensorEffect) and not effect.amplitudes:
                gain, amplitudes = self._corrected_gain(rows[:, start], left[:, start], effect, values), np.zeros(0)
            else:
                gain, amplitudes = self._gain(rows[:, part], left[:, part], effect)
            start += width
            names = [p.name for p in effect.amplitudes]
            found = {**values, **dict(zip(names, amplitudes.tolist(), strict=False))} if names else dict(values)
            out.append(Candidate(effect=effect, place=place, values=found, log_likelihood_gain=gain))
        return out

    def _gain(self, columns: Array, left: Array, effect: Effect) -> tuple[float, Array]:
        """Return the log-likelihood gain of columns, and their coefficients.

        With W = (I + N P N^T)^-1, N the uncertain parameters' columns and P their prior covariance, the gain is b^T
        A^-1 b/2. Here A = c^T W c and b = c^T W e, with innovations of unit variance.
        """
        size = np.sqrt(np.einsum("ij,ij->j", columns, left).clip(0.0))
        width = columns.shape[1]
        if not np.all(size > 1e-9):
            return 0.0, np.zeros(width)
        gram = (columns / size).T @ (left / size) + 1e-9 * np.eye(width)
        b = (columns / size).T @ self.base
        x = np.linalg.solve(gram, b)
        negative = [i for i, p in enumerate(effect.amplitudes) if not p.signed and x[i] < 0]
        if negative:  # a negative friction or mass counts as its standard deviation
            others = [i for i in range(width) if i not in negative]
            x = np.full(width, np.sqrt(self.variance))
            if others:
                x[others] = np.linalg.solve(gram[np.ix_(others, others)], b[others])
            if not others or any(x[i] < 0 for i, p in enumerate(effect.amplitudes) if not p.signed):
                return 0.0, np.sqrt(self.variance) / size
            return 0.5 * float(b[others] @ x[others]) / self.variance, x / size
        if not effect.amplitudes and x[0] < 0.2 * size[0]:
            return 0.0, np.zeros(width)
        return 0.5 * float(b @ x) / self.variance, x / size

    def _corrected_gain(self, column: Array, left: Array, effect: SensorEffect, values: dict[str, float]) -> float:
        """Return the log-likelihood gain of a corrected recording.

        The correction's amplification of noise is subtracted.
        """
        before = float(self.base @ self.e)
        after = before - 2 * float(column @ self.base) + float(column @ left)
        if not after > 0:
            return 0.0
        samples = len(self.e) / len(self.reduced_model.rows.at_q)
        return 0.5 * len(self.e) * float(np.log(before / after)) + samples * effect.stretch(values, self.groups[0].h)

    def motion(self, group: Group, place: Place) -> tuple[Array, Array]:
        """Return port displacement and velocity (n, n_runs) at mid-step."""
        if place.name not in group.at_places:
            row = place.rows[0]
            group.at_places[place.name] = (group.motion[0] @ row, group.motion[1] @ row)
        return group.at_places[place.name]

    def reference(self, name: str, place: Place) -> float:
        """Return the reference quantity of a relative parameter range.

        Parameters
        ----------
        name : str
            Name of the quantity.
        place : Place
            Location.

        Returns
        -------
        float
            Quantity [SI].
        """
        if name in ("displacement", "velocity"):
            which = 0 if name == "displacement" else 1
            sizes = []
            for group in self.groups:
                x = self.motion(group, place)[which]
                for i, length in enumerate(group.lengths):
                    part = x[group.first : length, i]
                    sizes.append(float(np.abs(part).max(initial=0.0)))
            return max(max(sizes), 1e-300)
        if name in ("error", "servo-force"):
            return max(max(self._of_servo(group, place, name) for group in self.groups), 1e-300)
        if name == "input":
            return max(max(float(np.abs(g.u[..., list(place.indices)]).max()) for g in self.groups), 1e-300)
        if name == "input-slope":
            own = list(place.indices)
            return max(max(float(np.abs(np.diff(g.u[..., own], axis=0)).max() / g.h) for g in self.groups), 1e-300)
        if name == "output":
            return max(max(float(np.abs(g.y[..., place.index]).max()) for g in self.groups), 1e-300)
        if name == "duration":
            return max(float(g.lengths.max() * g.h) for g in self.groups)
        if name == "step":
            return max(g.h for g in self.groups)
        return 1.0

    def _of_servo(self, group: Group, place: Place, name: str) -> float:
        """Return a servo's largest position error, or its largest force."""
        servo, (z, v) = place.servo, self.motion(group, place)
        assert servo is not None
        error = group.u[..., place.indices[0]] - servo.rest - z
        x = error if name == "error" else servo.limited(servo.gain * error - servo.damping * v)
        return max(float(np.abs(x[group.first : n, i]).max(initial=0.0)) for i, n in enumerate(group.lengths))

    def tones(self, place: Place) -> tuple[tuple[float, bool], ...]:
        """Return the frequencies of the strongest tones in the residual.

        A force of one frequency stands out of its neighbours; a resonance need not.

        Parameters
        ----------
        place : Place
            Port of the force.

        Returns
        -------
        tuple of (float, bool)
            Frequency [Hz], and whether the tone stands out.
        """
        if place.name in self._tones:
            return self._tones[place.name]
        if self._spectra is None:
            self._spectra = self._spectra_left()
        group, frequency, left = self._spectra
        answer = self._answer(group, place, frequency)
        seen = np.abs(np.einsum("fp,frp->fr", answer.conj(), left)) ** 2
        power = seen.sum(axis=1) / np.maximum(np.sum(np.abs(answer) ** 2, axis=1), 1e-300)
        apart = SCORE_TEST.tone_width / (len(group.e) * group.h)
        power[(frequency < apart) | (frequency > SCORE_TEST.highest_tone / group.h)] = 0.0
        out = []
        whole = power.copy()
        for _ in range(SCORE_TEST.tones):
            top = int(np.argmax(power))
            far = np.abs(frequency - frequency[top])
            beside = whole[
                (far > apart) & (far < SCORE_TEST.tone_neighbours / SCORE_TEST.tone_width * apart) & (whole > 0)
            ]
            stands_out = bool(beside.size and power[top] > SCORE_TEST.tone_stands_out * np.median(beside))
            out.append((float(frequency[top]) or apart, stands_out))
            power[far < apart] = 0.0
        self._tones[place.name] = tuple(out)
        return tuple(out)

    def _spectra_left(self) -> tuple[Group, Array, Any]:
        """Return the largest group, frequencies, and spectra (nf, n_runs, p) of the residual."""
        sizes = [len(g.rows(g.e[..., None])) for g in self.groups]
        which = int(np.argmax(sizes))
        group = self.groups[which]
        left = np.zeros_like(group.e)
        left[group.first :][group.counts] = self.base[sum(sizes[:which]) :][: sizes[which]].reshape(-1, left.shape[2])
        size = next_fast_len(4 * len(left), real=True)
        return group, np.fft.rfftfreq(size, group.h), np.fft.rfft(left, size, axis=0)

    def _answer(self, group: Group, place: Place, frequency: Array) -> Any:
        """Return the whitened innovations (nf, p) of a unit force by frequency."""
        system, K = group.system, group.gains.K[-1]
        C, D, row = system.C[0], system.D[0], place.rows[0]
        poles, vectors = np.linalg.eig(system.A[0] - K @ C)
        push = np.linalg.solve(vectors, (system.B[0] - K @ D) @ row)
        z = np.exp(2j * np.pi * frequency * group.h)
        seen = (push / (z[:, None] - poles)) @ (C @ vectors).T + D @ row
        return seen @ group.white.T

    def _grid(self, effect: Effect, parameter: Parameter, place: Place) -> list[float]:
        """Return the trial values of a shape, with tones for frequencies."""
        values = [g * self.reference(parameter.reference, place) for g in parameter.grid]
        if isinstance(effect, PortEffect) and parameter.name == "frequency":
            values += [hz for hz, stands_out in self.tones(place) if stands_out or effect.response != "none"]
        return values + (self._scanned(effect, parameter, place) if parameter.scan else [])

    def _scanned(self, effect: Effect, parameter: Parameter, place: Place) -> list[float]:
        """Return the best values of a parameter over its whole range."""
        key = (effect.name, parameter.name, place.name)
        if key not in self._scans:
            others = {p.name: p.grid[0] * self.reference(p.reference, place) for p in effect.shapes}

            def gains(values: Sequence[float]) -> list[float]:
                plans: list[tuple[Effect, dict[str, float]]]
                plans = [(effect, {**others, parameter.name: value}) for value in values]
                return [c.log_likelihood_gain for c in self._regressed(place, self._columns(place, plans))]

            self._scans[key] = best_values(scan_values(parameter, self._scales(place)), gains)
        return self._scans[key]

    def _scales(self, place: Place) -> Scales:
        """Return the scales of the recordings at a location."""
        own = list(place.indices) if place.kind == "actuator" else []
        return Scales(
            step=max(g.h for g in self.groups),
            duration=self.reference("duration", place),
            highest_hz=self.problem.highest_hz,
            span=max((float(np.ptp(run.u[:, own], axis=0).max()) for run in self.runs), default=0.0) if own else 0.0,
            steepest=self.reference("input-slope", place) if own else 0.0,
        )

    def _shapes(self, effect: Effect, place: Place) -> list[dict[str, float]]:
        if not effect.shapes:
            return [{}]
        grids = [self._grid(effect, p, place) for p in effect.shapes]
        return [dict(zip((p.name for p in effect.shapes), values, strict=True)) for values in product(*grids)]

    def _causes(self, group: Group, place: Place, effect: Effect, shape: dict[str, float]) -> list[Cause]:
        """Return the signals of an effect's unit amplitudes, with their entrances."""
        if isinstance(effect, PickUp):
            other = before(group.u[..., place.other]) if place.tag == "command" else group.y[..., place.other]
            recorded = group.y[..., place.index]
            (values,) = unit_amplitudes(effect, shape)
            return [Cause(series=(effect.mix(recorded, other, values) - recorded)[..., None], channel=place.index)]
        if isinstance(effect, SensorEffect):
            recorded = group.y[..., place.index]
            parts = [
                recorded - effect.correct(recorded, v, group.h, group.times) for v in unit_amplitudes(effect, shape)
            ]
            return [Cause(series=np.stack(parts, axis=-1), channel=place.index)]
        if isinstance(effect, ActuatorEffect):
            return [
                Cause(
                    series=commands_changed(effect, group.u[..., i], shape, group.h, group.commands_before[:, i]),
                    force=self.now.forces[:, i],
                )
                for i in place.indices
            ]
        if isinstance(effect, LinearPortEffect):
            return self._linear_causes(group, place, effect)
        assert isinstance(effect, PortEffect)
        z, v = self.motion(group, place)
        own: Any = group.u[..., place.coil] if place.coil is not None else 0.0
        parts = [self._series(group, place, effect, values, z, v, own) for values in unit_amplitudes(effect, shape)]
        return [Cause(series=np.stack(parts, axis=-1) / effect.probe, force=place.rows[0])]

    def _series(
        self, group: Group, place: Place, effect: PortEffect, values: dict[str, float], z: Array, v: Array, command: Any
    ) -> Array:
        """Return an effect's force along the motion at a location.

        Hysteretic laws are integrated for all locations at once.
        """
        if effect.memory((1,)) is None:
            return port_series(effect, z, v, values, group.h, command, group.starts)
        ports = [p for p in self.problem.places if p.kind == "port" and admissible(effect, p)]
        unit = tuple(values[p.name] for p in effect.amplitudes)
        shapes = [self._shapes(effect, p) for p in ports]
        at = next((i for i, p in enumerate(ports) if p.name == place.name), -1)
        shape = {p.name: values[p.name] for p in effect.shapes}
        if at < 0 or shape not in shapes[at]:
            return port_series(effect, z, v, values, group.h, command, group.starts)
        which = shapes[at].index(shape)
        key = (id(group), effect.name, unit)
        if key not in self._integrated:  # all ports and shapes in one batch: the loop over samples dominates
            motion = [self.motion(group, p) for p in ports]
            both = [np.stack([m[i] for m in motion], axis=-1)[..., None] for i in range(2)]
            own = {p.name: np.array([[s[p.name] for s in of_port] for of_port in shapes]) for p in effect.shapes}
            amplitudes = {p.name: values[p.name] for p in effect.amplitudes}
            wide = np.zeros((1, 1, 1, len(shapes[at])))
            starts = group.starts[:, None, None]
            self._integrated[key] = port_series(
                effect, both[0] + wide, both[1] + wide, {**own, **amplitudes}, group.h, starts=starts
            )
        return np.asarray(self._integrated[key][..., at, which])

    def _linear_causes(self, group: Group, place: Place, effect: LinearPortEffect) -> list[Cause]:
        p, v, a = group.motion
        (values,) = unit_amplitudes(effect, {})
        mass, damping, stiffness = effect.impedance(values, place.stiffness)
        return [
            Cause(series=-(mass * (a @ row) + damping * (v @ row) + stiffness * (p @ row))[..., None], force=row)
            for row in place.rows
        ]


def _moved(y: Array, channels: Sequence[int], samples: float) -> Array:
    """Return the change of channels (n, n_runs, p) under a time skew."""
    out = np.zeros_like(y)
    for run in range(y.shape[1]):
        for channel in channels:
            out[:, run, channel] = y[:, run, channel] - between_samples(y[:, run, channel], -samples)
    return out
