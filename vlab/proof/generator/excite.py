"""Excitation signals of unit size from a random generator."""

from typing import Any

import numpy as np
from scipy import signal

from vlab.signals import Array

REST_S = 0.25
"""REST_S [s]: silence at the beginning of every recording."""
CLASSES = ("multisine", "sweep", "pulses", "steps", "noise")


def excite(kind: str, rng: np.random.Generator, time: Array, band: tuple[float, float]) -> Array:
    """Return an excitation signal of unit rms.

    Pulses and steps have a band-limited part of unit rms.

    Parameters
    ----------
    kind : str
        One of `CLASSES`.
    rng : Generator
        Random numbers.
    time : (n,) array
        Even time stamps [s].
    band : (float, float)
        Band [Hz].

    Returns
    -------
    array
        Signal, (n,).
    """
    made: dict[str, Any] = {
        "multisine": _multisine,
        "sweep": _sweep,
        "pulses": _pulses,
        "steps": _steps,
        "noise": _noise,
    }
    moving = time >= REST_S
    out = np.zeros(time.size)
    raw = made[kind](rng, time[moving] - REST_S, band)
    fade = np.minimum((time[moving] - REST_S) / 0.2, 1.0)
    out[moving] = raw * fade
    return np.asarray(out / np.sqrt(np.mean(out**2)))


def _multisine(rng: np.random.Generator, time: Array, band: tuple[float, float]) -> Array:
    """Return two periods of equal lines with random phases."""
    period = 0.5 * (time[-1] + time[1] - time[0])
    lines = np.arange(np.ceil(band[0] * period), np.floor(band[1] * period) + 1) / period
    phase = rng.uniform(0, 2 * np.pi, lines.size)
    count = len(time)
    out = np.zeros(count)
    for f, p in zip(lines, phase, strict=True):
        out += np.sin(2 * np.pi * f * time + p)
    return out


def _sweep(rng: np.random.Generator, time: Array, band: tuple[float, float]) -> Array:
    low, high = band if rng.random() < 0.5 else band[::-1]
    return np.asarray(signal.chirp(time, low, time[-1], high, method="logarithmic", phi=rng.uniform(0, 360)))


def _pulses(rng: np.random.Generator, time: Array, band: tuple[float, float]) -> Array:
    """Return half sines at random moments, one every two seconds."""
    width, out = 1.0 / band[1] * 1.5, np.zeros(time.size)
    start = 0.1 + rng.uniform(0, 0.5)
    while start < time[-1] - 1.0:
        inside = (time >= start) & (time < start + width)
        out[inside] += rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 1.0) * np.sin(np.pi * (time[inside] - start) / width)
        start += rng.uniform(1.2, 2.8)
    return out


def _steps(rng: np.random.Generator, time: Array, band: tuple[float, float]) -> Array:
    """Return random steps, rounded over the shortest period of the band."""
    out, at, value = np.zeros(time.size), 0.0, 0.0
    while at < time[-1]:
        value = rng.uniform(-1, 1)
        out[time >= at] = value
        at += rng.uniform(0.5, 2.0)
    window = np.hanning(max(3, round(1.0 / band[1] / (time[1] - time[0]))))
    return np.asarray(np.convolve(out, window / window.sum(), mode="full")[: time.size])


def _noise(rng: np.random.Generator, time: Array, band: tuple[float, float]) -> Array:
    sections = signal.butter(4, band, btype="bandpass", fs=1.0 / (time[1] - time[0]), output="sos")
    return np.asarray(signal.sosfilt(sections, rng.standard_normal(time.size)))
