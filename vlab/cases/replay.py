"""Step-by-step replay of a recording on a plant.

MuJoCo's semi-implicit steps keep the position half a step ahead of the velocity (see `vlab.plants.base`). A state
here holds position and velocity at the same time.

A run starts with the position advanced by half a step. Each reading comes from a copy of the state without that half
step. Positions, velocities and accelerations of all sensors then belong to the time of the reading.
"""

from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from scipy.interpolate import CubicSpline

from vlab.cases.channel_map import Law, Run
from vlab.cases.clock import Clock
from vlab.cases.open_loop import CHECK_EVERY
from vlab.cases.replay_bench import Bench, NotSafe, State, copy_sensors
from vlab.cases.replay_inputs import drives_of, inputs_of
from vlab.hardware.laboratory import Converter
from vlab.hardware.output_chain import OutputChain
from vlab.lab.callback import control_callback
from vlab.physics.running import Running
from vlab.plants.base import Port, check_run
from vlab.plants.computable import computable
from vlab.signals import Array

if TYPE_CHECKING:
    from vlab.cases.compiled_replay import Records


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
    with computable(f"{run.name}: the model as it moves"):
        try:
            return _played(bench, run, clock, state, law, progress, is_at_rest, may_compile=True)
        except NotSafe:
            return _played(bench, run, clock, state, law, progress, is_at_rest, may_compile=False)


def _played(
    bench: Bench,
    run: Run,
    clock: Clock,
    state: State,
    law: Law | None,
    progress: Callable[[float], None],
    is_at_rest: bool,
    *,
    may_compile: bool,
) -> Played:
    plant, physics = bench.plant, _physics(bench, run, clock, is_at_rest)
    means, present = drives_of(run, clock, plant, stood=not is_at_rest)
    loads = [drive for drive in run.drives if drive.port]
    load_means, load_present = inputs_of(run, clock, loads, stood=not is_at_rest)
    ports = [plant.port(drive.port) for drive in loads]
    every = bool(loads) or plant.prescribed is not None or physics is not None
    if law is None and not every and not any(c.order == 2 and c.sensor is None for c in run.compared):
        controls = plant.control_matrix
        return Played(clock.times, bench.open_loop(run, state, means @ controls.T, present @ controls.T, progress))
    if law is None and may_compile:
        from vlab.cases import compiled_replay  # deferred, because no other replay needs the compiler

        if compiled_replay.can_compile(plant, ports):
            done = compiled_replay.replay_compiled(
                bench, run, state, physics, (means, present), (ports, load_means, load_present), progress
            )
            if done is not None:
                return Played(clock.times, _values_of(bench, run, physics, clock, *done))
    callback = nullcontext() if physics is None else control_callback(bench.data, physics.callback)
    with callback:
        return _stepped(
            bench,
            run,
            clock,
            state,
            law,
            physics,
            (means, present),
            (ports, load_means, load_present) if every else None,
            progress,
        )


def _values_of(
    bench: Bench, run: Run, physics: Running | None, clock: Clock, forces: Array, records: "Records"
) -> Array:
    """Return the compared channels of a compiled run."""
    sensors, times = bench.sensors(records.raw), clock.times
    out = np.zeros((clock.readings, len(run.compared)))
    if physics is not None and physics.has_sensors:
        for k in range(clock.readings):
            if k:
                physics.force[:] = forces[k * clock.steps - 1]
            physics.sense(sensors[k], times[k])
    copy_sensors(run.compared, sensors, out)
    bench.copy_ports(run.compared, (records.qpos, records.qvel, records.qacc), out)
    if physics is not None and physics.is_read:
        for i, c in enumerate(run.compared):
            out[:, i] = [
                physics.read(c.channel, float(value), time) for value, time in zip(out[:, i], times, strict=True)
            ]
    return out


def _stepped(
    bench: Bench,
    run: Run,
    clock: Clock,
    state: State,
    law: Law | None,
    physics: Running | None,
    drives: tuple[Array, Array],
    loads: tuple[Sequence[Port], Array, Array] | None,
    progress: Callable[[float], None],
) -> Played:
    """Simulate step by step, with laws and effects in Python."""
    plant, model, data, (means, present) = bench.plant, bench.model, bench.data, drives
    push = None if law is None else _chain(law, run, clock)
    controls = plant.control_matrix
    feedback = np.zeros((clock.steps * clock.law_every, len(plant.actuators)))
    command = np.zeros(len(plant.actuators))
    out = np.zeros((clock.readings, len(run.compared)))
    reads_forces = bench.reads_forces(run.compared)
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
            present_loads = None if loads is None else list(zip(loads[0], loads[2][k], strict=True))
            bench.look(controls @ force, physics, present_loads, force)
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
        step_loads = None if loads is None else loads[1][first : first + clock.steps]
        _advance(bench, controls, force, step_loads, () if loads is None else loads[0], physics)
        if (k + 1) * clock.steps - last_check >= CHECK_EVERY or k == clock.readings - 2:
            last_check = (k + 1) * clock.steps
            check_run(model, data, last_check * clock.timestep)
            progress((k + 1) / (clock.readings - 1))
    if raw is not None:
        copy_sensors(run.compared, bench.sensors(raw), out)
    return Played(times, out)


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


def _physics(bench: Bench, run: Run, clock: Clock, is_at_rest: bool) -> Running | None:
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
