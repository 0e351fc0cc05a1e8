"""Effects inside the loop of a position servo.

A position servo is an actuator of MuJoCo with fixed gain kp and affine bias -kp l - kv l'. The length of its
transmission is l. With the command u and the position error e = u - l, the force is kp e - kv l', within the force limits.
An effect replaces this force; the law is the difference between the changed force and the modelled force. An error e
contains the command and the motion, so `actuator-gain`, which changes commands alone, is another law.
"""

import copy
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, ClassVar

import mujoco
import numpy as np

from vlab.physics.effect import Parameter, PortEffect, Step, Values
from vlab.plants.base import Plant, Port
from vlab.plants.mjcf import MjcfPlant


@dataclass(frozen=True, kw_only=True)
class Servo:
    """Numbers of a position servo.

    Parameters
    ----------
    gain : float
        Position gain kp, in units of the servo's force per length of its transmission.
    damping : float
        Velocity gain kv.
    rest : float
        Length of the transmission at the plant's rest.
    limits : tuple of (float, float)
        Least and largest force.
    commands : tuple of (float, float)
        Least and largest command.
    inertia : float
        Inertia of the motor's side along the transmission: the joint's armature over the squared gear. 0 if the model
        states none.
    drag : float
        Damping of the joint along the transmission.
    """

    gain: float = 0.0
    damping: float = 0.0
    rest: float = 0.0
    limits: tuple[float, float] = (-np.inf, np.inf)
    commands: tuple[float, float] = (-np.inf, np.inf)
    inertia: float = 0.0
    drag: float = 0.0

    def error(self, command: Any, z: Any) -> Any:
        """Return the position error at a displacement from rest."""
        return _within(command, self.commands) - self.rest - z

    def limited(self, force: Any) -> Any:
        """Return a force within the limits."""
        return _within(force, self.limits)


def _within(x: Any, limits: tuple[float, float]) -> Any:
    low, high = limits
    if low == -np.inf and high == np.inf:
        return x
    return min(max(x, low), high) if isinstance(x, float) else np.minimum(np.maximum(x, low), high)


_FILTERS = (mujoco.mjtDyn.mjDYN_NONE, mujoco.mjtDyn.mjDYN_FILTER, mujoco.mjtDyn.mjDYN_FILTEREXACT)
_SPAN = {mujoco.mjtTrn.mjTRN_JOINT: "joint", mujoco.mjtTrn.mjTRN_TENDON: "tendon"}


def servo_of(plant: Plant, index: int) -> Servo | None:
    """Return the position servo behind an actuator.

    Parameters
    ----------
    plant : Plant
        Plant.
    index : int
        Index into ``plant.actuators``.

    Returns
    -------
    Servo or None
        None for any other actuator, or a servo on anything but a joint or tendon.
    """
    if not isinstance(plant, MjcfPlant) or len(plant.actuators[index].controls) != 1:
        return None
    model, i = plant.model, int(plant.actuators[index].controls[0])
    gain, bias = float(model.actuator_gainprm[i, 0]), model.actuator_biasprm[i]
    is_servo = (
        model.actuator_gaintype[i] == mujoco.mjtGain.mjGAIN_FIXED
        and model.actuator_biastype[i] == mujoco.mjtBias.mjBIAS_AFFINE
        and mujoco.mjtDyn(int(model.actuator_dyntype[i])) in _FILTERS
        and gain > 0
        and abs(bias[1] + gain) <= 1e-9 * gain
        and bias[0] == 0.0
    )
    port = _span(plant, i)
    if not is_servo or port is None:
        return None
    has_state = int(model.actuator_actadr[i]) >= 0
    return Servo(
        gain=gain,
        damping=-float(bias[2]),
        rest=float(model.actuator_gear[i, 0]) * port.position(plant.new_data()),
        limits=_range(model.actuator_forcelimited[i], model.actuator_forcerange[i]),
        commands=_range(model.actuator_ctrllimited[i] and not has_state, model.actuator_ctrlrange[i]),
        inertia=_of_span(model, i, "armature"),
        drag=_of_span(model, i, "damping"),
    )


def _of_span(model: Any, control: int, quantity: str) -> float:
    """Return the armature or damping along an actuator's length."""
    spanned = int(model.actuator_trnid[control, 0])
    if model.actuator_trntype[control] == mujoco.mjtTrn.mjTRN_JOINT:
        value = getattr(model, f"dof_{quantity}")[model.jnt_dofadr[spanned]]
    else:
        value = getattr(model, f"tendon_{quantity}")[spanned]
    return float(value) / float(model.actuator_gear[control, 0]) ** 2


def has_motor(plant: Plant, index: int) -> bool:
    """Return whether the model states the inertia of a servo's motor.

    Parameters
    ----------
    plant : Plant
        Plant.
    index : int
        Index into ``plant.actuators``.
    """
    servo = servo_of(plant, index)
    return servo is not None and servo.inertia > 0


