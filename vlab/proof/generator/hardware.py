"""Hardware: converter, delay, filter, noise, mains interference, quantisation.

Signals on the fine clock are constant over its steps. A delay shifts their integral, and a filter is integrated
exactly between edges. Neither reduces the order of accuracy.
"""

from dataclasses import dataclass

import numpy as np
from scipy import interpolate, signal

from vlab.signals import Array


@dataclass(frozen=True, kw_only=True)
class Output:
    """Path of a command to the force.

    Parameters
    ----------
    delay_s : float
        Transport delay before the output of the hold [s].
    corner_hz : float
        Corner of a first-order low-pass [Hz]; zero for none.
    """

    delay_s: float = 0.0
    corner_hz: float = 0.0

    def forces(self, commands: Array, step: float, substeps: int) -> Array:
        """Return forces on the fine clock for held commands."""
        fine = np.repeat(commands, substeps, axis=0)
        fine = late(fine, self.delay_s / step)
        return low_passed(fine, 2 * np.pi * self.corner_hz, step) if self.corner_hz else fine


@dataclass(frozen=True, kw_only=True)
class Converted(Output):
    """Path of a command to the force, with the steps of its converter.

    Parameters
    ----------
    step_n : float
        Step of the converter, in the unit of the commands; zero for none.
    """

    step_n: float = 0.0

    def forces(self, commands: Array, step: float, substeps: int) -> Array:
        """Return forces on the fine clock for rounded and held commands."""
        held = np.round(commands / self.step_n) * self.step_n if self.step_n else commands
        return super().forces(held, step, substeps)


def late(fine: Array, steps: float | Array) -> Array:
    """Return the step means of a delayed staircase.

    Parameters
    ----------
    fine : array
        Values on the fine clock.
    steps : float or array
        Delay in steps, not necessarily whole.

    Returns
    -------
    array
        Delayed step means.
    """
    if np.all(np.asarray(steps) == 0.0):
        return fine
    edges = np.arange(len(fine) + 1)
    integral = np.concatenate([np.zeros((1, *fine.shape[1:])), np.cumsum(fine, axis=0)])
    at = np.maximum(edges - steps, 0.0)
    whole = np.minimum(at.astype(int), len(fine) - 1)
    share = (at - whole).reshape(-1, *[1] * (fine.ndim - 1))
    moved = integral[whole] + share * fine[whole]
    return np.diff(moved, axis=0)


def low_passed(fine: Array, omega: float, step: float) -> Array:
    """Return the step means of x' = omega (w - x), from rest."""
    left = np.exp(-omega * step)
    state = signal.lfilter([0.0, 1.0 - left], [1.0, -left], fine, axis=0)  # at the beginning of the steps
    return np.asarray(fine + (state - fine) * (1.0 - left) / (omega * step))


def filtered(y: Array, numerator: list[float], denominator: list[float], step: float) -> Array:
    """Return samples through a continuous filter."""
    b, a, _ = signal.cont2discrete((numerator, denominator), step, method="foh")
    return np.asarray(signal.lfilter(b.ravel(), a, y, axis=0))


def moved(y: Array, seconds: float, step: float) -> Array:
    """Return samples delayed by cubic splines."""
    time = np.arange(len(y)) * step
    return np.asarray(interpolate.make_interp_spline(time, y, k=3)(np.maximum(time - seconds, 0.0)))


def red_noise(rng: np.random.Generator, shape: tuple[int, ...], rate_hz: float, time_constant: float) -> Array:
    """Return stationary noise of first order with unit variance.

    Parameters
    ----------
    rng : Generator
        Random numbers.
    shape : tuple of int
        Shape, samples first.
    rate_hz : float
        Sample rate [Hz].
    time_constant : float
        Time constant [s].

    Returns
    -------
    array
        Noise.
    """
    pole = np.exp(-1.0 / (rate_hz * time_constant))
    red = rng.standard_normal(shape) * np.sqrt(1.0 - pole**2)
    red[0] /= np.sqrt(1.0 - pole**2)
    return np.asarray(signal.lfilter([1.0], [1.0, -pole], red, axis=0))


@dataclass(frozen=True, kw_only=True, eq=False)
class Pickup:
    """Additions of the electronics to every channel.

    Parameters
    ----------
    sigma : (n_sensors,) array
        Standard deviation of the noise.
    hum, hum_hz : float
        Amplitude of mains interference in multiples of sigma, and its frequency [Hz].
    step : float
        Quantisation step in multiples of sigma.
    coloured : float
        Standard deviation of the coloured part of the noise over that of the white part.
    time_constant : float
        Time constant of the coloured part [s].
    """

    sigma: Array
    hum: float
    hum_hz: float
    step: float
    coloured: float = 0.0
    time_constant: float = 0.0

    def noise(self, rng: np.random.Generator, samples: int, runs: int, rate_hz: float) -> Array:
        """Return noise and mains interference.

        Parameters
        ----------
        rng : Generator
            Random numbers.
        samples : int
            Number of samples.
        runs : int
            Number of recordings.
        rate_hz : float
            Sample rate [Hz].

        Returns
        -------
        array
            Values, (n_samples, n_sensors, runs).
        """
        time = np.arange(samples)[:, None, None] / rate_hz
        phase = rng.uniform(0, 2 * np.pi, (1, len(self.sigma), runs))
        white = rng.standard_normal((samples, len(self.sigma), runs))
        if self.coloured:
            red = red_noise(rng, white.shape, rate_hz, self.time_constant)
            white = (white + self.coloured * red) / np.hypot(1.0, self.coloured)
        hum = self.hum * np.sin(2 * np.pi * self.hum_hz * time + phase)
        return np.asarray((white + hum) * self.sigma[None, :, None])

    def quantised(self, y: Array) -> Array:
        """Return the numbers of the converter."""
        q = (self.step * self.sigma)[None, :, None]
        return np.asarray(np.round(y / q) * q)
