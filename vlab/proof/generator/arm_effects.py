"""Hidden effects of arms: in the library, in other forms, and outside it."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from vlab.proof.generator.arm_models import with_payload
from vlab.proof.generator.arm_setup import ServoArm, ServoScale
from vlab.proof.generator.hidden import Action, Kind

Shapes = Mapping[str, float]
Made = tuple[dict[str, float], Action]
TICK_S = 0.01
"""TICK_S [s]: unit of the sizes of delays and lags."""


def _numbers(**numbers: float) -> Action:
    return Action(machine=lambda arm, place: arm.with_numbers(place, **numbers))


def _way(**numbers: float) -> Action:
    return Action(machine=lambda arm, place: arm.with_way(place, **numbers))


def _scaled(**factors: float) -> Action:
    """Return factors on numbers of a drive."""

    def machine(arm: ServoArm, place: str) -> ServoArm:
        j = arm.joint(place)
        return arm.with_numbers(place, **{name: by * arm.machine.number(name)[j] for name, by in factors.items()})

    return Action(machine=machine)


def _added(**more: float) -> Action:
    """Return terms added to numbers of a drive."""

    def machine(arm: ServoArm, place: str) -> ServoArm:
        j = arm.joint(place)
        return arm.with_numbers(place, **{name: x + arm.machine.number(name)[j] for name, x in more.items()})

    return Action(machine=machine)


def _everywhere(each: list[dict[str, float]]) -> Action:
    """Return numbers of every drive."""

    def machine(arm: ServoArm, place: str) -> ServoArm:
        drives = arm.machine
        for j, numbers in enumerate(each):
            drives = drives.with_numbers(j, **numbers)
        return replace(arm, machine=drives)

    return Action(machine=machine)


def _rated(s: float, p: Shapes, at: ServoScale) -> list[float]:
    """Return the friction of every joint as a share of its drive's force."""
    return [float(s * one.limit * x) for x, one in zip(_spread(p, len(at.each)), at.each, strict=True)]


def _spread(p: Shapes, count: int) -> Any:
    """Return the factors by which the joints of an arm differ."""
    return np.random.default_rng(int(p["draw"])).uniform(0.6, 1.4, count)


# ---- in the library -------------------------------------------------------------------------------------------------


def _limit(s: float, p: Shapes, at: ServoScale) -> Made:
    most = at.most_moment * np.exp(-s)
    return {"limit": most}, _numbers(low=-most, high=most)


def _backlash(s: float, p: Shapes, at: ServoScale) -> Made:
    gap, k, zeta, share = s * at.z, p["stiffness"] * at.k, p["zeta"], p["share"]
    numbers = {"has_train": 1.0, "gap": gap, "train": k, "train_damper": 2 * zeta * np.sqrt(k * at.motor)}
    made = {"gap": gap, "stiffness": k, "damping_ratio": zeta, "motor_share": share}
    return made, _numbers(**numbers, motor_share=share)


def _compliance(s: float, p: Shapes, at: ServoScale) -> Made:
    k, zeta, share = at.k / s, p["zeta"], p["share"]
    numbers = {"has_train": 1.0, "train": k, "train_damper": 2 * zeta * np.sqrt(k * at.motor), "motor_share": share}
    return {"stiffness": k, "damping_ratio": zeta, "motor_share": share}, _numbers(**numbers)


def _stribeck(s: float, p: Shapes, at: ServoScale) -> Made:
    force, excess, speed = s * at.moment, s * at.moment * p["excess"], p["speed"] * at.v
    return {"force": force, "excess": excess, "speed": speed}, _numbers(dry=force, excess=excess, speed=speed)


def _rubbing(s: float, p: Shapes, at: ServoScale) -> Made:
    each = _rated(s, p, at)
    return {f"force_{j + 1}": x for j, x in enumerate(each)}, _everywhere([{"dry": x} for x in each])


def _sticking(s: float, p: Shapes, at: ServoScale) -> Made:
    each = _rated(s, p, at)
    numbers = [
        {"dry": x, "excess": p["excess"] * x, "speed": p["speed"] * one.v} for x, one in zip(each, at.each, strict=True)
    ]
    return {f"force_{j + 1}": x for j, x in enumerate(each)}, _everywhere(numbers)


def _payload(s: float, p: Shapes, at: ServoScale) -> Made:
    mass = s * at.payload
    return {"mass": mass}, Action(machine=lambda arm, place: _carrying(arm, mass, np.zeros(3), 0.02))


