"""The state that a recording starts from: at rest, or estimated from its first samples.

The linearised model says how every mode's initial displacement and velocity shows in the compared channels, so they follow
by least squares from the first two periods of the slowest mode; how many modes are worth estimating is chosen by the
Bayesian information criterion. The estimate is then refined on the model itself (Gauss-Newton), which takes up large
motion. The window is short on purpose: an error of frequency turns the phase by little within it.

Motion so large that the linearised model leads nowhere is started locally: measured joints from a polynomial through their
first samples, joints that a position servo moves from its commands, the others as the linear estimate has them, refined on a
window that grows from a few samples.
"""

import copy
from dataclasses import dataclass, field, replace

import mujoco
import numpy as np

from vlab.cases.channel_map import Compared, Drive, Law, Run, compared_with_sensors
from vlab.cases.replay import Bench, Clock, Loads, State, at_timestep, before, bench_for, plan_clock, play
from vlab.errors import BadCase, BadStructure, Diverged
from vlab.fe.second_order import SecondOrderModel
from vlab.plants.base import Plant, without_limits
from vlab.signals import Array, Channel, Recording

PERIODS = 2.0
"""Periods of the slowest oscillation in the window of the estimate."""
LEAST_SAMPLES, MOST_SAMPLES = 20, 2000
MOST_MODES = 8
AT_REST, STILL = 0.02, 5
"""A driven recording starts at rest where its first sample is within this share of its largest deflection; of accelerations
alone, where so many samples are."""
AT_UNSTABLE_REST = 1e-3
"""The same where the rest is unstable: all that follows grows out of how it begins."""
REFINEMENTS = 4
WORTH, ENOUGH = 1.1, 0.02
"""The estimate is refined on the model where it leaves this much more there than on the linearisation, which says that
the motion is large, or more than this share of the recording."""
STAGES = (0.06, 0.25, 1.0)
"""Shares of the window on which a local start is refined, one after the other."""
LOCAL, HOPELESS = 0.05, 0.2
"""Where more than the first share is left, of joints that are all measured, or the second, of others, a local start is tried;
a linear estimate that leaves more than the second is no start for a refinement at all."""
LEAST_STAGE = 8
"""Samples of the first of them."""
MOST_LOCAL, PER_CHANNEL = 12, 3
"""Degrees of freedom that a local start can have, in all and for every channel: few sensors say little of many joints, and
what a model lacks would go into the start."""
STIFF = 3e-3
"""Weight that a local start is held by to where the stage before left it, beside samples of the largest deflection: the speed of a
joint on a stiff servo is gone before a sample shows it, and would be fitted to noise."""
_ACCELERATIONS = ("acceleration", "angular-acceleration", "force", "moment")
_ONE_WAY = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
_STEP = 1e-6
"""Step of the central differences of the sensors [largest joint motion, m or rad]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class InitialState:
    """The true state at a recording's first sample.

    Parameters
    ----------
    how : str
        ``"rest"`` or ``"estimated"``.
    modes_hz : tuple of float
        Natural frequencies of the modes that were estimated.
    window_s : float
        Length of the part that the estimate is from.
    nrmse : float
        What is left over on that part, beside the deviation of the recording from rest there.
    """

    qpos: Array
    qvel: Array
    how: str
    modes_hz: tuple[float, ...] = ()
    window_s: float = 0.0
    nrmse: float = 0.0

    def to_json(self) -> dict[str, object]:
        """Return plain values for a JSON document; the state is in the model's own coordinates."""
        return {
            "how": self.how,
            "modes_hz": list(self.modes_hz),
            "window_s": self.window_s,
            "nrmse": self.nrmse,
            "qpos": self.qpos.tolist(),
            "qvel": self.qvel.tolist(),
        }


@dataclass(eq=False)
class _Problem:
    """The least squares problem of one run's window."""

    bench: Bench
    clock: Clock
    run: Run  # the window, without a law
    measured: Array  # (samples, channels), from the model's rest
    weight: Array  # (channels,)
    shapes: Array = field(default_factory=lambda: np.zeros((0, 0)))
    scale: Array = field(default_factory=lambda: np.zeros(0))
    origin: State | None = None  # what the coordinates count from; rest without it
    held: float = 0.0  # weight of the coordinates beside the samples
    servoed: dict[int, tuple[str, float]] = field(default_factory=dict)  # see `_servoed`

    def state(self, x: Array) -> State:
        """Return the state of scaled modal coordinates, displacements before velocities."""
        m = self.shapes.shape[1]
        origin = self.bench.rest if self.origin is None else self.origin
        qpos = origin.qpos.copy()
        mujoco.mj_integratePos(self.bench.model, qpos, self.shapes @ (x[:m] * self.scale[:m]), 1.0)
        return State(qpos, origin.qvel + self.shapes @ (x[m:] * self.scale[m:]))


