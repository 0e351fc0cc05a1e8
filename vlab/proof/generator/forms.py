"""Other forms of physics in `vlab effects`.

The laws differ from those of the vocabulary, but a name of the vocabulary is the right answer. `accepted` lists all
right names, the nearest first.
"""

from typing import Any

import numpy as np

from vlab.proof.generator.hardware import filtered, low_passed
from vlab.proof.generator.hidden import Action, Kind, Scale, Signals
from vlab.proof.generator.law import Bristles, Hysteresis, Relaxing, Sliders, Static, Tracking
from vlab.signals import Array

Shapes = Any
Made = tuple[dict[str, float], Action]
SLIDERS = 16
"""SLIDERS [-]: sliders of an Iwan element."""


def _static(of: Any) -> Action:
    return Action(law=Static(of))


def _smooth_friction(s: float, p: Shapes, at: Scale) -> Made:
    force, speed = s * at.k * at.z, p["speed"] * at.v
    return {"force": force, "width": speed}, _static(lambda z, v, t, u: -force * np.tanh(v / speed))


def _dahl(s: float, p: Shapes, at: Scale) -> Made:
    force, bend = s * at.k * at.z, p["bristle"] * at.z
    return {"force": force, "bristle": bend}, Action(law=Bristles(force, bend, lambda v: 1.0))


def _friction_with_load(s: float, p: Shapes, at: Scale) -> Made:
    """Dry friction with a normal force that grows with displacement."""
    force, grows, speed = s * at.k * at.z, p["grows"] / at.z, 0.03 * at.v
    law = _static(lambda z, v, t, u: -force * (1 + grows * np.abs(z)) * np.tanh(v / speed))
    return {"force": force, "grows": grows}, law


def _iwan(s: float, p: Shapes, at: Scale) -> Made:
    """Iwan element of equal springs and evenly spread slider strengths."""
    force, slip = s * at.k * at.z, p["slip"] * at.z
    k = force / slip / SLIDERS
    strength = 2 * force / SLIDERS * (np.arange(SLIDERS) + 0.5) / SLIDERS
    return {"force": force, "slip": slip}, Action(law=Sliders(np.full(SLIDERS, k), strength))


def _wen(s: float, p: Shapes, at: Scale) -> Made:
    force, d, n = s * at.k * at.z, p["yield"] * at.z, p["n"]
    return {"force": force, "yield": d, "n": n}, Action(law=Hysteresis(force, d, beta=0.8, gamma=0.2, n=n))


def _sinh(s: float, p: Shapes, at: Scale) -> Made:
    d, k = p["width"] * at.z, s * at.k
    law = _static(lambda z, v, t, u: -k * d * (np.sinh(np.minimum(np.maximum(z / d, -20.0), 20.0)) - z / d))
    return {"stiffness": k, "width": d}, law


def _tangent(s: float, p: Shapes, at: Scale) -> Made:
    """Stretched string between fixed ends: F = -k z (1 - d/sqrt(d^2 + z^2))."""
    d, k = p["width"] * at.z, s * at.k
    return {"stiffness": k, "width": d}, _static(lambda z, v, t, u: -k * z * (1 - d / np.sqrt(d * d + z * z)))


def _power_drag(s: float, p: Shapes, at: Scale) -> Made:
    n = p["n"]
    c = s * at.k * at.z / at.v**n
    return {"coefficient": c, "n": n}, _static(lambda z, v, t, u: -c * v * np.abs(v) ** (n - 1))


def _smooth_band(s: float, p: Shapes, at: Scale) -> Made:
    gap, k = s * at.z, at.own
    return {"stiffness": k, "gap": gap}, _static(lambda z, v, t, u: k * gap * np.tanh(z / gap))


def _hertz(s: float, p: Shapes, at: Scale) -> Made:
    """Two-sided Hertzian stop with Hunt-Crossley damping: F = -k d^1.5 (1 + c d')."""
    gap, k, c = p["gap"] * at.z, s * at.k / np.sqrt(at.z), p["loss"] / at.v

    def law(z: Array, v: Array, t: Any, u: Any) -> Array:
        over = np.abs(z) - gap
        deep = np.maximum(over, 0.0)
        return np.asarray(-np.sign(z) * k * deep**1.5 * np.maximum(1 + c * v * np.sign(z), 0.0))

    return {"stiffness": k, "gap": gap}, _static(law)


