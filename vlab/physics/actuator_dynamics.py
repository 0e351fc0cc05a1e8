"""Effects between command and force with memory: slew limits, delays, lags."""

from collections import deque
from itertools import chain, count
from typing import Any, ClassVar

import numpy as np
from scipy import signal

from vlab.physics.compiled_commands import starts_within_slope
from vlab.physics.effect import TIMES, ActuatorEffect, ActuatorStep, Parameter, Values, limited
from vlab.physics.filters import delay_line, delayed, lag_weights, lagged, recursion
from vlab.signals import Array

SETTLED = 8.0
"""SETTLED [1]: time constants after which a low-pass has forgotten its past."""
SAME_CLOCK = 0.02
"""SAME_CLOCK [1]: relative distance within which a period counts as a whole number of samples. Slower clocks are
divided from faster ones. Without rounding, the last digit of the period would change which samples are held."""
BLOCK = 1024
"""BLOCK [samples]: samples whose clock is computed at once; the value changes no result."""


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
        return np.asarray(self._acted(u, p, h)[0])

    def ends(self, u: Array, p: Values, h: float) -> Array:
        """See `ActuatorEffect`."""
        return np.asarray(self._acted(u, p, h)[1])

    def _acted(self, u: Array, p: Values, h: float) -> tuple[Any, Any]:
        most, commands = float(p["slope"]) * h, np.asarray(u, dtype=float)
        starts = starts_within_slope(np.ascontiguousarray(commands.reshape(len(u), -1)), most)
        return self.acted(starts.reshape(commands.shape), commands, most)

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

    def ends(self, u: Array, p: Values, h: float) -> Array:
        """See `ActuatorEffect`: exact for held commands."""
        left = float(np.exp(-h / float(p["time_constant"])))
        return np.asarray(signal.lfilter([1.0 - left], [1.0, -left], np.asarray(u, dtype=float), axis=0))

    def stepper(self, p: Values, h: float) -> ActuatorStep:
        """See `ActuatorEffect`."""
        return recursion(*lag_weights(float(p["time_constant"]), h))


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
        period, held = self._clock(float(p["period"]), h), 0.0
        blocks = (np.arange(first, first + BLOCK) for first in count(0, BLOCK))
        is_taken = chain.from_iterable((self._taken(k, period, h) == k).tolist() for k in blocks)

        def step(u: float) -> float:
            nonlocal held
            if next(is_taken):
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
        late = float(p["jitter"]) / h * np.random.default_rng(0).random(len(u))
        whole = late.astype(int)
        part = (late - whole).reshape(-1, *(1,) * (u.ndim - 1))
        longest = int(whole.max(initial=0)) + 1
        led = np.concatenate([np.zeros((longest, *u.shape[1:])), u])  # zero before the start
        at = longest + np.arange(len(u)) - whole
        return np.asarray((1 - part) * led[at] + part * led[at - 1])

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