def find_initial_state(plant: Plant, run: Run, law: Law | None = None) -> InitialState:
    """Find the state at the first sample of a run.

    Parameters
    ----------
    law : Law or None
        The run's law with its memory at the start. Its commands over the window are those recorded, or else what it
        gives to the recorded sensors.

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
    starts_at_rest = bool(run.drives) and begins_at_rest(deviation, np.array(slow, dtype=bool), plant)
    if run.initial == "rest" or not compared or (run.initial == "auto" and starts_at_rest):
        return InitialState(qpos=rest.qpos, qvel=rest.qvel, how="rest")
    linear: SecondOrderModel | None = None
    try:
        linear = plant.linearise()
    except BadStructure as error:
        if plant.model.nv > MOST_LOCAL or not all(joint_of(plant, c) for c in compared):
            raise BadCase(
                f'{run.name}: the initial state cannot be estimated, say initial = "rest": {error}'
            ) from error
    samples = _window(run, np.zeros(0) if linear is None else linear.freq)
    window = replace(_open_loop(run, law, samples, bench), compared=compared)
    clock = _clock(plant.timestep, window)
    problem = _Problem(
        bench=bench_for(at_timestep(plant, clock.timestep), window),
        clock=clock,
        run=window,
        measured=deviation[:samples],
        weight=1.0 / np.where(largest > 0, largest, 1.0),
        servoed=_servoed(plant, window),
    )
    size = float(np.sum((problem.measured * problem.weight) ** 2))
    state, lost, chosen = rest, np.inf, np.zeros(0, dtype=int)
    is_measured = len({j[0] for c in compared if (j := joint_of(plant, c)) and j[1] == 0}) == plant.model.nv
    unknown = plant.model.nv - len(problem.servoed)
    can_be_local = plant.model.nv <= MOST_LOCAL and unknown <= PER_CHANNEL * len(compared)
    if linear is not None:
        x, chosen, expected = _linear_estimate(problem, linear)
        state, lost = problem.state(x), _lost(problem, x, offset)
        is_hopeless = lost > HOPELESS**2 * size and can_be_local
        if (
            not is_hopeless
            and np.isfinite(lost)
            and lost > min(WORTH**2 * expected + 1e-18 * problem.measured.size, ENOUGH**2 * size)
        ):
            x, left = _refine(problem, x, _residual(problem, x, offset), offset)
            state, lost = problem.state(x), float(left @ left)
    share = LOCAL if is_measured else HOPELESS
    if lost > share**2 * size and can_be_local:
        local = _local_start(problem, state if np.isfinite(lost) else rest)
        nearby, remains = _from_nearby(problem, local, offset)
        if remains < lost:
            state, lost, chosen = nearby, remains, np.zeros(0, dtype=int)
        elif is_measured and not np.isfinite(lost):  # where the model runs away, what was measured stands
            state, chosen = local, np.zeros(0, dtype=int)
    span = float(window.measured.time[-1] - window.measured.time[0])
    return InitialState(
        qpos=state.qpos,
        qvel=state.qvel,
        how="estimated",
        modes_hz=() if linear is None else tuple(float(f) for f in linear.freq[chosen]),
        window_s=span,
        nrmse=float(np.sqrt(lost / size)) if size > 0 else 0.0,
    )


def begins_at_rest(deviation: Array, slow: Array, plant: Plant) -> bool:
    """Return whether channels begin at their rest values.

    Parameters
    ----------
    deviation : (n, n_channels) array
        From rest.
    slow : (n_channels,) array of bool
        Channels that stand still while the thing does; accelerations do so under a steady force as well, so where there is
        nothing else, several samples must be still.
    plant : Plant
        Whose rest it is.
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
    """Return (degree of freedom, order) of a channel that reads a hinge's or slide's position (0) or velocity (1)."""
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


