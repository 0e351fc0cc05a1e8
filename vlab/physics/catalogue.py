"""Catalogue of effects by name."""

from collections.abc import Collection
from pathlib import Path
from typing import Any

from vlab.controllers.user_law import ENTRY, FAILURES, check_code, class_from_file, from_entry_point, is_user_law
from vlab.errors import BadExperiment, unknown_name
from vlab.physics import (
    actuator_dynamics,
    actuator_memory,
    actuators,
    drive_train,
    port_linear,
    port_memory,
    port_nonlinear,
    sensors,
    servo,
    servo_drive,
    tabulated,
)
from vlab.physics.effect import Effect

EFFECTS: dict[str, Effect] = {
    effect.name: effect
    for effect in (
        port_linear.AddedMass(),
        port_linear.RotaryInertia(),
        port_linear.LostStiffness(),
        port_linear.StiffnessToGround(),
        port_linear.NegativeStiffness(),
        port_linear.TensionError(),
        port_linear.ViscousDamping(),
        port_nonlinear.QuadraticDrag(),
        port_nonlinear.CubicStiffness(),
        port_nonlinear.QuinticStiffness(),
        port_nonlinear.StringStiffness(),
        port_nonlinear.QuadraticStiffness(),
        port_nonlinear.PolynomialStiffness(),
        port_nonlinear.CoulombFriction(),
        port_nonlinear.SmoothFriction(),
        port_nonlinear.StribeckFriction(),
        port_nonlinear.DeadBand(),
        port_nonlinear.Stop(),
        port_nonlinear.OneSidedStiffness(),
        port_nonlinear.ForceOffset(),
        port_nonlinear.SinusoidalForce(),
        port_nonlinear.Cogging(),
        port_memory.JenkinsSlip(),
        port_memory.IwanSlip(),
        port_memory.BoucWen(),
        port_memory.LooseningStiffness(),
        port_memory.LuGreFriction(),
        port_memory.PlasticSet(),
        port_memory.AttachedOscillator(),
        port_memory.StructuralDamping(),
        tabulated.TabulatedForce(),
        actuators.ActuatorGain(),
        actuators.ActuatorOffset(),
        actuators.Clipping(),
        actuators.SoftSaturation(),
        actuators.DeadZone(),
        actuator_dynamics.SlewLimit(),
        actuator_dynamics.RateLimit(),
        actuator_dynamics.ActuatorDelay(),
        actuator_dynamics.ActuatorLag(),
        actuator_memory.InputHysteresis(),
        actuators.Quantisation(),
        actuator_dynamics.CoarseHold(),
        actuator_dynamics.Jitter(),
        actuators.CoilForceOverTravel(),
        servo.ServoPositionGain(),
        servo.ServoVelocityGain(),
        servo.ServoTorqueConstant(),
        servo_drive.ServoIntegralGain(),
        servo.ServoErrorDeadZone(),
        servo.ServoForceLimit(),
        servo_drive.ServoSoftForceLimit(),
        servo_drive.ServoTorqueSpeedLine(),
        servo_drive.ServoLoadFriction(),
        drive_train.ServoBacklash(),
        drive_train.ServoCompliance(),
        sensors.SensorGain(),
        sensors.SensorOffset(),
        sensors.SensorDrift(),
        sensors.SensorClipping(),
        sensors.SensorSoftSaturation(),
        sensors.SensorDelay(),
        sensors.SensorLag(),
        sensors.SensorHighPass(),
        sensors.SensorQuantisation(),
        sensors.MainsHum(),
        sensors.SensorResonance(),
        sensors.Crosstalk(),
        sensors.CrossAxis(),
        sensors.MisplacedSensor(),
    )
}
"""Effects by name."""
CANDIDATES: tuple[Effect, ...] = tuple(
    effect for effect in EFFECTS.values() if not (effect.is_last_resort or effect.is_on_request)
)
"""Effects that every search tries."""
LAST_RESORT: tuple[Effect, ...] = tuple(effect for effect in EFFECTS.values() if effect.is_last_resort)
"""Effects that are tried where none of `CANDIDATES` explains the recordings."""


