"""Initial state of a recording: rest, or an early estimate.

The linearised model gives the response of the compared channels to every mode's initial displacement and velocity.
Linear least squares over the first two periods of the slowest mode gives both; of a growing mode, over two
e-foldings. The Bayesian information criterion [1]_
chooses the number of modes. Gauss-Newton iterations on the model itself then account for large motion. The window is
short, so a frequency error changes the phase little.

For large motion the linearised model fails and a local start replaces the estimate. Measured joints start from a
polynomial through their first samples, and servo-driven joints from their commands. All remaining joints keep the
linear estimate. Refinement then uses a window that grows from a few samples.

References
----------
.. [1] G. Schwarz, Estimating the dimension of a model, Annals of Statistics 6 (1978) 461-464.
"""

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import mujoco
import numpy as np

from vlab.cases.channel_map import Compared, Drive, Law, Run, compared_with_sensors
from vlab.cases.clock import plan_clock
from vlab.cases.held_rest import friction_of_joints, held_rest
from vlab.cases.linear_start import StartProblem, estimate_linear_start
from vlab.cases.refined_start import refine, window_residual
from vlab.cases.replay_bench import Bench, State, at_timestep, bench_for
from vlab.errors import BadCase, BadStructure, Diverged
from vlab.fe.second_order import SecondOrderModel
from vlab.plants.base import ONE_WAY, Plant
from vlab.signals import Array, Channel, Recording

PERIODS = 2.0
"""PERIODS [1]: periods of the slowest oscillation in the estimate's window, or e-foldings of the slowest growth."""
LEAST_SAMPLES, MOST_SAMPLES = 20, 2000
"""LEAST_SAMPLES [samples]: shortest window of the estimate.
MOST_SAMPLES [samples]: longest window."""
AT_REST, STILL = 0.02, 5
"""AT_REST [1]: largest first deflection, as a share of the largest, at which a driven recording starts at rest.
STILL [samples]: number of such samples required of accelerations alone."""
AT_UNSTABLE_REST = 1e-3
"""AT_UNSTABLE_REST [1]: `AT_REST` for an unstable equilibrium, from which small initial errors grow."""
WORTH, ENOUGH = 1.1, 0.02
"""WORTH [1]: ratio of the rms residual on the model to that on the linearisation above which the estimate is refined; a
larger ratio means large motion.
ENOUGH [1]: rms residual, relative to the recording's deviation from rest, above which the estimate is refined."""
STAGES = (0.06, 0.25, 1.0)
"""STAGES [1]: successive window lengths of a local start, as shares of the window."""
LOCAL, HOPELESS = 0.002, 0.2
"""LOCAL [1]: rms residual, relative to the recording's deviation from rest, above which a local start is tried if all
joints are measured.
HOPELESS [1]: same if joints are unmeasured; a linear estimate above the limit is not refined."""
LEAST_STAGE = 8
"""LEAST_STAGE [samples]: shortest window of a local start."""
MOST_LOCAL, PER_CHANNEL = 12, 3
"""MOST_LOCAL [1]: largest number of degrees of freedom of a local start.
PER_CHANNEL [1]: largest number per channel. Few sensors identify few joints, and more freedom would absorb the
model's error."""
STIFF = 3e-3
"""STIFF [1]: weight that ties a local start to the preceding stage, relative to samples of the largest deflection. The
speed of a joint on a stiff servo decays before the first sample and would fit noise."""
_ACCELERATIONS = ("acceleration", "angular-acceleration", "force", "moment")
"""Kinds of channels that respond to acceleration."""
NO_MODES = np.zeros(0, dtype=int)
"""Modes of a state that no linear estimate gave."""


