"""Effects between command and force: amplifiers, converters, coils."""

from collections import deque
from typing import Any, ClassVar

import numpy as np
from scipy import signal

from vlab.physics.effect import (
    TIMES,
    ActuatorEffect,
    ActuatorStep,
    Parameter,
    PortEffect,
    Step,
    Values,
    limited,
    softly_limited,
)
from vlab.signals import Array


def delayed(x: Array, delay: float, h: float) -> Array:
    """Return signals delayed by a time.

    The delay need not be a whole number of samples. The signal is linear between samples and zero before the start.

    Parameters
    ----------
    x : array
        Signals, time along the first axis.
    delay : float
        Delay [s].
    h : float
        Sample period [s].

    Returns
    -------
    array
        Delayed signals, shape of `x`.
    """
    index = np.arange(len(x)) - delay / h
    whole = np.floor(index).astype(int)
    part = (index - whole).reshape(-1, *(1,) * (x.ndim - 1))
    low = np.where((whole >= 0).reshape(part.shape), x[np.maximum(whole, 0)], 0.0)
    high = np.where((whole + 1 >= 0).reshape(part.shape), x[np.clip(whole + 1, 0, len(x) - 1)], 0.0)
    return np.asarray(low * (1 - part) + high * part)


def delay_line(delay: float, h: float) -> ActuatorStep:
    """Return a sample-by-sample form of `delayed`.

    Parameters
    ----------
    delay : float
        Delay [s].
    h : float
        Sample period [s].

    Returns
    -------
    ActuatorStep
        One input sample to one delayed sample.
    """
    whole = int(np.floor(delay / h))
    part = delay / h - whole
    past = deque([0.0] * (whole + 2), maxlen=whole + 2)

    def step(x: float) -> float:
        past.append(x)
        return part * past[0] + (1 - part) * past[1]

    return step


def lag_weights(time_constant: float, h: float) -> tuple[float, float, float]:
    """Return the weights (new input, old input, old output) of `lagged`.

    With a = exp(-h/tau), the output is y[k] = b0 x[k] + b1 x[k-1] + a y[k-1], b0 = 1 - (1 - a) tau/h, b1 = (1 - a) -
    b0. This recursion is the ramp-invariant (first-order hold) discretisation of 1/(1 + s tau).

    Parameters
    ----------
    time_constant : float
        Time constant tau [s].
    h : float
        Sample period [s].

    Returns
    -------
    tuple of (float, float, float)
        b0, b1 and a.
    """
    a = float(np.exp(-h / time_constant))
    new = 1.0 - (1.0 - a) * time_constant / h  # response to a ramp
    return new, (1.0 - a) - new, a


def recursion(new: float, old: float, kept: float, x: float = 0.0, y: float = 0.0) -> ActuatorStep:
    """Return the first-order filter y+ = new x+ + old x + kept y.

    Parameters
    ----------
    new : float
        Weight of the present input.
    old : float
        Weight of the preceding input.
    kept : float
        Weight of the preceding output.
    x, y : float
        Input and output before the first sample; zero means a start from rest.

    Returns
    -------
    ActuatorStep
        One input sample to one output sample.
    """

    def step(sample: float) -> float:
        nonlocal x, y
        y = new * sample + old * x + kept * y
        x = sample
        return y

    return step


def lagged(x: Array, time_constant: float, h: float) -> Array:
    """Return signals behind a first-order low-pass.

    The discretisation is exact for inputs that run straight between samples.
    """
    new, old, a = lag_weights(time_constant, h)
    return np.asarray(signal.lfilter([new, old], [1.0, -a], x, axis=0))


SETTLED = 8.0
"""SETTLED [1]: time constants after which a low-pass has forgotten its past."""
CUT_OFF = (0.3, 0.45, 0.6, 0.75, 0.85, 0.92, 0.97)
"""CUT_OFF [1]: trial limits as shares of the largest command. A limit reached in only a few samples leaves its trace
only in those samples, so the grid is dense near 1."""


class ActuatorGain(ActuatorEffect):
    """A gain that differs from the model's.

    A gain error of -2 is a reversed polarity.
    """

    name = "actuator-gain"
    family = "gain"
    law = "force = (1 + g) u"
    words = "an actuator's gain differs from the model's (g = -2: its polarity is reversed)"
    parameters: ClassVar = (Parameter(name="gain", unit="1", low=0.005, high=3.0, signed=True),)

    def actuate(self, u: Array, p: Values, h: float) -> Array:
        """See `ActuatorEffect`."""
        return np.asarray((1.0 + p["gain"]) * u)