def _range(is_limited: Any, values: Any) -> tuple[float, float]:
    return (float(values[0]), float(values[1])) if is_limited else (-np.inf, np.inf)


def _span(plant: MjcfPlant, control: int) -> Port | None:
    """Return the port of the joint or tendon that an actuator spans."""
    model = plant.model
    kind = _SPAN.get(mujoco.mjtTrn(int(model.actuator_trntype[control])))
    if kind is None:
        return None
    name = getattr(model, kind)(int(model.actuator_trnid[control, 0])).name
    return plant.ports.get(f"{kind}:{name}")


def servo_port(plant: Plant, index: int) -> Port | None:
    """Return the port along which a servo acts.

    Parameters
    ----------
    plant : Plant
        Plant.
    index : int
        Index into ``plant.actuators``.

    Returns
    -------
    Port or None
        Port with the length of the transmission as coordinate; None without a position servo.
    """
    if servo_of(plant, index) is None:
        return None
    assert isinstance(plant, MjcfPlant)
    control = int(plant.actuators[index].controls[0])
    along, gear = _span(plant, control), float(plant.model.actuator_gear[control, 0])
    if along is None:
        return None
    return replace(
        along,
        name=f"actuator:{plant.actuators[index].name}",
        row=lambda data: gear * along.row(data),
        position=lambda data: gear * along.position(data),
    )


class ServoEffect(PortEffect):
    """A change within a position servo's loop.

    Attribute `servo` holds the numbers of the servo at the place, see `at_servo`.
    """

    needs: ClassVar[tuple[str, ...]] = ("servo",)
    servo: Servo = Servo()

    def changed(self, e: Any, v: Any, p: Values) -> Any:
        """Return the changed force of the servo.

        Parameters
        ----------
        e : float or array
            Position error: command minus length.
        v : float or array
            Rate of the length.
        p : Values
            Parameter values.

        Returns
        -------
        float or array
            Force.
        """
        raise NotImplementedError

    def force(self, z: Any, v: Any, p: Values, step: Step, memory: Any) -> tuple[Any, Any]:
        """See `PortEffect`: the difference from the modelled force."""
        e = self.servo.error(step.command, z)
        return self.changed(e, v, p) - self.modelled(e, v), memory

    def modelled(self, e: Any, v: Any) -> Any:
        """Return the modelled force at a position error and a rate."""
        return self.servo.limited(self.servo.gain * e - self.servo.damping * v)

    def factors(self, p: Values) -> Mapping[str, float] | None:
        """Return the effect as factors on the servo's numbers.

        Parameters
        ----------
        p : Values
            Parameter values.

        Returns
        -------
        mapping of str to float or None
            Factors on ``gain``, ``damping`` and ``limits``; None for a law without such a form.
        """
        return None


@lru_cache(maxsize=1024)
def at_servo(effect: ServoEffect, servo: Servo) -> ServoEffect:
    """Return an effect at a servo, as one object for each servo.

    Parameters
    ----------
    effect : ServoEffect
        Effect of the catalogue.
    servo : Servo
        Numbers of the servo.

    Returns
    -------
    ServoEffect
        Copy of the effect.
    """
    out = copy.copy(effect)
    out.servo = servo
    return out


SMALL = 0.02
"""SMALL [1]: relative change of a gain at which the screening takes a law as linear. Raising it averages over more of
the force limits."""


class ServoPositionGain(ServoEffect):
    """A position gain that differs from the model's.

    The gain multiplies the position error. So the joint holds and follows softer or stiffer: under a constant load F the
    droop is F/kp, and the natural frequency of an inertia I is sqrt(kp/I).
    """

    name = "servo-position-gain"
    family = "servo"
    law = "force = (1 + g) kp (u - z) - kv v"
    words = "the position gain of a servo differs from the model's: the joint holds softer or stiffer than modelled"
    probe = SMALL
    parameters: ClassVar = (Parameter(name="gain", unit="1", low=0.005, high=3.0, signed=True),)

    def changed(self, e: Any, v: Any, p: Values) -> Any:
        """See `ServoEffect`."""
        return self.servo.limited((1.0 + p["gain"]) * self.servo.gain * e - self.servo.damping * v)

    def factors(self, p: Values) -> Mapping[str, float]:
        """See `ServoEffect`."""
        return {"gain": 1.0 + p["gain"]}


