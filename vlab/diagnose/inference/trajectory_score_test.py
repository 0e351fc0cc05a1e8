"""Score test on the linear time-varying system along the motion.

The method is that of `vlab.diagnose.inference.score_test` (Rao 1948).
"""

import copy
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar

import numpy as np

from vlab.diagnose.data.runs import Signals
from vlab.diagnose.inference.limited_amplitudes import at_found_amplitudes
from vlab.diagnose.inference.score_test import ScoreTest
from vlab.diagnose.inference.screening_cache import ScreeningCache
from vlab.diagnose.parameters.discrete import Discrete
from vlab.diagnose.parameters.locations import Place
from vlab.diagnose.parameters.mjcf import Uncertain
from vlab.diagnose.parameters.terms import Candidate, Term
from vlab.diagnose.predictors.error_growth import parts_within_growth
from vlab.diagnose.predictors.held_commands import changed_in_parts, over_intervals, parts_of_interval
from vlab.diagnose.predictors.innovations import Cause, Group
from vlab.diagnose.predictors.inverse_dynamics import changed_models, forces_of_change, middle_of_steps
from vlab.diagnose.predictors.kalman import FilterGains as SteadyGains
from vlab.diagnose.predictors.kalman import Smoothed, stack_runs
from vlab.diagnose.predictors.limited_actuator import LimitedActuator, limited_actuator
from vlab.diagnose.predictors.servo_numbers import servo_numbers
from vlab.diagnose.predictors.step_jacobian import Stepper
from vlab.diagnose.predictors.trajectory import (
    FilterGains,
    SystemBatch,
    TimeVaryingSystem,
    filtered,
    gains_of,
    innovations,
    pad_and_stack,
    smoothed,
    smoothed_motions,
)
from vlab.diagnose.predictors.trajectory_data import without_sensor_effects
from vlab.diagnose.predictors.trajectory_lines import Lines, lines_along
from vlab.diagnose.predictors.trajectory_problem import Trajectories
from vlab.diagnose.predictors.unit_causes import Shape
from vlab.diagnose.predictors.unit_effects import commands_changed, fast_series, forces_on_trajectory, unit_amplitudes
from vlab.diagnose.problem import Problem
from vlab.diagnose.settings import KERNELS, TRAJECTORY_SCORE_TEST
from vlab.parallel import side_by_side
from vlab.physics.attach import port_at
from vlab.physics.effect import ActuatorEffect, Effect, LinearPortEffect, PortEffect, SensorEffect
from vlab.plants.base import Plant
from vlab.signals import Array


