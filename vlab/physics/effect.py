"""Interface of a physical effect: a law, its parameters, its kind of place.

A *port effect* is a force along a named scalar coordinate of the structure (a displacement, a rotation, a relative
motion). A *linear port effect* adds mass, damping or stiffness at a port and can enter the matrices. An *actuator
effect* changes the command on its way to the force. A *sensor effect* changes the motion on its way to the recorded
sample.

A law is written once, for arrays of any shape. The reduced model of the search evaluates a law for many parameter sets
at once, MuJoCo for one value at a time. The screening turns a law into regression columns.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np

from vlab.physics.family import FAMILIES, Family, register_family
from vlab.signals import Array

Kind = Literal["port", "actuator", "sensor"]
Values = Mapping[str, Any]
"""Parameter values by name: floats or arrays that broadcast against the signals."""
ActuatorStep = Callable[[float], float]
"""One command sample to one force sample; the callable holds the law's memory."""
SensorStep = Callable[[float, float, float], float]
"""True sample, its time [s] and the picked-up signal to the recorded sample."""

Scan = Literal["", "delay", "period", "slope"]
Reference = Literal[
    "",
    "displacement",
    "velocity",
    "input",
    "input-slope",
    "output",
    "duration",
    "step",
    "error",
    "servo-force",
    "servo-gain",
]


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A parameter of an effect's law.

    Parameters
    ----------
    unit : str
        SI unit at a translation. At a rotation N stands for N m, and m for rad. For an actuator N stands for the
        command's unit; for a sensor m stands for the channel's unit.
    low, high : float
        Range of the prior, in `unit`, or in multiples of `reference`.
    role : str
        ``"amplitude"``: the law is proportional to the parameter and the screening solves for the value. ``"shape"``:
        the screening tries the values of `grid`.
    reference : str
        Scale of `grid`, `low` and `high`: the largest recorded displacement or velocity at the place, the largest
        input, the largest slope of input or output, the duration, or the sample period. Of a servo: the largest
        position error or force, or the position gain. "" for no scale.
    grid : tuple of float
        Trial values of the screening.
    scan : str
        Further trial values that the screening derives from the recordings: delays over the whole range, whole sample
        periods, or slopes down to that of a slow command. "" for none.
    signed : bool
        Whether negative values are allowed. An unsigned parameter is fitted in its logarithm.
    grain : float
        Relative distance within which an unsigned parameter may leave the law unchanged; this distance bounds the
        parameter's precision, because the Jacobian vanishes within. 0 if the law changes with every change of the
        parameter.
    """

    name: str
    unit: str
    low: float
    high: float
    role: Literal["amplitude", "shape"] = "amplitude"
    reference: Reference = ""
    grid: tuple[float, ...] = ()
    scan: Scan = ""
    signed: bool = False
    words: str = ""
    grain: float = 0.0


class Step(NamedTuple):
    """Data of one integration step that a law may use.

    Parameters
    ----------
    h : float or array
        Length of the step [s].
    t : float or array
        Time at the middle of the step [s].
    mobility : float or array
        Velocity at the port after a unit force over the step [m/s/N].
    free_velocity : array or None
        Velocity at the end of the step without the effect's own force [m/s]; None if unknown.
    command : float or array
        Command of the actuator at the port, if any.
    first_velocity : array or None
        Velocity at the beginning of the step [m/s]; None if unknown.
    damped : float or None
        Share of the step's change of velocity on which the damping of actuators acts, where mobility and free velocity
        leave that damping out: 0 explicit, 1 implicit. None if both include the damping.
    """

    h: Any
    t: Any = 0.0
    mobility: Any = 0.0
    free_velocity: Any = None
    command: Any = 0.0
    first_velocity: Any = None
    damped: float | None = None


TIMES = (1e-4, 3e-4, 1e-3, 3e-3, 0.01, 0.03, 0.1)
"""TIMES [s]: trial delays and time constants, in half decades from 0.1 ms."""
IMPULSE = 4096
"""IMPULSE [samples]: record length for the frequency response of a sensor's correction. Raising it resolves slower
corrections."""
SETTLING = 512
"""SETTLING [samples]: default settling time of a sensor effect."""
OWN_SHARE = 0.1
"""OWN_SHARE [1]: smallest share of an element's stiffness at which a law describes the element itself."""