@dataclass(frozen=True, kw_only=True, eq=False)
class InitialState:
    """State at a recording's first sample.

    Parameters
    ----------
    how : str
        ``"rest"``, ``"estimated"``, or ``"stated"`` in the case.
    modes_hz : tuple of float
        Natural frequencies of the estimated modes [Hz].
    window_s : float
        Length of the estimate's window [s].
    nrmse : float
        Residual in the window over the recording's deviation from rest.
    """

    qpos: Array
    qvel: Array
    how: str
    modes_hz: tuple[float, ...] = ()
    window_s: float = 0.0
    nrmse: float = 0.0

    def to_json(self) -> dict[str, object]:
        """Return plain values for a JSON document.

        The state is in the model's own coordinates.
        """
        return {
            "how": self.how,
            "modes_hz": list(self.modes_hz),
            "window_s": self.window_s,
            "nrmse": self.nrmse,
            "qpos": self.qpos.tolist(),
            "qvel": self.qvel.tolist(),
        }


def find_initial_state(plant: Plant, run: Run, law: Law | None = None) -> InitialState:
    """Estimate the state at the first sample of a run.

    Parameters
    ----------
    plant : Plant
        Nominal plant.
    run : Run
        Recording with mapped channels.
    law : Law or None
        The run's law with its initial memory. Commands over the window are the recorded ones, or else the law's
        response to the recorded sensors.

    Returns
    -------
    InitialState
        State and details of the estimate.

    Raises
    ------
    BadCase
        The recording does not start at rest and the model cannot be linearised, or has no mode below half the sample
        rate.
    """
    bench = bench_for(plant, run)
    compared = tuple(c for c in run.compared if c.actuator is None)
    rest = State(bench.rest.qpos, bench.rest.qvel)
    offset = bench.rest_values(compared)
    deviation = np.column_stack([run.measured[c.channel] for c in compared]) if compared else np.zeros((2, 0))
    deviation = deviation - np.where([c.from_rest for c in compared], 0.0, offset)
    largest = np.abs(deviation).max(axis=0, initial=0.0)
    slow = [run.measured.channels[run.measured.index(c.channel)].kind not in _ACCELERATIONS for c in compared]
    if run.start is not None:
        return _stated(rest, run.start)
    starts_at_rest = bool(run.drives) and begins_at_rest(deviation, np.array(slow, dtype=bool), plant)
    if run.initial == "rest" or not compared or (run.initial == "auto" and starts_at_rest):
        joints = [joint_of(plant, c) for c in compared]
        positions = {j[0]: float(first) for j, first in zip(joints, deviation[0], strict=True) if j and j[1] == 0}
        rest = held_rest(plant, rest, positions) if starts_at_rest else rest
        return InitialState(qpos=rest.qpos, qvel=rest.qvel, how="rest")
    linear = _linearised(plant, run, compared)
    samples = _window(run, np.zeros(0) if linear is None else linear.freq)
    window = replace(_open_loop(run, law, samples, bench), compared=compared)
    clock = plan_clock(plant.timestep, window)
    problem = StartProblem(
        bench=bench_for(at_timestep(plant, clock.timestep), window),
        clock=clock,
        run=window,
        measured=deviation[:samples],
        weight=1.0 / np.where(largest > 0, largest, 1.0),
        servoed=_servoed(plant, window),
    )
    size = float(np.sum((problem.measured * problem.weight) ** 2))
    best = _Estimate(rest, np.inf, NO_MODES)
    is_measured = len({j[0] for c in compared if (j := joint_of(plant, c)) and j[1] == 0}) == plant.model.nv
    unknown = plant.model.nv - len(problem.servoed)
    can_be_local = plant.model.nv <= MOST_LOCAL and unknown <= PER_CHANNEL * len(compared)
    if linear is not None:
        best = _modal_estimate(problem, linear, offset, size, can_be_local=can_be_local)
    share = LOCAL if is_measured else HOPELESS
    is_held = is_measured and bool(friction_of_joints(plant))  # friction holds joints off the linear estimate
    if can_be_local and (is_held or best.lost > share**2 * size):
        best = _local_estimate(problem, best, rest, offset, is_measured=is_measured)
    return InitialState(
        qpos=best.state.qpos,
        qvel=best.state.qvel,
        how="estimated",
        modes_hz=() if linear is None else tuple(float(f) for f in linear.freq[best.modes]),
        window_s=float(window.measured.time[-1] - window.measured.time[0]),
        nrmse=float(np.sqrt(best.lost / size)) if size > 0 else 0.0,
    )


