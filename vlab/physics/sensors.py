"""Effects between motion and recorded sample: sensors, leads, converters."""

from collections import deque
from collections.abc import Callable
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np
from scipy import signal

from vlab.physics.effect import (
    SETTLING,
    TIMES,
    ActuatorStep,
    Parameter,
    PickUp,
    SensorEffect,
    SensorStep,
    Values,
    limited,
    softly_limited,
)
from vlab.physics.filters import lag_weights, lagged, recursion
from vlab.signals import Array

NEAR_LIMIT = 0.98
"""NEAR_LIMIT [1]: share of a soft limit beyond which the correction is cut. At this share the correction magnifies
noise 25 times."""
MOST_MAGNIFIED = 3.0
"""MOST_MAGNIFIED [1]: largest gain of a resonance's correction, reached at twice the resonance frequency."""


def _alone(step: ActuatorStep) -> SensorStep:
    """Return a filter as a step without a second signal."""
    return lambda y, t, other: step(y)


def _delay_taps(samples: float) -> tuple[int, list[float]]:
    """Return the first sample and weights of a delay.

    Lagrange's cubic weights four neighbouring samples. Linear interpolation would lower a signal of 20 samples a cycle
    by up to 1 %, as much as a short delay changes the signal. The signal is zero before the start.
    """
    first = max(int(np.floor(samples)) - 1, 0)
    nodes = first + np.arange(4)
    weights = [float(np.prod([(samples - b) / (a - b) for b in nodes if b != a])) for a in nodes]
    return first, weights


@lru_cache(maxsize=256)
def _resonance(frequency: float, damping_ratio: float, h: float) -> tuple[Array, Array]:
    """Return the filter coefficients of a resonance.

    The first-order hold is exact for straight lines between samples. A bilinear transform keeps the resonance in place
    but distorts the delay below, where most recordings lie. The cache serves a fit, which repeats the same coefficients
    for every window.
    """
    w = 2 * np.pi * frequency
    b, a, _ = signal.cont2discrete(([1.0], [1.0 / w**2, 2 * damping_ratio / w, 1.0]), h, method="foh")
    return b.ravel(), a


def _over(t: Any, y: Array) -> Any:
    """Return times that broadcast against signals."""
    return t.reshape(-1, *(1,) * (np.ndim(y) - 1)) if np.ndim(y) > np.ndim(t) else t


def _times(y: Array, h: float, factor: Callable[[Array], Array]) -> Array:
    """Return signals filtered by a function of s = i omega.

    Finite differences would be wrong by several per cent at few samples a cycle, and a wrong correction resembles an
    effect. The signals continue by point reflection about their ends, so that value and slope stay continuous.
    """
    n = len(y)
    longer = np.concatenate([y, 2 * y[-1] - y[-2::-1]]) - y[0]  # from y0 to 2 yn - y0 by point reflection
    ramp = np.linspace(0.0, 1.0, len(longer)).reshape(-1, *(1,) * (y.ndim - 1)) * longer[-1]
    s = 2j * np.pi * np.fft.rfftfreq(len(longer) - 1, h).reshape(-1, *(1,) * (y.ndim - 1))
    turned = np.fft.irfft(np.fft.rfft((longer - ramp)[:-1], axis=0) * factor(s), len(longer) - 1, axis=0)
    # the subtracted line and first value pass through the factor's value and slope at s = 0
    small = np.array([1e-6 / (h * n)]).reshape(-1, *(1,) * (y.ndim - 1)).astype(complex)
    zero = complex(np.ravel(factor(0 * small))[0]).real
    slope = (complex(np.ravel(factor(small))[0]).real - zero) / float(np.ravel(small)[0].real)
    rate = longer[-1] / ((len(longer) - 1) * h)
    return np.asarray(turned[:n] + zero * (ramp[:n] + y[0]) + slope * rate)


class SensorGain(SensorEffect):
    """A calibration error; -2 is a reversed polarity."""

    name = "sensor-gain"
    family = "gain"
    law = "y = (1 + g) x"
    words = "a sensor's calibration differs from what the recording says (g = -2: its polarity is reversed)"
    parameters: ClassVar = (
        Parameter(
            name="gain",
            unit="1",
            low=0.005,
            high=3.0,
            role="shape",
            grid=(-2.0, -0.3, -0.1, -0.04, -0.015, 0.015, 0.04, 0.1, 0.3),
            signed=True,
        ),
    )

    def sense(self, y: Array, p: Values, h: float, t: Array) -> Array:
        """See `SensorEffect`."""
        return np.asarray((1.0 + p["gain"]) * y)

    def correct(self, y: Array, p: Values, h: float, t: Array) -> Array:
        """See `SensorEffect`."""
        return np.asarray(y / (1.0 + p["gain"]))


