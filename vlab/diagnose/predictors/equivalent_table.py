"""Tables of describing functions over the amplitude, for fast and smooth evaluation.

A law is linear in its amplitude parameters, so its describing function is a sum of unit functions. Each unit function is
tabulated over the log of amplitude. Cubic splines through neighbouring values interpolate (Catmull and Rom, in Computer
Aided Geometric Design, 1974, 317-326).
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from vlab.diagnose.settings import EQUIVALENT_TABLE
from vlab.physics.describing_function import channel_gain, dependence, describing_function, gaussian_mean
from vlab.physics.effect import ChannelEffect, Effect, PortEffect, Values
from vlab.signals import Array, ComplexArray

Shapes = tuple[tuple[str, float], ...]
"""Parameter values as a hashable key."""


@dataclass(frozen=True, kw_only=True)
class Equivalent:
    """Equivalent stiffness or gain of a law at amplitudes.

    Parameters
    ----------
    value : complex array
        Stiffness [N/m or N m/rad] or gain [1].
    slope : complex array
        Derivative by the log of amplitude.
    """

    value: ComplexArray
    slope: ComplexArray


def equivalent(
    effect: Effect, values: Values, amplitude: Array, omega: Array, *, is_gaussian: bool = False
) -> Equivalent:
    """Return the equivalent stiffness or gain of a law.

    Parameters
    ----------
    effect : Effect
        Port, actuator or sensor law.
    values : Values
        Parameter values.
    amplitude : array
        Amplitude, or standard deviation of Gaussian motion, above zero.
    omega : array
        Circular frequency of the motion [rad/s], of a shape that broadcasts against `amplitude`.
    is_gaussian : bool
        Whether the motion is Gaussian instead of sinusoidal.

    Returns
    -------
    Equivalent
        Values and slopes over the broadcast shape.
    """
    kind = dependence(effect)
    at = np.asarray(amplitude * omega if kind == "velocity" else amplitude * np.ones_like(omega))
    factor = omega if kind == "velocity" and effect.is_force else 1.0
    position = np.log(at) / _step()
    low, high = _bounds(position)
    nodes = _frequency_nodes(omega) if kind == "both" else ()
    value, slope = np.zeros(at.shape, dtype=complex), np.zeros(at.shape, dtype=complex)
    for weight, name, chosen in _units(effect, values):
        key = (name, chosen, low, high, nodes, is_gaussian)
        if nodes:
            part = _between(type(effect), key, position, np.broadcast_to(np.log(omega), at.shape))
        else:
            part = _interpolated(_table(type(effect), *key)[0], position - low)
        value += weight * part[0]
        slope += weight * part[1] / _step()
    return Equivalent(value=value * factor, slope=slope * factor)


def _step() -> float:
    return float(np.log(10.0) / EQUIVALENT_TABLE.per_decade)


def _bounds(position: Array) -> tuple[int, int]:
    """Return the first and last node, by whole decades."""
    whole = EQUIVALENT_TABLE.per_decade
    reach = EQUIVALENT_TABLE.most_decades * whole
    middle = int(np.floor(np.median(position) / whole)) * whole
    low = int(np.floor((position.min() - 2) / whole)) * whole
    high = int(np.ceil((position.max() + 2) / whole)) * whole
    return max(low, middle - reach), min(high, middle + reach)


def _frequency_nodes(omega: Array) -> tuple[float, ...]:
    """Return three frequencies over the band; a single one has one node."""
    low, high = float(np.min(omega)), float(np.max(omega))
    if high / low < 1.0 + 1e-6:
        return (float(np.sqrt(low * high)),)
    ends = np.log(low), np.log(high)
    count = EQUIVALENT_TABLE.frequencies
    return tuple(np.exp(np.linspace(*ends, count)).round(9).tolist())


def _units(effect: Effect, values: Values) -> list[tuple[float, str, Shapes]]:
    """Return weights, names and parameter values of unit functions."""
    p = {name: float(value) for name, value in values.items()}
    names = [q.name for q in effect.amplitudes] if effect.is_force else []
    if not names:
        return [(1.0, "", tuple(sorted(p.items())))]
    shapes = tuple((q.name, p[q.name]) for q in effect.shapes)
    return [(p[name], name, shapes) for name in names if p[name] != 0.0]


@lru_cache(maxsize=2048)
def _table(
    law: type[Effect], name: str, chosen: Shapes, low: int, high: int, nodes: tuple[float, ...], is_gaussian: bool
) -> ComplexArray:
    """Return a unit function at its nodes, (n_frequencies, n_amplitudes)."""
    effect = law()
    amplitude = np.exp(_step() * np.arange(low, high + 1))
    p = {q.name: 0.0 for q in effect.parameters} | dict(chosen) | ({name: 1.0} if name else {})
    omega = np.array(nodes or (1.0,))

    def function(a: Array) -> ComplexArray:
        if isinstance(effect, PortEffect):
            return describing_function(effect, p, a, omega[:, None])
        assert isinstance(effect, ChannelEffect)
        return channel_gain(effect, p, a, 1.0)

    with np.errstate(all="ignore"):
        grid = np.broadcast_to(amplitude, (len(omega), len(amplitude)))
        out = gaussian_mean(function, grid) if is_gaussian else function(grid)
    return np.nan_to_num(out, nan=0.0, posinf=0.0, neginf=0.0)


def _interpolated(table: ComplexArray, position: Array) -> tuple[ComplexArray, ComplexArray]:
    """Return the spline through a table (n,), and its derivative, at positions."""
    inside = np.clip(position, 1.0, len(table) - 2.0 - 1e-9)
    k = inside.astype(int)
    t = inside - k
    a, b, c, d = (table[k + i] for i in (-1, 0, 1, 2))
    linear, square, cube = c - a, 2 * a - 5 * b + 4 * c - d, 3 * b - a - 3 * c + d
    value = b + 0.5 * t * (linear + t * (square + t * cube))
    return value, 0.5 * (linear + t * (2 * square + 3 * t * cube)) * (inside == position)


def _between(
    law: type[Effect], key: tuple[str, Shapes, int, int, tuple[float, ...], bool], position: Array, log_omega: Array
) -> tuple[ComplexArray, ComplexArray]:
    """Return a unit function between frequencies, by Lagrange's polynomial in log frequency."""
    table, low, nodes = _table(law, *key), key[2], np.log(np.array(key[4]))
    value, slope = np.zeros(position.shape, dtype=complex), np.zeros(position.shape, dtype=complex)
    for i, node in enumerate(nodes):
        others = np.delete(nodes, i)
        weight = np.prod([(log_omega - other) / (node - other) for other in others], axis=0) if len(others) else 1.0
        part = _interpolated(table[i], position - low)
        value += weight * part[0]
        slope += weight * part[1]
    return value, slope