def _lost(problem: _Problem, x: Array, offset: Array) -> float:
    """Return the sum of squares that an estimate leaves on the model; infinite where the model runs away."""
    try:
        left = _residual(problem, x, offset)
    except Diverged:
        return np.inf
    return float(left @ left)


def _clock(timestep: float, run: Run) -> Clock:
    """Return the clock of a window; where samples are uneven it reads at their mean rate and splines go between."""
    clock = plan_clock(timestep, run)
    if run.measured.is_uniform or run.law is not None:
        return clock
    time = run.measured.time
    steps = max(1, int((time[-1] - time[0]) / (len(time) - 1) / clock.timestep))
    return replace(clock, steps=steps, law_every=1, readings=max(2, -(-(clock.readings - 1) // steps) + 1))


def _servoed(plant: Plant, run: Run) -> dict[int, tuple[str, float]]:
    """Return the degrees of freedom that a recorded command moves by a position servo and no channel shows, by the command's channel and
    the motion for a unit of it: they are where they are told to be."""
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
        if is_servo and gain > 0 and gear and model.jnt_type[joint] in _ONE_WAY and dof not in shown:
            out[dof] = (drive.channel, 1.0 / float(gear))
    return out


def _stage(problem: _Problem, share: float) -> _Problem:
    """Return the problem of the first part of a window."""
    whole = problem.run.measured
    count = min(max(round(share * len(whole)), LEAST_STAGE), len(whole))
    part = replace(whole, time=whole.time[:count], data=whole.data[:count])
    run = replace(problem.run, measured=part)
    clock = _clock(problem.clock.timestep, run)
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


def _local_start(problem: _Problem, state: State) -> State:
    """Return a state with the measured joints as a cubic through their first samples has them, and those of servos as their commands."""
    first = _stage(problem, STAGES[0]).run.measured
    time = first.time - first.time[0]
    qpos, qvel, model = state.qpos.copy(), state.qvel.copy(), problem.bench.model
    for dof, (channel, unit) in problem.servoed.items():
        told = np.polynomial.Polynomial.fit(time, unit * first[channel], 3)
        qpos[model.jnt_qposadr[model.dof_jntid[dof]]], qvel[dof] = told(0.0), told.deriv()(0.0)
    rest = problem.bench.rest_values(problem.run.compared)
    for i, c in enumerate(problem.run.compared):
        joint = joint_of(problem.bench.plant, c)
        if joint is None:
            continue
        fitted = np.polynomial.Polynomial.fit(time, first[c.channel] + (rest[i] if c.from_rest else 0.0), 3)
        dof, order = joint
        if order == 1:
            qvel[dof] = fitted(0.0)
            continue
        qpos[model.jnt_qposadr[model.dof_jntid[dof]]] = fitted(0.0)
        if not any(joint_of(problem.bench.plant, other) == (dof, 1) for other in problem.run.compared):
            qvel[dof] = fitted.deriv()(0.0)
    return State(qpos, qvel)


def _from_nearby(problem: _Problem, state: State, offset: Array) -> tuple[State, float]:
    """Refine a state on a window that grows from a few samples; return it and the sum of squares that it leaves."""
    left = np.array([np.inf])
    for share in STAGES:
        stage = replace(_stage(problem, share), origin=state)
        x = np.zeros(len(stage.scale))
        try:
            left = _residual(stage, x, offset)
        except Diverged:
            return state, np.inf
        x, left = _refine(stage, x, left, offset)
        state = stage.state(x)
    return state, float(left @ left)


def _window(run: Run, freq: Array) -> int:
    """Return how many samples the estimate is from."""
    time = run.measured.time - run.measured.time[0]
    slow = freq[freq > 0.5 / time[-1]]  # what turns at least half a time in the recording
    span = PERIODS / slow[0] if slow.size else time[-1] / 10 if freq.size == 0 else 0.0
    count = int(np.searchsorted(time, span, side="right"))
    return min(max(count, LEAST_SAMPLES), MOST_SAMPLES, len(run.measured))


def _open_loop(run: Run, law: Law | None, samples: int, bench: Bench) -> Run:
    """Return the first samples of a run with its law's commands as recorded inputs."""
    part = replace(run.measured, time=run.measured.time[:samples], data=run.measured.data[:samples])
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
    is_held = not part.is_uniform or law.rate_hz < 1.5 * part.rate  # of a faster law's staircase only samples are known
    drives = tuple(
        Drive(channel=n, actuator=i, through_chain=at_rate, is_held=is_held)
        for n, i in zip(names, law.actuators, strict=True)
    )
    return replace(run, measured=both, law=None, drives=(*run.drives, *drives))


def replayed_commands(run: Run, law: Law, part: Recording, bench: Bench) -> Array:
    """Return what a copy of the law gives to the recorded sensors; zero where they were not all recorded."""
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


def _linear_estimate(problem: _Problem, linear: SecondOrderModel) -> tuple[Array, Array, float]:
    """Return scaled modal coordinates, which modes they are, and the sum of squares that they leave.

    The number of modes is chosen by the information criterion.
    """
    omega, all_shapes = linear.eigen
    time = problem.run.measured.time
    nyquist = 0.45 * (len(time) - 1) / (time[-1] - time[0])
    usable = np.flatnonzero(np.abs(omega) < 2 * np.pi * nyquist)[:MOST_MODES]
    usable = usable[: max(1, problem.measured.size // 4)]
    if not usable.size:
        raise BadCase(
            f'{problem.run.name}: no mode lies below {nyquist:.3g} Hz; the initial state cannot be estimated, say initial = "rest"'
        )
    best: tuple[float, Array, int, float] | None = None
    for m in range(1, usable.size + 1):
        chosen = usable[:m]
        slowest = 2 * np.pi / (time[-1] - time[0])
        problem.shapes = all_shapes[:, chosen]
        problem.scale = np.concatenate([np.ones(m), np.maximum(np.abs(omega[chosen]), slowest)])
        matrix, forced = _responses(problem, omega[chosen], linear)
        target = ((problem.measured - forced) * problem.weight).ravel()
        matrix *= np.tile(problem.weight, len(time))[:, None]
        x = np.linalg.lstsq(matrix, target, rcond=1e-9)[0]
        left = target - matrix @ x
        floor = 1e-20 * float(target @ target) + 1e-300  # rounding: below it a better fit means nothing
        score = target.size * np.log(float(left @ left) + floor) + 2 * m * np.log(target.size)
        if best is None or score < best[0]:
            best = (float(score), x, m, float(left @ left))
    assert best is not None
    _, x, m, expected = best
    chosen = usable[:m]
    problem.shapes = all_shapes[:, chosen]
    problem.scale = np.concatenate([np.ones(m), np.maximum(np.abs(omega[chosen]), 2 * np.pi / (time[-1] - time[0]))])
    return x, chosen, expected


def _responses(problem: _Problem, omega: Array, linear: SecondOrderModel) -> tuple[Array, Array]:
    """Return the channels' responses to the scaled modal coordinates, (samples * channels, 2 m), and to the inputs."""
    shapes, scale, m, window = problem.shapes, problem.scale, len(omega), problem.run
    damping = shapes.T @ linear.C @ shapes
    A = np.block([[np.zeros((m, m)), np.eye(m)], [-np.diag(np.sign(omega) * omega**2), -damping]])
    forces, direct = _input_matrices(problem)
    B = np.vstack([np.zeros((m, forces.shape[1])), shapes.T @ forces])
    C = _output_matrix(problem)
    time, names = window.measured.time, [d.channel for d in window.drives]
    inputs = window.measured.select(names).data if names else np.zeros((len(time), 0))
    held = np.array([d.is_held for d in window.drives], dtype=bool)
    present = np.where(held, before(inputs), inputs)
    steps = np.diff(time)[: 1 if window.measured.is_uniform else None]
    n, p = 2 * m, B.shape[1]
    blocks = np.zeros((steps.size, n + p, n + p))
    blocks[:, :n, :n], blocks[:, :n, n:] = A, B
    moves = exponentials(blocks * steps[:, None, None])
    free, forced = np.diag(scale), np.zeros(n)
    matrix, drive = np.zeros((len(time), C.shape[0], n)), np.zeros((len(time), C.shape[0]))
    for k in range(len(time)):
        matrix[k], drive[k] = C @ free, C @ forced + direct @ present[k]
        if k + 1 < len(time):
            move = moves[min(k, len(moves) - 1)]
            free, forced = move[:n, :n] @ free, move[:n, :n] @ forced + move[:n, n:] @ inputs[k]
    return matrix.reshape(-1, n), drive


def exponentials(matrices: Array) -> Array:
    """Return the exponentials of many small matrices: Taylor's series after scaling, then squaring.

    To rounding: with a norm of 1/4 the first term left out is 1/4^13/13! = 2e-18. (scipy takes 7 ms a small matrix here.)
    """
    norm = float(np.abs(matrices).sum(axis=-1).max(initial=0.0))
    squarings = max(0, int(np.ceil(np.log2(max(norm, 1e-300) / 0.25))))
    scaled = matrices / 2.0**squarings
    term = np.broadcast_to(np.eye(matrices.shape[-1]), matrices.shape)
    total = term.copy()
    for k in range(1, 13):
        term = term @ scaled / k
        total += term
    for _ in range(squarings):
        total = total @ total
    return total


def _output_matrix(problem: _Problem) -> Array:
    """Return the channels per modal displacement and velocity, by central differences."""
    bench, m = problem.bench, problem.shapes.shape[1]
    columns = []
    for i in range(2 * m):
        shape = problem.shapes[:, i % m]
        step = _STEP / np.abs(shape).max()
        sides = []
        for sign in (step, -step):
            qpos, qvel = bench.rest.qpos.copy(), np.zeros(bench.model.nv)
            if i < m:
                mujoco.mj_integratePos(bench.model, qpos, shape, sign)
            else:
                qvel = shape * sign
            sides.append(_values(bench, problem.run.compared, State(qpos, qvel), np.zeros(bench.model.nu)))
        columns.append((sides[0] - sides[1]) / (2 * step))
    return np.array(columns).T


def _values(
    bench: Bench, compared: tuple[Compared, ...], state: State, ctrl: Array, loads: Loads | None = None
) -> Array:
    bench.start(state)
    bench.look(ctrl, loads=loads)
    return bench.values(compared, bench.sensors())


def _input_matrices(problem: _Problem) -> tuple[Array, Array]:
    """Return the generalised forces (nv, inputs) and the direct effect on the channels (channels, inputs) of the drives."""
    window = problem.run
    plant = without_limits(problem.bench.plant)  # a unit command may be far outside of them
    bench = bench_for(plant, window)
    data = plant.new_data()
    base = data.qfrc_actuator.copy()
    rest = bench.rest_values(problem.run.compared)
    forces = np.zeros((bench.model.nv, len(window.drives)))
    direct = np.zeros((rest.size, len(window.drives)))
    still = np.zeros(bench.model.nu)
    for i, drive in enumerate(window.drives):
        if drive.port:
            port = plant.port(drive.port)
            forces[:, i] = port.row(data)
            pair = [_values(bench, problem.run.compared, bench.rest, still, [(port, load)]) for load in (1.0, 0.0)]
            direct[:, i] = pair[0] - pair[1]
        elif drive.actuator is not None:
            ctrl = plant.control_matrix[:, drive.actuator]
            data.ctrl[:] = ctrl
            mujoco.mj_forward(bench.model, data)
            forces[:, i] = data.qfrc_actuator - base
            direct[:, i] = _values(bench, problem.run.compared, bench.rest, ctrl) - rest
    return forces, direct


def _residual(problem: _Problem, x: Array, offset: Array) -> Array:
    """Return the weighted difference between the window and the model's own response."""
    run, clock = problem.run, problem.clock
    replayed = play(problem.bench, run, clock, problem.state(x), None)
    time = run.measured.time - run.measured.time[0]
    model = np.column_stack([replayed.at(time, clock, i) for i in range(len(run.compared))])
    return np.asarray(((model - offset - problem.measured) * problem.weight).ravel())


def _refine(problem: _Problem, x: Array, left: Array, offset: Array) -> tuple[Array, Array]:
    """Improve the linear estimate on the model itself (Gauss-Newton); keep it where that does not help."""
    try:
        for _ in range(REFINEMENTS):
            step = 1e-4 * max(float(np.abs(x).max()), 1e-9 if problem.origin is None else 0.1)
            moved = x + step * np.eye(x.size)
            slopes = np.array([(_residual(problem, point, offset) - left) / step for point in moved])
            held = problem.held * np.eye(x.size)
            rows, wanted = np.vstack([slopes.T, held]), np.concatenate([left, problem.held * x])
            better = x - np.linalg.lstsq(rows, wanted, rcond=1e-9)[0]
            trial = _residual(problem, better, offset)
            gained = 1.0 - float(trial @ trial) / float(left @ left)
            if not gained > 0:
                break
            x, left = better, trial
            if gained < 1e-3:
                break
    except Diverged:
        pass  # a step too far; what was found before it stands
    return x, left