class SensorOffset(SensorEffect):
    """A sensor offset (bias)."""

    name = "sensor-offset"
    family = "bias"
    law = "y = x + y0"
    words = "a constant is added to a sensor's output"
    confirmed_by = "a reading of the sensor at rest, before and after"
    parameters: ClassVar = (Parameter(name="offset", unit="m", low=1e-4, high=10.0, reference="output", signed=True),)

    def sense(self, y: Array, p: Values, h: float, t: Array) -> Array:
        """See `SensorEffect`."""
        return np.asarray(y + p["offset"])

    def correct(self, y: Array, p: Values, h: float, t: Array) -> Array:
        """See `SensorEffect`."""
        return np.asarray(y - p["offset"])


class SensorDrift(SensorEffect):
    """An offset that drifts with time or temperature."""

    name = "sensor-drift"
    family = "bias"
    law = "y = x + r t"
    words = "a sensor's zero drifts with time or temperature"
    parameters: ClassVar = (Parameter(name="rate", unit="m/s", low=1e-9, high=1e3, signed=True),)

    def sense(self, y: Array, p: Values, h: float, t: Array) -> Array:
        """See `SensorEffect`."""
        return np.asarray(y + p["rate"] * _over(t, y))

    def correct(self, y: Array, p: Values, h: float, t: Array) -> Array:
        """See `SensorEffect`."""
        return np.asarray(y - p["rate"] * _over(t, y))


class SensorClipping(SensorEffect):
    """A sensor or converter at its range limit."""

    name = "sensor-clipping"
    family = "saturation"
    law = "y = min(max(x, -L), L)"
    words = "a sensor or its converter is at the end of its range"
    confirmed_by = "the same excitation at a level at which the sensor stays within its range"
    parameters: ClassVar = (
        Parameter(name="limit", unit="m", low=0.1, high=1.0, role="shape", reference="output", grid=(0.98,)),
    )

    def sense(self, y: Array, p: Values, h: float, t: Array) -> Array:
        """See `SensorEffect`."""
        return np.asarray(limited(y, p["limit"]))

    def correct(self, y: Array, p: Values, h: float, t: Array) -> Array:
        """See `SensorEffect`: clipped values are lost."""
        return y


class SensorSoftSaturation(SensorEffect):
    """A sensor that saturates gradually."""

    name = "sensor-soft-saturation"
    form_of = "sensor-clipping"
    family = "saturation"
    law = "y = L tanh(x/L)"
    words = "a sensor or its amplifier saturates softly: its output flattens towards a limit that it never reaches"
    parameters: ClassVar = (
        Parameter(
            name="limit",
            unit="m",
            low=0.9,
            high=10.0,
            role="shape",
            reference="output",
            grid=(1.01, 1.05, 1.15, 1.4, 2.0, 3.0),
        ),
    )

    def sense(self, y: Array, p: Values, h: float, t: Array) -> Array:
        """See `SensorEffect`."""
        return np.asarray(softly_limited(y, p["limit"]))

    def correct(self, y: Array, p: Values, h: float, t: Array) -> Array:
        """See `SensorEffect`: cut near the limit, where noise diverges."""
        return np.asarray(p["limit"] * np.arctanh(limited(y / p["limit"], NEAR_LIMIT)))


class SensorDelay(SensorEffect):
    """Processing or transmission time."""

    name = "sensor-delay"
    family = "timing"
    law = "y(t) = x(t - tau)"
    words = "samples are older than their time stamps: processing or transmission time"
    parameters: ClassVar = (
        Parameter(name="delay", unit="s", low=1e-6, high=0.25, role="shape", grid=TIMES, scan="delay"),
    )

    def sense(self, y: Array, p: Values, h: float, t: Array) -> Array:
        """See `SensorEffect`."""
        first, weights = _delay_taps(float(p["delay"]) / h)
        longer = np.concatenate([np.zeros((first + 3, *y.shape[1:])), y])
        return np.asarray(sum(w * longer[3 - i : len(longer) - first - i] for i, w in enumerate(weights)))

    def stepper(self, p: Values, h: float) -> SensorStep:
        """See `SensorEffect`."""
        first, weights = _delay_taps(float(p["delay"]) / h)
        past = deque([0.0] * (first + 4), maxlen=first + 4)  # newest sample first

        def step(y: float) -> float:
            past.appendleft(y)
            return sum(w * past[first + i] for i, w in enumerate(weights))

        return _alone(step)

    def resumed(self, p: Values, h: float, reading: float) -> SensorStep:
        """See `SensorEffect`: the reading stood before the start."""
        step = self.stepper(p, h)
        return lambda y, t, other: reading + step(y - reading, t, other)

    def settling_samples(self, p: Values, h: float) -> int:
        """See `SensorEffect`."""
        return max(SETTLING, _delay_taps(float(p["delay"]) / h)[0] + 4)

    def correct(self, y: Array, p: Values, h: float, t: Array) -> Array:
        """See `SensorEffect`: a shift in frequency, which preserves noise."""
        return _times(y, h, lambda s: np.exp(s * float(p["delay"])))


