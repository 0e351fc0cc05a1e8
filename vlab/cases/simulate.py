"""Simulation of a recording under its inputs and time stamps."""

import copy
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from vlab.cases.channel_map import Law, Run, compared_with_sensors
from vlab.cases.clock import Clock, plan_clock
from vlab.cases.history import early_error, from_file_start, remembers
from vlab.cases.initial_state import InitialState, find_initial_state
from vlab.cases.replay import Played, play
from vlab.cases.replay_bench import Bench, State, at_timestep, bench_for
from vlab.errors import BadCase, Diverged
from vlab.plants.base import Plant
from vlab.signals import Recording


@dataclass(frozen=True, kw_only=True, eq=False)
class Simulation:
    """Response of the model to a recording's inputs.

    Parameters
    ----------
    recording : Recording
        Channels and time stamps of the recording: inputs as recorded, compared channels from the model.
    initial : InitialState
        Initial state of the model.
    timestep_s : float
        Integration step [s].
    notes : tuple of str
        Remarks on the simulation.
    """

    recording: Recording
    initial: InitialState
    timestep_s: float
    notes: tuple[str, ...] = ()


def simulate(
    plant: Plant,
    run: Run,
    *,
    initial: InitialState | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> Simulation:
    """Simulate a recording.

    The inputs act as recorded. A law in the loop acts on the simulated sensors at its own rate, and the recorded inputs
    add to its commands. Laws with memory may start with the samples before the run, see `vlab.cases.history`. For irregular time stamps, cubic splines interpolate the response of every integration step.

    Parameters
    ----------
    plant : Plant
        Plant with its effects.
    run : Run
        Recording with mapped channels.
    initial : InitialState, optional
        Initial state; estimated by `find_initial_state` by default.
    progress : callable
        Called with the share of the run done.

    Returns
    -------
    Simulation
        Simulated recording and notes.

    Raises
    ------
    Diverged
        The run became nonfinite or MuJoCo reset the state.
    BadCase
        No initial state can be found, or the run is too long.
    """
    once = _simulate(plant, run, initial, progress)
    is_in_motion = initial is None and once.initial.how == "estimated"
    longer = from_file_start(run) if is_in_motion and remembers(plant) else None
    if longer is None:
        return once
    try:
        whole = _simulate(plant, longer, None, progress)
    except (BadCase, Diverged):
        return once
    part = whole.recording.rows(slice(len(longer.measured) - len(run.measured), None))
    window_s = once.initial.window_s
    if early_error(run, part, window_s) >= early_error(run, once.recording, window_s):
        return once
    return replace(
        whole, recording=part, notes=(*whole.notes, "simulated from the start of the file, for laws with memory")
    )


def _simulate(plant: Plant, run: Run, initial: InitialState | None, progress: Callable[[float], None]) -> Simulation:
    """Simulate a recording from its first sample."""
    clock = plan_clock(plant.timestep, run)
    notes = []
    if clock.timestep < (1 - 1e-9) * plant.timestep:
        notes.append(
            f"integration step {clock.timestep:g} s instead of {plant.timestep:g} s, so that it fits the samples"
        )
    plant = at_timestep(plant, clock.timestep)
    bench = bench_for(plant, run)
    law = None
    if run.law is not None:
        law, warmed = warmed_up(run.law, run, bench)
        notes.append(warmed)
    if initial is None:
        initial = find_initial_state(plant, run, law)
    try:
        state = State(initial.qpos, initial.qvel)
        replayed = play(bench, run, clock, state, law, progress, is_at_rest=initial.how == "rest" or None)
    except Diverged as error:
        raise Diverged(f"{run.name}: {error}; are the inputs in the right unit?") from error
    return Simulation(
        recording=_record(bench, run, clock, replayed), initial=initial, timestep_s=clock.timestep, notes=tuple(notes)
    )


def warmed_up(law: Law, run: Run, bench: Bench) -> tuple[Law, str]:
    """Return a law with memory from the preceding samples.

    Parameters
    ----------
    law : Law
        The run's law.
    run : Run
        Recording with mapped channels.
    bench : Bench
        Plant prepared for replay.

    Returns
    -------
    tuple of (Law, str)
        A copy of the law, and a note for the report.
    """
    law = replace(law, controller=copy.deepcopy(law.controller))
    law.controller.reset()
    channels = compared_with_sensors(run, law.sensors)
    if run.before is None or channels is None:
        why = "nothing stands before it in the file" if run.before is None else "not all of its sensors were recorded"
        return law, f"the law starts without memory: {why}"
    rest = bench.rest_values(tuple(channels))
    start = run.measured.time[0]
    count = int((start - run.before.time[0]) * law.rate_hz + 1e-6)
    ticks = start - np.arange(count, 0, -1) / law.rate_hz
    samples = np.column_stack(
        [
            np.interp(ticks, run.before.time, run.before[c.channel]) + (r if c.from_rest else 0.0)
            for c, r in zip(channels, rest, strict=True)
        ]
    )
    y = np.zeros(len(bench.plant.sensors))
    for row in samples:
        y[list(law.sensors)] = row
        law.step(y)
    return law, f"the law's memory at the start comes from the {count} samples before it"


def _record(bench: Bench, run: Run, clock: Clock, replayed: Played) -> Recording:
    time = run.measured.time - run.measured.time[0]
    data = run.measured.data.copy()
    rest = bench.rest_values(run.compared)
    for i, c in enumerate(run.compared):
        values = replayed.at(time, clock, i, is_held=c.actuator is not None)
        data[:, run.measured.index(c.channel)] = values - (rest[i] if c.from_rest else 0.0)
    return replace(run.measured, data=data, meta={"simulated": run.name})
