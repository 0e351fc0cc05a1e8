"""Effects of sensors: from the motion to the recorded sample."""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np

from vlab.physics.effect.base import Kind
from vlab.physics.effect.channel import ChannelEffect
from vlab.physics.effect.parameter import Values
from vlab.signals import Array

SensorStep = Callable[[float, float, float], float]
"""True sample, its time [s] and the picked-up signal to the recorded sample."""
IMPULSE = 4096
"""IMPULSE [samples]: record length for the frequency response of a sensor's correction. Raising it resolves slower
corrections."""
SETTLING = 512
"""SETTLING [samples]: default settling time of a sensor effect."""


class SensorEffect(ChannelEffect):
    """A change of a motion before the recorded sample.

    `sense` applies the law to a whole signal, `stepper` sample by sample, as in `ActuatorEffect`.
    """

    kind: ClassVar[Kind] = "sensor"

    def transfer(self, x: Array, p: Values, h: float, t: Array) -> Array:
        """See `ChannelEffect`: `sense`."""
        return self.sense(x, p, h, t)

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

    picks_up = True

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