class ActuatorOffset(ActuatorEffect):
    """A direct current in the drive."""

    name = "actuator-offset"
    family = "bias"
    law = "force = u + u0"
    words = "a constant is added to an actuator's command: an amplifier's offset, the zero of a servo's encoder"
    parameters: ClassVar = (Parameter(name="offset", unit="N", low=1e-4, high=10.0, reference="input", signed=True),)

    def actuate(self, u: Array, p: Values, h: float) -> Array:
        """See `ActuatorEffect`."""
        return np.asarray(u + p["offset"])


class Clipping(ActuatorEffect):
    """The rails of an amplifier."""

    name = "actuator-clipping"
    family = "saturation"
    law = "force = min(max(u, -L), L)"
    words = "an amplifier or actuator saturates: commands beyond a limit are cut off"
    confirmed_by = (
        "the same loop at half the level, where no command reaches the limit: the model must then do without it"
    )
    parameters: ClassVar = (
        Parameter(name="limit", unit="N", low=0.02, high=0.999, role="shape", reference="input", grid=CUT_OFF),
    )

    def actuate(self, u: Array, p: Values, h: float) -> Array:
        """See `ActuatorEffect`."""
        return np.asarray(limited(u, p["limit"]))


class SoftSaturation(ActuatorEffect):
    """An amplifier or a magnet that saturates softly."""

    name = "soft-saturation"
    family = "saturation"
    law = "force = L tanh(u/L)"
    words = "an amplifier or magnet saturates softly"
    parameters: ClassVar = (
        Parameter(name="limit", unit="N", low=0.1, high=10.0, role="shape", reference="input", grid=(0.5, 1.0, 2.0)),
    )

    def actuate(self, u: Array, p: Values, h: float) -> Array:
        """See `ActuatorEffect`."""
        return np.asarray(softly_limited(u, p["limit"]))


class DeadZone(ActuatorEffect):
    """A drive that does nothing below a threshold."""

    name = "actuator-dead-zone"
    family = "clearance"
    law = "force = u - min(max(u, -d), d)"
    words = "a drive does nothing below a threshold: a dead zone of an amplifier or valve"
    parameters: ClassVar = (
        Parameter(
            name="threshold",
            unit="N",
            low=0.001,
            high=0.7,
            role="shape",
            reference="input",
            grid=(0.003, 0.01, 0.03, 0.06, 0.1, 0.2, 0.4),
        ),
    )

    def actuate(self, u: Array, p: Values, h: float) -> Array:
        """See `ActuatorEffect`."""
        return np.asarray(u - limited(u, p["threshold"]))


class SlewLimit(ActuatorEffect):
    """An amplifier that cannot follow fast commands."""

    name = "slew-limit"
    keeps_constants: ClassVar = True
    family = "saturation"
    law = "|d force/dt| <= R"
    words = "an amplifier follows no faster than a limited slope"
    parameters: ClassVar = (
        Parameter(
            name="slope",
            unit="N/s",
            low=0.02,
            high=0.95,
            role="shape",
            reference="input-slope",
            grid=(0.1, 0.3, 0.6),
            scan="slope",
        ),
    )

    def acted(self, now: Any, command: Any, most: float) -> tuple[Any, Any]:
        """Return the means over intervals and the end values.

        Parameters
        ----------
        now : float or array
            Force at the end of the last interval.
        command : float or array
            Command of the interval.
        most : float
            Largest change within an interval.

        Returns
        -------
        tuple of (object, object)
            Mean and end value, of the type of `now`.
        """
        return _ramped(now, command, most)

    def actuate(self, u: Array, p: Values, h: float) -> Array:
        """See `ActuatorEffect`: the result is the mean over each interval."""
        most, commands = float(p["slope"]) * h, np.asarray(u, dtype=float)
        starts = [_within_slope(column, most) for column in commands.reshape(len(u), -1).T.tolist()]
        return np.asarray(self.acted(np.transpose(starts).reshape(commands.shape), commands, most)[0])

    def stepper(self, p: Values, h: float) -> ActuatorStep:
        """See `ActuatorEffect`."""
        most, last = float(p["slope"]) * h, 0.0

        def step(u: float) -> float:
            nonlocal last
            mean, last = self.acted(last, u, most)
            return mean

        return step


