"""Force laws at places, and their solution within a step.

A force is positive along the coordinate of the place. All values are arrays over parallel recordings.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from vlab.signals import Array

Memory = dict[str, Any]


class Law:
    """Force along a place."""

    def start(self, runs: int) -> Memory:
        """Return the initial memory."""
        return {"force": np.zeros(runs)}

    def solve(
        self,
        z0: Array,
        v0: Array,
        z1: Array,
        v1: Array,
        a: float,
        b: float,
        t: float,
        h: float,
        coil: Any,
        memory: Memory,
    ) -> Array:
        """Return the mean force over a step.

        Parameters
        ----------
        z0, v0 : (runs,) array
            Displacement and velocity at the beginning.
        z1, v1 : (runs,) array
            Displacement and velocity at the end without the force.
        a, b : float
            Displacement and velocity added by a unit force over the step.
        t, h : float
            Beginning and length of the step [s].
        coil : array or 0
            Commanded force of the actuator along the place.
        memory : Memory
            Memory of the law.

        Returns
        -------
        array
            Mean force, (runs,).
        """
        # one iteration from the last force; the error is the change of force times the small mobility
        z = 0.5 * (z0 + z1 + a * memory["force"])
        v = 0.5 * (v0 + v1 + b * memory["force"])
        force = memory["force"] = self.force(z, v, t + 0.5 * h, h, coil, memory)
        self.keep(z, v, h, memory)
        return force

    def force(self, z: Array, v: Array, t: Any, h: float, coil: Any, memory: Memory) -> Array:
        """Return the force at the middle of a step."""
        raise NotImplementedError

    def keep(self, z: Array, v: Array, h: float, memory: Memory) -> None:
        """Update the memory over a step with this midpoint."""


class Static(Law):
    """Force without memory, of displacement, velocity, time and coil force.

    `of` also takes windows: (steps, runs) arrays with times of shape (steps, 1).
    """

    def __init__(self, of: Callable[[Array, Array, Any, Any], Array]) -> None:
        self._of = of

    def force(self, z: Array, v: Array, t: Any, h: float, coil: Any, memory: Memory) -> Array:
        """See `Law`."""
        return self._of(z, v, t, coil)


class DryFriction(Law):
    """Coulomb friction as a stopping impulse; `level` depends on speed and time."""

    def __init__(self, level: Callable[[Array, float], Any]) -> None:
        self._level = level

    def solve(
        self,
        z0: Array,
        v0: Array,
        z1: Array,
        v1: Array,
        a: float,
        b: float,
        t: float,
        h: float,
        coil: Any,
        memory: Memory,
    ) -> Array:
        """See `Law`: the stopping force is explicit."""
        most = self._level(v0, t)
        return np.minimum(np.maximum(v1 * (-1.0 / b), -most), most)


class Sliders(Law):
    """Parallel spring-slider pairs: Jenkins element, or Iwan element of several.

    Parameters
    ----------
    stiffness, strength : (m,) array
        Values of each element [N/m, N].
    """

    def __init__(self, stiffness: Any, strength: Any) -> None:
        self._k = np.asarray(stiffness, dtype=float).reshape(-1, 1)
        self._most = np.asarray(strength, dtype=float).reshape(-1, 1)

    def start(self, runs: int) -> Memory:
        """See `Law`: unloaded sliders."""
        return {"force": np.zeros(runs), "at": np.zeros((len(self._k), runs))}

    def _each(self, z: Array, memory: Memory) -> Array:
        return np.minimum(np.maximum(self._k * (z - memory["at"]), -self._most), self._most)

    def force(self, z: Array, v: Array, t: float, h: float, coil: Any, memory: Memory) -> Array:
        """See `Law`."""
        return -self._each(z, memory).sum(axis=0)

    def keep(self, z: Array, v: Array, h: float, memory: Memory) -> None:
        """See `Law`: sliders yield beyond their strength."""
        memory["at"] = z - self._each(z, memory) / self._k


class Yielding(Law):
    """Elastic element with plastic set s: force +k s."""

    def __init__(self, stiffness: float, yields_at: float) -> None:
        self._k, self._at = stiffness, yields_at

    def start(self, runs: int) -> Memory:
        """See `Law`: no set yet."""
        return {"force": np.zeros(runs), "set": np.zeros(runs)}

    def _set(self, z: Array, memory: Memory) -> Array:
        over = z - memory["set"]
        return np.asarray(memory["set"] + over - np.minimum(np.maximum(over, -self._at), self._at))

    def force(self, z: Array, v: Array, t: float, h: float, coil: Any, memory: Memory) -> Array:
        """See `Law`."""
        return self._k * self._set(z, memory)

    def keep(self, z: Array, v: Array, h: float, memory: Memory) -> None:
        """See `Law`."""
        memory["set"] = self._set(z, memory)


class Bristles(Law):
    """Bristle friction, exact over a step of constant velocity.

        F = -F x,  dx/dt = (v - |v| shape(x) x/g(v))/d

    With g = 1 + s exp(-(v/vs)^2) the law is LuGre without micro-damping, with g = 1 Dahl's model.
    """

    def __init__(self, force: float, bend: float, g: Callable[[Array], Any]) -> None:
        self._force, self._bend, self._g = force, bend, g

    def start(self, runs: int) -> Memory:
        """See `Law`: straight bristles."""
        return {"force": np.zeros(runs), "x": np.zeros(runs)}

    def _moved(self, v: Array, h: float, x: Array) -> Array:
        g = self._g(v)
        rest = np.sign(v) * g
        return np.asarray(rest + (x - rest) * np.exp(-np.abs(v) * (h / self._bend) / g))

    def force(self, z: Array, v: Array, t: float, h: float, coil: Any, memory: Memory) -> Array:
        """See `Law`: half way."""
        return -self._force * self._moved(v, 0.5 * h, memory["x"])

    def keep(self, z: Array, v: Array, h: float, memory: Memory) -> None:
        """See `Law`."""
        memory["x"] = self._moved(v, h, memory["x"])


class Hysteresis(Law):
    """Bouc-Wen hysteresis.

    F = -F s,  ds/dt = (v - beta |v| |s|^(n-1) s - gamma v |s|^n)/d
    """

    def __init__(
        self, force: float, yields_at: float, *, beta: float = 0.5, gamma: float = 0.5, n: float = 2.0
    ) -> None:
        self._force, self._d, self._beta, self._gamma, self._n = force, yields_at, beta, gamma, n

    def start(self, runs: int) -> Memory:
        """See `Law`: unloaded."""
        return {"force": np.zeros(runs), "s": np.zeros(runs)}

    def _moved(self, v: Array, h: float, s: Array) -> Array:
        def rate(s: Array) -> Array:
            size = np.abs(s) ** self._n
            return np.asarray((v - self._beta * np.abs(v) * np.sign(s) * size - self._gamma * v * size) / self._d)

        return np.asarray(s + h * rate(s + 0.5 * h * rate(s)))

    def force(self, z: Array, v: Array, t: float, h: float, coil: Any, memory: Memory) -> Array:
        """See `Law`: half way."""
        return -self._force * self._moved(v, 0.5 * h, memory["s"])

    def keep(self, z: Array, v: Array, h: float, memory: Memory) -> None:
        """See `Law`."""
        memory["s"] = self._moved(v, h, memory["s"])


class Relaxing(Law):
    """Parallel Maxwell elements: a fading memory of displacement.

        F = -sum k_i (z - y_i),  dy_i/dt = (z - y_i) w_i

    Parameters
    ----------
    stiffness, omega : (m,) array
        k_i [N/m] and w_i [rad/s].
    stored : float
        Subtracted stiffness, stored by the elements at some frequency [N/m].
    """

    def __init__(self, stiffness: Any, omega: Any, stored: float = 0.0) -> None:
        self._stored = stored
        self._k = np.asarray(stiffness, dtype=float).reshape(-1, 1)
        self._w = np.asarray(omega, dtype=float).reshape(-1, 1)

    def start(self, runs: int) -> Memory:
        """See `Law`: relaxed."""
        return {"force": np.zeros(runs), "y": np.zeros((len(self._k), runs))}

    def force(self, z: Array, v: Array, t: float, h: float, coil: Any, memory: Memory) -> Array:
        """See `Law`: half way."""
        left = (z - memory["y"]) * np.exp(-0.5 * h * self._w)
        return self._stored * z - (self._k * left).sum(axis=0)

    def keep(self, z: Array, v: Array, h: float, memory: Memory) -> None:
        """See `Law`."""
        memory["y"] = z + (memory["y"] - z) * np.exp(-h * self._w)


class Delayed(Law):
    """Force of the past motion: gain z(t - tau) + rate v(t - tau)."""

    def __init__(self, delay: float, gain: float, rate: float) -> None:
        self._delay, self._gain, self._rate = delay, gain, rate

    def start(self, runs: int) -> Memory:
        """See `Law`: at rest."""
        return {"force": np.zeros(runs), "past": [], "runs": runs}

    def force(self, z: Array, v: Array, t: float, h: float, coil: Any, memory: Memory) -> Array:
        """See `Law`."""
        back = max(1, round(self._delay / h))
        past = memory["past"]
        return past[-back] if len(past) >= back else np.zeros(memory["runs"])

    def keep(self, z: Array, v: Array, h: float, memory: Memory) -> None:
        """See `Law`."""
        memory["past"].append(self._gain * z + self._rate * v)


class Tracking(Law):
    """Force of place, speed and a slow level.

    d level/dt = (measure - level)/tau
    """

    def __init__(
        self,
        measure: Callable[[Array, Array], Array],
        of: Callable[[Array, Array, Array], Array],
        rise_s: float,
        fall_s: float,
    ) -> None:
        self._measure, self._of, self._rise, self._fall = measure, of, rise_s, fall_s

    def start(self, runs: int) -> Memory:
        """See `Law`: level zero."""
        return {"force": np.zeros(runs), "level": np.zeros(runs)}

    def force(self, z: Array, v: Array, t: float, h: float, coil: Any, memory: Memory) -> Array:
        """See `Law`."""
        return self._of(z, v, memory["level"])

    def keep(self, z: Array, v: Array, h: float, memory: Memory) -> None:
        """See `Law`."""
        level, now = memory["level"], self._measure(z, v)
        tau = np.where(now > level, self._rise, self._fall)
        memory["level"] = now + (level - now) * np.exp(-h / tau)


class Absorber(Law):
    """Mass on its own nonlinear spring and damper.

    F = -m x'',  x'' = of(z - x) + 2 zeta omega (v - x')
    """

    def __init__(self, mass: float, damping: float, spring: Callable[[Array], Array]) -> None:
        self._m, self._c, self._spring = mass, damping, spring

    def start(self, runs: int) -> Memory:
        """See `Law`: at rest."""
        return {"force": np.zeros(runs), "x": np.zeros(runs), "u": np.zeros(runs)}

    def force(self, z: Array, v: Array, t: float, h: float, coil: Any, memory: Memory) -> Array:
        """See `Law`: spring and damper force at the midpoint."""
        x = memory["x"] + 0.5 * h * memory["u"]
        return -(self._spring(z - x) + self._c * (v - memory["u"]))

    def keep(self, z: Array, v: Array, h: float, memory: Memory) -> None:
        """See `Law`: leap-frog."""
        x = memory["x"] + 0.5 * h * memory["u"]
        u = memory["u"]
        pull = (self._spring(z - x) + self._c * (v - u)) / self._m
        memory["u"] = u + h * pull / (1.0 + 0.5 * h * self._c / self._m)
        memory["x"] = x + 0.5 * h * memory["u"]