class SensorLag(SensorEffect):
    """A low-pass in the sensor's electronics."""

    name = "sensor-lag"
    family = "timing"
    law = "y = x/(1 + s tau)"
    words = "a sensor's low-pass is slower than the model says"
    parameters: ClassVar = (
        Parameter(name="time_constant", unit="s", low=1e-6, high=1.0, role="shape", grid=(*TIMES, 0.3)),
    )

    def sense(self, y: Array, p: Values, h: float, t: Array) -> Array:
        """See `SensorEffect`."""
        return lagged(y, float(p["time_constant"]), h)

    def stepper(self, p: Values, h: float) -> SensorStep:
        """See `SensorEffect`."""
        return _alone(recursion(*lag_weights(float(p["time_constant"]), h)))

    def resumed(self, p: Values, h: float, reading: float) -> SensorStep:
        """See `SensorEffect`."""
        weights = lag_weights(float(p["time_constant"]), h)
        later: list[ActuatorStep] = []

        def step(y: float) -> float:
            if later:
                return later[0](y)
            later.append(recursion(*weights, x=y, y=reading))
            return reading

        return _alone(step)

    def correct(self, y: Array, p: Values, h: float, t: Array) -> Array:
        """See `SensorEffect`."""
        return _times(y, h, lambda s: 1.0 + s * float(p["time_constant"]))


class SensorHighPass(SensorEffect):
    """AC coupling or a charge amplifier."""

    name = "sensor-high-pass"
    family = "sensor-dynamics"
    law = "y = x s tau/(1 + s tau)"
    words = "a sensor loses slow motion: a high-pass, AC coupling, a charge amplifier"
    parameters: ClassVar = (
        Parameter(
            name="time_constant",
            unit="s",
            low=1e-3,
            high=100.0,
            role="shape",
            reference="step",
            grid=(20.0, 100.0, 500.0, 2000.0),
        ),
    )

    def sense(self, y: Array, p: Values, h: float, t: Array) -> Array:
        """See `SensorEffect`."""
        a = float(np.exp(-h / float(p["time_constant"])))
        return np.asarray(signal.lfilter([0.5 * (1 + a), -0.5 * (1 + a)], [1.0, -a], y, axis=0))

    def stepper(self, p: Values, h: float) -> SensorStep:
        """See `SensorEffect`."""
        a = float(np.exp(-h / float(p["time_constant"])))
        return _alone(recursion(0.5 * (1 + a), -0.5 * (1 + a), a))

    def settling_samples(self, p: Values, h: float) -> int:
        """See `SensorEffect`: to exp(-8), or 0.03 %."""
        return int(np.ceil(8.0 * float(p["time_constant"]) / h))

    def correct(self, y: Array, p: Values, h: float, t: Array) -> Array:
        """See `SensorEffect`: the lost part is the integral of the output.

        A wrong offset would make the integral grow steadily, so its trend is removed.
        """
        return np.asarray(y + signal.detrend(np.cumsum(y, axis=0), axis=0) * (h / float(p["time_constant"])))


class SensorQuantisation(SensorEffect):
    """Few bits of a converter, an encoder's counts."""

    name = "sensor-quantisation"
    family = "resolution"
    law = "y = q round(x/q)"
    words = "coarse steps of a sensor or converter"
    parameters: ClassVar = (
        Parameter(name="step", unit="m", low=0.002, high=0.5, role="shape", reference="output", grid=(0.02, 0.06, 0.2)),
    )

    def sense(self, y: Array, p: Values, h: float, t: Array) -> Array:
        """See `SensorEffect`."""
        return np.asarray(p["step"] * np.round(y / p["step"]))

    def correct(self, y: Array, p: Values, h: float, t: Array) -> Array:
        """See `SensorEffect`: rounded digits are lost."""
        return y


