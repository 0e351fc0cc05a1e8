"""Runs of a case on one clock, for the search.

Inputs are means over the sample intervals, outputs are deviations from rest.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy import signal

from vlab.cases.channel_map import Compared, Run
from vlab.cases.initial_state import begins_at_rest
from vlab.cases.replay_inputs import at_samples
from vlab.diagnose.data.band import fastest
from vlab.diagnose.data.noise import is_motion, known_noise, noise_level
from vlab.diagnose.data.quality import is_informative, on_clock
from vlab.diagnose.data.recorded_inputs import interval_means, recorded_inputs
from vlab.diagnose.settings import RUNS
from vlab.plants.base import Plant
from vlab.signals import Array, sample_period


@dataclass(frozen=True, kw_only=True, eq=False)
class Signals:
    """One run on the clock of the search.

    Parameters
    ----------
    name, role : str
        Name and role of the run.
    h : float
        Sample period of the search [s].
    u : (n, n_actuators) array
        Mean command of every actuator over each sample interval.
    load : (n, n_ports) array
        Mean force on directly driven ports over each sample interval [N or N m].
    y : (n, n_channels) array
        Compared channels [SI], as deviation from the model's rest unless the recording counts from rest.
    noise : (n_channels,) array
        Standard deviation of the noise of y.
    scale : (n_channels,) array
        Rms of y about its mean, above zero.
    at_rest : bool
        Whether the run starts at rest.
    t0 : float
        Time of the first sample in the recording [s].
    start : (2m,) array or None
        Known modal state at the first sample.
    before : (k, 2m) array or None
        Modal states before the first sample, for hysteretic laws.
    shown : (k, n_channels) array or None
        Smoothed channels before the first sample without sensor effects, for sensors with dynamics.
    led : (k, n_actuators) array or None
        Commands before the first sample, for actuators with memory.
    valid : (n, n_channels) array of bool or None
        Mask of informative samples; all by default.
    end : float or None
        Time of the last sample [s] where the sample period is uneven.
    now : (n, n_actuators) array or None
        Command of every actuator as readings see it at the samples; by default that before the samples.
    """

    name: str
    role: str
    h: float
    u: Array
    load: Array
    y: Array
    noise: Array
    scale: Array
    at_rest: bool
    t0: float = 0.0
    start: Array | None = None
    before: Array | None = None
    shown: Array | None = None
    led: Array | None = None
    valid: Array | None = None
    end: float | None = None
    now: Array | None = None

    @property
    def seen(self) -> Array:
        """Commands (n, n_actuators) as readings see them at the samples."""
        if self.now is not None:
            return self.now
        led = self.command_before if self.led is None or not len(self.led) else self.led[-1]
        return np.concatenate([np.reshape(led, (1, -1)), self.u[:-1]])

    @property
    def last_s(self) -> float:
        """Time of the last sample in the recording [s]."""
        return self.t0 + (len(self.y) - 1) * self.h if self.end is None else self.end

    @property
    def usable(self) -> Array:
        """Weights (n, n_channels): one for informative samples, otherwise zero."""
        return np.ones(self.y.shape) if self.valid is None else np.asarray(self.valid, dtype=float)

    @property
    def t(self) -> Array:
        """Time stamps from the start of the recording [s]."""
        return self.t0 + np.arange(len(self.y)) * self.h

    @property
    def command_before(self) -> Array:
        """Commands (n_actuators,) before the run: zero at rest, else the first."""
        return 0.0 * self.u[0] if self.at_rest else self.u[0]

    def __len__(self) -> int:
        return len(self.y)

    def first(self, most: int) -> "Signals":
        """Return the first samples alone."""
        valid = None if self.valid is None else self.valid[:most]
        now = None if self.now is None else self.now[:most]
        return replace(self, u=self.u[:most], load=self.load[:most], y=self.y[:most], valid=valid, now=now)


@dataclass(frozen=True, kw_only=True, eq=False)
class Feedthrough:
    """Instantaneous response of channels to inputs.

    Parameters
    ----------
    direct : (n_channels, n_actuators + n_ports) array
        Response to the acceleration from a unit command or load.
    still : (n_channels, n_actuators + n_ports) array
        Response to a unit command or load without acceleration of the dynamic modes: force sensors, and quasi-static
        modes above the band. Actuator effects are excluded.
    moving : (n_channels, n_actuators + n_ports) array
        Response to a unit rate of a command or load: velocities of quasi-static modes.

    Notes
    -----
    All values are nominal. The error of a refitted gain is of second order: deviation times difference.
    """

    direct: Array
    still: Array
    moving: Array

    def shows(self, column: int) -> bool:
        """Return whether any channel responds instantaneously to an input."""
        return any(np.any(part[:, column]) for part in (self.direct, self.still, self.moving))

    def ahead(self, column: int, mean: Array, now: Array, h: float) -> Array:
        """Return the channels' difference between present input and interval mean.

        Parameters
        ----------
        column : int
            Index of the input.
        mean, now : (n,) array
            Interval means and present values of the input.
        h : float
            Sample period [s].

        Returns
        -------
        (n, n_channels) array
            Difference [SI].
        """
        out = np.outer(now - mean, self.direct[:, column]) + np.outer(now, self.still[:, column])
        return out + np.outer(np.gradient(now, h), self.moving[:, column])


def windows(run: Signals, states: Array, shown: Array, slowest_hz: float) -> list[Signals]:
    """Divide a run into windows with known initial states.

    A fit cannot lose the phase over a long record then.

    Parameters
    ----------
    run : Signals
        Run.
    states : (n, 2m) array
        Smoothed modal states.
    shown : (n, n_channels) array
        Channels of these states.
    slowest_hz : float
        Frequency of the slowest oscillating mode [Hz]; 0 without one.

    Returns
    -------
    list of Signals
        Windows.
    """
    n = len(run)
    length = max(n // RUNS.windows, RUNS.least_window, int(RUNS.cycles / (slowest_hz * run.h)) if slowest_hz > 0 else 0)
    count = max(1, n // length)
    edges = np.linspace(0, n, count + 1).astype(int)
    out = []
    for i, (a, b) in enumerate(pairwise(edges)):
        part = slice(a, b)
        out.append(
            replace(
                run,
                name=f"{run.name}[{i}]",
                u=run.u[part],
                load=run.load[part],
                y=run.y[part],
                valid=None if run.valid is None else run.valid[part],
                at_rest=run.at_rest and i == 0,
                t0=run.t0 + float(a * run.h),
                start=states[a],
                before=states[max(a - RUNS.long_preroll, 0) : a],
                shown=shown[:a],
                led=run.u[max(a - RUNS.long_preroll, 0) : a],
                now=None if run.now is None else run.now[part],
            )
        )
    return out


def thinning(count: int, h: float, highest_hz: float, enough: int = RUNS.enough_samples) -> int:
    """Return the decimation factor of a run.

    Parameters
    ----------
    count : int
        Samples.
    h : float
        Sample period [s].
    highest_hz : float
        Highest frequency of interest [Hz].
    enough : int
        Length up to which a run is not decimated [samples].

    Returns
    -------
    int
        Factor, at least 1.
    """
    if highest_hz <= 0 or count <= enough:
        return 1
    by_band = int(1.0 / (h * RUNS.points_per_cycle * highest_hz))
    return max(1, min(by_band, count // enough))


def on_grid(time: Array, values: Array, grid: Array, thin: int) -> Array:
    """Resample a channel to a grid of every `thin`-th sample.

    A linear-phase low-pass precedes decimation; uneven times are interpolated.

    Parameters
    ----------
    time : (n,) array
        Times of the channel [s].
    values : (n,) array
        Channel.
    grid : (m,) array
        Uniform times [s].
    thin : int
        Decimation factor.

    Returns
    -------
    (m,) array
        Channel on the grid.
    """
    h = sample_period(time)
    even = time[0] + h * np.arange(round((time[-1] - time[0]) / h) + 1)
    aligned = even.size == time.size and bool(np.all(np.abs(even - time) < 1e-3 * h))
    x = values if aligned else np.interp(even, time, values)
    if thin > 1:
        taps = signal.firwin(20 * thin + 1, 1.0 / thin, window="hamming")
        padded = np.concatenate([2 * x[0] - x[10 * thin : 0 : -1], x, 2 * x[-1] - x[-2 : -10 * thin - 2 : -1]])
        x = np.convolve(padded, taps, mode="valid")[: len(x)]
    out = x[::thin]
    return out[: len(grid)] if len(out) >= len(grid) else np.interp(grid, even[::thin] - even[0], out)


def signals_of(
    run: Run,
    plant: Plant,
    compared: Sequence[Compared],
    rest: Array,
    port_names: Sequence[str],
    *,
    orders: Sequence[int],
    commands: Array | None = None,
    highest_hz: float | None = None,
    feedthrough: Feedthrough | None = None,
) -> Signals:
    """Resample one run to the clock of the search.

    Inputs act by their interval means, but sensors measure at their own instant. The instantaneous response to the
    difference is subtracted from the channels.

    Parameters
    ----------
    run : Run
        Recording.
    plant : Plant
        Plant with the actuators.
    compared : sequence of Compared
        Measured channels, without commands.
    rest : (n_channels,) array
        Model values at rest [SI].
    port_names : sequence of str
        Directly driven ports.
    orders : sequence of int
        0 displacement, 1 velocity, 2 acceleration.
    commands : (n_samples, n_actuators) array or None
        Commands of a control law, added to the inputs.
    highest_hz : float or None
        Highest frequency of interest [Hz]; from the run by default.
    feedthrough : Feedthrough or None
        Instantaneous response of channels to inputs.

    Returns
    -------
    Signals
        Run on the clock of the search.
    """
    time = run.measured.time - run.measured.time[0]
    h, n_actuators = sample_period(time), len(plant.actuators)
    columns = np.column_stack(
        [run.measured[c.channel] - (0.0 if c.from_rest else r) for c, r in zip(compared, rest, strict=True)]
    )
    top = fastest(columns, h, orders) if highest_hz is None else highest_hz
    thin = thinning(len(time), h, top)
    grid = h * thin * np.arange(round(time[-1] / h) // thin + 1)
    recorded = np.column_stack([on_grid(time, column, grid, thin) for column in columns.T])
    y, inputs = recorded.copy(), np.zeros((len(grid), n_actuators + len(port_names)))
    seen = np.zeros_like(inputs)

    slow = np.array([order < 2 for order in orders])
    is_driven = bool(run.drives) or commands is not None
    stood = feedthrough is not None and run.initial != "rest" and not (is_driven and begins_at_rest(y, slow, plant))
    for i in recorded_inputs(run, n_actuators, port_names, commands, through_hardware=True):
        mean = interval_means(time, i.values, i.is_held, grid)
        inputs[:, i.column] += mean
        if feedthrough is not None and feedthrough.shows(i.column):
            now = at_samples(i.values, is_held=i.is_held, is_first=i.is_first, stood=stood)
            present = on_grid(time, now, grid, thin)
            seen[:, i.column] += present
            y -= feedthrough.ahead(i.column, mean, present, h * thin)

    usable = on_clock(run, is_informative(run, compared), grid)
    part = liveliest(recorded, RUNS.most_samples)
    recorded, y, inputs, usable, seen = recorded[part], y[part], inputs[part], usable[part], seen[part]
    scale = np.std(recorded, axis=0)
    starts = is_driven and begins_at_rest(y, slow, plant)
    return Signals(
        name=run.name,
        role=run.role,
        h=float(h * thin),
        u=inputs[:, :n_actuators],
        load=inputs[:, n_actuators:],
        y=y,
        noise=np.array(
            [_noise(run, c.channel, column, inputs, thin) for c, column in zip(compared, recorded.T, strict=True)]
        ),
        scale=np.where(scale > 0, scale, np.abs(recorded).max(axis=0, initial=0.0) + 1e-12),
        at_rest=part.start == 0 and (run.initial == "rest" or (run.initial == "auto" and starts)),
        t0=float(grid[part.start]),
        valid=None if usable.all() else usable,
        now=None if feedthrough is None else seen[:, :n_actuators],
    )


def _noise(run: Run, channel: str, column: Array, inputs: Array, thin: int) -> float:
    """Return the standard deviation of a channel's noise.

    While a transient lasts, the periods of a nonlinear motion differ by more than the sensor's noise.
    """
    known = known_noise(run, channel, column, thin)
    if known and known.source != "periods":
        return known.sigma
    return min(known.sigma if known else np.inf, noise_level(column, inputs, is_motion=is_motion(run, channel)))


def liveliest(y: Array, most: int) -> slice:
    """Return the part of `most` samples for the search.

    The first part is used, or the part of most power where the first has little.

    Parameters
    ----------
    y : (n, p) array
        Channels.
    most : int
        Samples of the part.

    Returns
    -------
    slice
        Part.
    """
    n = len(y)
    if n <= most:
        return slice(0, n)
    size = np.std(y, axis=0)
    power = np.sum(((y - y.mean(axis=0)) / np.where(size > 0, size, 1.0)) ** 2, axis=1)
    total = np.concatenate([[0.0], np.cumsum(power)])
    starts = np.append(np.arange(0, n - most, max(most // 8, 1)), n - most)
    held = total[starts + most] - total[starts]
    start = 0 if held[0] >= RUNS.first_will_do * held.max() else int(starts[np.argmax(held)])
    return slice(start, start + most)
