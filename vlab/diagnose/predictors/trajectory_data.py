"""Trajectory data of one run, and its first motion."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_smoothing_spline

from vlab.cases.channel_map import Run
from vlab.cases.initial_state import begins_at_rest, joint_of
from vlab.cases.linear_start import exponentials
from vlab.cases.replay_inputs import at_samples
from vlab.diagnose.data.noise import is_motion, known_noise, noise_level, uneven_noise
from vlab.diagnose.data.quality import is_informative, on_clock
from vlab.diagnose.data.recorded_inputs import recorded_inputs
from vlab.diagnose.data.runs import liveliest, on_grid
from vlab.diagnose.parameters.locations import Place
from vlab.diagnose.predictors.actuator_states import actuator_states
from vlab.diagnose.predictors.step_jacobian import Stepper
from vlab.diagnose.settings import TRAJECTORY_DATA
from vlab.errors import Diverged
from vlab.physics.effect import SensorEffect
from vlab.signals import Array, sample_period


@dataclass(frozen=True, kw_only=True, eq=False)
class TrajectoryData:
    """One run at its own sample times.

    Parameters
    ----------
    name, role : str
        Name and role of the run.
    time : (n,) array
        Times in the recording [s], possibly uneven.
    h : (n,) array
        Intervals to the next sample [s], the last one repeated.
    u, load : (n, n_actuators), (n, n_ports) array
        Means of the inputs over the intervals.
    now_u, now_load : (n, n_actuators), (n, n_ports) array
        Inputs at the samples, as sensors of forces and accelerations see them. A sensor is read before a held command changes.
    is_behind : bool
        Whether all commands are held, so that readings of their forces are one sample behind them.
    is_stepped : bool
        Whether all commands are constant over the intervals.
    act : (n, na) array or None
        Actuator states.
    y : (n, p) array
        Channels [SI], relative to the model's zero.
    noise, scale : (p,) array
        Standard deviation of the noise, and rms about the mean.
    at_rest : bool
        Whether the run starts at rest.
    valid : (n, p) array of bool or None
        Mask of informative samples; all by default.
    """

    name: str
    role: str
    time: Array
    h: Array
    u: Array
    load: Array
    now_u: Array
    now_load: Array
    is_behind: bool
    is_stepped: bool
    act: Array | None
    y: Array
    noise: Array
    scale: Array
    at_rest: bool
    valid: Array | None = None

    def __len__(self) -> int:
        return len(self.time)

    def present(self, k: int) -> tuple[Array, Array]:
        """Return commands and direct forces at a sample."""
        return self.now_u[k], self.now_load[k]

    def inputs(self, k: int) -> tuple[Array, Array]:
        """Return commands and direct forces of an interval."""
        return self.u[k], self.load[k]


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """Configurations (n, nq) and velocities (n, nv) at a run's samples."""

    q: Array
    v: Array


def read_trajectory_data(
    run: Run, stepper: Stepper, rest: Array, n_actuators: int, load_ports: Sequence[str], thin: int,
    commands: Array | None = None,
) -> TrajectoryData:  # fmt: skip
    """Return one run at its own sample times.

    Parameters
    ----------
    run : Run
        Recording.
    stepper : Stepper
        Stepped plant with its channels.
    rest : (p,) array
        Channel values at rest, for channels that count from rest.
    n_actuators : int
        Number of actuators.
    load_ports : sequence of str
        Directly driven ports.
    thin : int
        Decimation factor of an even record.
    commands : (n_samples, n_actuators) array or None
        Commands of a control law, added to the inputs.

    Returns
    -------
    TrajectoryData
        Run.
    """
    time = run.measured.time - run.measured.time[0]
    is_even = bool(np.ptp(np.diff(time)) < 1e-3 * sample_period(time))
    grid, y = _on_sample_times(run, stepper, rest, time, thin if is_even else 1)
    most = TRAJECTORY_DATA.most_samples
    part = slice(0, most) if stepper.model.na else liveliest(y, most)  # actuator states start at zero
    grid, y = grid[part], y[part]
    edges = np.append(grid, grid[-1] + (grid[-1] - grid[-2]))
    slow = np.array([_order(stepper, i, run) < 2 for i in range(y.shape[1])])
    is_driven = bool(run.drives) or commands is not None
    starts = is_driven and begins_at_rest(y - rest, slow, stepper.plant)
    stood = run.initial != "rest" and not starts
    inputs, now = np.zeros((2, len(grid), n_actuators + len(load_ports)))
    for i in recorded_inputs(run, n_actuators, load_ports, commands, through_hardware=False):
        inputs[:, i.column] += _means(time, i.values, i.is_held, edges)
        present = at_samples(i.values, is_held=i.is_held, is_first=i.is_first, stood=stood)
        now[:, i.column] += np.interp(grid, time, present)
    u = inputs[:, :n_actuators]
    valid = is_informative(run, stepper.channels)
    usable = on_clock(run, valid, grid) if is_even else valid[part]
    scale = np.std(y, axis=0)
    return TrajectoryData(
        name=run.name,
        role=run.role,
        time=grid,
        h=np.diff(edges),
        u=u,
        load=inputs[:, n_actuators:],
        now_u=now[:, :n_actuators],
        now_load=now[:, n_actuators:],
        is_behind=all(drive.is_held and not drive.is_first for drive in run.drives),
        is_stepped=all(drive.is_held for drive in run.drives),
        act=actuator_states(stepper.plant, u, np.diff(edges)) if stepper.model.na else None,
        y=y,
        noise=np.array(
            [
                known.sigma
                if (known := known_noise(run, c.channel, column, thin if is_even else 1))
                else _noise(grid, column, inputs if is_even else None, is_motion(run, c.channel))
                for c, column in zip(stepper.channels, y.T, strict=True)
            ]
        ),
        scale=np.where(scale > 0, scale, np.abs(y).max(axis=0, initial=0.0) + 1e-12),
        at_rest=part.start == 0 and (run.initial == "rest" or (run.initial == "auto" and starts)),
        valid=None if usable.all() else usable,
    )


