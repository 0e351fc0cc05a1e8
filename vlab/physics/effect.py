"""What an effect of physics is: a law with parameters, and the kind of place on which it acts.

There are four kinds. A *port effect* is a force along a named scalar coordinate of the structure (a displacement, a
rotation, a relative motion). A *linear port effect* is one that adds mass, damping or stiffness there, so it can enter the
matrices instead. An *actuator effect* changes the command on its way to the force; a *sensor effect* changes the motion on
its way to the recorded sample. Laws are written once, for arrays of any shape, and serve three uses: the reduced model of
the search (many parameter sets at once), MuJoCo (one value at a time), and the regression columns of the screening.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np

from vlab.signals import Array

Kind = Literal["port", "actuator", "sensor"]
Values = Mapping[str, Any]
"""Parameter values by name: floats, or arrays that broadcast against the signals."""
ActuatorStep = Callable[[float], float]
"""One sample of a command to one of the force; it keeps what the law remembers."""
SensorStep = Callable[[float, float, float], float]
"""One true sample, its time and the signal that is picked up besides, to the recorded sample."""

Reference = Literal["", "displacement", "velocity", "input", "input-slope", "output", "duration", "step"]


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A parameter of an effect's law.

    Parameters
    ----------
    unit : str
        SI unit at a translation; at a rotation N is N m, m is rad. Of an actuator N stands for the unit of its command, of a
        sensor m for that of its channel.
    low, high : float
        Range of the prior, in that unit, or in multiples of the `reference` where one is given.
    role : str
        ``"amplitude"``: the law is proportional to it, so the screening solves for it. ``"shape"``: the screening tries
        the values of `grid`.
    reference : str
        What the values of `grid`, `low` and `high` are multiples of: the largest displacement or velocity recorded at
        the place, the largest input, slope of the input or output, the duration, or the sample period; "" for none.
    grid : tuple of float
        Values that the screening tries.
    signed : bool
        Whether the parameter may be negative as well; an unsigned one is fitted in its logarithm.
    grain : float
        Relative distance of an unsigned one within which the law may be the same for all values: slopes tell nothing there, and
        this is how well it is known. 0 where the law changes with every change of it.
    """

    name: str
    unit: str
    low: float
    high: float
    role: Literal["amplitude", "shape"] = "amplitude"
    reference: Reference = ""
    grid: tuple[float, ...] = ()
    signed: bool = False
    words: str = ""
    grain: float = 0.0


class Step(NamedTuple):
    """What a law may need of the step that it is evaluated in.

    Parameters
    ----------
    h : float
        Length of the step [s].
    t : float or array
        Time at its middle [s].
    mobility : float or array
        Velocity that a unit force over the step leaves at the port [m/s/N].
    free_velocity : array or None
        Velocity at the end of the step without the effect's own force; None where it is not known.
    command : float or array
        Command of the actuator at the port, where there is one.
    first_velocity : array or None
        Velocity at the beginning of the step; None where it is not known.
    """

    h: float
    t: Any = 0.0
    mobility: Any = 0.0
    free_velocity: Any = None
    command: Any = 0.0
    first_velocity: Any = None


IMPULSE = 4096
"""Samples of the impulse that tells how a sensor's correction stretches noise."""
SETTLING = 512
"""Samples after which a sensor has forgotten, unless it says otherwise."""


OWN_SHARE = 0.1
"""Share of an element's stiffness that a law about the element itself is about, at least."""