class ServoVelocityGain(ServoEffect):
    """A velocity gain that differs from the model's.

    Within the force limits the law is that of a damper at the joint, which may be negative.
    """

    name = "servo-velocity-gain"
    family = "servo"
    law = "force = kp (u - z) - (1 + g) kv v"
    words = "the velocity gain of a servo differs from the model's: the drive brakes more or less than modelled"
    probe = SMALL
    parameters: ClassVar = (Parameter(name="gain", unit="1", low=0.005, high=5.0, signed=True),)

    def changed(self, e: Any, v: Any, p: Values) -> Any:
        """See `ServoEffect`."""
        return self.servo.limited(self.servo.gain * e - (1.0 + p["gain"]) * self.servo.damping * v)

    def factors(self, p: Values) -> Mapping[str, float]:
        """See `ServoEffect`."""
        return {"damping": 1.0 + p["gain"]}


class ServoTorqueConstant(ServoEffect):
    """A torque constant or supply voltage that differs from the model's.

    Both gains and the force limits scale alike.
    """

    name = "servo-torque-constant"
    family = "servo"
    law = "force = (1 + g) (kp (u - z) - kv v)"
    words = "all forces of a servo differ from the model's by one factor: its torque constant or supply"
    probe = SMALL
    parameters: ClassVar = (Parameter(name="gain", unit="1", low=0.005, high=3.0, signed=True),)

    def changed(self, e: Any, v: Any, p: Values) -> Any:
        """See `ServoEffect`."""
        return (1.0 + p["gain"]) * self.modelled(e, v)

    def factors(self, p: Values) -> Mapping[str, float]:
        """See `ServoEffect`."""
        return dict.fromkeys(("gain", "damping", "limits"), 1.0 + p["gain"])


ERRORS = (0.005, 0.01, 0.02, 0.03, 0.05, 0.08, 0.12, 0.2, 0.3, 0.5)
"""ERRORS [1]: trial thresholds as shares of the largest position error. Steps of a command make that error large, so
the grid reaches far down."""


class ServoErrorDeadZone(ServoEffect):
    """A servo that does nothing about small position errors.

    At rest the joint stands anywhere within the threshold beside the modelled position.
    """

    name = "servo-error-dead-zone"
    family = "clearance"
    law = "force = kp (e - min(max(e, -d), d)) - kv v, e = u - z"
    words = "a servo ignores position errors below a threshold: the dead band of its controller"
    parameters: ClassVar = (
        Parameter(name="threshold", unit="m", low=1e-3, high=0.9, role="shape", reference="error", grid=ERRORS),
    )

    def changed(self, e: Any, v: Any, p: Values) -> Any:
        """See `ServoEffect`."""
        beyond = e - np.minimum(np.maximum(e, -p["threshold"]), p["threshold"])
        return self.servo.limited(self.servo.gain * beyond - self.servo.damping * v)


class ServoForceLimit(ServoEffect):
    """A servo that gives less force than its stated limit.

    The limit acts on the whole force, so accelerations are capped while gains stay.
    """

    name = "servo-force-limit"
    family = "saturation"
    law = "force = min(max(kp (u - z) - kv v, -L), L)"
    words = "a servo's force ends at a lower limit than the model's: a current limit, a weak supply"
    confirmed_by = "the same motion at half the speed, where no force reaches the limit"
    parameters: ClassVar = (
        Parameter(
            name="limit",
            unit="N",
            low=0.02,
            high=0.999,
            role="shape",
            reference="servo-force",
            grid=(0.15, 0.3, 0.45, 0.6, 0.75, 0.85, 0.92, 0.97),
        ),
    )

    def changed(self, e: Any, v: Any, p: Values) -> Any:
        """See `ServoEffect`."""
        return np.minimum(np.maximum(self.modelled(e, v), -p["limit"]), p["limit"])


def put_into(model: Any, plant: Plant, index: int, effect: ServoEffect, values: Values) -> bool:
    """Put an effect into the numbers of a compiled model's servo.

    Parameters
    ----------
    model : object
        Compiled model, changed in place.
    plant : Plant
        Plant of the model.
    index : int
        Index into ``plant.actuators``.
    effect : ServoEffect
        Effect.
    values : Values
        Parameter values.

    Returns
    -------
    bool
        Whether the servo's numbers can hold the effect.
    """
    i = int(plant.actuators[index].controls[0])
    if isinstance(effect, ServoForceLimit):
        least, most = _range(model.actuator_forcelimited[i], model.actuator_forcerange[i])
        model.actuator_forcelimited[i] = 1
        model.actuator_forcerange[i] = max(least, -values["limit"]), min(most, values["limit"])
        return True
    factors = effect.factors(values)
    if factors is None:
        return False
    model.actuator_gainprm[i, 0] *= factors.get("gain", 1.0)
    model.actuator_biasprm[i, 1] *= factors.get("gain", 1.0)
    model.actuator_biasprm[i, 2] *= factors.get("damping", 1.0)
    model.actuator_forcerange[i] *= factors.get("limits", 1.0)
    return True
