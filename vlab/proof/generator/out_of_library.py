"""Physics outside `vlab effects`; the right answer names nothing known."""

from typing import Any

import numpy as np

from vlab.proof.generator.hidden import Action, Kind, Scale, Signals
from vlab.proof.generator.law import Absorber, Delayed, Static, Tracking
from vlab.signals import Array

Shapes = Any
Made = tuple[dict[str, float], Action]


def _static(of: Any) -> Action:
    return Action(law=Static(of))


def _pumped(s: float, p: Shapes, at: Scale) -> Made:
    """Stiffness that oscillates at its own frequency."""
    k, w, phase = s * at.k, 2 * np.pi * p["hz"], p["phase"]
    return {"stiffness": k, "hz": p["hz"]}, _static(lambda z, v, t, u: -k * np.sin(w * t + phase) * z)


def _sink(s: float, p: Shapes, at: Scale) -> Made:
    """Mass on a purely cubic spring, an absorber without own frequency."""
    m = s * at.m
    w = 2 * np.pi * at.low_hz * (at.high_hz / at.low_hz) ** p["where"]
    k3 = m * w**2 / at.z**2
    return {"mass": m, "k3": k3}, Action(law=Absorber(m, 0.1 * m * w, lambda d: k3 * d * d * d))


def _flow(s: float, p: Shapes, at: Scale) -> Made:
    """Van der Pol force: feeds small motion and brakes large motion."""
    c, d = s * at.k * at.z / at.v, p["width"] * at.z
    return {"damping": c, "width": d}, _static(lambda z, v, t, u: c * (1 - (z / d) ** 2) * v)


def _echo(s: float, p: Shapes, at: Scale) -> Made:
    """Force of past motion, as of a pneumatic mount with a long line."""
    k, tau = p["sign"] * s * at.k, p["cycles"] / np.sqrt(at.low_hz * at.high_hz)
    return {"stiffness": k, "delay": tau}, Action(law=Delayed(tau, -k, 0.0))


def _burst(s: float, p: Shapes, at: Scale) -> Made:
    """Temporary friction after large motion."""
    c, gate = s * at.k * at.z / at.v, p["gate"] * at.z

    def of(z: Array, v: Array, level: Array) -> Array:
        return -c * v * (level > 0.5)

    law = Tracking(lambda z, v: 1.0 * (np.abs(z) > gate), of, 1e-4, 0.4)
    return {"damping": c, "gate": gate}, Action(law=law)


def _thixotropic(s: float, p: Shapes, at: Scale) -> Made:
    """Stiffness that softens with vibration and recovers in a second."""
    k, ref = s * at.k, at.v**2
    law = Tracking(lambda z, v: v * v, lambda z, v, level: k * np.tanh(level / ref) * z, 1.0, 1.0)
    return {"stiffness": k, "memory_s": 1.0}, Action(law=law)


def _gusts(s: float, p: Shapes, at: Scale) -> Made:
    """Broadband external force: incommensurate sines over the band."""
    rng = np.random.default_rng(int(p["draw"]))
    w = 2 * np.pi * rng.uniform(at.low_hz, at.high_hz, 60)
    phase = rng.uniform(0, 2 * np.pi, 60)
    a = s * at.k * at.z * np.sqrt(2 / 60)
    law = _static(lambda z, v, t, u: a * np.sin(np.multiply.outer(t, w) + phase).sum(axis=-1) + 0.0 * z)
    return {"force": s * at.k * at.z}, law


def _touching(s: float, p: Shapes, at: Scale) -> Made:
    """Wire that touches the structure at times, independent of its motion."""
    k, period = s * at.k, p["period"]

    def law(z: Array, v: Array, t: Any, u: Any) -> Array:
        leaning = np.sin(2 * np.pi * t / period) + np.sin(2 * np.pi * t / (0.618 * period)) > 0.3
        return np.asarray(-k * z * leaning)

    return {"stiffness": k, "period": period}, _static(law)


def _play(s: float, p: Shapes, at: Scale) -> Made:
    """Backlash between command and force: the play operator."""
    width = s * at.u

    def act(u: Array, x: Signals) -> Array:
        out, now = np.empty_like(u), np.zeros(u.shape[1:])
        for i, target in enumerate(u):
            now = np.minimum(np.maximum(now, target - width), target + width)
            out[i] = now
        return out

    return {"width": width}, Action(command=act)


def _warming(s: float, p: Shapes, at: Scale) -> Made:
    """Coil that warms with squared current and loses force."""
    loss, tau = s / at.u**2, p["tau"] * at.T

    def act(u: Array, x: Signals) -> Array:
        out, heat = np.empty_like(u), np.zeros(u.shape[1:])
        for i, now in enumerate(u):
            out[i] = now / (1 + loss * heat)
            heat = heat + (now * now - heat) * (x.h / tau)
        return out

    return {"loss": loss, "tau": tau}, Action(command=act)


def _bent_sensor(s: float, p: Shapes, at: Scale) -> Made:
    """Sensor with an even curve."""
    curve = p["sign"] * s / at.z
    return {"curve": curve}, Action(sensor=lambda y, x: y + curve * y * y)


def _clock(s: float, p: Shapes, at: Scale) -> Made:
    """Fast clock of one sensor."""
    share = s * 0.01

    def see(y: Array, x: Signals) -> Array:
        time = np.arange(len(y)) * x.h
        late = time * (1 - share)
        return np.stack([np.interp(late, time, column) for column in y.T], axis=1)

    return {"share": share}, Action(sensor=see)


STRANGE: tuple[Kind, ...] = (
    Kind(name="parametric-stiffness", family="time-variation", on="any", make=_pumped, same=False, most=0.6,
         shapes={"hz": (0.4, 9.0, "log"), "phase": (0.0, 6.28)}),
    Kind(name="nonlinear-absorber", family="substructure", on="point", make=_sink, same=False, most=0.5,
         shapes={"where": (0.2, 0.6)}),
    Kind(name="flow-damping", family="self-excitation", on="any", make=_flow, same=False, shapes={"width": (1.0, 2.0)}),
    Kind(name="delayed-stiffness", family="memory", on="any", make=_echo, same=False, most=0.5,
         shapes={"sign": "sign", "cycles": (0.4, 1.6)}),
    Kind(name="triggered-damping", family="memory", on="any", make=_burst, same=False, shapes={"gate": (1.3, 2.2)}),
    Kind(name="thixotropic-stiffness", family="memory", on="any", make=_thixotropic, same=False, most=0.7),
    Kind(name="random-force", family="disturbance", on="point", make=_gusts, same=False, shapes={"draw": (0.0, 1e9)}),
    Kind(name="intermittent-contact", family="time-variation", on="point", make=_touching, same=False,
         shapes={"period": (1.0, 4.0)}),
    Kind(name="actuator-play", family="hysteresis", on="actuator", make=_play, same=False, most=2.0),
    Kind(name="warming-coil", family="time-variation", on="actuator", make=_warming, same=False, most=3.0,
         shapes={"tau": (0.1, 0.4)}),
    Kind(name="curved-sensor", family="sensor", on="sensor", make=_bent_sensor, same=False, most=0.5,
         shapes={"sign": "sign"}),
    Kind(name="sensor-clock", family="timing", on="sensor", make=_clock, same=False, start=0.1, most=5.0),
)  # fmt: skip
"""STRANGE: all kinds outside the library."""