def _carrying(arm: ServoArm, mass: float, away: Any, size: float) -> ServoArm:
    return replace(arm, machine=with_payload(arm.machine, arm.arm, mass, away, size))


FRICTION = ("coulomb-friction", "stribeck-friction", "lugre-friction", "smooth-friction")
GEARS = (*FRICTION, "servo-load-friction")
PROFILE = ("rate-limit", "slew-limit")
BRAKES = ("servo-velocity-gain", "viscous-damping")
"""BRAKES: one law within the limits of a drive's force, hence both names are right."""
LATE = ("actuator-delay", "sensor-delay")
"""LATE: alike where all commands are late, since an arm has no other inputs."""
_TRAIN = {"zeta": (0.03, 0.3, "log"), "share": (0.2, 0.9)}
_STRIBECK = {"excess": (0.4, 1.2), "speed": (0.05, 0.3, "log")}
ARM_LIBRARY: tuple[Kind, ...] = (
    Kind(name="servo-position-gain", family="servo", on="servo", shapes={"sign": "sign"}, most=0.6,
         make=lambda s, p, at: ({"gain": (g := p["sign"] * s)}, _scaled(gain=1 + g))),
    Kind(name="servo-velocity-gain", family="servo", on="servo", shapes={"sign": "sign"}, most=0.8, accepted=BRAKES,
         make=lambda s, p, at: ({"gain": (g := p["sign"] * s)}, _scaled(velocity_gain=1 + g))),
    Kind(name="servo-torque-constant", family="servo", on="servo", shapes={"sign": "sign"}, most=0.6,
         make=lambda s, p, at: ({"gain": (g := p["sign"] * s)}, _scaled(torque=1 + g))),
    Kind(name="servo-error-dead-zone", family="clearance", on="servo", most=3.0, start=0.1,
         make=lambda s, p, at: ({"threshold": (d := s * at.error)}, _numbers(dead_zone=d))),
    Kind(name="servo-force-limit", family="saturation", on="servo", make=_limit, start=0.3, most=1.5),
    Kind(name="servo-backlash", family="clearance", on="servo", make=_backlash, most=0.4, start=0.02,
         shapes={"stiffness": (4.0, 30.0, "log"), **_TRAIN}),
    Kind(name="servo-compliance", family="stiffness", on="servo", make=_compliance, most=1.5, start=0.1, shapes=_TRAIN),
    Kind(name="actuator-gain", family="gain", on="servo", shapes={"sign": "sign"}, most=0.3,
         make=lambda s, p, at: ({"gain": (g := p["sign"] * s)}, _way(scale=1 + g))),
    Kind(name="actuator-offset", family="bias", on="servo", shapes={"sign": "sign"}, most=0.6,
         make=lambda s, p, at: ({"offset": (o := p["sign"] * s * at.z)}, _way(offset=o))),
    Kind(name="actuator-delay", family="timing", on="servo", start=0.5, most=8.0,
         make=lambda s, p, at: ({"delay": (d := s * TICK_S)}, _way(delay=d))),
    Kind(name="actuator-delay", family="timing", on="all servos", start=0.5, most=8.0, accepted=LATE,
         make=lambda s, p, at: ({"delay": (d := s * TICK_S)}, _way(delay=d))),
    Kind(name="actuator-lag", family="timing", on="servo", start=0.5, most=15.0,
         make=lambda s, p, at: ({"time_constant": (d := s * TICK_S)}, _way(lag=d))),
    Kind(name="actuator-lag", family="timing", on="all servos", start=0.5, most=15.0,
         make=lambda s, p, at: ({"time_constant": (d := s * TICK_S)}, _way(lag=d))),
    Kind(name="rate-limit", family="saturation", on="servo", start=0.3, most=2.0, accepted=PROFILE,
         make=lambda s, p, at: ({"slope": (r := at.slope * np.exp(-s))}, _way(slope=r))),
    Kind(name="actuator-quantisation", family="resolution", on="servo", most=0.4, start=0.02,
         make=lambda s, p, at: ({"step": (q := s * at.z)}, _way(quantum=q))),
    Kind(name="actuator-hold", family="timing", on="all servos", start=3.0, most=20.0,
         make=lambda s, p, at: ({"period": (n := max(2, round(s))) * at.h}, _way(hold=float(n)))),
    Kind(name="coulomb-friction", family="friction", on="joint", most=1.5,
         make=lambda s, p, at: ({"force": (f := s * at.moment)}, _numbers(dry=f))),
    Kind(name="stribeck-friction", family="friction", on="joint", make=_stribeck, most=1.2, shapes=_STRIBECK),
    Kind(name="coulomb-friction", family="friction", on="all joints", form="in every joint", make=_rubbing, most=0.2,
         accepted=FRICTION, shapes={"draw": (0.0, 1e9)}, same=False),
    Kind(name="stribeck-friction", family="friction", on="all joints", form="in every joint", make=_sticking, most=0.15,
         accepted=FRICTION, shapes={"draw": (0.0, 1e9), **_STRIBECK}, same=False),
    Kind(name="viscous-damping", family="damping", on="joint", most=2.0, start=0.2, accepted=BRAKES[::-1],
         make=lambda s, p, at: ({"damping": (c := s * at.brake)}, _added(damping=c))),
    Kind(name="rotary-inertia", family="mass", on="joint", most=2.0, start=0.1,
         make=lambda s, p, at: ({"inertia": (i := s * at.m)}, _added(armature=i))),
    Kind(name="added-mass", family="mass", on="tip", make=_payload, most=2.0, start=0.2),
    Kind(name="force-offset", family="bias", on="joint", shapes={"sign": "sign"}, most=1.0,
         make=lambda s, p, at: ({"force": (f := p["sign"] * s * at.moment)}, _numbers(push=f))),
)  # fmt: skip
"""ARM_LIBRARY: kinds in the form of the vocabulary."""


