"""Maximum a posteriori fits on the linear time-varying system along the motion.

The system is linearised about the smoothed recorded motion, so a correct hypothesis deviates little. The method is that
of `vlab.diagnose.inference.least_squares`, with matrices of every sample.
"""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from vlab.diagnose.data.runs import Signals
from vlab.diagnose.inference.least_squares import LeastSquares
from vlab.diagnose.inference.parameter_vector import ParameterVector
from vlab.diagnose.inference.ridge_regression import ridge_inverse
from vlab.diagnose.inference.run_part import Part
from vlab.diagnose.inference.trajectory_score_test import TrajectoryScoreTest
from vlab.diagnose.parameters.locations import Place
from vlab.diagnose.parameters.mjcf import relative_changes
from vlab.diagnose.parameters.terms import Fit, Term
from vlab.diagnose.predictors.held_commands import changed_in_parts, over_intervals
from vlab.diagnose.predictors.servo_numbers import carried, servo_numbers
from vlab.diagnose.predictors.trajectory import pad_and_stack
from vlab.diagnose.predictors.trajectory_integration import integrate_trajectory, trace_laws
from vlab.diagnose.predictors.trajectory_laws import Law, Path, path_of
from vlab.diagnose.predictors.trajectory_lines import Lines
from vlab.diagnose.predictors.unit_effects import fast_march
from vlab.diagnose.settings import FIT, TRAJECTORY, TRAJECTORY_FIT, TRAJECTORY_INTEGRATION
from vlab.physics.effect import ActuatorEffect, PortEffect, SensorEffect, Step, Values
from vlab.physics.servo import ServoEffect
from vlab.signals import Array