class Effect(ABC):
    """One effect of the catalogue; a user's own effect is a subclass in their own file.

    The class attributes say what it is in words and which parameters it has; subclasses of `PortEffect`,
    `LinearPortEffect`, `ActuatorEffect` and `SensorEffect` give its law.
    """

    name: ClassVar[str]
    family: ClassVar[str]
    kind: ClassVar[Kind]
    law: ClassVar[str]
    words: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]]
    needs: ClassVar[tuple[str, ...]] = ()
    """What a place must have: ``"stiffness"`` (an elastic element), ``"coil"`` (an actuator along it), ``"magnet"`` (that,
    or no elastic element, to be sought there), ``"translation"``,
    ``"rotation"``, ``"tension"`` (the rows of a stretched bar); of a sensor ``"command"`` or ``"sensor"``: a second signal
    that it picks up."""
    form_of: ClassVar[str] = ""
    """Name of the effect that this is another form of, under which it is reported."""

    @property
    def physics(self) -> str:
        """The name under which it is reported: another form of an effect is the same physics."""
        return self.form_of or self.name

    @property
    def shapes(self) -> tuple[Parameter, ...]:
        """The parameters that the screening tries on a grid."""
        return tuple(p for p in self.parameters if p.role == "shape")

    @property
    def amplitudes(self) -> tuple[Parameter, ...]:
        """The parameters that the law is linear in."""
        return tuple(p for p in self.parameters if p.role == "amplitude")

    def taken(self, p: Values, h: float) -> Values:
        """Return parameter values as the law takes them where samples are `h` seconds apart: the same, but where it takes few."""
        return p

    def parameter(self, name: str) -> Parameter:
        """Return a parameter by name."""
        return next(p for p in self.parameters if p.name == name)


class PortEffect(Effect):
    """A force along a port's coordinate."""

    kind: ClassVar[Kind] = "port"
    response: ClassVar[Literal["any", "linear", "none"]] = "any"
    """How the force depends on the port's motion. ``"linear"``: force and memory are linear in the motion and the memory, the same
    at all times and under every command; ``"none"``: the force depends on time alone. Such laws are simulated much faster."""
    lasts: ClassVar[bool] = False
    """Whether an event leaves something for good: what begins after it, from the motion as it is, need not show it. The law's size is
    then a stiffness, of the element that the event befalls."""

    def memory(self, shape: tuple[int, ...]) -> list[Any] | None:
        """Return the law's memory before anything happened, a state of this shape each; None for a law without memory."""
        return None

    def of_element(self, p: Values, stiffness: float) -> dict[str, float] | None:
        """Return values with which a law that takes an elastic element's own stiffness does the same in large motion; None for others.

        Parameters
        ----------
        stiffness : float
            Of the element.
        """
        return None

    def is_meant(self, p: Values, stiffness: float) -> bool:
        """Return whether fitted values are what the effect's words say, at a place whose own element has a stiffness, 0 without one."""
        return True

    @abstractmethod
    def force(self, z: Any, v: Any, p: Values, step: Step, memory: Any) -> tuple[Any, Any]:
        """Return the force on the structure along the port, and the memory after the step.

        Parameters
        ----------
        z, v : float or array
            The port's displacement from rest and velocity at the middle of the step.
        p : mapping
            Parameter values.
        memory : list or None
            As returned by `memory` or by the last call.
        """


class LinearPortEffect(Effect):
    """Mass, damping and stiffness added at a port."""

    kind: ClassVar[Kind] = "port"

    @abstractmethod
    def impedance(self, p: Values, own_stiffness: Any) -> tuple[Any, Any, Any]:
        """Return the mass, the damping and the stiffness that it adds.

        Parameters
        ----------
        own_stiffness : float
            Stiffness of the elastic element at the port, where there is one.
        """


class ActuatorEffect(Effect):
    """A change of a command on its way to the force.

    The law is given for a whole signal (`actuate`) and sample by sample (`stepper`), which in a law without memory is the
    same; a law with memory gives both.
    """

    kind: ClassVar[Kind] = "actuator"
    is_clocked: ClassVar[bool] = False
    """Whether it happens where commands are computed, once a sample, and not on their way from there."""

    def stepper(self, p: Values, h: float) -> ActuatorStep:
        """Return the law for one sample after the other, every `h` seconds, as `actuate` has it for all of them."""
        return lambda u: float(self.actuate(np.float64(u), p, h))  # type: ignore[arg-type]

    @abstractmethod
    def actuate(self, u: Array, p: Values, h: float) -> Array:
        """Return the force signals to command signals, time along the first axis, both in the actuator's unit.

        Parameters
        ----------
        h : float
            Sample period [s].
        """