class RateLimit(SlewLimit):
    """A converter that limits the command's change per sample.

    The output is a staircase; an amplifier's slew limit (`SlewLimit`) makes ramps.
    """

    name = "rate-limit"
    form_of = "slew-limit"
    is_clocked = True
    law = "|u(k) - u(k-1)| <= R h"
    words = "commands move no further from one sample to the next than a limited slope allows"

    def acted(self, now: Any, command: Any, most: float) -> tuple[Any, Any]:
        """See `SlewLimit`: the output steps at once."""
        end = now + limited(command - now, most)
        return end, end


def _within_slope(commands: list[float], most: float) -> list[float]:
    """Return a signal of limited slope before every command.

    The signal starts at zero. Plain numbers are ten times as fast as short arrays.
    """
    out, now = [], 0.0
    for command in commands:
        out.append(now)
        way = command - now
        now += most if way > most else -most if way < -most else way
    return out


def _ramped(start: Any, target: Any, most: float) -> tuple[Any, Any]:
    """Return the mean and the end of a limited ramp.

    The ramp moves at most `most` in an interval and holds at its target.
    """
    way = target - start
    end = start + limited(way, most)
    share = limited(abs(way) / most, 1.0)  # share of the interval until the ramp arrives
    return end - 0.5 * share * (end - start), end


class ActuatorDelay(ActuatorEffect):
    """Processing and transport time."""

    name = "actuator-delay"
    keeps_constants: ClassVar = True
    family = "timing"
    law = "force(t) = u(t - tau)"
    words = "commands act later than the model says: processing or transport time"
    parameters: ClassVar = (
        Parameter(name="delay", unit="s", low=1e-6, high=0.25, role="shape", grid=TIMES, scan="delay"),
    )

    def reach(self, p: Values) -> float:
        """See `ActuatorEffect`."""
        return float(p["delay"])

    def actuate(self, u: Array, p: Values, h: float) -> Array:
        """See `ActuatorEffect`."""
        return delayed(u, float(p["delay"]), h)

    def stepper(self, p: Values, h: float) -> ActuatorStep:
        """See `ActuatorEffect`."""
        return delay_line(float(p["delay"]), h)


class ActuatorLag(ActuatorEffect):
    """Inductance of a coil, a filter with another corner."""

    name = "actuator-lag"
    keeps_constants: ClassVar = True
    family = "timing"
    law = "force = u/(1 + s tau)"
    words = "the force lags the command by a time constant: a coil's inductance, a filter with a lower corner"
    parameters: ClassVar = (
        Parameter(name="time_constant", unit="s", low=1e-6, high=1.0, role="shape", grid=(*TIMES, 0.3)),
    )

    def reach(self, p: Values) -> float:
        """See `ActuatorEffect`: to exp(-8), or 0.03 %."""
        return SETTLED * float(p["time_constant"])

    def actuate(self, u: Array, p: Values, h: float) -> Array:
        """See `ActuatorEffect`."""
        return lagged(u, float(p["time_constant"]), h)

    def stepper(self, p: Values, h: float) -> ActuatorStep:
        """See `ActuatorEffect`."""
        return recursion(*lag_weights(float(p["time_constant"]), h))


STEPS = tuple(round(0.02 * 1.06**i, 4) for i in range(66))
"""STEPS [1]: trial converter steps as shares of the largest input. Neighbouring steps differ by 6 % because the
residual of a wrong step resembles the true one only nearby."""


class Quantisation(ActuatorEffect):
    """Few bits of a converter."""

    name = "actuator-quantisation"
    family = "resolution"
    law = "force = q round(u/q)"
    words = "a converter with coarse steps stands before the actuator"
    parameters: ClassVar = (
        Parameter(name="step", unit="N", low=0.002, high=1.0, role="shape", reference="input", grid=STEPS),
    )

    def actuate(self, u: Array, p: Values, h: float) -> Array:
        """See `ActuatorEffect`."""
        return np.asarray(p["step"] * np.round(u / p["step"]))


SAME_CLOCK = 0.02
"""SAME_CLOCK [1]: relative distance within which a period counts as a whole number of samples. Slower clocks are
divided from faster ones. Without rounding, the last digit of the period would change which samples are held."""


