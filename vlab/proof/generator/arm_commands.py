"""Commands to arms as users record them, and their way into a drive."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from vlab.proof.generator.compilation import compiled
from vlab.proof.generator.hardware import late, low_passed
from vlab.signals import Array

MOTIONS = ("waypoints", "sines", "multisine", "steps")
BAND_HZ = (0.2, 3.0)
"""BAND_HZ [Hz]: lines of a multisine."""
HOLD_S = 0.4
"""HOLD_S [s]: rest at the first posture."""
SMALL = 0.35
"""SMALL [-]: step or multisine amplitude over the half range of a joint."""
WAY: dict[str, float] = {
    "scale": 1.0,
    "offset": 0.0,
    "quantum": 0.0,
    "hold": 1.0,
    "delay": 0.0,
    "slope": np.inf,
    "bend": np.inf,
    "lag": 0.0,
    "second_lag": 0.0,
}
"""WAY: numbers of the way of a command, with their values in an ideal one. Angles in rad, times in s, hold in samples."""


def motion(kind: str, rng: np.random.Generator, time: Array, home: Array, reach: Array) -> Array:
    """Return the commands of one recording.

    Parameters
    ----------
    kind : str
        One of `MOTIONS`.
    rng : Generator
        Random numbers.
    time : (n_samples,) array
        Even time stamps [s].
    home, reach : (n,) array
        Middle and half range of the joints [rad].

    Returns
    -------
    (n_samples, n) array
        Commands [rad], at rest in the first `HOLD_S`.
    """
    made: dict[str, Any] = {"waypoints": _waypoints, "sines": _sines, "multisine": _multisine, "steps": _steps}
    moving = time >= HOLD_S
    out = np.zeros((time.size, home.size))
    unit = made[kind](rng, time[moving] - HOLD_S, home.size)
    out[moving] = unit
    out[~moving] = unit[0]
    return np.asarray(home + reach * out)


def _waypoints(rng: np.random.Generator, time: Array, n: int) -> Array:
    """Return moves of least jerk between random postures, with pauses."""
    now, at = rng.uniform(-0.7, 0.7, n), 0.0
    out = np.tile(now, (time.size, 1))
    while at < time[-1]:
        there = np.clip(now + rng.uniform(-1.2, 1.2, n), -1.0, 1.0)
        takes = rng.uniform(0.5, 1.3)
        s = np.clip((time - at) / takes, 0.0, 1.0)[:, None]
        later = time >= at
        out[later] = (now + (there - now) * (10 * s**3 - 15 * s**4 + 6 * s**5))[later]
        now, at = there, at + takes + rng.uniform(0.1, 0.7)
    return out


def _sines(rng: np.random.Generator, time: Array, n: int) -> Array:
    """Return one slow sine a joint, faded in."""
    hz, size = rng.uniform(0.15, 0.6, n), rng.uniform(0.4, 0.9, n)
    fade = np.minimum(time / 0.8, 1.0)[:, None]
    return np.asarray(fade * size * np.sin(2 * np.pi * time[:, None] * hz) + rng.uniform(-0.1, 0.1, n))


def _multisine(rng: np.random.Generator, time: Array, n: int) -> Array:
    """Return lines of random phase about a posture."""
    span = time[-1] + time[1] - time[0]
    lines = np.arange(np.ceil(BAND_HZ[0] * span), np.floor(BAND_HZ[1] * span) + 1) / span
    out = np.zeros((time.size, n))
    for j in range(n):
        chosen = lines[rng.random(lines.size) < 0.6] if lines.size > 4 else lines
        phase = rng.uniform(0, 2 * np.pi, chosen.size)
        wave = np.sin(2 * np.pi * time[:, None] * chosen + phase).sum(axis=1)
        out[:, j] = SMALL * wave / np.abs(wave).max() + rng.uniform(-0.4, 0.4)
    fade = np.minimum(time / 0.5, 1.0)[:, None]
    middle = out.mean(axis=0)
    return np.asarray(middle + fade * (out - middle))


def _steps(rng: np.random.Generator, time: Array, n: int) -> Array:
    """Return steps of single joints, in turn."""
    now = rng.uniform(-0.5, 0.5, n)
    out = np.tile(now, (time.size, 1))
    at, order = 0.2, list(rng.permutation(n))
    while at < time[-1]:
        j = order.pop(0)
        order.append(j)
        size = SMALL * rng.uniform(0.4, 1.0)
        now[j] += -size if now[j] > 0.0 else size
        out[time >= at] = now
        at += rng.uniform(0.5, 0.9)
    return out


def received(commands: Array, ways: Mapping[str, Array], *, step: float, substeps: int, before: int) -> Array:
    """Return commands as the loops of the drives receive them, on the fine clock.

    Parameters
    ----------
    commands : (n_samples, n) array
        Recorded commands [rad], each held to the next.
    ways : mapping of str to (n,) array
        Numbers of `WAY` by joint.
    step : float
        Fine step [s].
    substeps : int
        Fine steps per sample.
    before : int
        Samples at the first command ahead of the recording.

    Returns
    -------
    ((before + n_samples) substeps, n) array
        Means over the fine steps [rad].
    """
    out = np.zeros(((before + len(commands)) * substeps, commands.shape[1]))
    for j, column in enumerate(commands.T):
        way = {name: float(values[j]) for name, values in ways.items()}
        every = max(1, round(way["hold"]))
        u = column[np.arange(len(column)) // every * every]
        if way["quantum"]:
            u = way["quantum"] * np.round(u / way["quantum"])
        u = way["scale"] * u + way["offset"]
        fine = np.concatenate([np.full(before * substeps, u[0]), np.repeat(u, substeps)])
        if way["delay"]:
            fine = late(fine - u[0], way["delay"] / step) + u[0]
        if np.isfinite(way["slope"]):
            fine = _profile(fine, way["slope"] * step, way["bend"] * step * step)
        for lag in (way["lag"], way["second_lag"]):
            if lag:
                fine = low_passed(fine - u[0], 1.0 / lag, step) + u[0]
        out[:, j] = fine
    return out


@compiled
def _profile(target: Array, most: float, bend: float) -> Array:
    """Return a target of limited slope and limited change of slope."""
    out = np.empty_like(target)
    at, rate = target[0], 0.0
    for i in range(len(target)):
        away = target[i] - at
        if bend == np.inf:
            rate = min(max(away, -most), most)
        else:  # the fastest rate from which it can still stop at the target
            stopping = np.sqrt(2.0 * bend * abs(away) + 0.25 * bend * bend) - 0.5 * bend
            wanted = min(stopping, most, abs(away)) * np.sign(away)
            rate = rate + min(max(wanted - rate, -bend), bend)
        out[i] = at + 0.5 * rate  # its mean over the step
        at = at + rate
    return out