class SensorEffect(Effect):
    """A change of a motion on its way to the recorded sample; whole signals and sample by sample, as in `ActuatorEffect`."""

    kind: ClassVar[Kind] = "sensor"

    def stepper(self, p: Values, h: float) -> SensorStep:
        """Return the law for one sample after the other, every `h` seconds, as `sense` has it for all of them."""
        return lambda y, t, other: float(self.sense(np.float64(y), p, h, np.float64(t)))  # type: ignore[arg-type]

    def resumed(self, p: Values, h: float, reading: float) -> SensorStep:
        """Return the law as `stepper` does, in the middle of a motion: the first sample was recorded as `reading`. What the law remembers
        of the motion before follows from it where its memory is one number; other laws begin as from rest.
        """
        return self.stepper(p, h)

    @abstractmethod
    def sense(self, y: Array, p: Values, h: float, t: Array) -> Array:
        """Return the recorded signals to true ones, time along the first axis.

        Parameters
        ----------
        h : float
            Sample period [s].
        t : (n,) array
            Time stamps from the start of the recording [s].
        """

    @abstractmethod
    def correct(self, y: Array, p: Values, h: float, t: Array) -> Array:
        """Return the true signals to recorded ones: the inverse of `sense`, as far as there is one."""

    def settling_samples(self, p: Values, h: float) -> int:
        """Return after how many samples, `h` seconds apart, nothing shows any more of what the true signal was."""
        return SETTLING

    def stretch(self, p: Values, h: float) -> float:
        """Return the log of how much `correct` magnifies white noise's volume: what a likelihood of true signals must pay.

        For a linear correction it is the mean over all frequencies of the log of its magnitude (Szego's theorem).
        """
        return float(np.mean(np.log(self._response(p, h))))

    def growth(self, p: Values, h: float) -> float:
        """Return how much `correct` magnifies the rms of white noise."""
        return float(np.sqrt(np.mean(self._response(p, h) ** 2)))

    def _response(self, p: Values, h: float) -> Array:
        """Return the magnitude of `correct` over frequency, as an impulse shows it."""
        impulse = np.zeros(IMPULSE)
        impulse[IMPULSE // 2] = 1.0
        with np.errstate(all="ignore"):
            response = np.abs(np.fft.rfft(self.correct(impulse, p, h, np.arange(IMPULSE) * h)))
        return np.asarray(np.clip(response, 1e-6, 1e6))


class PickUp(SensorEffect):
    """A sensor that picks up a second signal: the command of a coil, or what another sensor sees (`needs` says which)."""

    @abstractmethod
    def mix(self, y: Any, other: Any, p: Values) -> Any:
        """Return the recorded signal to the true one and the one that is picked up."""

    def sense(self, y: Array, p: Values, h: float, t: Array) -> Array:
        """See `SensorEffect`: the part that does not come from the other signal."""
        return np.asarray(self.mix(y, 0.0, p))

    def correct(self, y: Array, p: Values, h: float, t: Array) -> Array:
        """See `SensorEffect`: without the other signal nothing is taken off."""
        return y

    def stepper(self, p: Values, h: float) -> SensorStep:
        """See `SensorEffect`."""
        return lambda y, t, other: float(self.mix(y, other, p))


def limited(x: Any, most: Any) -> Any:
    """Return x limited to +-most; plain floats, as in a step of MuJoCo, go ten times as fast as through numpy."""
    if isinstance(x, float) and isinstance(most, float):
        return min(max(x, -most), most)
    return np.minimum(np.maximum(x, -most), most)  # numpy's clip takes longer for the same


def softly_limited(x: Any, most: Any) -> Any:
    """Return x flattened towards +-most, which it never reaches."""
    return most * np.tanh(x / most)


def positive(x: Any) -> Any:
    """Return x where it is above zero, else zero."""
    return max(x, 0.0) if isinstance(x, float) else np.maximum(x, 0.0)


def smooth_sign(x: Any, width: Any) -> Any:
    """Return x/width limited to +-1: a sign that is linear within `width` of zero."""
    return limited(x / np.maximum(width, 1e-300), 1.0)