class _Estimate(NamedTuple):
    """State with its residual and its modes.

    Parameters
    ----------
    lost : float
        Sum of squared residuals on the model.
    modes : (m,) array of int
        Modes of the linear estimate.
    """

    state: State
    lost: float
    modes: Array


def _linearised(plant: Plant, run: Run, compared: Sequence[Compared]) -> SecondOrderModel | None:
    """Return the linearised model, or None where a local start may do."""
    try:
        return plant.linearise()
    except BadStructure as error:
        if plant.model.nv > MOST_LOCAL or not all(joint_of(plant, c) for c in compared):
            raise BadCase(
                f'{run.name}: the initial state cannot be estimated, say initial = "rest": {error}'
            ) from error
    return None


def _modal_estimate(
    problem: StartProblem, linear: SecondOrderModel, offset: Array, size: float, *, can_be_local: bool
) -> _Estimate:
    """Return the linear estimate, refined on the model for large motion."""
    x, modes, expected = estimate_linear_start(problem, linear)
    state, lost = problem.state(x), _lost(problem, x, offset)
    if not np.isfinite(lost) or (can_be_local and lost > HOPELESS**2 * size):
        return _Estimate(state, lost, modes)
    if lost > min(WORTH**2 * expected + 1e-18 * problem.measured.size, ENOUGH**2 * size):
        x, left = refine(problem, x, window_residual(problem, x, offset), offset)
        state, lost = problem.state(x), float(left @ left)
    return _Estimate(state, lost, modes)


def _local_estimate(
    problem: StartProblem, best: _Estimate, rest: State, offset: Array, *, is_measured: bool
) -> _Estimate:
    """Return a local start where it is better.

    If the model diverges, measured joints remain the best start.
    """
    local = _local_start(problem, best.state if np.isfinite(best.lost) else rest)
    nearby, remains = _from_nearby(problem, local, offset)
    if remains < best.lost:
        return _Estimate(nearby, remains, NO_MODES)
    if is_measured and not np.isfinite(best.lost):
        return _Estimate(local, best.lost, NO_MODES)
    return best


def _stated(rest: State, start: tuple[Array, Array]) -> InitialState:
    """Return the stated initial state; added effects begin at rest."""
    qpos, qvel = rest.qpos.copy(), rest.qvel.copy()
    qpos[: len(start[0])], qvel[: len(start[1])] = start
    return InitialState(qpos=qpos, qvel=qvel, how="stated")


def begins_at_rest(deviation: Array, slow: Array, plant: Plant) -> bool:
    """Return whether channels begin at their rest values.

    Parameters
    ----------
    deviation : (n, n_channels) array
        Deviation from rest.
    slow : (n_channels,) array of bool
        Channels that are zero only at rest. Accelerations are zero under a steady force too, so several samples must be
        zero without other channels.
    plant : Plant
        Plant with the equilibrium.

    Returns
    -------
    bool
        True at rest.
    """
    largest = np.abs(deviation).max(axis=0, initial=0.0)
    first, share = (deviation[:1, slow], largest[slow]) if np.any(slow) else (deviation[:STILL], largest)
    if not np.all(np.abs(first) <= AT_REST * share):
        return False
    return bool(np.all(np.abs(first) <= AT_UNSTABLE_REST * share)) or not _is_unstable(plant)


def _is_unstable(plant: Plant) -> bool:
    try:
        linear = plant.linearise()
    except BadStructure:
        return False
    return bool(np.any(linear.eigen[0] < 0) or np.any(np.nan_to_num(linear.zeta) < 0))


def joint_of(plant: Plant, channel: Compared) -> tuple[int, int] | None:
    """Return the degree of freedom and order of a joint channel.

    The order is 0 for position and 1 for velocity of a hinge or slide.

    Parameters
    ----------
    plant : Plant
        Plant with its ports and transducers.
    channel : Compared
        Compared channel.

    Returns
    -------
    tuple of (int, int) or None
        None for any other channel.
    """
    model = plant.model
    if channel.sensor is None:
        kind, _, name = channel.port.partition(":")
        is_motion = kind == "joint" and channel.order <= 1 and channel.actuator is None
        return (int(model.joint(name).dofadr[0]), channel.order) if is_motion else None
    (address, *more) = plant.sensors[channel.sensor].addresses
    found = np.flatnonzero(model.sensor_adr == address)
    if more or not found.size:
        return None
    orders = {int(mujoco.mjtSensor.mjSENS_JOINTPOS): 0, int(mujoco.mjtSensor.mjSENS_JOINTVEL): 1}
    order = orders.get(int(model.sensor_type[found[0]]))
    return None if order is None else (int(model.jnt_dofadr[model.sensor_objid[found[0]]]), order)


