"""What can be hidden: its names, where it can sit, how it is drawn, and what it does to the thing on the bench."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from vlab.proof.generator.bench import Bench
from vlab.proof.generator.law import Law
from vlab.signals import Array

On = Literal["point", "element", "any", "coil", "actuator", "sensor", "sensor and coil", "two sensors"]
"""Where something can sit: a point or joint, an elastic element, either of both, a point that an actuator pushes, an
actuator, a sensor, a sensor that picks up a coil or what another sensor sees."""


@dataclass(frozen=True, kw_only=True)
class Scale:
    """How large things are at a place in the loudest recording to fit, without anything hidden.

    Parameters
    ----------
    z, v : float
        Rms displacement and velocity of a place; rms of a sensor's signal and zero.
    peak : float
        Largest displacement; of a sensor's signal, of an actuator's command.
    k, m : float
        Static stiffness and effective mass of a place.
    own : float
        Stiffness of the element at the place.
    u : float
        Rms of the command.
    slope : float
        Largest rate of the command, in its unit per second, of the band-limited signal.
    h, T : float
        Sample period and length of a recording [s].
    low_hz, high_hz : float
        Band of the excitation.
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
    """What a sensor's or actuator's change may look at besides its own signal.

    Parameters
    ----------
    h : float
        Step of the clock [s].
    rng : Generator
        For what changes at random from sample to sample.
    other : array or None
        The second signal.
    """

    h: float
    rng: np.random.Generator
    other: Array | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Action:
    """What something hidden does: exactly one of these.

    Parameters
    ----------
    bench : callable
        From the bench and the place to the bench with it.
    law : callable
        Makes a force law; a law holds no memory, so one serves all recordings.
    command, force : callable
        Changes samples of a command, (n, runs), or the force on the fine clock.
    sensor : callable
        Changes samples of a sensor, (n, runs), before its noise.
    reading : callable
        Changes them behind the noise: a converter rounds and cuts off what it is given.
    """

    bench: Callable[[Bench, str], Bench] | None = None
    law: Law | None = None
    command: Callable[[Array, Signals], Array] | None = None
    force: Callable[[Array, Signals], Array] | None = None
    sensor: Callable[[Array, Signals], Array] | None = None
    reading: Callable[[Array, Signals], Array] | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Kind:
    """A kind of hidden physics.

    Parameters
    ----------
    name : str
        In the vocabulary of `vlab effects` where that has it; else a name of its own.
    form : str
        Which form of the physics: ``""`` is the form of the vocabulary.
    accepted : tuple of str
        Names that are right answers; empty for what no library has.
    make : callable
        Size, drawn shapes and scales to parameters (SI, by the names of `vlab effects` where the law is the same) and the
        action.
    shapes : mapping
        What is drawn besides the size: name to (low, high), evenly; (low, high, "log") evenly in the logarithm;
        ``"sign"`` is +-1.
    start, most : float
        Size to begin with and the largest that makes sense.
    same : bool
        Whether the parameters mean what those of the vocabulary mean.
    """

    name: str
    family: str
    on: On
    make: Callable[[float, Mapping[str, float], Scale], tuple[dict[str, float], Action]]
    shapes: Mapping[str, Any] = field(default_factory=dict)
    form: str = ""
    accepted: tuple[str, ...] = ()
    start: float = 0.05
    most: float = 1e3
    same: bool = True
    angular: bool | None = None

    def draw(self, rng: np.random.Generator) -> dict[str, float]:
        """Draw the shapes."""
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
    """Something hidden, drawn, at a place and of a size."""

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
        """What it does."""
        return self.kind.make(self.size, self.shapes, self.scale)[1]


def places_for(bench: Bench, on: On, *, angular: bool | None, driven: tuple[str, ...]) -> list[str]:
    """Return the places where something can sit.

    Parameters
    ----------
    angular : bool or None
        Only at rotations, only at translations, or either.
    driven : tuple of str
        The actuators that recordings use.
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
