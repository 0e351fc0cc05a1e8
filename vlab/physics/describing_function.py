"""Describing functions: first-harmonic equivalents of nonlinear laws under sinusoidal or Gaussian motion.

A port follows z = a sin(omega t). The describing function is the complex stiffness Z = -F1/z1, with the first harmonics
F1 of the force and z1 of the motion. Its real part stores energy, its imaginary part is omega times a damping. Under
Gaussian motion of standard deviation s, amplitudes are Rayleigh distributed. Statistical linearisation is then the mean
of Z(a), weighted with the squared amplitude. For laws without memory the mean is exact (Roberts and Spanos, Random
Vibration and Statistical Linearization, 1990, section 5.3). See also Gelb and Vander Velde, Multiple-Input Describing
Functions and Nonlinear System Design, 1968.
"""

from collections.abc import Callable
from functools import cache
from typing import Any, Literal

import numpy as np
from scipy.special import gammaincinv

from vlab.physics.effect import ChannelEffect, Effect, PortEffect, Step, Values
from vlab.physics.small_signal import is_linear
from vlab.signals import Array, ComplexArray

PER_CYCLE = 256
"""PER_CYCLE [samples]: samples per cycle of the motion. A jump of a law errs by (pi/256)^2/6 = 3e-5 of its harmonic;
raising it costs time."""
SETTLED = 3
"""SETTLED [cycles]: cycles before the measured cycle of a law with memory; raising it costs time."""
INSTANT = 1e-200
"""INSTANT [m/s/N]: mobility under which dry friction reverses at once with the velocity."""
RAYLEIGH = tuple((np.arange(24) + 0.5) / 24)
"""RAYLEIGH [1]: quantiles of the weighted amplitude distribution in a Gaussian mean; more quantiles cost time."""
TRIED = (0.3, 1.0, 3.0)
"""TRIED [1]: amplitudes of the tests of a law, in units of its shape parameters."""
SAME = 1e-6
"""SAME [1]: relative tolerance of the tests of a law."""

Dependence = Literal["displacement", "velocity", "both"]
"""Motion that determines a describing function: Z = f(a), Z = omega f(a omega), or neither form."""


def describing_function(effect: PortEffect, values: Values, amplitude: Any, omega: Any) -> ComplexArray:
    """Return the equivalent complex stiffness of a port law under sinusoidal motion.

    Parameters
    ----------
    effect : PortEffect
        Law.
    values : Values
        Parameter values.
    amplitude : float or array
        Amplitude of the port's displacement, above zero [m or rad].
    omega : float or array
        Circular frequency [rad/s]; the shape broadcasts against `amplitude`.

    Returns
    -------
    complex array
        Resisting force per unit displacement [N/m or N m/rad].
    """
    harmonic, _ = _harmonics(effect, values, amplitude, omega)
    return np.asarray(harmonic / (1j * np.asarray(amplitude, dtype=float)))


def _harmonics(effect: PortEffect, values: Values, amplitude: Any, omega: Any) -> tuple[ComplexArray, Array]:
    """Return first harmonic and mean of the force over a cycle."""
    a, w = np.broadcast_arrays(np.asarray(amplitude, dtype=float), np.asarray(omega, dtype=float))
    p = {name: float(value) for name, value in values.items()}
    theta = 2 * np.pi * (np.arange(PER_CYCLE) + 0.5) / PER_CYCLE
    h = 2 * np.pi / w / PER_CYCLE
    mobility = np.full(a.shape, INSTANT)
    memory = effect.memory(a.shape)
    if memory is None:
        angle = theta.reshape(-1, *(1,) * a.ndim)
        force, _ = effect.force(a * np.sin(angle), a * w * np.cos(angle), p, Step(h, angle / w, mobility), None)
        force = np.broadcast_to(force, (PER_CYCLE, *a.shape))
        turned = np.exp(-1j * theta)
        return 2 * np.tensordot(turned, force, axes=1) / PER_CYCLE, np.mean(force, axis=0)
    chord = np.sin(np.pi / PER_CYCLE) / (np.pi / PER_CYCLE)  # the mean velocity of a step: displacements then close
    harmonic, mean = np.zeros(a.shape, dtype=complex), np.zeros(a.shape)
    for cycle in range(SETTLED + 1):
        for angle in theta.tolist():
            t = (2 * np.pi * cycle + angle) / w
            z, v = a * np.sin(angle), a * w * chord * np.cos(angle)
            force, memory = effect.force(z, v, p, Step(h, t, mobility), memory)
            if cycle == SETTLED:
                harmonic += np.exp(-1j * angle) * force
                mean += force
    return 2 * harmonic / PER_CYCLE, mean / PER_CYCLE


def channel_gain(effect: ChannelEffect, values: Values, amplitude: Any, omega: float) -> ComplexArray:
    """Return the first-harmonic gain of an actuator or sensor law.

    Parameters
    ----------
    effect : ChannelEffect
        Law.
    values : Values
        Parameter values.
    amplitude : float or (n,) array
        Amplitude of the signal before the law, above zero.
    omega : float
        Circular frequency [rad/s].

    Returns
    -------
    complex array
        First harmonic after the law over the one before, shape of `amplitude`.
    """
    a = np.asarray(amplitude, dtype=float)
    p = {name: float(value) for name, value in values.items()}
    angle = 2 * np.pi * (np.arange(PER_CYCLE * (SETTLED + 1)) + 0.5) / PER_CYCLE
    h = 2 * np.pi / omega / PER_CYCLE
    signal = np.sin(angle).reshape(-1, *(1,) * a.ndim) * a
    out = effect.transfer(signal, p, h, angle / omega)
    last = slice(PER_CYCLE * SETTLED, None)
    return np.asarray(2j * np.tensordot(np.exp(-1j * angle[last]), out[last], axes=1) / PER_CYCLE / a)


