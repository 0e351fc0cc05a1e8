"""Effects of actuators: from the command to the force."""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np

from vlab.physics.effect.base import Kind
from vlab.physics.effect.channel import ChannelEffect
from vlab.physics.effect.parameter import Values
from vlab.signals import Array

ActuatorStep = Callable[[float], float]
"""One command sample to one force sample; the callable holds the law's memory."""


class ActuatorEffect(ChannelEffect):
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

    @property
    def has_memory(self) -> bool:
        """Whether the law remembers earlier commands, by a `stepper`."""
        return type(self).stepper is not ActuatorEffect.stepper

    def transfer(self, x: Array, p: Values, h: float, t: Array) -> Array:
        """See `ChannelEffect`: `actuate`."""
        return self.actuate(x, p, h)

    def reach(self, p: Values) -> float:
        """Return the time over which past commands matter [s].

        Parameters
        ----------
        p : Values
            Parameter values.
        """
        return 0.0

    def follow(self, u: Array, p: Values, h: float, before: Any = 0.0, *, at_ends: bool = False) -> Array:
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
        at_ends : bool
            Whether to return the forces at the ends of the sample intervals, see `ends`.

        Returns
        -------
        array
            Forces, shape and unit of `u`.
        """
        act = self.ends if at_ends else self.actuate
        if not (self.keeps_constants and np.any(before)):
            return act(u, p, h)
        return np.asarray(before + act(u - before, p, h))

    def ends(self, u: Array, p: Values, h: float) -> Array:
        """Return force signals at the ends of the sample intervals.

        An effect that lets the force move on within an interval overrides the method.

        Parameters
        ----------
        u : array
            Commands, time along the first axis.
        p : Values
            Parameter values.
        h : float
            Sample period [s].

        Returns
        -------
        array
            Forces, shape and unit of `u`; by default those of `actuate`.
        """
        return self.actuate(u, p, h)

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