def _lost(problem: StartProblem, x: Array, offset: Array) -> float:
    """Return the sum of squared residuals on the model.

    The result is infinite if the model diverges.
    """
    try:
        left = window_residual(problem, x, offset)
    except Diverged:
        return np.inf
    return float(left @ left)


def _servoed(plant: Plant, run: Run) -> dict[int, tuple[str, float]]:
    """Return servo-driven, unmeasured degrees of freedom.

    A position servo with a recorded command holds each of them at the command. The result gives the command's channel
    and the motion per unit command.
    """
    model = plant.model
    out: dict[int, tuple[str, float]] = {}
    shown = {found[0] for c in run.compared if (found := joint_of(plant, c))}
    for drive in run.drives:
        i = drive.actuator
        if i is None or i >= model.nu or model.actuator_trntype[i] != int(mujoco.mjtTrn.mjTRN_JOINT):
            continue
        joint, gain, gear = int(model.actuator_trnid[i, 0]), model.actuator_gainprm[i, 0], model.actuator_gear[i, 0]
        is_affine = model.actuator_biastype[i] == int(mujoco.mjtBias.mjBIAS_AFFINE)
        is_servo = is_affine and model.actuator_biasprm[i, 1] == -gain
        dof = int(model.jnt_dofadr[joint])
        if is_servo and gain > 0 and gear and model.jnt_type[joint] in ONE_WAY and dof not in shown:
            out[dof] = (drive.channel, 1.0 / float(gear))
    return out


def _stage(problem: StartProblem, share: float) -> StartProblem:
    """Return the problem on the first part of a window."""
    whole = problem.run.measured
    count = min(max(round(share * len(whole)), LEAST_STAGE), len(whole))
    part = whole.rows(slice(count))
    run = replace(problem.run, measured=part)
    clock = plan_clock(problem.clock.timestep, run)
    bench = bench_for(at_timestep(problem.bench.plant, clock.timestep), run)
    nv = bench.model.nv
    size = max(float(np.abs(problem.measured[:count]).max()), 1e-9)
    rate = 2 * np.pi / max(float(whole.time[-1] - whole.time[0]), 1e-9)
    scale = np.concatenate([np.full(nv, size), np.full(nv, size * rate)])
    free = np.setdiff1d(np.arange(nv), list(problem.servoed))
    return replace(
        problem,
        bench=bench,
        clock=clock,
        run=run,
        measured=problem.measured[:count],
        shapes=np.eye(nv)[:, free],
        scale=scale[np.concatenate([free, nv + free])],
        held=STIFF * np.sqrt(problem.measured[:count].size),
    )


def _local_start(problem: StartProblem, state: State) -> State:
    """Return a state with joints from samples and commands.

    A cubic through the first samples gives the measured joints; commands give the servo-driven joints.
    """
    first = _stage(problem, STAGES[0]).run.measured
    time = first.time - first.time[0]
    degree = min(3, time.size - 1)
    qpos, qvel, model = state.qpos.copy(), state.qvel.copy(), problem.bench.model
    for dof, (channel, unit) in problem.servoed.items():
        told = np.polynomial.Polynomial.fit(time, unit * first[channel], degree)
        qpos[model.jnt_qposadr[model.dof_jntid[dof]]], qvel[dof] = told(0.0), told.deriv()(0.0)
    rest = problem.bench.rest_values(problem.run.compared)
    for i, c in enumerate(problem.run.compared):
        joint = joint_of(problem.bench.plant, c)
        if joint is None:
            continue
        fitted = np.polynomial.Polynomial.fit(time, first[c.channel] + (rest[i] if c.from_rest else 0.0), degree)
        dof, order = joint
        if order == 1:
            qvel[dof] = fitted(0.0)
            continue
        qpos[model.jnt_qposadr[model.dof_jntid[dof]]] = fitted(0.0)
        if not any(joint_of(problem.bench.plant, other) == (dof, 1) for other in problem.run.compared):
            qvel[dof] = fitted.deriv()(0.0)
    return State(qpos, qvel)