def _settling(s: float, p: Shapes, at: Scale) -> Made:
    """Loosening joint: stiffness lost as 1 - exp(-t/tau)."""
    k, tau = s * at.k, p["tau"] * at.T
    return {"stiffness": k, "tau": tau}, _static(lambda z, v, t, u: k * -np.expm1(-t / tau) * z)


def _fractional(s: float, p: Shapes, at: Scale) -> Made:
    """Damping of order one half by eight Maxwell elements."""
    omega = 2 * np.pi * np.geomspace(at.low_hz / 10, at.high_hz * 10, 8)
    k = s * at.k * np.sqrt(omega / omega.mean())
    return {"stiffness": float(k.mean()), "order": 0.5}, Action(law=Relaxing(k, omega))


def _algebraic(s: float, p: Shapes, at: Scale) -> Made:
    most = at.peak / s
    return {"limit": most}, Action(command=lambda u, x: u / np.sqrt(1 + (u / most) ** 2))


def _skew_clip(s: float, p: Shapes, at: Scale) -> Made:
    """Rails that differ by up to a fifth."""
    most = at.peak * np.exp(-s)
    return {"limit": most}, Action(command=lambda u, x: np.clip(u, -most * p["skew"], most / p["skew"]))


def _lag_of_two(s: float, p: Shapes, at: Scale) -> Made:
    """Two equal lags in series, half the time constant each."""
    tau = s * at.h

    def act(f: Array, x: Signals) -> Array:
        return low_passed(low_passed(f, 2 / tau, x.h), 2 / tau, x.h)

    return {"time_constant": tau}, Action(force=act)


def _smooth_zone(s: float, p: Shapes, at: Scale) -> Made:
    d = s * at.u
    return {"threshold": d}, Action(command=lambda u, x: u - d * np.tanh(u / d))


def _soft_sensor(s: float, p: Shapes, at: Scale) -> Made:
    most = at.peak / s
    return {"limit": most}, Action(sensor=lambda y, x: most * np.tanh(y / most))


def _bessel(s: float, p: Shapes, at: Scale) -> Made:
    """Second-order Bessel filter in the sensor, nearly a pure delay."""
    tau = s * at.h
    return {"delay": tau}, Action(sensor=lambda y, x: filtered(y, [1.0], [tau**2 / 3, tau, 1.0], x.h))


def _two_masses(s: float, p: Shapes, at: Scale) -> Made:
    """Two small oscillators a tenth apart in frequency."""
    m, f, zeta = s * at.m, at.low_hz * (at.high_hz / at.low_hz) ** p["where"], p["zeta"]

    def bench(b: Any, place: str) -> Any:
        first = b.with_oscillator(place, m / 2, 2 * np.pi * f * 0.97, zeta)
        return first.with_oscillator(place, m / 2, 2 * np.pi * f * 1.03, zeta)

    return {"mass": m, "frequency": f, "damping_ratio": zeta}, Action(bench=bench)


def _following(s: float, p: Shapes, at: Scale) -> Made:
    """Drag of entrained air: v|v| of the speed over a slow wake."""
    c = s * at.k * at.z / at.v**2
    law = Tracking(lambda z, v: np.abs(v), lambda z, v, level: -c * v * (0.5 * np.abs(v) + 0.5 * level), 0.05, 0.05)
    return {"coefficient": c}, Action(law=law)