# ---- other forms ----------------------------------------------------------------------------------------------------


def _gears(s: float, p: Shapes, at: ServoScale) -> Made:
    """Friction of a gear: a part that grows with the transmitted moment."""
    dry, share = s * at.moment * (1 - p["share"]), s * p["share"]
    return {"force": dry, "share": share}, _numbers(dry=dry, loaded=share)


def _all_gears(s: float, p: Shapes, at: ServoScale) -> Made:
    each = [s * x for x in _spread(p, len(at.each))]
    numbers = [
        {"dry": 0.1 * x * one.limit * (1 - p["share"]), "loaded": x * p["share"]}
        for x, one in zip(each, at.each, strict=True)
    ]
    return {f"share_{j + 1}": x for j, x in enumerate(each)}, _everywhere(numbers)


def _profile(s: float, p: Shapes, at: ServoScale) -> Made:
    """Trapezoidal profile: velocity and acceleration of the target are limited."""
    slope, takes = at.slope * np.exp(-s), p["takes"]
    return {"slope": slope, "bend": slope / takes}, _way(slope=slope, bend=slope / takes)


def _worn(s: float, p: Shapes, at: ServoScale) -> Made:
    """Friction that differs between the directions."""
    return {"force": s * at.moment, "skew": p["skew"]}, _numbers(dry=s * at.moment, skew=p["skew"])


def _tool(s: float, p: Shapes, at: ServoScale) -> Made:
    """Payload whose centre stands off the flange."""
    rng, mass = np.random.default_rng(int(p["draw"])), s * at.payload
    away = 0.05 * rng.uniform(-1.0, 1.0, 3)
    return {"mass": mass}, Action(machine=lambda arm, place: _carrying(arm, mass, away, 0.04))