def gaussian_mean(function: Callable[[Array], ComplexArray], deviation: Any) -> ComplexArray:
    """Return the statistical linearisation of a describing function.

    The weight a^3 exp(-a^2/(2 s^2)) of an amplitude a makes a^2/(2 s^2) a gamma variable of order two. The mean runs
    over the quantiles `RAYLEIGH` of that variable.

    Parameters
    ----------
    function : callable
        Describing function over amplitudes (k, ...).
    deviation : float or array
        Standard deviation of the motion, above zero.

    Returns
    -------
    complex array
        Mean stiffness or gain, shape of `deviation`.
    """
    s = np.asarray(deviation, dtype=float)
    ratios = _weighted_quantiles().reshape(-1, *(1,) * s.ndim)
    return np.asarray(np.mean(function(ratios * s), axis=0))


@cache
def _weighted_quantiles() -> Array:
    """Return amplitudes over the standard deviation at the quantiles."""
    return np.sqrt(2 * gammaincinv(2.0, np.array(RAYLEIGH)))


def trial_values(effect: Effect) -> dict[str, float]:
    """Return parameter values of order one for unit motion."""
    return {p.name: p.grid[len(p.grid) // 2] if p.grid else 1.0 for p in effect.parameters}


def dependence(effect: Effect) -> Dependence:
    """Return the motion that determines the describing function of a law.

    For an actuator or sensor, displacement stands for the signal and velocity for its slope.

    Parameters
    ----------
    effect : Effect
        Law.

    Returns
    -------
    {"displacement", "velocity", "both"}
        Kind of dependence.
    """
    return _dependence(type(effect))


@cache
def _dependence(law: type[Effect]) -> Dependence:
    effect = law()
    a, values = np.array(TRIED), trial_values(effect)
    here, fast, large = (_tried(effect, values, x, w) for x, w in ((a, 1.0), (a, 2.0), (2 * a, 1.0)))
    size = SAME * (np.abs(here).max() + np.abs(fast).max())
    if np.abs(fast - here).max() <= size:
        return "displacement"
    factor = 2.0 if effect.is_force else 1.0
    return "velocity" if np.abs(fast - factor * large).max() <= size else "both"


def _tried(effect: Effect, values: Values, amplitude: Array, omega: float) -> ComplexArray:
    with np.errstate(all="ignore"):
        if isinstance(effect, PortEffect):
            return describing_function(effect, values, amplitude, omega)
        assert isinstance(effect, ChannelEffect)
        return channel_gain(effect, values, amplitude, omega)


def has_describing_function(effect: Effect) -> bool:
    """Return whether the first harmonic of a law depends on amplitude.

    Such a law is nonlinear, vanishes at rest, exerts no mean force, and shows all its parameters in the first harmonic.
    Laws of time, commands or offsets, and laws of one side fail the test. Laws within a servo act on its error, not on the
    motion alone.

    Parameters
    ----------
    effect : Effect
        Law.

    Returns
    -------
    bool
        Whether responses at several levels can identify the law.
    """
    return _has_describing_function(type(effect))


@cache
def _has_describing_function(law: type[Effect]) -> bool:
    effect = law()
    if is_linear(effect) or effect.response != "any" or effect.is_in_servo:
        return False
    values, a = trial_values(effect), np.array(TRIED)
    own = _tried(effect, values, a, 1.0)
    size = float(np.abs(own).max())
    if not np.isfinite(size) or size == 0 or np.ptp(np.abs(own)) <= SAME * size or not _is_calm(effect, values):
        return False
    if isinstance(effect, PortEffect):
        harmonic, mean = _harmonics(effect, values, a, 1.0)
        if np.any(np.abs(mean) > 1e3 * SAME * np.abs(harmonic)):
            return False
    elif dependence(effect) == "both":
        return False
    moved = ({**values, p.name: 1.3 * values[p.name]} for p in effect.parameters)
    return all(np.abs(_tried(effect, other, a, 1.0) - own).max() > SAME * size for other in moved)


def _is_calm(effect: Effect, values: Values) -> bool:
    """Return whether a law is idle at rest and time-invariant."""
    if isinstance(effect, PortEffect):
        late = 50.0
        still, _ = effect.force(0.0, 0.0, values, Step(0.01, late, INSTANT), effect.memory(()))
        first, _ = effect.force(0.7, 0.4, values, Step(0.01, 0.0, INSTANT), effect.memory(()))
        again, _ = effect.force(0.7, 0.4, values, Step(0.01, late, INSTANT), effect.memory(()))
        return bool(still == 0 and first == again)
    assert isinstance(effect, ChannelEffect)
    return not np.any(effect.transfer(np.zeros(64), values, 0.01, np.arange(64) * 0.01))
