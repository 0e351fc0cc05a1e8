"""Effects of the motor and the gear of a position servo.

The laws replace the force of a servo as those of `vlab.physics.servo` do.
"""

from typing import Any, ClassVar

import numpy as np

from vlab.physics.effect import Parameter, Step, Values, softly_limited
from vlab.physics.port_memory import zeros
from vlab.physics.servo import SMALL, ServoEffect


class ServoSoftForceLimit(ServoEffect):
    """A force of a servo that approaches its limit gradually.

    The torque per current of a motor falls as the iron saturates.
    """

    name = "servo-soft-force-limit"
    form_of = "servo-force-limit"
    family = "saturation"
    law = "force = L tanh((kp (u - z) - kv v)/L)"
    words = "a servo's force approaches a limit gradually: the iron of a motor saturates"
    confirmed_by = "the same motion at half the speed: the missing force falls to an eighth"
    parameters: ClassVar = (
        Parameter(
            name="limit",
            unit="N",
            low=0.1,
            high=10.0,
            role="shape",
            reference="servo-force",
            grid=(0.3, 0.5, 0.8, 1.2, 2.0, 4.0),
        ),
    )

    def changed(self, e: Any, v: Any, p: Values) -> Any:
        """See `ServoEffect`."""
        return softly_limited(self.modelled(e, v), p["limit"])


class ServoTorqueSpeedLine(ServoEffect):
    """A force limit that falls with speed.

    The counter-voltage of a turning motor leaves less of the supply for the current. Driving force is limited by
    L (1 - v/v0), with the stall force L and the no-load speed v0; braking force has a higher limit [1]_.

    References
    ----------
    .. [1] R. Krishnan, Electric Motor Drives: Modeling, Analysis, and Control, Prentice Hall, 2001, chapter 2.
    """

    name = "servo-torque-speed-line"
    family = "saturation"
    law = "force = min(max(kp (u - z) - kv v, -L (1 + v/v0)), L (1 - v/v0))"
    words = "a servo's largest force falls with speed: the counter-voltage of its motor uses up the supply"
    confirmed_by = "the same motion at half the speed, where no force reaches the line"
    parameters: ClassVar = (
        Parameter(
            name="limit",
            unit="N",
            low=0.05,
            high=20.0,
            role="shape",
            reference="servo-force",
            grid=(0.5, 0.8, 1.2, 2.0, 4.0),
        ),
        Parameter(
            name="speed",
            unit="m/s",
            low=0.3,
            high=20.0,
            role="shape",
            reference="velocity",
            grid=(0.7, 1.0, 1.4, 2.0, 4.0),
        ),
    )

    def changed(self, e: Any, v: Any, p: Values) -> Any:
        """See `ServoEffect`."""
        share = v / p["speed"]
        return np.minimum(np.maximum(self.modelled(e, v), -p["limit"] * (1.0 + share)), p["limit"] * (1.0 - share))


class ServoIntegralGain(ServoEffect):
    """Integral action of a servo whose model has none.

    The position error is integrated, so no constant load leaves an error [1]_. A run at rest begins with an empty
    integrator.

    References
    ----------
    .. [1] K. J. Åström, T. Hägglund, Advanced PID Control, ISA, 2006, chapter 3.
    """

    name = "servo-integral-gain"
    family = "servo"
    law = "force = kp (e + r q) - kv v, dq/dt = e, e = u - z"
    words = "a servo integrates its position error: the I of a PID controller, which removes the droop under a load"
    confirmed_by = "a constant command under a constant load: the error dies away at the rate"
    probe = SMALL
    parameters: ClassVar = (
        Parameter(name="rate", unit="1/s", low=0.01, high=100.0, words="inverse of the reset time: ki over kp"),
    )

    def memory(self, shape: tuple[int, ...]) -> list[Any] | None:
        """See `PortEffect`: the integral of the error."""
        return zeros(1, shape)

    def force(self, z: Any, v: Any, p: Values, step: Step, memory: Any) -> tuple[Any, Any]:
        """See `PortEffect`."""
        e = self.servo.error(step.command, z)
        middle, after = memory[0] + 0.5 * step.h * e, memory[0] + step.h * e
        changed = self.servo.limited(self.servo.gain * (e + p["rate"] * middle) - self.servo.damping * v)
        return changed - self.modelled(e, v), [after]


class ServoLoadFriction(ServoEffect):
    """Friction of a gear that grows with the force it transmits.

    The loss of tooth contacts is a share of the force between the teeth [1]_.

    References
    ----------
    .. [1] A. C. Bittencourt, E. Wernholt, S. Sander-Tavallaey and T. Brogardh, An extended friction model to capture
           load and temperature effects in robot joints, IEEE/RSJ International Conference on Intelligent Robots and
           Systems, 2010, 6161-6167.
    """

    name = "servo-load-friction"
    family = "friction"
    law = "force = F - m |F| tanh(v/vr), F = kp (u - z) - kv v"
    words = "friction in proportion to the force of a servo: losses between the teeth of its gear"
    confirmed_by = "the same motion with and without a payload: the friction must grow with the load"
    probe = SMALL
    parameters: ClassVar = (
        Parameter(name="share", unit="1", low=0.005, high=0.95),
        Parameter(
            name="rise",
            unit="m/s",
            low=0.01,
            high=0.5,
            role="shape",
            reference="velocity",
            grid=(0.02, 0.06, 0.2),
            words="the velocity at which three quarters of it are there",
        ),
    )

    def changed(self, e: Any, v: Any, p: Values) -> Any:
        """See `ServoEffect`."""
        force = self.modelled(e, v)
        return force - p["share"] * abs(force) * np.tanh(v / p["rise"])