ALIASES = {
    "air-added-mass": "added-mass",
    "hardening": "cubic-stiffness",
    "initial-curvature": "quadratic-stiffness",
    "joint-flexibility": "lost-stiffness",
    "clamp-flexibility": "lost-stiffness",
    "temperature-drift": "drifting-stiffness",
    "loosening": "drifting-stiffness",
    "cable-slack": "one-sided-stiffness",
    "cable-string-mode": "attached-oscillator",
    "tuned-mass": "attached-oscillator",
    "back-emf": "viscous-damping",
    "eddy-currents": "viscous-damping",
    "rubbing": "coulomb-friction",
    "micro-slip": "iwan-slip",
    "lap-joint": "iwan-slip",
    "backlash": "dead-band",
    "rattle": "stop",
    "piezo-hysteresis": "actuator-hysteresis",
    "magnetic-hysteresis": "actuator-hysteresis",
    "coil-inductance": "actuator-lag",
    "filter-corner": "actuator-lag",
    "gear-play": "servo-backlash",
    "elastic-gear": "servo-compliance",
    "torque-ripple": "cogging",
    "servo-zero": "actuator-offset",
    "servo-supply": "servo-torque-constant",
    "floor-motion": "sinusoidal-force",
    "draught": "sinusoidal-force",
    "force-hum": "sinusoidal-force",
}
"""Alternative names of a law: the cause or the place differs, the equation does not."""

EFFECT_FORM = "path/to/effect.py:ClassName or entry:NAME"
"""Form of a reference to a user's own effect."""
GROUP = "vlab.effects"
"""Entry point group of packages with effects."""


def effects(family: str = "") -> list[Effect]:
    """Return the effects of the catalogue.

    Parameters
    ----------
    family : str
        Family of the effects; all by default.

    Returns
    -------
    list of Effect
        Effects in the order of the catalogue.

    Raises
    ------
    UnknownName
        No such family.
    """
    known = dict.fromkeys(effect.family for effect in EFFECTS.values())
    if family and family not in known:
        raise unknown_name("family of effects", family, known)
    return [effect for effect in EFFECTS.values() if family in ("", effect.family)]


def last_resort(searched: Collection[Effect]) -> tuple[Effect, ...]:
    """Return the effects that are tried where no other one explains the recordings.

    Parameters
    ----------
    searched : collection of Effect
        Effects that were searched.

    Returns
    -------
    tuple of Effect
        Empty if the search left out effects of the catalogue: one of these may explain the recordings.
    """
    names = {effect.name for effect in searched}
    return LAST_RESORT if all(effect.name in names for effect in CANDIDATES) else ()


def effect_named(name: str, *, code: Collection[str] | None = None) -> Effect:
    """Return an effect by name or alias.

    A user's own effect has the form ``path/to/effect.py:ClassName``. ``entry:NAME`` means the entry point NAME of the
    group ``vlab.effects`` of an installed package.

    Parameters
    ----------
    name : str
        Name; loading a user's own effect runs the code of its file.
    code : collection of str, optional
        Python files that the user named, if `name` comes from a data file; `name` may then refer to one of the listed
        files only. None if the user gave `name`.

    Returns
    -------
    Effect
        The catalogue's object, or a new one of the user's class.

    Raises
    ------
    UnknownName
        No effect of that name.
    BadExperiment
        A user's file is not listed or fails, or the class is no effect.
    """
    name = ALIASES.get(name, name)
    if name in EFFECTS:
        return EFFECTS[name]
    if is_user_law(name):
        check_code(name, code, kind="effect", error=BadExperiment)
        return _users_own(name)
    raise unknown_name("effect", name, [*EFFECTS, *ALIASES, EFFECT_FORM])


def _users_own(text: str) -> Effect:
    if text.startswith(ENTRY):
        given = from_entry_point(text.removeprefix(ENTRY), group=GROUP, kind="effect", error=BadExperiment)
        return given if isinstance(given, Effect) else _made(given, text)
    path, colon, name = text.rpartition(":")
    if not colon or not path.endswith(".py") or not name.isidentifier():
        raise BadExperiment(f"the effect {text!r} names no class of a file; write {EFFECT_FORM}")
    return _made(class_from_file(Path(path), name, kind="effect", form=EFFECT_FORM, error=BadExperiment), text)


def _made(made_by: Any, text: str) -> Effect:
    """Return an effect of a user's class."""
    if not (isinstance(made_by, type) and issubclass(made_by, Effect)):
        raise BadExperiment(f"{text} is no subclass of vlab.physics.effect.PortEffect, ActuatorEffect or SensorEffect")
    missing = [key for key in ("name", "family", "law", "words", "parameters") if not hasattr(made_by, key)]
    if missing:
        raise BadExperiment(f"the effect {text} does not say its {', '.join(missing)}")
    try:
        return made_by()
    except FAILURES as error:
        raise BadExperiment(f"the effect {text} cannot be made without arguments: {error}") from error