def _from_nearby(problem: StartProblem, state: State, offset: Array) -> tuple[State, float]:
    """Refine a state on a growing window.

    Returns
    -------
    tuple of (State, float)
        State and its sum of squared residuals.
    """
    left = np.array([np.inf])
    for share in STAGES:
        stage = replace(_stage(problem, share), origin=state)
        x = np.zeros(len(stage.scale))
        try:
            left = window_residual(stage, x, offset)
        except Diverged:
            return state, np.inf
        x, left = refine(stage, x, left, offset)
        state = stage.state(x)
    return state, float(left @ left)


def _window(run: Run, freq: Array) -> int:
    """Return the number of samples in the window."""
    time = run.measured.time - run.measured.time[0]
    slow = freq[freq > 0.5 / time[-1]]  # modes with at least half a period in the recording
    growing = -2 * np.pi * freq[freq < 0]
    growing = growing[growing * time[-1] > 1.0]  # rates [1/s] of modes that grow e-fold within the recording
    span = max(PERIODS / slow[0] if slow.size else 0.0, PERIODS / growing[-1] if growing.size else 0.0)
    if freq.size == 0:
        span = time[-1] / 10
    count = int(np.searchsorted(time, span, side="right"))
    return min(max(count, LEAST_SAMPLES), MOST_SAMPLES, len(run.measured))


def _open_loop(run: Run, law: Law | None, samples: int, bench: Bench) -> Run:
    """Return a run's window with commands as recorded inputs."""
    part = run.measured.rows(slice(samples))
    if law is None:
        return replace(run, measured=part, law=None)
    commands = replayed_commands(run, law, part, bench)
    for c in run.compared:
        if c.actuator in law.actuators:
            commands[:, law.actuators.index(c.actuator)] = part[c.channel]
    names = [f"law:{i}" for i in law.actuators]
    channels = tuple(Channel(name=name, kind="command", unit="", is_input=True) for name in names)
    both = Recording(time=part.time, data=np.column_stack([part.data, commands]), channels=(*part.channels, *channels))
    at_rate = run.hardware is not None and part.is_uniform and abs(part.rate / law.rate_hz - 1) < 1e-6
    is_held = not part.is_uniform or law.rate_hz < 1.5 * part.rate  # a faster law's staircase is known at samples only
    drives = tuple(
        Drive(channel=n, actuator=i, through_chain=at_rate, is_held=is_held)
        for n, i in zip(names, law.actuators, strict=True)
    )
    return replace(run, measured=both, law=None, drives=(*run.drives, *drives))


def replayed_commands(run: Run, law: Law, part: Recording, bench: Bench) -> Array:
    """Return a law's response to the recorded sensors.

    Parameters
    ----------
    run : Run
        Recording with mapped channels.
    law : Law
        The run's law.
    part : Recording
        Window of the recording.
    bench : Bench
        Plant prepared for replay.

    Returns
    -------
    array
        Commands (n, n_actuators); zero if a sensor was not recorded.
    """
    commands = np.zeros((len(part), len(law.actuators)))
    channels = compared_with_sensors(run, law.sensors)
    if channels is None:
        return commands
    law = replace(law, controller=copy.deepcopy(law.controller))
    rest = np.where([c.from_rest for c in channels], bench.rest_values(tuple(channels)), 0.0)
    samples = part.select([c.channel for c in channels]).data + rest
    y = np.zeros(max(law.sensors) + 1)
    tick, present = 0, np.zeros(len(law.actuators))
    for k, t in enumerate(part.time - part.time[0]):
        while tick <= t * law.rate_hz + 1e-6:
            y[list(law.sensors)] = samples[k]
            present = law.step(y)
            tick += 1
        commands[k] = present
    return commands
