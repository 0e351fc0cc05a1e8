"""Inputs of a run: values at samples, means over intervals."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from vlab.cases.channel_map import Run
from vlab.hardware.output_chain import OutputChain
from vlab.signals import Array


class RecordedInput(NamedTuple):
    """One input of a run.

    Parameters
    ----------
    column : int
        Index among the actuators, followed by the directly driven ports.
    values : (n_samples,) array
        Values at the samples.
    is_held : bool
        Whether the input is held between samples.
    is_first : bool
        Whether a sensor sees the new value at the sample already.
    """

    column: int
    values: Array
    is_held: bool
    is_first: bool


def recorded_inputs(
    run: Run, n_actuators: int, port_names: Sequence[str], commands: Array | None, *, through_hardware: bool
) -> Iterator[RecordedInput]:
    """Yield the inputs of a run: drives, then commands of its law.

    Parameters
    ----------
    run : Run
        Recording.
    n_actuators : int
        Number of actuators.
    port_names : sequence of str
        Directly driven ports.
    commands : (n_samples, n_actuators) array or None
        Commands of a control law.
    through_hardware : bool
        Whether commands pass the output hardware of the run.

    Yields
    ------
    RecordedInput
        Input of one actuator or port; several may share a column.
    """
    for drive in run.drives:
        values, is_held = run.measured[drive.channel], drive.is_held
        if through_hardware and drive.through_chain and run.hardware is not None:
            values, is_held = behind_hardware(run, values, run.hardware.converter.rate), True
        at = n_actuators + list(port_names).index(drive.port) if drive.actuator is None else drive.actuator
        yield RecordedInput(at, values, is_held, drive.is_first)
    for i, column in enumerate([] if commands is None else commands.T):
        if through_hardware and run.law is not None:
            column = behind_hardware(run, column, run.law.rate_hz)
        yield RecordedInput(i, column, True, False)


def behind_hardware(run: Run, commands: Array, rate_hz: float) -> Array:
    """Return the mean force of every sample behind the run's output hardware.

    Delay, hold and filter act where the run is sampled at the converter's rate. Otherwise the commands are the forces.

    Parameters
    ----------
    run : Run
        Recording with its hardware.
    commands : (n,) array
        Commands.
    rate_hz : float
        Rate of the commands [Hz].

    Returns
    -------
    (n,) array
        Mean forces.
    """
    if run.hardware is None or abs(run.measured.rate / rate_hz - 1) > 1e-6 or not run.measured.is_uniform:
        return commands
    converter = run.hardware.at_rate(rate_hz).converter
    return OutputChain(converter, channels=1).response(commands[:, None])[:, 0]


def interval_means(time: Array, values: Array, is_held: bool, grid: Array) -> Array:
    """Return the mean of an input over every interval of a grid.

    The last interval continues the input: held, or along its last slope.

    Parameters
    ----------
    time : (n,) array
        Times of the input [s].
    values : (n,) array
        Input.
    is_held : bool
        Whether the input is held between its times (zero-order hold); linear otherwise.
    grid : (m,) array
        Uniform times [s].

    Returns
    -------
    (m,) array
        Means from every time of the grid to the next.
    """
    h = grid[1] - grid[0]
    edges = np.append(grid, grid[-1] + h)
    if is_held:
        end = max(edges[-1], time[-1]) + h
        integral = np.concatenate([[0.0], np.cumsum(values * np.diff(np.append(time, end)))])
        at = np.interp(edges, np.append(time, end), integral)
    else:
        integral = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(time))])
        fine = np.searchsorted(time, edges, side="right").clip(1, len(time) - 1) - 1
        part = np.clip(edges - time[fine], 0.0, None)
        slope = (values[fine + 1] - values[fine]) / (time[fine + 1] - time[fine])
        at = integral[fine] + values[fine] * part + 0.5 * slope * part**2
    return np.asarray(np.diff(at) / h)