class TrajectoryLeastSquares(LeastSquares):
    """Fits of hypotheses to runs along their motion.

    Parameters
    ----------
    screen : TrajectoryScoreTest
        Screening along the motion.
    whole : bool
        Whether to fit whole runs, or the parts of unstable ones, instead of windows.
    without : sequence of Term
        Sensor effects to remove from the recordings before smoothing of the starts.
    model_error : float or None
        See `LeastSquares`.
    """

    def __init__(
        self,
        screen: TrajectoryScoreTest,
        *,
        whole: bool = False,
        without: Sequence[Term] = (),
        model_error: float | None = None,
    ) -> None:
        self.moving = screen
        wrong = [(t.effect, t.place, dict(t.values)) for t in without if isinstance(t.effect, SensorEffect)]
        smooth = screen.states_without(wrong) if wrong else screen.smooth
        self.parts: list[Part] = []
        runs: list[Signals] = []
        for i, run in enumerate(screen.runs):
            count = screen.part_counts[i]
            if not whole:
                count = max(count, min(TRAJECTORY_FIT.windows, len(run) // TRAJECTORY_FIT.least_window))
            edges = np.linspace(0, len(run), count + 1).astype(int)
            for j, (a, b) in enumerate(pairwise(edges)):
                self.parts.append(Part(i, int(a), int(b)))
                cut = {name: getattr(run, name)[a:b] for name in ("u", "load", "y")}
                valid = None if run.valid is None else run.valid[a:b]
                name = run.name if count == 1 else f"{run.name}[{j}]"
                runs.append(replace(run, name=name, **cut, valid=valid, start=smooth[a, i], at_rest=False))
        self.length = max(len(run) for run in runs)
        self.whole = whole
        self.screen, self.problem, self.reduced_model, self.runs = screen, screen.problem, screen.reduced_model, runs
        self._gather()
        self._weigh(model_error)
        # no law is followed closer than the steps of the linear system allow
        self.noise_share += self.integration_share
        self.active = np.zeros(0, dtype=int)
        self.start_scale = self._spreads()
        self.first_starts = [run.start for run in runs]
        self.free_starts = {}
        self.directions = self._identifiable()
        self.free_starts = self.first_free_starts = self.initial_condition_nuisance()

    def forget_starts(self) -> None:
        """See `LeastSquares`."""
        self.runs = [replace(run, start=first) for run, first in zip(self.runs, self.first_starts, strict=True)]
        self.free_starts = self.first_free_starts

    def about(self, fit: Fit) -> "TrajectoryLeastSquares":
        """See `LeastSquares`; the starts are those of the fit."""
        own = copy(self)
        own.move_starts(fit.terms, fit.theta, [dict(t.values) for t in fit.terms], fit.offsets)
        return own

    @property
    def correlated_error(self) -> float:
        """See `LeastSquares`: that of responses linear in the parameters."""
        return self.model_error

    def beside(self, terms: Sequence[Term]) -> LeastSquares:
        """See `LeastSquares`."""
        if not any(t.effect.kind == "sensor" for t in terms):
            return self
        return TrajectoryLeastSquares(self.moving, without=terms, model_error=self.model_error)

    @property
    def recordings(self) -> list[str]:
        """See `LeastSquares`: of every window."""
        return [self.moving.runs[part.run].name for part in self.parts]

    @property
    def sample_times(self) -> list[Array]:
        """See `LeastSquares`: the recorded times."""
        return [self.moving.moving.trajectories[part.run].time[part.first : part.end] for part in self.parts]

    def _gather(self) -> None:
        """Divide the system into windows, (n, n_windows, ...)."""
        s, screen = self.moving.stack, self.moving
        self.A, self.G, self.C, self.D = (self._cut(x) for x in (s.A, s.G, s.C, s.D))
        self.fine_A, self.fine_G = self._cut(s.fine_A), self._cut(s.fine_G)
        self.defect, self.h = self._cut(s.defect), self._cut(s.h)
        inside = self.h > 0
        self.even = float(self.h[0, 0]) if np.ptp(self.h[inside]) <= TRAJECTORY_FIT.even * self.h[0, 0] else None
        self.h[~inside] = 1.0
        self.t = self._cut(pad_and_stack([c.time for c in screen.moving.trajectories]))
        self.read = self._cut(pad_and_stack([a.read for a in screen.systems]))
        self.changes = self._cut(screen.changes)
        self.efforts = screen.efforts if np.any(screen.efforts) else screen.efforts[:0]
        self.v = self._cut(pad_and_stack([a.motion.v for a in screen.systems]))
        self._lines: dict[str, tuple[Array, Array, Array, Array]] = {}
        self._paths: dict[str, Path] = {}

    def _cut(self, series: Array) -> Array:
        out = np.zeros((self.length, len(self.parts), *series.shape[2:]))
        for w, part in enumerate(self.parts):
            out[: part.end - part.first, w] = part.of(series)
        return out

    def _spreads(self) -> list[Array]:
        """Return the square-root covariances (2 nv, 2 nv) of the windows' starts."""
        out = []
        for part in self.parts:
            at_rest = part.first == 0 and self.moving.moving.trajectories[part.run].at_rest
            sample = part.first if at_rest else max(part.first, min(TRAJECTORY_FIT.settled, part.end - 1))
            size, vectors = np.linalg.eigh(self.moving.gains.P[sample, part.run])
            out.append((1.0 if at_rest else TRAJECTORY_FIT.loose) * vectors * np.sqrt(np.maximum(size, 0.0)))
        return out

    def initial_condition_nuisance(self) -> dict[int, tuple[Array, Array, Array]]:
        """See `LeastSquares`; the spread is that of the filter's predictions."""
        return self._free_starts((), self.moving.theta, [])[1]

    def _free_starts(
        self, terms: Sequence[Term], theta: Array, values: Sequence[Mapping[str, float]]
    ) -> tuple[Array, dict[int, tuple[Array, Array, Array]]]:
        """Return a hypothesis' channels, and the free responses of the starts."""
        m2 = 2 * self.reduced_model.m
        middle = np.array([run.start for run in self.runs])
        starts = np.repeat(middle[None], m2 + 1, axis=0)
        for w, spread in enumerate(self.start_scale):
            starts[1:, w] += TRAJECTORY_FIT.probe * spread.T
        own = [{k: np.full(m2 + 1, v) for k, v in p.items()} for p in values]
        y = self.simulate(self.runs, terms, np.repeat(theta[None], m2 + 1, axis=0), own, starts)
        moved = np.clip(
            np.nan_to_num((y[:, 1:] - y[:, :1]) / TRAJECTORY_FIT.probe),
            -TRAJECTORY_INTEGRATION.far,
            TRAJECTORY_INTEGRATION.far,
        )
        out = {}
        for w, run in enumerate(self.runs):
            seen = moved[: len(run), :, w] * run.usable[:, None, :] / self.sigma[w]
            response = seen.transpose(0, 2, 1).reshape(-1, m2)
            out[w] = (response, ridge_inverse(response), np.ones(m2))
        return y[:, 0], out

    def descend(self, vector: ParameterVector, x: Array, iterations: int, tolerance: float = FIT.near_enough) -> Fit:
        """See `LeastSquares`; starts of whole runs move to the optimum first."""
        theta, offsets, _, values = vector.unpacked(x[None])
        own = [{k: float(v[0]) for k, v in p.items()} for p in values]
        self.move_starts(vector.terms, theta[0], own, offsets[0])
        return super().descend(vector, x, iterations, tolerance)

    def move_starts(
        self, terms: Sequence[Term], theta: Array, values: Sequence[Mapping[str, float]], offsets: Array
    ) -> Array:
        """Move the initial states of whole runs to a hypothesis' optimum.

        Windows are short enough for linear free responses.

        Parameters
        ----------
        terms : sequence of Term
            Effects.
        theta : (n_changes,) array
            Log factors.
        values : sequence of mapping
            Parameter values of every term.
        offsets : (n_channels,) array
            Sensor offsets.

        Returns
        -------
        (n, n_windows, p) array
            Channels at the optimum.
        """
        self.runs = [replace(run, start=start) for run, start in zip(self.runs, self.first_starts, strict=True)]
        y, self.free_starts = self._free_starts(terms, theta, values)
        for _ in range(TRAJECTORY_FIT.settlings if self.whole else 0):
            starts = []
            for w, run in enumerate(self.runs):
                missed = ((y[: len(run), w] + offsets - run.y) * run.usable / self.sigma[w]).ravel()
                move = self.free_starts[w][1] @ np.clip(missed, -TRAJECTORY_INTEGRATION.far, TRAJECTORY_INTEGRATION.far)
                starts.append(
                    run.start - self.start_scale[w] @ np.clip(move, -TRAJECTORY_FIT.most_move, TRAJECTORY_FIT.most_move)
                )
            self.runs = [replace(run, start=start) for run, start in zip(self.runs, starts, strict=True)]
            y, self.free_starts = self._free_starts(terms, theta, values)
        return y

    # ---- simulation -------------------------------------------------------------------------------------------------

    def simulate(
        self,
        runs: list[Signals],
        terms: Sequence[Term],
        theta: Array,
        values: Sequence[Mapping[str, Array]],
        starts: Array,
    ) -> Array:
        """See `LeastSquares`; `starts` are deviations from the motion."""
        assert len(runs) == len(self.parts)
        terms, values = self.problem.beside_known(terms, values, len(theta))
        with np.errstate(all="ignore"):  # a diverged trial keeps its large residual
            y = self._integrated(terms, theta, values, starts)
        return self._read(y, runs, terms, theta, values)

    def _integrated(
        self, terms: Sequence[Term], theta: Array, values: Sequence[Mapping[str, Array]], starts: Array
    ) -> Array:
        """Return channels (n, n_sets, n_windows, p) before sensor effects."""
        drive, forces, within = self._drive(terms, theta, values, len(theta))
        acting = [(term, own) for term, own in zip(terms, values, strict=True) if term.effect.kind == "port"]
        # a drive answers a step of its command, and a law the drive, within an interval
        steps, A, G = (TRAJECTORY.fine, self.fine_A, self.fine_G) if acting else (1, self.A, self.G)
        laws = [self._law(term, self._calibrated(term, own, theta)) for term, own in acting]
        laws.sort(key=lambda law: (not law.is_linear, law.is_last))
        drive = np.einsum("kwan,kswn->kswa", G, drive, optimize=True)
        defect = self.defect[:, None] - within if within.ndim else self.defect[:, None]
        seen = bool(np.any(self.D) or len(self.efforts))
        graphs = trace_laws(laws)
        if graphs is None:
            states = self._as_written(laws, A, drive, defect, starts, forces, steps, seen=seen)
        else:
            states = integrate_trajectory(laws, graphs, A, drive, defect, starts, forces if seen else forces[:0], steps)
        y = self.read[:, None] + np.einsum("kwpa,kswa->kswp", self.C, states, optimize=True)
        if seen:
            nv = self.reduced_model.m
            y += np.einsum("kwpn,kswn->kswp", self.D, forces[..., :nv], optimize=True)
            if len(self.efforts):
                y += self.moving.read_late(forces[..., nv:])
        return np.asarray(
            np.clip(
                np.nan_to_num(y, nan=TRAJECTORY_INTEGRATION.far),
                -TRAJECTORY_INTEGRATION.far,
                TRAJECTORY_INTEGRATION.far,
            )
        )

    def _as_written(
        self, laws: Sequence[Law], A: Array, drive: Array, defect: Array, starts: Array, forces: Array, steps: int,
        *, seen: bool,
    ) -> Array:  # fmt: skip
        """Integrate with laws without an expression graph."""
        x = starts.copy()
        states = np.zeros((self.length, *x.shape))
        for k in range(self.length):
            states[k] = x
            for j in range(steps):
                free = np.einsum("wab,swb->swa", A[k], x) + drive[k]
                for law in laws:
                    push = law.push(k, j, x, free)
                    if seen and j == 0:
                        forces[k] += push
                x = free
            x = x - defect[k]
            if k % TRAJECTORY_INTEGRATION.check_every == 0:
                x = np.clip(
                    np.nan_to_num(x, nan=TRAJECTORY_INTEGRATION.far),
                    -TRAJECTORY_INTEGRATION.far,
                    TRAJECTORY_INTEGRATION.far,
                )
        return states

    def _drive(
        self, terms: Sequence[Term], theta: Array, values: Sequence[Mapping[str, Array]], n_sets: int
    ) -> tuple[Array, Array, Array]:
        """Return forces on deviations, readings of forces, and motion within the intervals."""
        own = relative_changes(self.problem.parameters, theta - self.moving.theta)
        changes, drives = self._changes_beside(terms), self.moving.in_drive
        forces = np.einsum("kwni,si->kswn", changes, own, optimize=True)
        commanded, within = np.zeros(()), np.zeros(())
        for term, given in zip(terms, values, strict=True):
            if isinstance(term.effect, ActuatorEffect):
                for i in term.place.indices:
                    mean, moved = self._actuated(term.effect, i, given, n_sets)
                    commanded, within = commanded + mean, within if moved is None else within + moved
        forces = forces + commanded
        if not len(self.efforts):
            return forces, forces.copy(), within
        in_drive = np.einsum("kwni,si->kswn", changes[..., drives], own[:, drives], optimize=True) + commanded
        return forces, np.concatenate([forces, in_drive @ self.efforts.T], axis=-1), within

    def _calibrated(self, term: Term, own: Mapping[str, Array], theta: Array) -> Mapping[str, Array]:
        """Return a term's values with the law's own calibrated numbers."""
        return {**own, **servo_numbers(self.problem, term.effect, term.place, theta, self.moving.theta)}

    def _changes_beside(self, terms: Sequence[Term]) -> Array:
        """Return uncertain parameters' forces without the laws' own parts."""
        out = self.changes
        for term in terms:
            which = carried(self.problem, term.effect, term.place)
            if np.any(which):
                along = self.lines(term.place)[0][0]
                along = along / np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-300)
                out = out - np.einsum("kwn,kwm,kwmi->kwni", along, along, out, optimize=True) * which
        return out

    def _law(self, term: Term, own: Mapping[str, Array]) -> Law:
        rows, z, v, weight = self.lines(term.place)
        path = self._paths.get(term.place.name)
        if path is None:
            path = path_of(rows, z, v, self.defect, self.h, self.fine_G, weight, TRAJECTORY.fine, self.even)
            self._paths[term.place.name] = path
        command = None if term.place.coil is None else self._cut(self.moving.commands(term.place.coil))
        memory = self._remembered(term, own) if term.effect.is_force else None
        return Law(term, own, path, self.t, command, memory, self.efforts)

    def _remembered(self, term: Term, own: Mapping[str, Array]) -> Any:
        """Return a law's memory at every window's start."""
        effect, s = term.effect, self.moving
        assert isinstance(effect, PortEffect)
        p = {name: np.asarray(value)[:, None] for name, value in own.items()}
        memory = effect.memory((len(next(iter(own.values()))), len(self.parts)))
        longest = min(TRAJECTORY_FIT.preroll, max(part.first for part in self.parts))
        if memory is None or longest == 0:
            return memory
        lines, nv = s.lines_of(term.place), self.reduced_model.m
        z, v = np.zeros((longest, len(self.parts))), np.zeros((longest, len(self.parts)))
        h = np.full((longest, len(self.parts)), s.runs[0].h)
        for w, part in enumerate(self.parts):
            count = min(longest, part.first)
            if count:
                cut = slice(part.first - count, part.first)
                row, deviation = lines.rows[0][cut, part.run], s.smooth[cut, part.run]
                z[-count:, w] = lines.z[0][cut, part.run] + np.einsum("kn,kn->k", row, deviation[:, :nv])
                speed = s.systems[part.run].motion.v[cut] + deviation[:, nv:]
                v[-count:, w] = np.einsum("kn,kn->k", row, speed)
                h[-count:, w] = s.stack.h[cut, part.run]
        if effect.is_fast:
            return self._driven_memory(term, p, (z, v), longest)
        for k in range(longest):
            memory = effect.force(z[k][None], v[k][None], p, Step(h=h[k][None]), memory)[1]
        return memory

    def _driven_memory(self, term: Term, p: Values, motion: tuple[Array, Array], longest: int) -> Any:
        """Return a fast law's memory after a motion (longest, n_windows) under commands."""
        effect, s, (z, v) = term.effect, self.moving, motion
        assert isinstance(effect, PortEffect)
        command = np.zeros(z.shape)
        for w, part in enumerate(self.parts):
            count = min(longest, part.first)
            z[: longest - count, w], v[: longest - count, w] = z[-count, w] * (count > 0), v[-count, w] * (count > 0)
            if isinstance(effect, ServoEffect) and term.place.coil is not None:
                servo, whole = effect.servo, s.commands(term.place.coil)[:, part.run]
                command[:, w] = servo.rest + z[0, w] + servo.damping / servo.gain * v[0, w]  # no force before the run
                command[longest - count :, w] = whole[part.first - count : part.first]
        later = np.minimum(np.arange(1, longest + 1), longest - 1)
        z, v, a = 0.5 * (z + z[later]), 0.5 * (v + v[later]), (v[later] - v) / s.runs[0].h
        wide = np.zeros((len(next(iter(p.values()))), z.shape[1]))
        z, v, a, command = (x[:, None] + wide for x in (z, v, a, command))
        return fast_march(effect, z, v, a, p, s.runs[0].h, command)[1]

    def _actuated(
        self, effect: ActuatorEffect, index: int, given: Mapping[str, Array], n_sets: int
    ) -> tuple[Array, Array | None]:
        """Return an actuator effect's forces and motion within the intervals.

        The shapes are (n, n_sets, n_windows, nv) and (n, n_sets, n_windows, 2 nv).
        """
        moving, h = self.moving, self.moving.runs[0].h
        parts = moving.parts_of(index, effect)
        values = np.reshape([np.broadcast_to(v, n_sets) for v in given.values()], (len(given), n_sets))
        distinct, which = np.unique(values, axis=1, return_inverse=True)  # most sets of a Jacobian share them
        series = []
        for own in distinct.T:
            p = dict(zip(given, own.tolist(), strict=True))
            each = [
                changed_in_parts(partial(_changed, effect, p, h / parts, before), run.u[:, index], parts)
                for run in moving.runs
                for before in [float(run.command_before[index])]
            ]
            series.append(pad_and_stack([np.moveaxis(change, 0, 1) for change in each]))
        change = np.stack(series, axis=-1)  # (n, n_runs, parts, n_distinct)
        forces = moving.force_changes(index, [change[:, :, j] for j in range(parts)])
        mean, moved = over_intervals(moving.stack, *forces)
        mean = np.moveaxis(self._cut(mean), -1, 1)[:, which]
        return mean, None if moved is None else np.moveaxis(self._cut(moved), -1, 1)[:, which]

    def _sense(
        self,
        y: Array,
        effect: SensorEffect,
        index: int,
        gains: Array,
        given: Mapping[str, Array],
        runs: Sequence[Signals],
    ) -> None:
        """Apply a sensor effect with memory to a run's joined windows."""
        h = self.moving.runs[0].h
        for r, trajectory in enumerate(self.moving.moving.trajectories):
            mine = [(w, part) for w, part in enumerate(self.parts) if part.run == r]
            if not mine:
                continue
            first, end = min(p.first for _, p in mine), max(p.end for _, p in mine)
            t = trajectory.time[first:end]
            is_even = bool(np.ptp(np.diff(t)) < 1e-6 * h)
            for s in range(y.shape[1]):
                p = {k: float(v[s]) for k, v in given.items()}
                whole = self.read_of(r, index)[first:end].copy()
                for w, part in mine:
                    whole[part.first - first : part.end - first] = y[: part.end - part.first, s, w, index]
                changed = _sensed(effect, whole, p, h, t, is_even)
                for w, part in mine:
                    y[: part.end - part.first, s, w, index] = changed[part.first - first : part.end - first]

    def read_of(self, run: int, channel: int) -> Array:
        """Return a channel along a run's motion."""
        return self.moving.systems[run].read[:, channel]

    def lines(self, place: Place) -> tuple[Array, Array, Array, Array]:
        """Return a location's rows, coordinates, rates and gravity.

        Parameters
        ----------
        place : Place
            Location.

        Returns
        -------
        rows : (k, n, n_windows, nv) array
            Jacobian rows.
        z, v : (k, n, n_windows) array
            Coordinates and rates along the motion.
        weight : (k,) array
            Gravity along the coordinates [m/s^2].
        """
        if place.name not in self._lines:
            whole: Lines = self.moving.lines_of(place)
            rows = np.stack([self._cut(r) for r in whole.rows])
            z = np.stack([self._cut(r) for r in whole.z])
            self._lines[place.name] = (rows, z, np.einsum("lkwn,kwn->lkw", rows, self.v), whole.weight)
        return self._lines[place.name]


def _changed(effect: ActuatorEffect, p: Values, h: float, before: float, u: Array) -> Array:
    return np.asarray(effect.follow(u, p, h, before) - u)


def _sensed(effect: SensorEffect, x: Array, p: Values, h: float, t: Array, is_even: bool) -> Array:
    """Return an even or uneven record after a sensor effect."""
    grid = t if is_even else np.linspace(t[0], t[-1], len(t))
    step = h if is_even else float(grid[1] - grid[0])
    even = x if is_even else CubicSpline(t, x)(grid)
    pad = min(TRAJECTORY_FIT.pad, len(even) - 1)
    longer = np.concatenate([2 * even[0] - even[pad:0:-1], even])
    times = grid[0] + step * (np.arange(len(longer)) - pad)
    out = np.asarray(effect.sense(longer, p, step, times))[pad:]
    return out if is_even else x + np.interp(t, grid, out - even)
