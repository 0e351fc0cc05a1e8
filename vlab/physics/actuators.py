"""Effects between command and force without memory: amplifiers, converters, coils."""

from typing import Any, ClassVar

import numpy as np

from vlab.physics.effect import ActuatorEffect, Parameter, PortEffect, Step, Values, limited, softly_limited
from vlab.signals import Array

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


class Quantisation(ActuatorEffect):
    """Few bits of a converter."""

    name = "actuator-quantisation"
    family = "resolution"
    law = "force = q round(u/q)"
    words = "a converter with coarse steps stands before the actuator"
    parameters: ClassVar = (
        Parameter(
            name="step",
            unit="N",
            low=0.002,
            high=1.0,
            role="shape",
            reference="input",
            grid=(0.05, 0.2, 0.5),
            scan="step",
        ),
    )

    def actuate(self, u: Array, p: Values, h: float) -> Array:
        """See `ActuatorEffect`."""
        return np.asarray(p["step"] * np.round(u / p["step"]))


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
