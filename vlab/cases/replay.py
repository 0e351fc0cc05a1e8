"""Step-by-step replay of a recording on a plant.

MuJoCo's semi-implicit steps keep the position half a step ahead of the velocity (see `vlab.plants.base`). A state
here holds position and velocity at the same time.

A run starts with the position advanced by half a step. Each reading comes from a copy of the state without that half
step. Positions, velocities and accelerations of all sensors then belong to the time of the reading.
"""

import copy
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from scipy.interpolate import CubicSpline

from vlab.cases.channel_map import Compared, Law, Run
from vlab.cases.clock import Clock
from vlab.cases.open_loop import CHECK_EVERY, motion_of, run_open_loop
from vlab.cases.replay_inputs import drives_of, inputs_of
from vlab.hardware.laboratory import Converter
from vlab.hardware.output_chain import OutputChain
from vlab.hardware.sensing import coil_gain
from vlab.lab.callback import control_callback
from vlab.physics.running import STAGGERED, Running
from vlab.plants.base import Plant, Port, check_run
from vlab.plants.computable import computable
from vlab.signals import Array

Loads = Sequence[tuple[Port, float]]
"""Forces [N or N m] on ports."""


@dataclass(frozen=True)
class State:
    """True state: position and velocity at the same time."""

    qpos: Array
    qvel: Array