class Effect(ABC):
    """One effect of the catalogue.

    Class attributes give the description and the parameters. Subclasses of `PortEffect`, `LinearPortEffect`,
    `ActuatorEffect` and `SensorEffect` give the law. A user's own effect is a subclass in a user's file.
    """

    name: ClassVar[str]
    family: ClassVar[str]
    kind: ClassVar[Kind]
    law: ClassVar[str]
    words: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]]
    needs: ClassVar[tuple[str, ...]] = ()
    """Requirements on a place. For a port: ``"stiffness"`` (an elastic element), ``"coil"`` (an actuator along the
    port), ``"magnet"`` (an actuator, or no elastic element), ``"translation"`` or ``"rotation"``. ``"tension"``
    means the rows of a stretched bar, ``"servo"`` a position servo, ``"armature"`` an inertia of the servo's motor. For a sensor: ``"command"`` or ``"sensor"``, the
    kind of the picked-up signal."""
    probe: ClassVar[float] = 1.0
    """Amplitude at which the screening evaluates a law; small where the law is linear in small amplitudes only."""
    form_of: ClassVar[str] = ""
    """Name of the effect of which this class is another form; reports use that name."""
    confirmed_by: ClassVar[str] = ""
    """Measurement that confirms a finding which needs no fit; "" for none."""
    lasts: ClassVar[bool] = False
    """Whether an event leaves a permanent change. A run that begins after the event, from the motion at that time, need
    not show the change. The law's amplitude is then a stiffness of the changed element."""
    is_linear: ClassVar[bool] = False
    """Whether the effect adds mass, damping or stiffness."""
    sought_at: frozenset[str] | None = None
    """Names of the places at which alone the effect is sought, with or without their kind; None for all places."""
    is_last_resort: ClassVar[bool] = False
    """Whether the effect is tried only where no other effect explains the recordings."""

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        own: Any = cls.__dict__.get("family")
        if isinstance(own, Family):  # a family that the effect's own file defines
            register_family(own)
            cls.family = own.name

    @property
    def traits(self) -> Family:
        """Family of the effect; one without traits if the family's name is unknown."""
        return FAMILIES.get(self.family, Family(name=self.family))

    @property
    def acts_in_drive(self) -> bool:
        """Whether the effect changes the force that a sensor of the actuator's force reads."""
        return self.kind == "actuator" or "servo" in self.needs or "coil" in self.needs

    @property
    def needs_rest(self) -> bool:
        """Whether the law is plausible at an element with a position of rest only."""
        return self.traits.needs_rest or "magnet" in self.needs

    @property
    def has_state(self) -> bool:
        """Whether the law remembers the motion."""
        return False

    @property
    def physics(self) -> str:
        """Name in reports, shared by all forms of an effect."""
        return self.form_of or self.name

    @property
    def shapes(self) -> tuple[Parameter, ...]:
        """Parameters that the screening tries on a grid."""
        return tuple(p for p in self.parameters if p.role == "shape")

    @property
    def amplitudes(self) -> tuple[Parameter, ...]:
        """Parameters in which the law is linear."""
        return tuple(p for p in self.parameters if p.role == "amplitude")

    def taken(self, p: Values, h: float) -> Values:
        """Return parameter values as the law uses them.

        Most laws use `p` unchanged; a law with discrete values rounds `p`.

        Parameters
        ----------
        p : Values
            Parameter values.
        h : float
            Sample period [s].
        """
        return p

    def parameter(self, name: str) -> Parameter:
        """Return a parameter by name."""
        return next(p for p in self.parameters if p.name == name)

    def of_element(self, p: Values, stiffness: float) -> dict[str, float] | None:
        """Return values of a law that takes an element's whole stiffness.

        In large motion the law with these values acts like the law with `p`.

        Parameters
        ----------
        p : Values
            Parameter values.
        stiffness : float
            Stiffness of the elastic element [N/m or N m/rad].

        Returns
        -------
        dict of str to float or None
            Parameter values; None for a law without such a form.
        """
        return None

    def is_meant(self, p: Values, stiffness: float) -> bool:
        """Return whether fitted values agree with the effect's description.

        Parameters
        ----------
        p : Values
            Fitted parameter values.
        stiffness : float
            Stiffness of the element at the place, 0 without one [N/m or N m/rad].
        """
        return True


