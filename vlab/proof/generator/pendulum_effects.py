"""Hidden effects of pendulums and carts, by their form."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from vlab.proof.generator.hidden import Action, Kind
from vlab.proof.generator.pendulum_setup import SwingScale

Shapes = Mapping[str, float]
Made = tuple[dict[str, float], Action]
TICK_S = 0.01
"""TICK_S [s]: unit of the sizes of delays and lags."""
FRICTION = ("coulomb-friction", "stribeck-friction", "lugre-friction", "smooth-friction")
PROFILE = ("slew-limit", "rate-limit")


def _numbers(**numbers: float) -> Action:
    return Action(machine=lambda log, place: log.with_numbers(place, **numbers))


def _added(name: str, more: float) -> Action:
    """Return a term added to a number of a joint."""
    return Action(
        machine=lambda log, place: log.with_numbers(
            place, **{name: more + log.machine.number(name)[log.coordinate(place)]}
        )
    )


def _motor(**numbers: float) -> Action:
    return Action(machine=lambda log, place: log.with_motor(**numbers))


def _sensor(**numbers: float) -> Action:
    return Action(machine=lambda log, place: log.with_sensor(place, **numbers))


# ---- in the library -------------------------------------------------------------------------------------------------


def _stribeck(s: float, p: Shapes, at: SwingScale) -> Made:
    force, excess, speed = s * at.force, s * at.force * p["excess"], p["speed"] * at.v
    return {"force": force, "excess": excess, "speed": speed}, _numbers(dry=force, excess=excess, speed=speed)


def _stop(s: float, p: Shapes, at: SwingScale) -> Made:
    k, gap = s * at.k, p["gap"] * at.peak
    return {"stiffness": k, "gap": gap}, _numbers(stop=k, gap=gap)


def _one_sided(s: float, p: Shapes, at: SwingScale) -> Made:
    """Spring beyond a place; a negative gap is on the other side."""
    side, way, k = p["sign"], p["gap"] * at.peak, s * at.k
    return {"stiffness": k, "gap": side * way}, _numbers(stop=k, gap=way, side=side)


def _sine(s: float, p: Shapes, at: SwingScale) -> Made:
    a, w = s * at.force, 2 * np.pi * p["hz"]
    sine, cosine = a * np.cos(p["phase"]), a * np.sin(p["phase"])
    return {"sine": sine, "cosine": cosine, "frequency": p["hz"]}, _numbers(sine=sine, cosine=cosine, omega=w)


def _payload(s: float, p: Shapes, at: SwingScale) -> Made:
    mass = s * at.payload
    return {"mass": mass}, Action(machine=lambda log, place: replace(log, machine=log.machine.with_payload(mass)))


SWING_LIBRARY: tuple[Kind, ...] = (
    Kind(name="coulomb-friction", family="friction", on="joint", most=0.8, start=0.01,
         make=lambda s, p, at: ({"force": (f := s * at.force)}, _numbers(dry=f))),
    Kind(name="stribeck-friction", family="friction", on="joint", make=_stribeck, most=0.6, start=0.01,
         shapes={"excess": (0.4, 1.2), "speed": (0.05, 0.3, "log")}),
    Kind(name="viscous-damping", family="damping", on="joint", most=1.0, start=0.05,
         make=lambda s, p, at: ({"damping": (c := s * at.force / at.v)}, _added("damping", c))),
    Kind(name="quadratic-drag", family="damping", on="joint", most=2.0, start=0.02,
         make=lambda s, p, at: ({"coefficient": (c := s * at.force / at.v**2)}, _numbers(drag=c))),
    Kind(name="cubic-stiffness", family="nonlinear-stiffness", on="joint", most=2.0,
         make=lambda s, p, at: ({"k3": (k := s * at.force / at.z**3)}, _numbers(cubic=k))),
    Kind(name="stiffness-to-ground", family="stiffness", on="joint", most=2.0,
         make=lambda s, p, at: ({"stiffness": (k := s * at.k)}, _numbers(spring=k))),
    Kind(name="stop", family="contact", on="joint", make=_stop, shapes={"gap": (0.5, 0.9)}, start=0.5, most=200.0),
    Kind(name="one-sided-stiffness", family="contact", on="joint", make=_one_sided, start=0.2, most=50.0,
         shapes={"gap": (0.2, 0.8), "sign": "sign"}),
    Kind(name="force-offset", family="bias", on="joint", shapes={"sign": "sign"}, most=0.5, start=0.01,
         make=lambda s, p, at: ({"force": (f := p["sign"] * s * at.force)}, _numbers(push=f))),
    Kind(name="sinusoidal-force", family="disturbance", on="joint", make=_sine, most=0.5, start=0.01,
         shapes={"hz": (0.3, 2.5, "log"), "phase": (0.0, 6.28)}),
    Kind(name="added-mass", form="at the tip", family="mass", on="tip", make=_payload, most=2.0, start=0.2,
         accepted=("added-mass",), same=False),
    Kind(name="added-mass", family="mass", on="joint", angular=False, most=1.0, start=0.1,
         make=lambda s, p, at: ({"mass": (m := s * at.m)}, _numbers(inertia=m))),
    Kind(name="rotary-inertia", family="mass", on="joint", angular=True, most=1.0, start=0.1,
         make=lambda s, p, at: ({"inertia": (i := s * at.m)}, _numbers(inertia=i))),
    Kind(name="actuator-gain", family="gain", on="actuator", shapes={"sign": "sign"}, most=0.4,
         make=lambda s, p, at: ({"gain": (g := p["sign"] * s)}, _motor(scale=1 + g))),
    Kind(name="actuator-offset", family="bias", on="actuator", shapes={"sign": "sign"}, most=0.5, start=0.01,
         make=lambda s, p, at: ({"offset": (o := p["sign"] * s * at.u)}, _motor(offset=o))),
    Kind(name="actuator-clipping", family="saturation", on="actuator", most=2.0, start=0.2,
         make=lambda s, p, at: ({"limit": (m := at.most_u * np.exp(-s))}, _motor(limit=m))),
    Kind(name="soft-saturation", family="saturation", on="actuator", most=5.0, start=0.3,
         make=lambda s, p, at: ({"limit": (m := at.most_u / s)}, _motor(soft_limit=m))),
    Kind(name="actuator-dead-zone", family="clearance", on="actuator", most=1.0, start=0.02,
         make=lambda s, p, at: ({"threshold": (d := s * at.u)}, _motor(dead_zone=d))),
    Kind(name="actuator-delay", family="timing", on="actuator", start=0.5, most=15.0,
         make=lambda s, p, at: ({"delay": (d := s * TICK_S)}, _motor(delay=d))),
    Kind(name="actuator-lag", family="timing", on="actuator", start=0.5, most=15.0,
         make=lambda s, p, at: ({"time_constant": (d := s * TICK_S)}, _motor(lag=d))),
    Kind(name="slew-limit", family="saturation", on="actuator", start=1.0, most=6.0, accepted=PROFILE,
         make=lambda s, p, at: ({"slope": (r := at.slope * np.exp(-s))}, _motor(slope=r))),
    Kind(name="actuator-quantisation", family="resolution", on="actuator", most=1.5,
         make=lambda s, p, at: ({"step": (q := s * at.u)}, _motor(quantum=q))),
    Kind(name="actuator-hold", family="timing", on="actuator", start=3.0, most=20.0,
         make=lambda s, p, at: ({"period": (n := max(2, round(s))) * at.h}, _motor(hold=float(n)))),
    Kind(name="sensor-gain", family="gain", on="sensor", shapes={"sign": "sign"}, most=0.3,
         make=lambda s, p, at: ({"gain": (g := p["sign"] * s)}, _sensor(gain=g))),
    Kind(name="sensor-offset", family="bias", on="sensor", shapes={"sign": "sign"}, most=0.5, start=0.01,
         make=lambda s, p, at: ({"offset": (o := p["sign"] * s * at.z)}, _sensor(offset=o))),
    Kind(name="sensor-drift", family="bias", on="sensor", shapes={"sign": "sign"}, most=1.0, start=0.01,
         make=lambda s, p, at: ({"rate": (r := p["sign"] * s * at.z / at.T)}, _sensor(drift=r))),
    Kind(name="sensor-delay", family="timing", on="sensor", start=0.5, most=10.0,
         make=lambda s, p, at: ({"delay": (d := s * TICK_S)}, _sensor(delay=d))),
    Kind(name="sensor-lag", family="timing", on="sensor", start=0.5, most=10.0,
         make=lambda s, p, at: ({"time_constant": (d := s * TICK_S)}, _sensor(lag=d))),
)  # fmt: skip
"""SWING_LIBRARY: kinds in the form of the vocabulary."""


# ---- other forms ----------------------------------------------------------------------------------------------------


def _bearing(s: float, p: Shapes, at: SwingScale) -> Made:
    """Friction of a bearing: a part that grows with the normal force."""
    dry, arm = s * at.force * (1 - p["share"]), s * at.force * p["share"] / at.load
    return {"force": dry, "arm": arm}, _numbers(dry=dry, loaded=arm)


def _worn(s: float, p: Shapes, at: SwingScale) -> Made:
    """Friction that differs between the directions."""
    return {"force": s * at.force, "skew": p["skew"]}, _numbers(dry=s * at.force, skew=p["skew"])


def _smooth(s: float, p: Shapes, at: SwingScale) -> Made:
    force, speed = s * at.force, p["speed"] * at.v
    return {"force": force, "speed": speed}, _numbers(smooth=force, smooth_speed=speed)


def _power(s: float, p: Shapes, at: SwingScale) -> Made:
    """Drag with another power of the rate."""
    coefficient = s * at.force / at.v ** p["power"]
    return {"coefficient": coefficient, "power": p["power"]}, _numbers(drag=coefficient, drag_power=p["power"])


def _hertz(s: float, p: Shapes, at: SwingScale) -> Made:
    """Stop of rubber, whose force grows with a power of the indentation."""
    gap, power = p["gap"] * at.peak, p["power"]
    k = s * at.k * at.z ** (1.0 - power)
    return {"stiffness": k, "gap": gap, "power": power}, _numbers(stop=k, gap=gap, stop_power=power)


SWING_FORMS: tuple[Kind, ...] = (
    Kind(name="coulomb-friction", form="grows with load", family="friction", on="joint", make=_bearing,
         accepted=FRICTION, shapes={"share": (0.4, 1.0)}, most=0.8, start=0.01, same=False),
    Kind(name="coulomb-friction", form="tanh", family="friction", on="joint", make=_smooth, accepted=FRICTION,
         shapes={"speed": (0.05, 0.3, "log")}, most=0.8, start=0.01, same=False),
    Kind(name="coulomb-friction", form="skew", family="friction", on="joint", make=_worn, accepted=FRICTION,
         shapes={"skew": (-0.4, 0.4)}, most=0.8, start=0.01, same=False),
    Kind(name="quadratic-drag", form="power law", family="damping", on="joint", make=_power, same=False,
         accepted=("quadratic-drag",), shapes={"power": (1.6, 2.6)}, most=2.0, start=0.02),
    Kind(name="cubic-stiffness", form="quintic", family="nonlinear-stiffness", on="joint", same=False, most=2.0,
         accepted=("cubic-stiffness", "cubic-quintic-stiffness"),
         make=lambda s, p, at: ({"k5": (k := s * at.force / at.z**5)}, _numbers(quintic=k))),
    Kind(name="stop", form="rubber", family="contact", on="joint", make=_hertz, accepted=("stop",), start=0.5,
         shapes={"gap": (0.5, 0.9), "power": (1.3, 2.0)}, most=200.0, same=False),
    Kind(name="actuator-dead-zone", form="smooth", family="clearance", on="actuator", most=1.5, start=0.05, same=False,
         accepted=("actuator-dead-zone",),
         make=lambda s, p, at: ({"threshold": (d := s * at.u)}, _motor(soft_zone=d))),
    Kind(name="actuator-lag", form="second order", family="timing", on="actuator", start=0.5, most=15.0, same=False,
         accepted=("actuator-lag", "actuator-delay"),
         make=lambda s, p, at: ({"time_constant": (d := s * TICK_S)}, _motor(lag=0.5 * d, second_lag=0.5 * d))),
)  # fmt: skip
"""SWING_FORMS: other forms of known physics."""


# ---- out of the library ---------------------------------------------------------------------------------------------


def _magnet(s: float, p: Shapes, at: SwingScale) -> Made:
    """Magnet beside the path, which pulls towards one angle."""
    pull, where, width = s * at.force, p["sign"] * p["where"] * at.peak, p["width"] * at.peak
    made = {"pull": pull, "angle": where, "width": width}
    return made, _numbers(magnet=pull, magnet_at=where, magnet_width=width)


def _running_in(s: float, p: Shapes, at: SwingScale) -> Made:
    """Friction that fades within each recording as the grease warms."""
    force, tau = s * at.force, p["tau"] * at.T
    return {"force": force, "tau": tau}, _numbers(dry=force, fading=1.0, fading_time=tau)


def _cable(s: float, p: Shapes, at: SwingScale) -> Made:
    """Cable that pulls in one direction only, with a loop."""
    force, bend = s * at.force, p["yield"] * at.z
    return {"force": force, "yield": bend}, _numbers(cable=force, cable_yield=bend)


def _rail(s: float, p: Shapes, at: SwingScale) -> Made:
    """Rail whose slope varies along the travel."""
    force, rate = s * at.force, 2 * np.pi / (p["waves"] * at.z)
    made = {"force": force, "rate": rate, "phase": p["phase"]}
    return made, _numbers(slope=force, slope_rate=rate, slope_phase=p["phase"])


def _swaying(s: float, p: Shapes, at: SwingScale) -> Made:
    """Supply that sways at its own frequency."""
    return {"share": s, "hz": p["hz"]}, _motor(sway=s, sway_omega=2 * np.pi * p["hz"], sway_phase=p["phase"])


def _warming(s: float, p: Shapes, at: SwingScale) -> Made:
    """Motor that warms with squared current and loses force."""
    loss, tau = s / at.u**2, p["tau"] * at.T
    return {"loss": loss, "tau": tau}, _motor(loss=loss, loss_time=tau)


def _bent_sensor(s: float, p: Shapes, at: SwingScale) -> Made:
    """Sensor with an even curve."""
    curve = p["sign"] * s / at.z
    return {"curve": curve}, _sensor(curve=curve)


SWING_STRANGE: tuple[Kind, ...] = (
    Kind(name="magnetic-pull", family="disturbance", on="joint", angular=True, make=_magnet, same=False, most=1.0,
         start=0.02, shapes={"sign": "sign", "where": (0.1, 0.7), "width": (0.08, 0.2)}),
    Kind(name="fading-friction", family="friction", on="joint", make=_running_in, same=False, most=1.0, start=0.02,
         shapes={"tau": (0.15, 0.5)}),
    Kind(name="cable-hysteresis", family="hysteresis", on="joint", make=_cable, same=False, most=1.0, start=0.02,
         shapes={"yield": (0.3, 1.0)}),
    Kind(name="uneven-rail", family="disturbance", on="joint", angular=False, make=_rail, same=False, most=1.0,
         start=0.02, shapes={"waves": (0.5, 2.0), "phase": (0.0, 6.28)}),
    Kind(name="swaying-supply", family="time-variation", on="actuator", make=_swaying, same=False, most=0.6,
         shapes={"hz": (0.3, 2.0, "log"), "phase": (0.0, 6.28)}),
    Kind(name="warming-motor", family="time-variation", on="actuator", make=_warming, same=False, most=3.0,
         shapes={"tau": (0.1, 0.4)}),
    Kind(name="curved-sensor", family="sensor", on="sensor", make=_bent_sensor, same=False, most=0.5, start=0.01,
         shapes={"sign": "sign"}),
)  # fmt: skip
"""SWING_STRANGE: kinds outside the library."""