class Bench:
    """Plant with its readings.

    Parameters
    ----------
    plant : Plant
        Plant with the timestep of the run.
    linear_range : float or None
        Travel in which coil sensors are linear [m]; None for hardware outside the laboratory.
    """

    def __init__(self, plant: Plant, linear_range: float | None = None) -> None:
        self.plant, self.model = plant, plant.model
        self.data, self._copy = plant.new_data(), plant.new_data()
        self.rest = State(self.data.qpos.copy(), np.zeros(self.model.nv))
        self._ahead = self.model.opt.timestep / 2 if self.model.opt.integrator in STAGGERED else 0.0
        self._sum = np.zeros((len(plant.sensors), self.model.nsensordata))
        for i, tap in enumerate(plant.sensors):
            self._sum[i, list(tap.addresses)] = 1.0
        self.applied = np.zeros(self.model.nv)
        """Generalised external forces of the present step, without attached physics."""
        self._range = linear_range
        self._coils = [i for i, tap in enumerate(plant.sensors) if tap.kind == "velocity"]

    def start(self, state: State) -> None:
        """Set the plant to a true state at time zero."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:], self.data.qvel[:] = state.qpos, state.qvel
        if self._ahead:
            mujoco.mj_integratePos(self.model, self.data.qpos, state.qvel, self._ahead)
        mujoco.mj_forward(self.model, self.data)

    def open_loop(
        self, run: Run, state: State, controls: Array, present: Array, progress: Callable[[float], None]
    ) -> Array:
        """Simulate a run without a law, port loads or attached effects.

        Parameters
        ----------
        run : Run
            Recording with mapped channels.
        state : State
            Initial state.
        controls, present : (n_steps, nu) and (n_readings, nu) array
            Controls of every step and at the readings.
        progress : callable
            Receives the completed share of the run.

        Returns
        -------
        (n_readings, n_channels) array
            Compared channels; zeros for commands.
        """
        self.start(state)
        states, raw = run_open_loop(self.model, self.data, controls, present, ahead=self._ahead, progress=progress)
        sensors, data = self.sensors(raw), self._copy
        out = np.zeros((len(raw), len(run.compared)))
        copy_sensors(run.compared, sensors, out)
        of_ports = [(i, c) for i, c in enumerate(run.compared) if c.sensor is None and c.port]
        moves = not all(self.plant.port(c.port).is_constant for _, c in of_ports)
        for k, (qpos, qvel) in enumerate(zip(*motion_of(self.model, states), strict=True)) if of_ports else ():
            data.qpos[:], data.qvel[:] = qpos, qvel
            if moves:
                mujoco.mj_fwdPosition(self.model, data)
            for i, c in of_ports:
                out[k, i] = self._value(c, sensors[k])
        return out

    def reads_forces(self, compared: tuple[Compared, ...]) -> bool:
        """Return whether compared values depend on forces."""
        return any(c.order == 2 for c in compared) or bool(
            np.any(self.model.sensor_needstage == int(mujoco.mjtStage.mjSTAGE_ACC))
        )

    def look(self, ctrl: Array, physics: Running | None = None, loads: Loads | None = None) -> None:
        """Evaluate the present true state in the copy.

        Attached physics acts there without updating its memory.

        Parameters
        ----------
        ctrl : array
            Commands, (n_actuators,).
        physics : Running or None
            Attached physics.
        loads : sequence of (Port, float) or None
            Present forces on ports; None keeps those of the last step.
        """
        data, model = self._at_present(), self.model
        if loads is not None:
            if not all(port.is_constant for port, _ in loads):  # rows at the present configuration
                mujoco.mj_fwdPosition(model, data)
            self.apply(data, loads)
        data.ctrl[:] = ctrl
        mujoco.mj_forward(model, data)
        if physics is not None and physics.ports is not None:
            data.qfrc_applied[:] = self.applied
            readings = physics.ports.look(data, physics.force)
            mujoco.mj_forwardSkip(model, data, int(mujoco.mjtStage.mjSTAGE_VEL), 0)
            data.sensordata += readings

    def apply(self, data: mujoco.MjData, loads: Loads) -> None:
        """Apply port forces and prescribed motion at the state of some data."""
        applied = self.applied
        if self.plant.prescribed is None:
            applied[:] = 0.0
        else:
            self.plant.prescribed(data.qpos, data.qvel, applied)
        for port, load in loads:
            applied += port.row(data) * load
        data.qfrc_applied[:] = applied

    def look_at_motion(self) -> None:
        """Evaluate the present motion in the copy, without forces."""
        data, model = self._at_present(), self.model
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_sensorPos(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_sensorVel(model, data)

    def _at_present(self) -> mujoco.MjData:
        """Return the copy at the present true state."""
        data, model = self._copy, self.model
        mujoco.mj_copyState(model, self.data, data, int(mujoco.mjtState.mjSTATE_INTEGRATION))
        if self._ahead:
            mujoco.mj_integratePos(model, data.qpos, data.qvel, -self._ahead)
        return data

    @property
    def acceleration(self) -> Array:
        """Generalised acceleration of the last `look`, (nv,)."""
        return np.asarray(self._copy.qacc)

    @property
    def raw(self) -> Array:
        """Sensor values of MuJoCo at the last `look`, (nsensordata,)."""
        return np.asarray(self._copy.sensordata)

    def sensors(self, raw: Array | None = None) -> Array:
        """Return the plant's sensor values, (..., n_sensors), from raw values.

        Parameters
        ----------
        raw : array or None
            Sensor values of MuJoCo, (..., nsensordata); those of the last `look` by default.

        Returns
        -------
        array
            Sensor values of the plant, (..., n_sensors).
        """
        raw = self.raw if raw is None else raw
        values = raw @ self._sum.T
        travel = raw[..., self.plant.travel]
        if self._range is not None and travel.shape[-1] == len(self._coils):
            values[..., self._coils] *= coil_gain(travel, self._range)
        return np.asarray(values)

    def values(self, compared: tuple[Compared, ...], sensors: Array) -> Array:
        """Return compared channels at the last `look`, with zeros for commands."""
        return np.array([self._value(c, sensors) for c in compared])

    def _value(self, compared: Compared, sensors: Array) -> float:
        if compared.sensor is not None:
            return float(sensors[compared.sensor])
        if not compared.port:
            return 0.0
        port, data = self.plant.port(compared.port), self._copy
        if compared.order == 0:
            return port.position(data)
        return float(port.row(data) @ (data.qvel if compared.order == 1 else data.qacc))

    def rest_values(self, compared: tuple[Compared, ...]) -> Array:
        """Return the values of compared channels at rest."""
        self.start(self.rest)
        self.look(np.zeros(self.model.nu))
        return self.values(compared, self.sensors())


@dataclass(frozen=True, eq=False)
class Played:
    """Compared channels at the readings, commands included."""

    times: Array
    values: Array

    def at(self, time: Array, clock: Clock, column: int, *, is_held: bool = False) -> Array:
        """Return a channel at given times, interpolated between readings if necessary.

        Parameters
        ----------
        time : array
            Times from the start [s].
        clock : Clock
            Clock of the run.
        column : int
            Column of the channel.
        is_held : bool
            Whether the channel stays constant between readings.

        Returns
        -------
        array
            Values at the times.
        """
        values = self.values[:, column]
        if clock.on_time:
            return np.asarray(values[np.rint(time / (clock.steps * clock.timestep)).astype(int)])
        if is_held:
            return np.asarray(values[np.searchsorted(self.times, time + 1e-9 * clock.timestep, side="right") - 1])
        return np.asarray(CubicSpline(self.times, values)(time))


def at_timestep(plant: Plant, timestep: float) -> Plant:
    """Return the plant with another integration step.

    Parameters
    ----------
    plant : Plant
        Plant.
    timestep : float
        Integration step [s].

    Returns
    -------
    Plant
        Plant with that step.
    """
    if plant.timestep == timestep:
        return plant
    model = copy.copy(plant.model)
    model.opt.timestep = timestep
    return replace(plant, model=model)


def bench_for(plant: Plant, run: Run) -> Bench:
    """Return the bench for a run of a plant."""
    return Bench(plant, None if run.hardware is None else run.hardware.velocity_sensor.linear_range)


def play(
    bench: Bench,
    run: Run,
    clock: Clock,
    state: State,
    law: Law | None,
    progress: Callable[[float], None] = lambda share: None,
    *,
    is_at_rest: bool | None = None,
) -> Played:
    """Simulate a plant under recorded inputs and a law.

    Parameters
    ----------
    bench : Bench
        Plant with its readings.
    run : Run
        Recording with its channel map.
    clock : Clock
        Clock of the run.
    state : State
        Initial state.
    law : Law or None
        Law with its initial memory, which is updated.
    progress : callable
        Receives the completed share of the run.
    is_at_rest : bool or None
        Whether the run starts at rest, with zero commands before; by default if `state` is the model's rest.

    Returns
    -------
    Played
        Compared channels at the readings.

    Raises
    ------
    Diverged
        The state left the finite range or MuJoCo reset the run.
    BadStructure
        MuJoCo cannot compute the model in a state of the run.
    """
    if is_at_rest is None:
        is_at_rest = not np.any(state.qvel) and bool(np.all(state.qpos == bench.rest.qpos))
    physics = _physics(bench, run, clock, state, is_at_rest)
    callback = nullcontext() if physics is None else control_callback(bench.data, physics.callback)
    with computable(f"{run.name}: the model as it moves"), callback:
        return _played(bench, run, clock, state, law, physics, progress, is_at_rest)


def _played(
    bench: Bench,
    run: Run,
    clock: Clock,
    state: State,
    law: Law | None,
    physics: Running | None,
    progress: Callable[[float], None],
    is_at_rest: bool,
) -> Played:
    plant, model, data = bench.plant, bench.model, bench.data
    means, present = drives_of(run, clock, plant, stood=not is_at_rest)
    loads = [drive for drive in run.drives if drive.port]
    load_means, load_present = inputs_of(run, clock, loads, stood=not is_at_rest)
    ports = [plant.port(drive.port) for drive in loads]
    push = None if law is None else _chain(law, run, clock)
    controls = plant.control_matrix
    every = bool(loads) or plant.prescribed is not None or physics is not None
    feedback = np.zeros((clock.steps * clock.law_every, len(plant.actuators)))
    command = np.zeros(len(plant.actuators))
    out = np.zeros((clock.readings, len(run.compared)))
    reads_forces = bench.reads_forces(run.compared)
    if law is None and not every and not any(c.order == 2 and c.sensor is None for c in run.compared):
        return Played(clock.times, bench.open_loop(run, state, means @ controls.T, present @ controls.T, progress))
    is_later = law is None and (physics is None or not physics.is_read) and not any(c.port for c in run.compared)
    raw = np.zeros((clock.readings, model.nsensordata)) if is_later else None
    bench.start(state)
    last_check = 0
    times = clock.times
    for k in range(clock.readings):
        part = (k % clock.law_every) * clock.steps
        if reads_forces:
            force = present[k] + feedback[part - 1]
            if physics is not None:
                force = force + physics.last_change
            bench.look(controls @ force, physics, list(zip(ports, load_present[k], strict=True)) if every else None)
        else:
            bench.look_at_motion()
        if raw is not None:
            raw[k] = bench.raw
        else:
            sensors = _read(bench, run, physics, times[k], out[k])
        if law is not None and push is not None and part == 0:
            command[list(law.actuators)] = law.step(sensors)
            feedback[:, list(law.actuators)] = push(command[list(law.actuators)])
        for i, c in enumerate(run.compared):
            if c.actuator is not None:
                out[k, i] = command[c.actuator]
        if k == clock.readings - 1:
            break
        first = k * clock.steps
        force = means[first : first + clock.steps] + feedback[part : part + clock.steps]
        _advance(bench, controls, force, load_means[first : first + clock.steps] if every else None, ports, physics)
        if (k + 1) * clock.steps - last_check >= CHECK_EVERY or k == clock.readings - 2:
            last_check = (k + 1) * clock.steps
            check_run(model, data, last_check * clock.timestep)
            progress((k + 1) / (clock.readings - 1))
    if raw is not None:
        copy_sensors(run.compared, bench.sensors(raw), out)
    return Played(times, out)


def copy_sensors(compared: Sequence[Compared], sensors: Array, out: Array) -> None:
    """Copy the columns of compared sensors.

    Parameters
    ----------
    compared : sequence of Compared
        Compared channels.
    sensors : (n, n_sensors) array
        Sensors of the plant.
    out : (n, n_channels) array
        Compared channels, overwritten where a channel is a sensor.
    """
    for i, c in enumerate(compared):
        if c.sensor is not None:
            out[:, i] = sensors[:, c.sensor]


def _read(bench: Bench, run: Run, physics: Running | None, time: float, out: Array) -> Array:
    """Return the bench's sensor values and write those of the compared channels."""
    sensors = bench.sensors()
    if physics is not None:
        physics.sense(sensors, time)
    out[:] = bench.values(run.compared, sensors)
    if physics is not None:
        for i, c in enumerate(run.compared):
            out[i] = physics.read(c.channel, float(out[i]), time)
    return sensors


