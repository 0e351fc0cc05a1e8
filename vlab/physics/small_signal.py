"""Linear effects in the frequency domain, derived from their time-domain laws.

A law is written once, as a step in time. A trial motion decides whether the law is linear. A linear force with memory
is identified state by state and converted to continuous time. A linear change of a command or a sample is identified by
its impulse response. A user's own effect therefore needs no separate frequency response.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from scipy import linalg

from vlab.physics.effect import (
    ChannelEffect,
    Effect,
    LinearPortEffect,
    PickUp,
    PortEffect,
    Step,
    Values,
)
from vlab.signals import Array, ComplexArray

TRIED = 48
"""TRIED [steps]: length of the trial motion of the linearity test."""
SCALES = (1e-3, 1.0, 1e3)
"""SCALES [1]: amplitudes of the trial motion in the linearity test."""
SAME = 1e-9
"""SAME [1]: relative tolerance of the linearity test."""
FINE = 1e-4
"""FINE [rad]: step for identifying a law with memory, in phase of the fastest motion of interest."""
PER_CYCLE, IMPULSE = 64, 1 << 15
"""PER_CYCLE [samples]: samples per cycle of the highest frequency in a filter's identification.
IMPULSE [samples]: length of the impulse response."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SmallSignal:
    """A linear force at a port in state-space form.

    F = -(mass z'' + damping z' + stiffness z) - C x, with x' = A x + B [z, z'].

    Parameters
    ----------
    A, B, C : (n, n), (n, 2), (n,) array
        State matrices of the law's memory; empty without memory.
    """

    mass: float
    damping: float
    stiffness: float
    A: Array
    B: Array
    C: Array

    def impedance(self, s: ComplexArray) -> ComplexArray:
        """Return the dynamic stiffness of the effect.

        Parameters
        ----------
        s : complex array
            Complex frequencies [rad/s], any shape.

        Returns
        -------
        complex array
            Resisting force per unit displacement [N/m], shape of `s`.
        """
        s = np.asarray(s, dtype=complex)
        out = (self.mass * s + self.damping) * s + self.stiffness
        if len(self.A):
            moved = self.B[:, 0] + s[..., None] * self.B[:, 1]
            states = np.linalg.solve(s[..., None, None] * np.eye(len(self.A)) - self.A, moved[..., None])[..., 0]
            out = out + states @ self.C
        return np.asarray(out)


def small_signal(
    effect: PortEffect | LinearPortEffect, values: Values, own_stiffness: float, fastest: float
) -> SmallSignal:
    """Return the linear force of an effect at a port.

    Parameters
    ----------
    effect : PortEffect or LinearPortEffect
        Linear port effect.
    values : Values
        Parameter values.
    own_stiffness : float
        Stiffness of the elastic element at the port, if any [N/m or N m/rad].
    fastest : float
        Circular frequency of the fastest motion of interest [rad/s].

    Returns
    -------
    SmallSignal
        Mass, damping, stiffness and the states of the memory.
    """
    none = np.zeros((0, 0)), np.zeros((0, 2)), np.zeros(0)
    if isinstance(effect, LinearPortEffect):
        mass, damping, stiffness = (float(v) for v in effect.impedance(values, own_stiffness))
        return SmallSignal(mass=mass, damping=damping, stiffness=stiffness, A=none[0], B=none[1], C=none[2])
    h, p = FINE / fastest, {k: float(v) for k, v in values.items()}
    start = effect.memory(())
    n = 0 if start is None else len(start)

    def response(z: float, v: float, state: list[float]) -> tuple[float, list[float]]:
        force, after = effect.force(z, v, p, Step(h), state if n else None)
        return float(force), [float(x) for x in after] if n else []

    at_z, at_v = response(1.0, 0.0, [0.0] * n), response(0.0, 1.0, [0.0] * n)
    D = np.array([at_z[0], at_v[0]])
    if n == 0:
        return SmallSignal(mass=0.0, damping=-D[1], stiffness=-D[0], A=none[0], B=none[1], C=none[2])
    units = [response(0.0, 0.0, list(row)) for row in np.eye(n)]
    stepped, read = np.array([after for _, after in units]).T, np.array([force for force, _ in units])
    A = _logarithm(stepped) / h
    B = np.array([at_z[1], at_v[1]]).T / h
    # the force belongs to mid-step, the states to its start: shift by half a step, and by half a step of the input
    C = read @ linalg.expm(-A * h)
    D = D - 0.5 * h * read @ B
    return SmallSignal(mass=0.0, damping=-float(D[1]), stiffness=-float(D[0]), A=A, B=B, C=-C)


def _logarithm(stepped: Array) -> Array:
    """Return the logarithm of a matrix near the identity.

    A short step gives such a matrix.
    """
    x = stepped - np.eye(len(stepped))
    if np.abs(x).sum(axis=0).max() > 0.02:  # the law is much faster than the motion of interest
        return np.real(linalg.logm(stepped))
    out, power = x.copy(), x
    for k in range(2, 8):
        power = -power @ x
        out += power / k
    return np.asarray(out)


def channel_response(effect: ChannelEffect, values: Values, freq: Array) -> ComplexArray:
    """Return the frequency response of a linear actuator or sensor effect.

    For a `PickUp` the response excludes the picked-up signal.

    Parameters
    ----------
    effect : ChannelEffect
        Linear effect.
    values : Values
        Parameter values.
    freq : (n,) array
        Frequencies [Hz].

    Returns
    -------
    complex array
        Response, (n,).
    """
    p = {k: float(v) for k, v in values.items()}
    if isinstance(effect, PickUp):
        return np.full(len(freq), complex(effect.mix(1.0, 0.0, p)))
    top = max(float(np.max(freq)), 1e-9)
    h = 1.0 / (PER_CYCLE * top)
    impulse = np.zeros(IMPULSE)
    impulse[0] = 1.0
    out = effect.transfer(impulse, p, h, np.arange(IMPULSE) * h)
    lines, response = np.fft.rfftfreq(IMPULSE, h), np.fft.rfft(out)
    return np.asarray(np.interp(freq, lines, response.real) + 1j * np.interp(freq, lines, response.imag))


def is_linear(effect: Effect) -> bool:
    """Return whether a law is linear, time-invariant and nonzero.

    The test concerns small motion.
    """
    return effect.is_linear or effect.picks_up or _tried(type(effect))


@cache
def _tried(law: type[Effect]) -> bool:
    effect = law()
    values = {p.name: p.grid[0] if p.grid else 1.0 for p in effect.parameters}
    signal = np.random.default_rng(0).standard_normal(TRIED)
    with np.errstate(all="ignore"):
        runs = [_run(effect, values, scale * signal) / scale for scale in SCALES]
        late = _run(effect, values, np.concatenate([np.zeros(7), signal]))[7:]
    size = np.abs(runs[1]).max()
    return bool(
        np.isfinite(size) and size > 0 and all(np.abs(run - runs[1]).max() <= SAME * size for run in (*runs, late))
    )


def _run(effect: Effect, values: Values, signal: Array) -> Array:
    h = 0.01
    if isinstance(effect, ChannelEffect):
        return effect.transfer(signal, values, h, np.arange(len(signal)) * h)
    assert isinstance(effect, PortEffect)
    memory: Any = effect.memory(())
    out = np.zeros(len(signal))
    rate = np.diff(signal, prepend=0.0) / h
    for k, (z, v) in enumerate(zip(signal.tolist(), rate.tolist(), strict=True)):
        out[k], memory = effect.force(z, v, values, Step(h, k * h), memory)
    return out