class PortEffect(Effect):
    """A force along the coordinate of a port."""

    kind: ClassVar[Kind] = "port"
    response: ClassVar[Literal["any", "linear", "none"]] = "any"
    """Dependence of the force on the port's motion. ``"linear"``: force and memory are linear in motion and memory, the
    same at all times and under every command. ``"none"``: the force depends on time alone. Both kinds are simulated
    much faster than ``"any"``."""
    is_fast: ClassVar[bool] = False
    """Whether the law moves faster than samples, so that the search takes several steps a sample."""

    @property
    def has_state(self) -> bool:
        """Whether the law remembers the motion."""
        return self.memory((1,)) is not None

    def memory(self, shape: tuple[int, ...]) -> list[Any] | None:
        """Return the law's memory at rest.

        Parameters
        ----------
        shape : tuple of int
            Shape of each state.

        Returns
        -------
        list of object or None
            One array a state; None for a law without memory.
        """
        return None

    @abstractmethod
    def force(self, z: Any, v: Any, p: Values, step: Step, memory: Any) -> tuple[Any, Any]:
        """Return the force along the port and the new memory.

        Parameters
        ----------
        z, v : float or array
            Displacement of the port from rest, and velocity, at the middle of the step.
        p : mapping
            Parameter values.
        step : Step
            Data of the step.
        memory : list or None
            Result of `memory` or of the last call.

        Returns
        -------
        tuple of (object, object)
            Force on the structure [N or N m], and the memory after the step.
        """


class LinearPortEffect(Effect):
    """Mass, damping and stiffness added at a port."""

    kind: ClassVar[Kind] = "port"
    is_linear: ClassVar[bool] = True

    @abstractmethod
    def impedance(self, p: Values, own_stiffness: Any) -> tuple[Any, Any, Any]:
        """Return the added mass, damping and stiffness.

        Parameters
        ----------
        p : Values
            Parameter values.
        own_stiffness : float
            Stiffness of the elastic element at the port, if any [N/m or N m/rad].

        Returns
        -------
        tuple of (object, object, object)
            Mass [kg], damping [N s/m], stiffness [N/m], or their rotational counterparts.
        """


class ActuatorEffect(Effect):
    """A change of a command before the force.

    `actuate` applies the law to a whole signal, `stepper` sample by sample. A law without memory needs `actuate` only;
    a law with memory gives both.
    """

    kind: ClassVar[Kind] = "actuator"
    is_clocked: ClassVar[bool] = False
    """Whether the effect acts at the computation of commands, once a sample, and not behind the converter."""
    keeps_extremes: ClassVar[bool] = False
    """Whether the law remembers extremes of the command for any time, as hysteresis does."""
    keeps_constants: ClassVar[bool] = False
    """Whether a constant added to the command is added to the force, as in a delay or a slew limit."""
    keeps_time: ClassVar[bool] = False
    """Whether the law runs on a clock of its own that starts with the recording, as a hold does."""

    def reach(self, p: Values) -> float:
        """Return the time over which past commands matter [s].

        Parameters
        ----------
        p : Values
            Parameter values.
        """
        return 0.0

    def follow(self, u: Array, p: Values, h: float, before: Any = 0.0) -> Array:
        """Return force signals after a command that stood before the start.

        A law without `keeps_constants` starts from rest.

        Parameters
        ----------
        u : array
            Commands, time along the first axis.
        p : Values
            Parameter values.
        h : float
            Sample period [s].
        before : float or array
            Command before the start, of the shape of one sample.

        Returns
        -------
        array
            Forces, shape and unit of `u`.
        """
        if not (self.keeps_constants and np.any(before)):
            return self.actuate(u, p, h)
        return np.asarray(before + self.actuate(u - before, p, h))

    def follower(self, p: Values, h: float, before: float = 0.0) -> ActuatorStep:
        """Return the sample-by-sample form of `follow`.

        Parameters
        ----------
        p : Values
            Parameter values.
        h : float
            Sample period [s].
        before : float
            Command before the start.
        """
        step = self.stepper(p, h)
        if not (self.keeps_constants and before):
            return step
        return lambda u: before + step(u - before)

    def stepper(self, p: Values, h: float) -> ActuatorStep:
        """Return the sample-by-sample form of `actuate`.

        Parameters
        ----------
        p : Values
            Parameter values.
        h : float
            Sample period [s].
        """
        return lambda u: float(self.actuate(np.float64(u), p, h))  # type: ignore[arg-type]

    @abstractmethod
    def actuate(self, u: Array, p: Values, h: float) -> Array:
        """Return force signals for command signals.

        Parameters
        ----------
        u : array
            Commands, time along the first axis, in the actuator's unit.
        p : Values
            Parameter values.
        h : float
            Sample period [s].

        Returns
        -------
        array
            Forces, shape and unit of `u`.
        """