class MainsHum(SensorEffect):
    """Pick-up of the mains on unshielded leads."""

    name = "mains-hum"
    family = "disturbance"
    law = "y = x + a sin(2 pi f t) + b cos(2 pi f t)"
    words = "mains hum is picked up on a sensor's leads"
    confirmed_by = "a recording at rest with the leads routed otherwise: mains interference changes, motion does not"
    parameters: ClassVar = (
        Parameter(name="sine", unit="m", low=1e-4, high=10.0, reference="output", signed=True),
        Parameter(name="cosine", unit="m", low=1e-4, high=10.0, reference="output", signed=True),
        Parameter(name="frequency", unit="Hz", low=45.0, high=65.0, role="shape", grid=(50.0, 60.0)),
    )

    def sense(self, y: Array, p: Values, h: float, t: Array) -> Array:
        """See `SensorEffect`."""
        phase = 2 * np.pi * p["frequency"] * _over(t, y)
        return np.asarray(y + p["sine"] * np.sin(phase) + p["cosine"] * np.cos(phase))

    def correct(self, y: Array, p: Values, h: float, t: Array) -> Array:
        """See `SensorEffect`."""
        phase = 2 * np.pi * p["frequency"] * _over(t, y)
        return np.asarray(y - p["sine"] * np.sin(phase) - p["cosine"] * np.cos(phase))


class SensorResonance(SensorEffect):
    """Resonance of a sensor's mount or seismic mass."""

    name = "sensor-resonance"
    family = "sensor-dynamics"
    law = "y = x/(1 + 2 D s/w + (s/w)^2)"
    words = (
        "a sensor sits on a mount that resonates: signals near that frequency come out too large, above it too small"
    )
    parameters: ClassVar = (
        Parameter(name="frequency", unit="Hz", low=1.0, high=1e4, role="shape", grid=(30.0, 60.0, 100.0, 170.0, 300.0)),
        Parameter(name="damping_ratio", unit="1", low=0.005, high=0.5, role="shape", grid=(0.05, 0.25)),
    )

    def sense(self, y: Array, p: Values, h: float, t: Array) -> Array:
        """See `SensorEffect`."""
        return np.asarray(signal.lfilter(*_resonance(float(p["frequency"]), float(p["damping_ratio"]), h), y, axis=0))

    def correct(self, y: Array, p: Values, h: float, t: Array) -> Array:
        """See `SensorEffect`: the gain far above the resonance is limited.

        Recorded content far above the resonance is noise.
        """
        w, damping = 2 * np.pi * float(p["frequency"]), float(p["damping_ratio"])

        def factor(s: Array) -> Array:
            whole = 1.0 + 2 * damping * s / w + (s / w) ** 2
            return np.asarray(whole / np.maximum(np.abs(whole) / MOST_MAGNIFIED, 1.0))

        return _times(y, h, factor)

    def stepper(self, p: Values, h: float) -> SensorStep:
        """See `SensorEffect`."""
        coefficients = _resonance(float(p["frequency"]), float(p["damping_ratio"]), h)
        (b0, b1, b2), (_, a1, a2) = (c.tolist() for c in coefficients)
        first, second = 0.0, 0.0

        def step(y: float) -> float:
            nonlocal first, second
            out = b0 * y + first
            first, second = b1 * y - a1 * out + second, b2 * y - a2 * out
            return out

        return _alone(step)


class Crosstalk(PickUp):
    """Pick-up of a coil's field or leads."""

    name = "crosstalk"
    family = "pick-up"
    law = "y = x + d u"
    words = "a sensor picks up the current of a coil: crosstalk through fields or leads, which fills the zeros of a response"
    parameters: ClassVar = (Parameter(name="share", unit="m/N", low=1e-9, high=1e2, signed=True),)
    needs = ("command",)

    def mix(self, y: Any, other: Any, p: Values) -> Any:
        """See `PickUp`."""
        return y + p["share"] * other


class CrossAxis(PickUp):
    """A sensor misaligned with its axis."""

    name = "cross-axis"
    family = "pick-up"
    law = "y = x + s x2"
    words = "a sensor also sees the motion across its axis"
    parameters: ClassVar = (Parameter(name="share", unit="1", low=1e-4, high=0.5, signed=True),)
    needs = ("sensor",)

    def mix(self, y: Any, other: Any, p: Values) -> Any:
        """See `PickUp`."""
        return y + p["share"] * other


class MisplacedSensor(PickUp):
    """A sensor displaced by millimetres from the drawing."""

    name = "misplaced-sensor"
    family = "gain"
    law = "y = x + s (x2 - x), s = the error over the distance to the neighbouring sensor"
    words = "a sensor sits beside its place, towards a neighbour: it sees a share of what that one sees"
    parameters: ClassVar = (Parameter(name="share", unit="1", low=1e-4, high=0.5, signed=True),)
    needs = ("sensor",)

    def mix(self, y: Any, other: Any, p: Values) -> Any:
        """See `PickUp`."""
        return y + p["share"] * (other - y)