class TrajectoryScoreTest(ScoreTest):
    """Screening of a problem's fit runs along their motion.

    Parameters
    ----------
    problem : Problem
        Problem.
    moving : Trajectories
        Runs at their own sample times.

    Notes
    -----
    Uncertain parameters enter linearly, about their nominal values. A refit to recordings with missing physics would reach
    their bounds and hide that physics. `at` linearises elsewhere: for a hypothesis, and for a plausible calibration.
    """

    keeps_plans: ClassVar[bool] = True
    plant: Plant
    stepper: Stepper
    systems: list[TimeVaryingSystem]
    stack: SystemBatch
    gains: FilterGains
    near: float | None
    part_counts: list[int]
    """Parts of every run within which small errors grow little."""
    changes: Array
    """Generalised forces (n, n_runs, nv, n_changes) per unit uncertain log factor."""
    efforts: Array
    """Readings (p, nv) per generalised force of the actuators."""
    now_known: Array
    """Deviations (n, n_runs, 2 nv) given the samples up to their own."""
    next_known: Array
    """Deviations (n, n_runs, 2 nv) at the next sample, predicted from `now_known`."""
    smooth: Array
    """Smoothed deviations (n, n_runs, 2 nv)."""
    L: Array
    B: Array
    _limits: dict[int, list[LimitedActuator]]

    def __init__(self, problem: Problem, moving: Trajectories) -> None:
        self.problem, self.reduced_model, self.trust, self.moving = problem, problem.reduced_model, 1.0, moving
        self.runs = list(problem.signals)
        self.motions, self.near = list(moving.motions), None
        self.lines: dict[str, Lines] = {}
        self._cache = ScreeningCache()
        self.theta = np.zeros(len(self.reduced_model.changes))
        self._along(1)
        self.part_counts = [parts_within_growth(system) for system in self.systems]
        horizons = [
            float(c.time[-1] - c.time[0]) / count
            for c, count in zip(moving.trajectories, self.part_counts, strict=True)
            if count > 1
        ]
        self.problem = replace(problem, horizon_s=min(horizons, default=np.inf))

    def trusting(self, trust: float) -> "TrajectoryScoreTest":
        """Return the screening with a slower observer.

        Parameters
        ----------
        trust : float
            Factor on the unknown-force intensity.

        Returns
        -------
        TrajectoryScoreTest
            Screening.
        """
        other = copy.copy(self)
        other.trust, other._cache = trust, ScreeningCache()
        other._linearise()
        return other

    def at(self, theta: Array) -> "TrajectoryScoreTest":
        """Return the screening linearised at other uncertain parameters.

        Parameters
        ----------
        theta : (n_changes,) array
            Log factors.

        Returns
        -------
        TrajectoryScoreTest
            Screening about the same motion.
        """
        other = copy.copy(self)
        other.theta, other.trust = np.array(theta, dtype=float), 1.0
        other.theta[[c.sensor is not None for c in self.reduced_model.changes]] = 0.0
        other._along(0)
        return other

    def _along(self, passes: int) -> None:
        """Linearise the plant along the smoothed motion, and regress the innovations."""
        self.plant = self.problem.adjusted(self.theta)
        self.stepper = self.moving.stepper(self.plant, self.problem.channels)
        self.systems, self.stack, _, self.near = smoothed_motions(
            self.moving.trajectories, self.motions, self.stepper, self.moving.driven, passes, self.near
        )
        self.motions = [system.motion for system in self.systems]
        self.lines, self._limits, self._cache = {}, {}, ScreeningCache()
        self.efforts = self.stepper.efforts
        self.changes = self._changes()
        self._linearise()

    def _group(self, runs: list[Signals]) -> Group:
        s = self.stack
        assert self.near is not None
        self.gains = gains_of(s, self.near * self.trust)
        left, predicted = innovations(s, self.gains)
        self.now_known = filtered(s, self.gains, left, predicted)
        self.smooth = smoothed(s, self.gains, left, predicted)
        self.L = s.A - self.gains.K @ s.C
        self.B = s.G - self.gains.K @ s.D
        self.next_known = np.einsum("krab,krb->kra", s.A, self.now_known) - s.defect
        u, lengths = stack_runs(runs, [run.u for run in runs])
        y, _ = stack_runs(runs, [run.y / self.sensor_gain for run in runs])
        states = Smoothed(e=left, x=self.smooth, filtered=self.now_known, predicted=y, lengths=lengths, loglik=0.0)
        steady = SteadyGains(K=self.gains.K[-1:, 0], S=self.gains.S[-1:, 0], P=self.gains.P[-1:, 0])
        last = Discrete(A=s.A[-1:, 0], B=s.G[-1:, 0], C=s.C[-1:, 0], D=s.D[-1:, 0])
        group = Group(
            runs, last, steady, states, u, np.zeros((*y.shape[:2], self.reduced_model.m)), y, lengths, s.usable, e=left
        )
        group.first = min(TRAJECTORY_SCORE_TEST.settled, int(lengths.min()) // 4)
        group.white = np.linalg.inv(np.linalg.cholesky(self.gains.S))
        return group

    def through(self, group: Group, modal: Array | None, reading: Array | None, moved: Array | None = None) -> Array:
        """See `ScoreTest`; forces are generalised, and `moved` adds to the states."""
        s, K = self.stack, self.gains.K
        assert modal is not None or reading is not None
        drive = self.B @ modal if modal is not None else -(K @ reading)
        if modal is not None and reading is not None:
            drive -= K @ reading
        if moved is not None:
            drive += moved
        states = drive  # overwritten: a state takes the place of the drive that leads to the next one
        state = np.zeros(states.shape[1:])
        for i in range(len(states)):
            state, states[i] = self.L[i] @ state + drive[i], state
        out = s.C @ states
        if modal is not None and np.any(s.D):
            out += s.D @ modal
        if reading is not None:
            out += reading
        return np.asarray(out)

    def force_response(self, group: Group, place: Place, frequency: Array) -> Array:
        """See `ScoreTest`; a time-varying system weights all frequencies equally."""
        return np.ones((len(frequency), self.stack.e.shape[2]))

    # ---- uncertain parameters ---------------------------------------------------------------------------------------

    def _changes(self) -> Array:
        """Return the generalised forces of uncertain parameters along the motion."""
        plant = self.plant
        middles = [
            (
                *middle_of_steps(self.stepper, a, c.h),
                c.u @ plant.control_matrix.T,
                np.zeros((len(c), 0)) if c.act is None else c.act,
            )
            for a, c in zip(self.systems, self.moving.trajectories, strict=True)
        ]

        def column(parameter: Uncertain) -> Array:
            if not (parameter.fields or parameter.shifted):
                return np.zeros((*self.stack.e.shape[:2], self.reduced_model.m))
            pair = changed_models(plant.model, parameter)
            return pad_and_stack([forces_of_change(pair, m, self._stride()) for m in middles])

        out = np.stack(side_by_side(column, self.problem.parameters), axis=-1)
        for i, change in enumerate(self.reduced_model.changes):
            if change.actuator is not None:
                out[..., i] += self.driven_force(change.actuator) * self.commands(change.actuator)[..., None]
        return out

    def _stride(self) -> int:
        """Return the sample stride for smooth forces, which splines interpolate."""
        h = float(np.median(self.stack.h[self.stack.h > 0]))
        return int(np.clip(1.0 / (TRAJECTORY_SCORE_TEST.often * self.problem.highest_hz * h), 1, 4))

    def commands(self, actuator: int) -> Array:
        """Return the input of an actuator's gain along the runs.

        The input is the command, or the actuator state where there is one.

        Parameters
        ----------
        actuator : int
            Index of the actuator.

        Returns
        -------
        (n, n_runs) array
            Input.
        """
        lag, trajectories = self.stepper.lags.get(actuator), self.moving.trajectories
        if lag is None:
            return pad_and_stack([c.u[:, actuator] for c in trajectories])
        unit = self.plant.control_matrix[lag.control, actuator]
        return pad_and_stack([c.act[:, lag.address] / unit for c in trajectories if c.act is not None])

    def acted(self, actuator: int, change: Array) -> Array:
        """Return a command change (n, n_runs, k) behind the actuator's dynamics."""
        lag = self.stepper.lags.get(actuator)
        return change if lag is None else lag.of_change(change, self.stack.h[: len(change), :, None])

    def force_changes(self, actuator: int, changes: Sequence[Array], sizes: Any = 1.0) -> tuple[Array, list[Array]]:
        """Return the forces of command changes, between the actuator's limits.

        Parameters
        ----------
        actuator : int
            Index of the actuator.
        changes : sequence of (n, n_runs, k) array
            Changes of the command in the parts of every interval.
        sizes : float or (k,) array
            Multiples of the changes whose forces, over the multiple, count.

        Returns
        -------
        unit : (n, n_runs, nv) array
            Generalised force of a unit force.
        forces : list of (n, n_runs, k) array
            Changes of the force.
        """
        limited = self._limited_along(actuator)
        if not limited:
            return self.driven_force(actuator), [self.acted(actuator, change) for change in changes]
        runs = [(own, i, run.u[:, actuator]) for i, (own, run) in enumerate(zip(limited, self.runs, strict=True))]
        parts = [[own.change(u, c[: len(u), i] * sizes) / sizes for own, i, u in runs] for c in changes]
        return pad_and_stack([own.moment for own in limited]), [pad_and_stack(part) for part in parts]

    def _limited_along(self, actuator: int) -> list[LimitedActuator]:
        """Return an actuator with limits along the runs, or nothing."""
        if actuator not in self._limits:
            found = []
            for system, trajectory in zip(self.systems, self.moving.trajectories, strict=True):
                q, v, _ = middle_of_steps(self.stepper, system, trajectory.h)
                found.append(limited_actuator(self.plant, actuator, q, v))
                if found[-1] is None:
                    break
            self._limits[actuator] = [one for one in found if one is not None]
        return self._limits[actuator]

    def driven_force(self, actuator: int) -> Array:
        """Return the generalised force (n, n_runs, nv) of a unit command."""
        column = list(self.moving.driven).index(actuator)
        return pad_and_stack([a.drives[:, :, column] for a in self.systems])

    def input_difference(self, group: Group, runs: Sequence[Signals]) -> Array:
        """See `ScoreTest`."""
        u, _ = stack_runs(runs, [run.u for run in runs])
        load, _ = stack_runs(runs, [run.load for run in runs])
        given, _ = stack_runs(runs, [trajectory.load for trajectory in self.moving.trajectories])
        out = np.zeros((*u.shape[:2], self.reduced_model.m))
        for i in self.moving.driven:
            out += self.driven_force(i) * self.acted(i, (u - group.u)[..., i, None])
        for j, name in enumerate(self.moving.load_ports):
            rows = lines_along(self.plant, self.systems, self.plant.port(name), is_body=False).rows
            out += rows.sum(axis=0) * (load - given)[..., j, None]
        return out

    def changed_forces(self, group: Group) -> Array:
        """See `ScoreTest`; the forces follow from inverse dynamics."""
        return self.changes

    def changed_readings(self, group: Group) -> Array:
        """See `ScoreTest`; effort sensors read the actuators' forces."""
        return self.read_late(self.efforts @ (self.changes * self.in_drive))

    @property
    def in_drive(self) -> Array:
        """Mask (n_changes,) of the parameters that change the forces of actuators alone."""
        return np.array([p.is_of_actuator for p in self.problem.parameters], dtype=bool)

    def read_late(self, readings: Array) -> Array:
        """Return direct readings (n, ...) at the samples, behind held commands."""
        is_behind = all(trajectory.is_behind for trajectory in self.moving.trajectories)
        return np.concatenate([readings[:1], readings[:-1]]) if is_behind else readings

    # ---- places along the motion ------------------------------------------------------------------------------------

    def lines_of(self, place: Place) -> Lines:
        """Return the rows and coordinates of a location along the motion."""
        if place.name not in self.lines:
            port = port_at(self.plant, place.name)
            self.lines[place.name] = lines_along(self.plant, self.systems, port, is_body=place.kind == "body")
        return self.lines[place.name]

    def known_motion(self, place: Place) -> tuple[Array, Array, Array, Array]:
        """Return a location's motion over every interval, from earlier samples.

        Parameters
        ----------
        place : Place
            Location.

        Returns
        -------
        rows : (k, n, n_runs, nv) array
            Rows at mid-interval.
        z, v, a : (k, n, n_runs) array
            Displacement, velocity and acceleration.
        """
        lines, nv = self.lines_of(place), self.reduced_model.m
        later = np.minimum(np.arange(1, len(self.stack.e) + 1), len(self.stack.e) - 1)
        after = lines.rows[:, later]
        v_now, v_next = self._velocities()
        z0 = lines.z + np.einsum("lkrn,krn->lkr", lines.rows, self.now_known[..., :nv])
        z1 = lines.z[:, later] + np.einsum("lkrn,krn->lkr", after, self.next_known[..., :nv])
        v0 = np.einsum("lkrn,krn->lkr", lines.rows, v_now)
        v1 = np.einsum("lkrn,krn->lkr", after, v_next)
        h = np.where(self.stack.h > 0, self.stack.h, 1.0)
        return 0.5 * (lines.rows + after), 0.5 * (z0 + z1), 0.5 * (v0 + v1), (v1 - v0) / h

    def _velocities(self) -> tuple[Array, Array]:
        nv = self.reduced_model.m
        v = pad_and_stack([a.motion.v for a in self.systems])
        return v + self.now_known[..., nv:], np.concatenate([v[1:], v[-1:]]) + self.next_known[..., nv:]

    def motion(self, group: Group, place: Place) -> tuple[Array, Array]:
        """See `ScoreTest`."""
        _, z, v, _ = self.known_motion(place)
        return z[0], v[0]

    # ---- the candidates ---------------------------------------------------------------------------------------------

    def effect_responses(
        self, group: Group, place: Place, plans: Sequence[tuple[Effect, dict[str, float]]]
    ) -> tuple[Array, list[int]]:
        """See `ScoreTest`; forces act along directions that turn with the motion."""
        if place.kind in ("sensor", "pick-up"):
            return super().effect_responses(group, place, plans)
        both = [self._forces(group, place, effect, shape) for effect, shape in plans]
        modal, widths = np.concatenate([force for force, _ in both], axis=-1), [force.shape[-1] for force, _ in both]
        reading = moved = None
        if np.any(self.efforts):
            in_drive = np.repeat([float(effect.acts_in_drive) for effect, _ in plans], widths)
            reading = self.read_late(self.efforts @ modal * in_drive)
        if any(motion is not None for _, motion in both):
            moved = np.zeros((*modal.shape[:2], self.stack.A.shape[2], modal.shape[3]))
            for start, (_, motion) in zip(np.cumsum([0, *widths]), both, strict=False):
                if motion is not None:
                    moved[..., start : start + motion.shape[-1]] = motion
        return self.through(group, modal, reading, moved), widths

    def cause_responses(self, group: Group, causes: Sequence[Sequence[Cause]]) -> tuple[Array, list[int]]:
        """See `ScoreTest`; a time-varying system has no impulse response."""
        widths = [own[0].series.shape[-1] for own in causes]
        reading = np.zeros((*group.y.shape, sum(widths)))
        for start, (cause,) in zip(np.cumsum([0, *widths]), causes, strict=False):
            reading[..., cause.channel, start : start + cause.series.shape[-1]] = cause.series
        return self.through(group, None, reading), widths

    def _at(self, place: Place, effects: Sequence[Effect]) -> list[Candidate]:
        """See `ScoreTest`; behind the limits of an actuator, the columns are those of the found amplitude."""
        found = super()._at(place, effects)
        limited, others = ([c for c in found if self._depends_on_size(c) == own] for own in (True, False))
        return others + at_found_amplitudes(limited, lambda plans: self._regressed(place, self._columns(place, plans)))

    def _plan_of(self, term: Term) -> Shape:
        """See `ScoreTest`; the columns of a limited actuator depend on the amplitude, too."""
        return dict(term.values) if self._depends_on_size(term) else super()._plan_of(term)

    def _depends_on_size(self, term: Term) -> bool:
        is_amplitude = isinstance(term.effect, ActuatorEffect) and bool(term.effect.amplitudes)
        return is_amplitude and any(self._limited_along(i) for i in term.place.indices)

    def parts_of(self, actuator: int, effect: ActuatorEffect) -> int:
        """Return the parts of an interval, each with a command, by `parts_of_interval`."""
        return parts_of_interval(self.moving.trajectories, self.stepper, actuator, effect)

    def _actuated(
        self, group: Group, place: Place, effect: ActuatorEffect, shape: dict[str, float]
    ) -> tuple[Array, Array | None]:
        """Return an actuator effect's forces and motion within the intervals."""
        total: Any = 0.0
        moves: Any = None
        sizes = np.array([shape.get(p.name, 1.0) for p in effect.amplitudes] or [1.0])
        sizes[sizes == 0.0] = np.sqrt(np.finfo(float).eps)  # the derivative
        for i in place.indices:
            parts, before = self.parts_of(i, effect), group.commands_before[:, i]
            follow = partial(commands_changed, effect, shape=shape, h=group.h / parts, before=before)
            each = changed_in_parts(follow, group.u[..., i], parts)
            mean, moved = over_intervals(self.stack, *self.force_changes(i, list(each), sizes))
            total, moves = total + mean, moved if moves is None else moves + moved
        return total, moves

    def _forces(
        self, group: Group, place: Place, effect: Effect, shape: dict[str, float]
    ) -> tuple[Array, Array | None]:
        """Return the forces of unit amplitudes, and the motion within the intervals.

        The shapes are (n, n_runs, nv, k) and (n, n_runs, 2 nv, k). Forces that are constant over the intervals move nothing.
        """
        if isinstance(effect, ActuatorEffect):
            return self._actuated(group, place, effect, shape)
        return self._at_port(group, place, effect, shape), None

    def _at_port(self, group: Group, place: Place, effect: Effect, shape: dict[str, float]) -> Array:
        """Return generalised forces (n, n_runs, nv, k) of unit amplitudes."""
        rows, z, v, a = self.known_motion(place)
        if isinstance(effect, LinearPortEffect):
            (values,) = unit_amplitudes(effect, {})
            mass, damping, stiffness = effect.impedance(values, place.stiffness)
            force = -mass * (a - self.lines_of(place).weight[:, None, None]) - damping * v - stiffness * z
            return np.einsum("lkrn,lkr->krn", rows, force)[..., None]
        assert isinstance(effect, PortEffect)
        own: Any = 0.0
        if place.coil is not None:
            own = self.commands(place.coil) if place.coil in self.stepper.lags else group.u[..., place.coil]
        with np.errstate(all="ignore"):  # a law too stiff for the samples diverges and is no candidate
            if effect.is_fast:
                h = float(np.median(self.stack.h[self.stack.h > 0]))
                numbers = servo_numbers(self.problem, effect, place, self.theta, self.theta)
                each = ({**u, **numbers} for u in unit_amplitudes(effect, shape))
                laws = [fast_series(effect, z[0], v[0], a[0], u, h, own) for u in each]
            else:
                laws = [self._series(effect, u, z[0], v[0], own) for u in unit_amplitudes(effect, shape)]
        series = [x / effect.probe if np.all(np.abs(x) < KERNELS.runaway) else 0.0 * z[0] for x in laws]
        return np.asarray(rows[0][..., None] * np.stack(series, axis=-1)[..., None, :])

    def _series(self, effect: PortEffect, values: dict[str, float], z: Array, v: Array, command: Any) -> Array:
        t = pad_and_stack([c.time for c in self.moving.trajectories]) + 0.5 * self.stack.h
        return forces_on_trajectory(effect, z, v, values, self.stack.h, t, command)

    def states_without(self, effects: Sequence[tuple[SensorEffect, Place, dict[str, float]]]) -> Array:
        """Return smoothed deviations from recordings without sensor effects.

        Parameters
        ----------
        effects : sequence of (SensorEffect, Place, dict)
            Sensor effects to remove.

        Returns
        -------
        (n, n_runs, 2 nv) array
            Deviations.
        """
        readings = [without_sensor_effects(trajectory, effects) for trajectory in self.moving.trajectories]
        e = pad_and_stack([y - a.read for y, a in zip(readings, self.systems, strict=True)])
        left, predicted = innovations(self.stack, self.gains, e)
        return smoothed(self.stack, self.gains, left, predicted)
