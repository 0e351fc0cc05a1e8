"""Kinds of hidden effects: names, places, draws and actions."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from vlab.proof.generator.bench import Bench
from vlab.proof.generator.law import Law
from vlab.signals import Array

On = Literal[
    "point", "element", "any", "coil", "actuator", "sensor", "sensor and coil", "two sensors",
    "servo", "all servos", "joint", "all joints", "tip",
]  # fmt: skip
"""Places of an effect. Point or joint; elastic element; either of both; driven point; actuator; sensor; sensor with
pick-up of a coil or another sensor. On an arm or a pendulum: a servo or all, a joint or all, the point of a payload."""


@dataclass(frozen=True, kw_only=True)
class Scale:
    """Signal sizes at a place in the loudest fit recording, without hidden effects.

    Parameters
    ----------
    z, v : float
        Rms displacement and velocity of a place; rms and zero for a sensor.
    peak : float
        Largest displacement, sensor signal or command.
    k, m : float
        Static stiffness and effective mass of a place.
    own : float
        Stiffness of the element at the place.
    u : float
        Rms of the command.
    slope : float
        Largest rate of the band-limited command [unit/s].
    h, T : float
        Sample period and duration of a recording [s].
    low_hz, high_hz : float
        Band of the excitation [Hz].
    """

    z: float = 0.0
    v: float = 0.0
    peak: float = 0.0
    k: float = 0.0
    m: float = 0.0
    own: float = 0.0
    u: float = 0.0
    slope: float = 0.0
    h: float = 0.0
    T: float = 0.0
    low_hz: float = 0.0
    high_hz: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Signals:
    """Other inputs of a changed sensor or actuator.

    Parameters
    ----------
    h : float
        Step of the clock [s].
    rng : Generator
        Random numbers of each sample.
    other : array or None
        Second signal.
    """

    h: float
    rng: np.random.Generator
    other: Array | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Action:
    """Action of a hidden effect; exactly one field is set.

    Parameters
    ----------
    bench : callable
        Maps the bench and the place to the changed bench.
    law : callable
        Returns a force law without memory, for all recordings.
    command, force : callable
        Changes samples of a command, (n, runs), or the force on the fine clock.
    sensor : callable
        Changes samples of a sensor, (n, runs), before its noise.
    reading : callable
        Changes samples after the noise, as a converter does.
    machine : callable
        Maps an arm or a pendulum with its log, and the place, to the changed one.
    """

    bench: Callable[[Bench, str], Bench] | None = None
    law: Law | None = None
    command: Callable[[Array, Signals], Array] | None = None
    force: Callable[[Array, Signals], Array] | None = None
    sensor: Callable[[Array, Signals], Array] | None = None
    reading: Callable[[Array, Signals], Array] | None = None
    machine: Callable[[Any, str], Any] | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Kind:
    """Kind of hidden effect.

    Parameters
    ----------
    name : str
        Name in `vlab effects`, or a name of its own.
    form : str
        Form of the physics; ``""`` is that of the vocabulary.
    accepted : tuple of str
        Right answers; empty outside the library.
    make : callable
        Maps size, drawn shapes and scales (a `Scale`) to parameters and action. Parameters are in SI, with the names of `vlab
        effects` for the same law.
    shapes : mapping
        Draws besides the size: name to (low, high), uniform; (low, high, "log"), log-uniform; ``"sign"``, +-1.
    start, most : float
        Initial and largest size.
    same : bool
        Whether the parameters have the meaning of the vocabulary.
    """

    name: str
    family: str
    on: On
    make: Callable[[float, Mapping[str, float], Any], tuple[dict[str, float], Action]]
    shapes: Mapping[str, Any] = field(default_factory=dict)
    form: str = ""
    accepted: tuple[str, ...] = ()
    start: float = 0.05
    most: float = 1e3
    same: bool = True
    angular: bool | None = None

    def draw(self, rng: np.random.Generator) -> dict[str, float]:
        """Draw the shapes.

        Parameters
        ----------
        rng : Generator
            Random numbers.

        Returns
        -------
        dict
            Values by name.
        """
        out = {}
        for name, given in self.shapes.items():
            if given == "sign":
                out[name] = float(rng.choice([-1.0, 1.0]))
            elif len(given) == 3:
                out[name] = float(np.exp(rng.uniform(np.log(given[0]), np.log(given[1]))))
            else:
                out[name] = float(rng.uniform(*given))
        return out


@dataclass(frozen=True, kw_only=True, eq=False)
class Hidden:
    """Drawn hidden effect with place and size."""

    kind: Kind
    place: str
    shapes: Mapping[str, float]
    scale: Scale
    size: float

    @property
    def parameters(self) -> dict[str, float]:
        """Its parameters."""
        return self.kind.make(self.size, self.shapes, self.scale)[0]

    @property
    def action(self) -> Action:
        """Its action."""
        return self.kind.make(self.size, self.shapes, self.scale)[1]


def places_for(bench: Bench, on: On, *, angular: bool | None, driven: tuple[str, ...]) -> list[str]:
    """Return the possible places of an effect.

    Parameters
    ----------
    bench : Bench
        Bench.
    on : On
        Kind of place.
    angular : bool or None
        True for rotations, False for translations, None for both.
    driven : tuple of str
        Actuators of the recordings.

    Returns
    -------
    list of str
        Names of the places.
    """
    sensors = [f"sensor:{name.partition(':')[2] or name}" for name in bench.sensors]
    if on == "actuator":
        return [f"actuator:{name}" for name in driven]
    if on == "sensor":
        return sensors
    if on == "sensor and coil":
        return [f"{a}/coil:{d}" for a in sensors for d in driven]
    if on == "two sensors":
        return [f"{a}/{b.partition(':')[2]}" for a in sensors for b in sensors if a != b]
    out = []
    for name, place in bench.places.items():
        is_element = (":" in name and not name.startswith("joint:")) or name.startswith("crosspiece")
        right = {
            "any": True,
            "point": not is_element,
            "element": place.stiffness > 0,
            "coil": place.actuator in driven and bool(place.actuator),
        }[on]
        if right and (angular is None or place.angular == angular):
            out.append(name)
    return out