class CoarseHold(ActuatorEffect):
    """A converter updated less often than modelled."""

    name = "actuator-hold"
    keeps_constants: ClassVar = True
    keeps_time: ClassVar = True
    family = "timing"
    law = "force(t) = u(T floor(t/T))"
    words = "a converter holds its output longer than the model says: steps of a slower clock"
    parameters: ClassVar = (
        Parameter(
            name="period",
            unit="s",
            low=1e-6,
            high=0.2,
            role="shape",
            reference="step",
            grain=SAME_CLOCK,
            scan="period",
            grid=(2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 16.0, 20.0),
        ),
    )

    def reach(self, p: Values) -> float:
        """See `ActuatorEffect`."""
        return float(p["period"])

    def actuate(self, u: Array, p: Values, h: float) -> Array:
        """See `ActuatorEffect`."""
        return np.asarray(u[self._taken(np.arange(len(u)), self._clock(float(p["period"]), h), h)])

    def stepper(self, p: Values, h: float) -> ActuatorStep:
        """See `ActuatorEffect`."""
        period, k, held = self._clock(float(p["period"]), h), -1, 0.0

        def step(u: float) -> float:
            nonlocal k, held
            k += 1
            if self._taken(np.array([k]), period, h)[0] == k:
                held = u
            return held

        return step

    def taken(self, p: Values, h: float) -> Values:
        """See `Effect`: the period is rounded to a whole number of samples."""
        return {**p, "period": self._clock(float(p["period"]), h)}

    @staticmethod
    def _clock(period: float, h: float) -> float:
        """Return a period, rounded to whole samples if near."""
        samples = period / h
        return round(samples) * h if abs(samples - round(samples)) < SAME_CLOCK * samples else period

    @staticmethod
    def _taken(k: Array, period: float, h: float) -> Array:
        """Return the index of the sample held at each sample.

        The held sample is the first one of its period.
        """
        start = np.floor(k * h / period + 1e-9) * period
        return np.minimum(np.ceil(start / h - 1e-9).astype(int), k)


class Jitter(ActuatorEffect):
    """A clock or computer with irregular delays."""

    name = "actuator-jitter"
    keeps_constants: ClassVar = True
    is_clocked = True
    family = "timing"
    law = "force(t) = u(t - J r_k), r_k evenly distributed over 0 to 1, new at every sample"
    words = (
        "commands come out late by an amount that changes from sample to sample: a computer that is not always on time"
    )
    parameters: ClassVar = (
        Parameter(name="jitter", unit="s", low=1e-6, high=0.1, role="shape", reference="step", grid=(0.5, 1.0)),
    )

    def reach(self, p: Values) -> float:
        """See `ActuatorEffect`."""
        return float(p["jitter"])

    def actuate(self, u: Array, p: Values, h: float) -> Array:
        """See `ActuatorEffect`: the r_k are the same in every run."""
        step, out = self.stepper(p, h), np.zeros(u.shape)
        for k in range(len(u)):
            out[k] = step(u[k])
        return out

    def stepper(self, p: Values, h: float) -> ActuatorStep:
        """See `ActuatorEffect`."""
        reach, rng = float(p["jitter"]) / h, np.random.default_rng(0)
        past: deque[float] = deque(maxlen=int(reach) + 2)

        def step(u: float) -> float:
            late = reach * rng.random()
            if not past:
                past.extend([0.0 * u] * (int(reach) + 2))
            past.append(u)
            whole = int(late)
            part = late - whole
            return (1 - part) * past[-1 - whole] + part * past[-2 - whole]

        return step


class CoilForceOverTravel(PortEffect):
    """A coil that leaves its magnet's uniform field."""

    name = "coil-force-over-travel"
    family = "actuator-position"
    law = "force = u (1 - (z/d)^2)"
    words = "the force of a coil falls as it leaves the uniform field of its magnet"
    parameters: ClassVar = (Parameter(name="loss", unit="1/m^2", low=1e-3, high=1e8, words="1/d^2"),)
    needs = ("coil",)

    def force(self, z: Any, v: Any, p: Values, step: Step, memory: Any) -> tuple[Any, Any]:
        """See `PortEffect`."""
        return -p["loss"] * z * z * step.command, memory
