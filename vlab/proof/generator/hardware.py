"""What stands between commands, structure and recorded numbers: converter, delay, filter; noise, hum, quantisation.

Signals on the fine clock are constant over its steps; a delay moves their integral, a filter is followed exactly from edge
to edge, so that neither costs an order of accuracy.
"""

from dataclasses import dataclass

import numpy as np
from scipy import interpolate, signal

from vlab.signals import Array


@dataclass(frozen=True, kw_only=True)
class Output:
    """The way of a command to the force.

    Parameters
    ----------
    delay_s : float
        Transport delay before the hold's output.
    corner_hz : float
        Of a first-order low-pass; zero for none.
    """

    delay_s: float = 0.0
    corner_hz: float = 0.0

    def forces(self, commands: Array, step: float, substeps: int) -> Array:
        """Return forces on the fine clock, (n_samples * substeps, actuators, runs), of commands held over samples."""
        fine = np.repeat(commands, substeps, axis=0)
        fine = late(fine, self.delay_s / step)
        return low_passed(fine, 2 * np.pi * self.corner_hz, step) if self.corner_hz else fine


def late(fine: Array, steps: float | Array) -> Array:
    """Return a staircase later by a number of steps, not necessarily whole: the means of the moved staircase."""
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
    """Return the step means of x' = omega (w - x) under a staircase w, from rest."""
    left = np.exp(-omega * step)
    state = signal.lfilter([0.0, 1.0 - left], [1.0, -left], fine, axis=0)  # at the beginning of the steps
    return np.asarray(fine + (state - fine) * (1.0 - left) / (omega * step))


def filtered(y: Array, numerator: list[float], denominator: list[float], step: float) -> Array:
    """Return samples through a continuous filter (coefficients of s, highest first), straight lines between samples."""
    b, a, _ = signal.cont2discrete((numerator, denominator), step, method="foh")
    return np.asarray(signal.lfilter(b.ravel(), a, y, axis=0))


def moved(y: Array, seconds: float, step: float) -> Array:
    """Return samples as they were `seconds` ago, by cubic splines; zero before the beginning."""
    time = np.arange(len(y)) * step
    return np.asarray(interpolate.make_interp_spline(time, y, k=3)(np.maximum(time - seconds, 0.0)))


@dataclass(frozen=True, kw_only=True, eq=False)
class Pickup:
    """What the electronics add to every channel.

    Parameters
    ----------
    sigma : (n_sensors,) array
        Standard deviation of the noise.
    hum, hum_hz : float
        Amplitude in multiples of sigma, and frequency.
    step : float
        Quantisation step in multiples of sigma.
    """

    sigma: Array
    hum: float
    hum_hz: float
    step: float

    def noise(self, rng: np.random.Generator, samples: int, runs: int, rate_hz: float) -> Array:
        """Return noise and hum, (n_samples, n_sensors, runs)."""
        time = np.arange(samples)[:, None, None] / rate_hz
        phase = rng.uniform(0, 2 * np.pi, (1, len(self.sigma), runs))
        white = rng.standard_normal((samples, len(self.sigma), runs))
        hum = self.hum * np.sin(2 * np.pi * self.hum_hz * time + phase)
        return np.asarray((white + hum) * self.sigma[None, :, None])

    def quantised(self, y: Array) -> Array:
        """Return the converter's numbers."""
        q = (self.step * self.sigma)[None, :, None]
        return np.asarray(np.round(y / q) * q)