ARM_FORMS: tuple[Kind, ...] = (
    Kind(name="coulomb-friction", form="grows with load", family="friction", on="joint", make=_gears, accepted=GEARS,
         shapes={"share": (0.4, 1.0)}, most=0.8, same=False),
    Kind(name="coulomb-friction", form="grows with load, in every joint", family="friction", on="all joints",
         make=_all_gears, accepted=GEARS, shapes={"share": (0.4, 1.0), "draw": (0.0, 1e9)}, most=0.6, same=False),
    Kind(name="coulomb-friction", form="tanh", family="friction", on="joint", accepted=FRICTION, same=False, most=1.5,
         shapes={"speed": (0.03, 0.15, "log")},
         make=lambda s, p, at: ({"force": (f := s * at.moment)}, _numbers(smooth=f, smooth_speed=p["speed"] * at.v))),
    Kind(name="coulomb-friction", form="skew", family="friction", on="joint", make=_worn, accepted=FRICTION, same=False,
         most=1.5, shapes={"skew": (-0.4, 0.4)}),
    Kind(name="rate-limit", form="trapezoid", family="saturation", on="servo", make=_profile, accepted=PROFILE,
         start=0.3, most=2.0, shapes={"takes": (0.05, 0.25)}, same=False),
    Kind(name="servo-error-dead-zone", form="smooth", family="clearance", on="servo", most=3.0, start=0.1, same=False,
         accepted=("servo-error-dead-zone",),
         make=lambda s, p, at: ({"threshold": (d := s * at.error)}, _numbers(soft_zone=d))),
    Kind(name="servo-force-limit", form="tanh", family="saturation", on="servo", most=3.0, start=0.3, same=False,
         accepted=("servo-force-limit",),
         make=lambda s, p, at: ({"limit": (m := at.most_moment / s)}, _numbers(soft_limit=m))),
    Kind(name="actuator-lag", form="second order", family="timing", on="servo", start=0.5, most=15.0, same=False,
         accepted=("actuator-lag", "actuator-delay"),
         make=lambda s, p, at: ({"time_constant": (d := s * TICK_S)}, _way(lag=0.5 * d, second_lag=0.5 * d))),
    Kind(name="added-mass", form="off the flange", family="mass", on="tip", make=_tool, most=2.0, start=0.2,
         accepted=("added-mass",), shapes={"draw": (0.0, 1e9)}),
)  # fmt: skip
"""ARM_FORMS: other forms of known physics."""


# ---- out of the library ---------------------------------------------------------------------------------------------


def _running_in(s: float, p: Shapes, at: ServoScale) -> Made:
    """Friction that fades as the grease warms."""
    force, tau = s * at.moment, p["tau"] * at.T
    return {"force": force, "tau": tau}, _numbers(dry=force, warm=1.0, warm_time=tau)


def _cable(s: float, p: Shapes, at: ServoScale) -> Made:
    """Cable that pulls in one direction only, with a loop."""
    force, bend = s * at.moment, p["yield"] * at.z
    return {"force": force, "yield": bend}, _numbers(cable=force, cable_yield=bend)


def _ripple(s: float, p: Shapes, at: ServoScale) -> Made:
    """Supply that sways at its own frequency."""
    return {"share": s, "hz": p["hz"]}, _numbers(ripple=s, ripple_rate=2 * np.pi * p["hz"], ripple_phase=p["phase"])


def _cogging(s: float, p: Shapes, at: ServoScale) -> Made:
    """Moment of the motor's teeth over its angle."""
    teeth = float(round(p["teeth"]))
    return {"moment": s * at.moment, "teeth": teeth}, _numbers(cog=s * at.moment, cogs=teeth, cog_phase=p["phase"])


ARM_STRANGE: tuple[Kind, ...] = (
    Kind(name="fading-friction", family="friction", on="joint", make=_running_in, same=False, most=2.0,
         shapes={"tau": (0.15, 0.5)}),
    Kind(name="cable-hysteresis", family="hysteresis", on="joint", make=_cable, same=False, most=1.5,
         shapes={"yield": (0.3, 1.0)}),
    Kind(name="sagging-gain", family="servo", on="servo", same=False, most=3.0, start=0.1,
         make=lambda s, p, at: ({"sag": (g := s / at.most_moment)}, _numbers(sag=g))),
    Kind(name="drive-moment-lag", family="timing", on="servo", same=False, start=0.2, most=3.0,
         make=lambda s, p, at: ({"time_constant": (d := s * at.brake / at.k)}, _numbers(lag=d))),
    Kind(name="integral-action", family="servo", on="servo", same=False, start=0.1, most=3.0,
         make=lambda s, p, at: ({"gain": (g := s * at.k)}, _numbers(integral=g))),
    Kind(name="swaying-supply", family="time-variation", on="servo", make=_ripple, same=False, most=0.6,
         shapes={"hz": (0.3, 2.0, "log"), "phase": (0.0, 6.28)}),
    Kind(name="cogging", family="disturbance", on="joint", make=_cogging, same=False, most=1.0,
         shapes={"teeth": (12.0, 60.0, "log"), "phase": (0.0, 6.28)}),
    Kind(name="coupled-drives", family="pick-up", on="servo", same=False, most=0.5, shapes={"sign": "sign"},
         make=lambda s, p, at: ({"share": (g := p["sign"] * s)}, _numbers(coupled=g))),
)  # fmt: skip
"""ARM_STRANGE: kinds outside the library."""