FRICTION = ("coulomb-friction", "stribeck-friction", "lugre-friction")
HYSTERESIS = ("jenkins-slip", "iwan-slip", "bouc-wen")
HARDENING = ("cubic-stiffness", "quadratic-cubic-stiffness")
FORMS: tuple[Kind, ...] = (
    Kind(name="coulomb-friction", form="tanh", family="friction", on="any", make=_smooth_friction, accepted=FRICTION,
         shapes={"speed": (0.02, 0.1, "log")}, same=False),
    Kind(name="coulomb-friction", form="Dahl", family="friction", on="any", make=_dahl,
         accepted=(*FRICTION, "jenkins-slip"), shapes={"bristle": (0.02, 0.1, "log")}, same=False),
    Kind(name="coulomb-friction", form="bowed guide", family="friction", on="any", make=_friction_with_load,
         accepted=FRICTION, shapes={"grows": (0.05, 0.3)}, same=False),
    Kind(name="jenkins-slip", form="Iwan, even spread", family="hysteresis", on="any", make=_iwan, accepted=HYSTERESIS,
         shapes={"slip": (0.3, 1.0)}, same=False),
    Kind(name="bouc-wen", form="other exponents", family="hysteresis", on="any", make=_wen,
         accepted=("bouc-wen", "jenkins-slip"), shapes={"yield": (0.2, 0.8), "n": (1.5, 4.0)}, same=False),
    Kind(name="cubic-stiffness", form="sinh", family="nonlinear-stiffness", on="any", make=_sinh, accepted=HARDENING,
         shapes={"width": (0.8, 2.0)}, same=False),
    Kind(name="cubic-stiffness", form="string", family="nonlinear-stiffness", on="any", make=_tangent,
         accepted=HARDENING, shapes={"width": (2.0, 4.0)}, start=0.3, same=False),
    Kind(name="quadratic-drag", form="power 1.7 to 2.2", family="damping", on="any", make=_power_drag,
         accepted=("quadratic-drag",), shapes={"n": (1.7, 2.2)}, same=False),
    Kind(name="quadratic-drag", form="wake", family="damping", on="any", make=_following, accepted=("quadratic-drag",),
         same=False),
    Kind(name="dead-band", form="smooth", family="clearance", on="element", make=_smooth_band, accepted=("dead-band",),
         same=False, most=2.0),
    Kind(name="stop", form="Hertz", family="contact", on="any", make=_hertz, accepted=("stop",),
         shapes={"gap": (0.8, 1.6), "loss": (0.0, 0.3)}, start=0.3, same=False),
    Kind(name="drifting-stiffness", form="settling", family="time-variation", on="any", make=_settling,
         accepted=("drifting-stiffness",), shapes={"tau": (0.5, 1.5)}, most=0.6, same=False),
    Kind(name="structural-damping", form="order one half", family="damping", on="any", make=_fractional,
         accepted=("structural-damping", "viscous-damping"), same=False),
    Kind(name="attached-oscillator", form="two of them", family="substructure", on="point", make=_two_masses,
         accepted=("attached-oscillator",), shapes={"where": (0.3, 0.7), "zeta": (0.02, 0.06, "log")}, most=0.5, same=False),
    Kind(name="soft-saturation", form="algebraic", family="saturation", on="actuator", make=_algebraic,
         accepted=("soft-saturation", "actuator-clipping"), start=0.3, most=8.0, same=False),
    Kind(name="actuator-clipping", form="skew rails", family="saturation", on="actuator", make=_skew_clip,
         accepted=("actuator-clipping", "soft-saturation"), shapes={"skew": (1.0, 1.1)}, most=3.0, same=False),
    Kind(name="actuator-dead-zone", form="smooth", family="clearance", on="actuator", make=_smooth_zone,
         accepted=("actuator-dead-zone",), most=1.5, same=False),
    Kind(name="actuator-lag", form="second order", family="timing", on="actuator", make=_lag_of_two,
         accepted=("actuator-lag", "actuator-delay"), start=0.5, most=20.0, same=False),
    Kind(name="sensor-clipping", form="tanh", family="saturation", on="sensor", make=_soft_sensor,
         accepted=("sensor-clipping",), start=0.3, most=8.0, same=False),
    Kind(name="sensor-delay", form="Bessel", family="timing", on="sensor", make=_bessel,
         accepted=("sensor-delay", "sensor-lag"), start=0.5, most=20.0, same=False),
)  # fmt: skip
"""FORMS: all other forms."""