def _on_sample_times(run: Run, stepper: Stepper, rest: Array, time: Array, thin: int) -> tuple[Array, Array]:
    """Return sample times (n,), and channels (n, p) from the model's zero."""
    columns = [
        run.measured[c.channel] + (r if c.from_rest else 0.0) for c, r in zip(stepper.channels, rest, strict=True)
    ]
    if thin == 1:
        return time, np.column_stack(columns)
    h = sample_period(time)
    grid = h * thin * np.arange(round(time[-1] / h) // thin + 1)
    columns = [on_grid(time, column, grid, thin) for column in columns]
    return grid, np.column_stack([column[: len(grid)] for column in columns])


def _noise(time: Array, column: Array, inputs: Array | None, is_motion: bool) -> float:
    """Return the standard deviation of a channel's noise.

    The median spectrum of few segments is low by up to a fifth. The residual of neighbouring samples corrects the
    estimate within that range.
    """
    local = uneven_noise(time, column)
    if inputs is None:  # uneven times
        return local
    floor = noise_level(column, inputs, is_motion=is_motion)
    return float(np.clip(local, floor, TRAJECTORY_DATA.most_noise * floor))


def _order(stepper: Stepper, i: int, run: Run) -> int:
    kind = run.measured.channels[run.measured.index(stepper.channels[i].channel)].kind
    return 2 if kind in ("acceleration", "angular-acceleration", "force", "moment") else 0


def _means(time: Array, values: Array, is_held: bool, edges: Array) -> Array:
    """Return the means of an input between edges, from its integral."""
    stamps = np.append(time, max(edges[-1], time[-1]) + 1.0)
    if is_held:
        integral = np.concatenate([[0.0], np.cumsum(values * np.diff(stamps))])
        return np.asarray(np.diff(np.interp(edges, stamps, integral)) / np.diff(edges))
    fine = np.unique(np.concatenate([time, edges]))
    at = np.interp(fine, time, values)
    integral = np.concatenate([[0.0], np.cumsum(0.5 * (at[1:] + at[:-1]) * np.diff(fine))])
    return np.asarray(np.diff(np.interp(edges, fine, integral)) / np.diff(edges))


# ---- the first motion ------------------------------------------------------------------------------------------------


def first_motion(trajectory: TrajectoryData, stepper: Stepper, rest: Array) -> Motion:
    """Return a first motion for linearisation.

    Smoothing splines give measured joints, an extended Kalman filter the others.

    Parameters
    ----------
    trajectory : TrajectoryData
        Run.
    stepper : Stepper
        Stepped plant.
    rest : (nq,) array
        Configuration at rest.

    Returns
    -------
    Motion
        Motion at the run's samples.
    """
    joints = [joint_of(stepper.plant, c) for c in stepper.channels]
    positions = {j[0]: i for i, j in enumerate(joints) if j is not None and j[1] == 0}
    splines = {}
    for dof, i in positions.items():
        splines[dof] = _spline(trajectory, i)
    q, v = np.repeat(rest[None], len(trajectory), axis=0), np.zeros((len(trajectory), stepper.nv))
    for dof, (position, rate) in splines.items():
        q[:, _address(stepper, dof)], v[:, dof] = position, rate
    if len(splines) == stepper.nv:
        return Motion(q=q, v=v)
    return _filtered(trajectory, stepper, q[0], v[0], list(splines))


def _address(stepper: Stepper, dof: int) -> int:
    return int(stepper.model.jnt_qposadr[stepper.model.dof_jntid[dof]])


def _spline(trajectory: TrajectoryData, i: int) -> tuple[Array, Array]:
    """Return a smoothed position and its rate."""
    y, t = trajectory.y[:, i], trajectory.time
    noise = float(trajectory.noise[i])
    low, high = TRAJECTORY_DATA.smoothing
    size = float(np.mean(np.diff(t))) ** 3
    best = make_smoothing_spline(t, y, lam=size * 10.0**low)
    for _ in range(TRAJECTORY_DATA.halvings):
        middle = 0.5 * (low + high)
        tried = make_smoothing_spline(t, y, lam=size * 10.0**middle)
        if float(np.std(tried(t) - y)) < noise:
            low, best = middle, tried
        else:
            high = middle
    return best(t), best.derivative()(t)


def _filtered(trajectory: TrajectoryData, stepper: Stepper, q: Array, v: Array, known: Sequence[int]) -> Motion:
    """Filter a run forwards on MuJoCo's steps."""
    nv = stepper.nv
    spread = np.concatenate(
        [np.full(nv, TRAJECTORY_DATA.wide), np.full(nv, TRAJECTORY_DATA.rates * TRAJECTORY_DATA.wide)]
    )
    for dof in known:
        spread[dof] *= TRAJECTORY_DATA.measured
    P = np.diag(spread**2) if not trajectory.at_rest else TRAJECTORY_DATA.known_start * np.eye(2 * nv)
    R = np.diag((trajectory.noise + TRAJECTORY_DATA.floor * trajectory.scale) ** 2)
    out_q, out_v = np.zeros((len(trajectory), len(q))), np.zeros((len(trajectory), nv))
    for k in range(len(trajectory)):
        (u, load), h = trajectory.inputs(k), float(trajectory.h[k])
        act = None if trajectory.act is None else trajectory.act[k]
        for _ in range(3 if k == 0 else 1):  # iterate the first update, since the prior may be far off
            L, M, _, sensors = stepper.slopes(q, v, u, load, act)
            here, C, _ = stepper.reading(q, v, *trajectory.present(k), act, M, sensors)
            gain = np.linalg.solve(C @ P @ C.T + R, C @ P).T
            change = gain @ (trajectory.y[k] - here)
            q, v = stepper.moved(q, change[:nv]), v + change[nv:]
        P = P - gain @ C @ P
        out_q[k], out_v[k] = q, v
        A, G = sampled(L, M, h)
        q, v = stepper.advance(q, v, u, load, h, act)
        rate = np.sqrt(np.mean(out_v[: k + 1] ** 2)) + TRAJECTORY_DATA.still
        intensity = (TRAJECTORY_DATA.accelerations * rate) ** 2  # unknown accelerations of some velocities per second
        P = A @ P @ A.T + intensity * G @ M @ G.T
        P = 0.5 * (P + P.T)
    return Motion(q=out_q, v=out_v)


def sampled(L: Array, M: Array, h: Array | float) -> tuple[Array, Array]:
    """Discretise x' = L x + [0, M^-1] f over intervals.

    Parameters
    ----------
    L : (..., 2 nv, 2 nv) array
        Derivative of the rate by the state.
    M : (..., nv, nv) array
        Mass matrices.
    h : array or float
        Intervals [s].

    Returns
    -------
    A : (..., 2 nv, 2 nv) array
        State matrices.
    G : (..., 2 nv, nv) array
        Effect of held forces.

    Raises
    ------
    Diverged
        The rates are not finite.
    """
    if not np.all(np.isfinite(L)):
        raise Diverged(
            "the model runs away where its steps follow the recorded motion: it is too stiff for its integration step; "
            "shorten <option timestep> or lower what holds its joints (the gains of servos, stiffness, damping)"
        )
    n, s = L.shape[:-2], L.shape[-1]
    nv = s // 2
    block = np.zeros((*n, s + nv, s + nv))
    block[..., :s, :s] = L
    block[..., nv:s, s:] = np.linalg.inv(M)
    whole = exponentials(block * np.asarray(h)[..., None, None])
    return whole[..., :s, :s], whole[..., :s, s:]


def without_sensor_effects(
    trajectory: TrajectoryData, effects: Sequence[tuple[SensorEffect, Place, dict[str, float]]]
) -> Array:
    """Return the channels of a run without sensor effects.

    Parameters
    ----------
    trajectory : TrajectoryData
        Run.
    effects : sequence of (SensorEffect, Place, dict)
        Sensor effects with their places and values.

    Returns
    -------
    (n, p) array
        Channels [SI].
    """
    y, h = trajectory.y.copy(), float(np.median(trajectory.h))
    for effect, place, values in effects:
        y[:, place.index] = effect.correct(y[:, place.index], values, h, trajectory.time)
    return y