class SensorEffect(Effect):
    """A change of a motion before the recorded sample.

    `sense` applies the law to a whole signal, `stepper` sample by sample, as in `ActuatorEffect`.
    """

    kind: ClassVar[Kind] = "sensor"

    def stepper(self, p: Values, h: float) -> SensorStep:
        """Return the sample-by-sample form of `sense`.

        Parameters
        ----------
        p : Values
            Parameter values.
        h : float
            Sample period [s].
        """
        return lambda y, t, other: float(self.sense(np.float64(y), p, h, np.float64(t)))  # type: ignore[arg-type]

    def resumed(self, p: Values, h: float, reading: float) -> SensorStep:
        """Return `stepper` for a start in the middle of a motion.

        A law with one state takes its memory from the first recorded sample. Any other law starts from rest.

        Parameters
        ----------
        p : Values
            Parameter values.
        h : float
            Sample period [s].
        reading : float
            Recorded value of the first sample.
        """
        return self.stepper(p, h)

    @abstractmethod
    def sense(self, y: Array, p: Values, h: float, t: Array) -> Array:
        """Return recorded signals for true signals.

        Parameters
        ----------
        y : array
            True signals, time along the first axis.
        p : Values
            Parameter values.
        h : float
            Sample period [s].
        t : (n,) array
            Time stamps from the start of the recording [s].

        Returns
        -------
        array
            Recorded signals, shape of `y`.
        """

    @abstractmethod
    def correct(self, y: Array, p: Values, h: float, t: Array) -> Array:
        """Return true signals for recorded signals.

        `correct` inverts `sense` as far as an inverse exists.
        """

    def settling_samples(self, p: Values, h: float) -> int:
        """Return the settling time of the sensor [samples].

        After this time the recorded signal no longer depends on the initial state.

        Parameters
        ----------
        p : Values
            Parameter values.
        h : float
            Sample period [s].
        """
        return SETTLING

    def stretch(self, p: Values, h: float) -> float:
        """Return the log volume change of white noise under `correct`.

        A likelihood of true signals contains this Jacobian term. For a linear correction G the term is the mean over
        frequency of log |G| (Szego's theorem).

        Parameters
        ----------
        p : Values
            Parameter values.
        h : float
            Sample period [s].
        """
        return float(np.mean(np.log(self._response(p, h))))

    def growth(self, p: Values, h: float) -> float:
        """Return the factor on white noise's rms under `correct`."""
        return float(np.sqrt(np.mean(self._response(p, h) ** 2)))

    def _response(self, p: Values, h: float) -> Array:
        """Return the magnitude of `correct` over frequency.

        The response comes from an impulse.
        """
        impulse = np.zeros(IMPULSE)
        impulse[IMPULSE // 2] = 1.0
        with np.errstate(all="ignore"):
            response = np.abs(np.fft.rfft(self.correct(impulse, p, h, np.arange(IMPULSE) * h)))
        return np.asarray(np.clip(response, 1e-6, 1e6))


class PickUp(SensorEffect):
    """A sensor that picks up a second signal.

    The second signal is the command of a coil or the output of another sensor, as `needs` states.
    """

    @abstractmethod
    def mix(self, y: Any, other: Any, p: Values) -> Any:
        """Return the recorded signal from true and picked-up signals."""

    def sense(self, y: Array, p: Values, h: float, t: Array) -> Array:
        """See `SensorEffect`: without the picked-up signal."""
        return np.asarray(self.mix(y, 0.0, p))

    def correct(self, y: Array, p: Values, h: float, t: Array) -> Array:
        """See `SensorEffect`: without the picked-up signal."""
        return y

    def stepper(self, p: Values, h: float) -> SensorStep:
        """See `SensorEffect`."""
        return lambda y, t, other: float(self.mix(y, other, p))


def limited(x: Any, most: Any) -> Any:
    """Return x limited to +-most.

    Plain floats take a branch that is ten times as fast as numpy; a MuJoCo step uses floats.
    """
    if isinstance(x, float) and isinstance(most, float):
        return min(max(x, -most), most)
    return np.minimum(np.maximum(x, -most), most)  # faster than numpy's clip


def softly_limited(x: Any, most: Any) -> Any:
    """Return x compressed below a limit: most tanh(x/most)."""
    return most * np.tanh(x / most)


def positive(x: Any) -> Any:
    """Return the positive part of x."""
    return max(x, 0.0) if isinstance(x, float) else np.maximum(x, 0.0)


def smooth_sign(x: Any, width: Any) -> Any:
    """Return x/width limited to +-1."""
    return limited(x / np.maximum(width, 1e-300), 1.0)
