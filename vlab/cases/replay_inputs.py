"""Inputs of a replay: means over steps, values at readings."""

from collections.abc import Sequence

import numpy as np

from vlab.cases.channel_map import Drive, Run
from vlab.cases.clock import Clock
from vlab.errors import BadCase
from vlab.hardware.output_chain import OutputChain
from vlab.plants.base import Plant
from vlab.signals import Array


def drives_of(run: Run, clock: Clock, plant: Plant, *, stood: bool = False) -> tuple[Array, Array]:
    """Return mean and present inputs of all actuators.

    Parameters
    ----------
    run : Run
        Recording with mapped channels.
    clock : Clock
        Clock of the run.
    plant : Plant
        Plant with its actuators.
    stood : bool
        See `before`.

    Returns
    -------
    means : (n_steps, n_actuators) array
        Mean over every step, behind the converter where the case says so.
    present : (n_readings, n_actuators) array
        Value at every reading.

    Raises
    ------
    BadCase
        Commands do not fit the converter's rate.
    """
    means = np.zeros(((clock.readings - 1) * clock.steps, len(plant.actuators)))
    present = np.zeros((clock.readings, len(plant.actuators)))
    drives = [drive for drive in run.drives if drive.actuator is not None]
    each, now = inputs_of(run, clock, drives, stood=stood)
    for i, drive in enumerate(drives):
        if drive.actuator is None:
            continue
        if drive.through_chain and run.hardware is not None:
            each[:, i] = _through_chain(run, clock, drive.channel)
            now[1:, i] = each[clock.steps - 1 :: clock.steps, i]
        means[:, drive.actuator] += each[:, i]
        present[:, drive.actuator] += now[:, i]
    return means, present


def _through_chain(run: Run, clock: Clock, channel: str) -> Array:
    if run.hardware is None or not (clock.on_time and run.measured.is_uniform):
        raise BadCase(f"{run.name}: commands {channel!r} must be sampled evenly to pass the hardware's converter")
    converter = run.hardware.converter
    if abs(run.measured.rate / converter.rate - 1) > 1e-6 or clock.times[1] * run.measured.rate > 1 + 1e-6:
        raise BadCase(
            f"{run.name}: commands {channel!r} are recorded at {run.measured.rate:g} Hz, the converter runs at "
            f'{converter.rate:g} Hz; record them at that rate, or give the forces instead (kind = "force")'
        )
    chain = OutputChain(converter, channels=1, substeps=clock.steps)
    forces = chain.response(run.measured[channel][:, None])[:, 0]
    steps = (clock.readings - 1) * clock.steps
    return np.resize(forces, steps) if forces.size >= steps else np.pad(forces, (0, steps - forces.size), mode="edge")


def inputs_of(run: Run, clock: Clock, drives: Sequence[Drive], *, stood: bool = False) -> tuple[Array, Array]:
    """Return mean and present values of inputs.

    Parameters
    ----------
    run : Run
        Recording with mapped channels.
    clock : Clock
        Clock of the run.
    drives : sequence of Drive
        Inputs.
    stood : bool
        See `before`.

    Returns
    -------
    means : (n_steps, n_drives) array
        Mean over every step.
    present : (n_readings, n_drives) array
        Value at every reading.
    """
    time = run.measured.time - run.measured.time[0]
    steps = (clock.readings - 1) * clock.steps
    means, present = np.zeros((steps, len(drives))), np.zeros((clock.readings, len(drives)))
    for i, drive in enumerate(drives):
        values = run.measured[drive.channel]
        if not drive.is_held:
            means[:, i] = np.interp(clock.middles, time, values)
            present[:, i] = np.interp(clock.times, time, values)
        elif clock.on_time:
            at = np.searchsorted(time, clock.middles, side="right") - 1
            means[:, i] = values[np.maximum(at, 0)]
            present[1:, i] = means[clock.steps - 1 :: clock.steps, i]
        else:
            means[:, i] = held_means(time, values, np.arange(steps + 1) * clock.timestep)
            present[1:, i] = means[clock.steps - 1 :: clock.steps, i]
        if stood and drive.is_held and steps:
            present[0, i] = means[0, i]
        if drive.is_first:
            present[:, i] = values[
                np.maximum(np.searchsorted(time, clock.times + 0.5 * clock.steps * clock.timestep, side="right") - 1, 0)
            ]
    return means, present


def before(u: Array, *, stood: bool = False) -> Array:
    """Return the held commands before each sample.

    Parameters
    ----------
    u : (n, ...) array
        Commands.
    stood : bool
        Whether the first command also stood before the record, as in a record that begins in motion; zero otherwise.

    Returns
    -------
    (n, ...) array
        Commands before the samples.
    """
    return np.concatenate([u[:1] if stood else np.zeros_like(u[:1]), u[:-1]])


def at_samples(values: Array, *, is_held: bool, is_first: bool, stood: bool) -> Array:
    """Return an input as sensors see it at its samples.

    A sensor is read before a held command changes.

    Parameters
    ----------
    values : (n, ...) array
        Input.
    is_held : bool
        Whether the input is held between its samples.
    is_first : bool
        Whether the input changes before the sensors are read.
    stood : bool
        See `before`.

    Returns
    -------
    (n, ...) array
        Values at the samples.
    """
    return before(values, stood=stood) if is_held and not is_first else values


def held_means(time: Array, values: Array, edges: Array) -> Array:
    """Return means of a staircase between edges.

    Parameters
    ----------
    time, values : (n,) array
        Time stamps [s] and held values.
    edges : (m + 1,) array
        Times of the edges [s].

    Returns
    -------
    (m,) array
        Means.
    """
    end = max(edges[-1], time[-1]) + 1.0
    stamps = np.append(time, end)
    integral = np.concatenate([[0.0], np.cumsum(values * np.diff(stamps))])
    return np.diff(np.interp(edges, stamps, integral)) / np.diff(edges)