def _physics(bench: Bench, run: Run, clock: Clock, state: State, is_at_rest: bool) -> Running | None:
    """Return the attached physics of a plant.

    A run in the middle of a motion continues from its first readings and commands, a run at rest from the values at
    rest.
    """
    plant = bench.plant
    if not plant.physics:
        return None
    read = {c.channel: plant.sensors[c.sensor].name for c in run.compared if c.sensor is not None}
    rest = bench.rest_values(run.compared)
    if is_at_rest:
        readings = {c.channel: float(r) for c, r in zip(run.compared, rest, strict=True) if r}
    else:
        first = [
            float(run.measured[c.channel][0]) + (r if c.from_rest else 0.0)
            for c, r in zip(run.compared, rest, strict=True)
        ]
        readings = {c.channel: value for c, value in zip(run.compared, first, strict=True) if np.isfinite(value)}
    return Running(
        plant,
        sample=clock.steps * clock.timestep,
        channels=read,
        readings=readings,
        commands=None if is_at_rest else drives_of(run, clock, plant)[0][:1].sum(axis=0),
    )


def _advance(
    bench: Bench,
    controls: Array,
    force: Array,
    loads: Array | None,
    ports: Sequence[Port],
    physics: Running | None = None,
) -> None:
    """Integrate to the next reading under forces and loads."""
    plant, data = bench.plant, bench.data
    if loads is None and (len(force) == 1 or np.ptp(force, axis=0).max(initial=0.0) == 0.0):
        data.ctrl[:] = controls @ force[0]
        mujoco.mj_step(plant.model, data, nstep=len(force))
        return
    for i, row in enumerate(force):
        if physics is not None:
            physics.actuate(row)
            physics.force[:], physics.is_due = row, True
        data.ctrl[:] = controls @ row
        if loads is not None:
            bench.apply(data, list(zip(ports, loads[i], strict=True)))
        mujoco.mj_step(plant.model, data)


def _chain(law: Law, run: Run, clock: Clock) -> Callable[[Array], Array]:
    """Return the map from commands to forces."""
    substeps = clock.steps * clock.law_every
    converter = _ideal(law.rate_hz) if run.hardware is None else run.hardware.at_rate(law.rate_hz).converter
    return OutputChain(converter, channels=len(law.actuators), substeps=substeps).push


def _ideal(rate: float) -> Converter:
    return Converter(rate=rate, lowest_rate=rate, highest_rate=rate, delay_samples=0.0, filter_corner=0.0)
