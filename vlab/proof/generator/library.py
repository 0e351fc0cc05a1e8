"""Physics of `vlab effects` with the vocabulary's names and independent laws."""

from typing import Any

import numpy as np

from vlab.proof.generator.bench import Bench
from vlab.proof.generator.hardware import filtered, late, low_passed, moved
from vlab.proof.generator.hidden import Action, Kind, Scale, Signals
from vlab.proof.generator.law import Bristles, DryFriction, Hysteresis, Law, Relaxing, Sliders, Static, Yielding
from vlab.signals import Array

Shapes = Any
Made = tuple[dict[str, float], Action]


def _mass(m: float) -> Action:
    def bench(b: Bench, place: str) -> Bench:
        row = b.places[place].row
        return b.adding(M=m * np.outer(row, row))

    return Action(bench=bench)


def _spring(k: float, c: float = 0.0) -> Action:
    def bench(b: Bench, place: str) -> Bench:
        row = b.places[place].row
        return b.adding(K=k * np.outer(row, row), C=c * np.outer(row, row))

    return Action(bench=bench)


def _lost(share: float) -> Action:
    def bench(b: Bench, place: str) -> Bench:
        p = b.places[place]
        own = p.stiffness * np.outer(p.row, p.row) if p.K is None else p.K
        return b.adding(K=-share * own)

    return Action(bench=bench)


def _port(law: Law) -> Action:
    return Action(law=law)


def _static(of: Any) -> Action:
    return Action(law=Static(of))


def _friction(s: float, p: Shapes, at: Scale) -> Made:
    force = s * at.k * at.z
    return {"force": force}, _port(DryFriction(lambda v, t: force))


def _stribeck(s: float, p: Shapes, at: Scale) -> Made:
    force, excess, speed = s * at.k * at.z, s * at.k * at.z * p["excess"], at.v * p["speed"]
    law = DryFriction(lambda v, t: force + excess * np.exp(-((v / speed) ** 2)))
    return {"force": force, "excess": excess, "speed": speed}, _port(law)


def _lugre(s: float, p: Shapes, at: Scale) -> Made:
    force, bend, speed, excess = s * at.k * at.z, p["bristle"] * at.z, p["speed"] * at.v, p["excess"]
    law = Bristles(force, bend, lambda v: 1.0 + excess * np.exp(-((v / speed) ** 2)))
    return {"force": force, "bristle": bend, "excess": excess, "speed": speed}, _port(law)


def _polynomial(s: float, p: Shapes, at: Scale) -> Made:
    k2, k3 = p["sign"] * s * at.k / at.z, p["cubic"] * s * at.k / at.z**2
    return {"k2": k2, "k3": k3}, _static(lambda z, v, t, u: -(k2 + k3 * z) * z * z)


def _dead_band(s: float, p: Shapes, at: Scale) -> Made:
    gap, k = s * at.z, at.own
    return {"stiffness": k, "gap": gap}, _static(lambda z, v, t, u: k * np.minimum(np.maximum(z, -gap), gap))


def _stop(s: float, p: Shapes, at: Scale) -> Made:
    gap, k = p["gap"] * at.z, s * at.k
    law = _static(lambda z, v, t, u: -k * (z - np.minimum(np.maximum(z, -gap), gap)))
    return {"stiffness": k, "gap": gap}, law


def _one_sided(s: float, p: Shapes, at: Scale) -> Made:
    side, way, k = p["sign"], p["gap"] * at.z, s * at.k  # negative gap: contact on the other side
    law = _static(lambda z, v, t, u: -side * k * np.maximum(side * z - way, 0.0))
    return {"stiffness": k, "gap": side * way}, law


def _sine(s: float, p: Shapes, at: Scale) -> Made:
    a, f = s * at.k * at.z, at.low_hz * (at.high_hz / at.low_hz) ** p["where"]
    w, phase = 2 * np.pi * f, p["phase"]
    made = {"sine": a * np.cos(phase), "cosine": a * np.sin(phase), "frequency": f}
    return made, _static(lambda z, v, t, u: a * np.sin(w * t + phase) + 0.0 * z)


def _slider(s: float, p: Shapes, at: Scale) -> Made:
    force, slip = s * at.k * at.z, p["slip"] * at.z
    return {"force": force, "slip": slip}, _port(Sliders([force / slip], [force]))


def _bouc_wen(s: float, p: Shapes, at: Scale) -> Made:
    force, d = s * at.k * at.z, p["yield"] * at.z
    return {"force": force, "yield": d}, _port(Hysteresis(force, d))


def _plastic(s: float, p: Shapes, at: Scale) -> Made:
    yields_at = at.peak * np.exp(-s)
    return {"stiffness": at.own, "yield": yields_at}, _port(Yielding(at.own, yields_at))


def _oscillator(s: float, p: Shapes, at: Scale) -> Made:
    mass, f, zeta = s * at.m, at.low_hz * (at.high_hz / at.low_hz) ** p["where"], p["zeta"]
    action = Action(bench=lambda b, place: b.with_oscillator(place, mass, 2 * np.pi * f, zeta))
    return {"mass": mass, "frequency": f, "damping_ratio": zeta}, action


def _loss(s: float, p: Shapes, at: Scale) -> Made:
    loss, centre = s * at.k, np.sqrt(at.low_hz * at.high_hz)
    omega = 2 * np.pi * centre * np.array([0.1, 1.0, 10.0])
    # at the centre 1/2 + 2 * 0.1/1.01 of an element's stiffness are lost; the stored 3/2 are part of the element
    law = Relaxing(np.full(3, loss / 0.7), omega, stored=1.5 * loss / 0.7)
    return {"loss": loss, "centre": centre}, _port(law)


def _slew(u: Array, most: float, h: float) -> Array:
    out, now = np.empty_like(u), np.zeros(u.shape[1:])
    for i, target in enumerate(u):
        now = now + np.clip(target - now, -most * h, most * h)
        out[i] = now
    return out


def _held(u: Array, every: int) -> Array:
    return u[(np.arange(len(u)) // every) * every]


def _jittered(u: Array, most: float, x: Signals) -> Array:
    """Delay samples by a random share of `most` fine steps.

    The share is drawn again at every change of the command.
    """
    change = np.any(np.diff(u, axis=0, prepend=u[:1] + 1.0) != 0.0, axis=1)
    each = np.cumsum(change) - 1
    delay = most * x.rng.random(each[-1] + 1)
    out = u.copy()
    for i in np.flatnonzero(change)[1:]:
        whole = int(delay[each[i]])
        out[i : i + whole] = u[i - 1]
        if i + whole < len(u):  # mean over the step of the delayed sample
            share = delay[each[i]] - whole
            out[i + whole] = share * u[i - 1] + (1 - share) * u[i + whole]
    return out


def _sensor(of: Any) -> Action:
    return Action(sensor=of)


def _reading(of: Any) -> Action:
    return Action(reading=of)


def _force(of: Any) -> Action:
    return Action(force=of)


def _command(of: Any) -> Action:
    return Action(command=of)


def _resonance(s: float, p: Shapes, at: Scale) -> Made:
    f, zeta = at.high_hz / s, p["zeta"]
    w = 2 * np.pi * f
    made = {"frequency": f, "damping_ratio": zeta}
    return made, _sensor(lambda y, x: filtered(y, [1.0], [1 / w**2, 2 * zeta / w, 1.0], x.h))


def _interference(s: float, p: Shapes, at: Scale) -> Made:
    a, f, phase = s * at.z, p["f"], p["phase"]

    def add(y: Array, x: Signals) -> Array:
        return y + a * np.sin(2 * np.pi * f * np.arange(len(y)) * x.h + phase)[:, None]

    return {"sine": a * np.cos(phase), "cosine": a * np.sin(phase), "frequency": f}, _sensor(add)


def _ramp(y: Array, rate: float, h: float) -> Array:
    return y + rate * h * np.arange(len(y))[:, None]


def _second(share: float) -> Action:
    return _sensor(lambda y, x: y + share * x.other)


LIBRARY: tuple[Kind, ...] = (
    Kind(name="added-mass", family="mass", on="point", angular=False, start=0.03, most=2.0,
         make=lambda s, p, at: ({"mass": s * at.m}, _mass(s * at.m))),
    Kind(name="rotary-inertia", family="mass", on="point", angular=True, start=0.03, most=2.0,
         make=lambda s, p, at: ({"inertia": s * at.m}, _mass(s * at.m))),
    Kind(name="lost-stiffness", family="stiffness", on="element", start=0.1, most=0.9,
         make=lambda s, p, at: ({"share": s}, _lost(s))),
    Kind(name="stiffness-to-ground", family="stiffness", on="point", most=20.0,
         make=lambda s, p, at: ({"stiffness": s * at.k}, _spring(s * at.k))),
    Kind(name="magnetic-negative-stiffness", family="stiffness", on="coil", most=0.6,
         make=lambda s, p, at: ({"stiffness": s * at.k}, _spring(-s * at.k))),
    Kind(name="viscous-damping", family="damping", on="any",
         make=lambda s, p, at: ({"damping": s * at.k * at.z / at.v}, _spring(0.0, s * at.k * at.z / at.v))),
    Kind(name="structural-damping", family="damping", on="any", make=_loss),
    Kind(name="quadratic-drag", family="damping", on="any",
         make=lambda s, p, at: ({"coefficient": (c := s * at.k * at.z / at.v**2)}, _static(lambda z, v, t, u: -c * v * np.abs(v)))),
    Kind(name="cubic-stiffness", family="nonlinear-stiffness", on="any",
         make=lambda s, p, at: ({"k3": (k := s * at.k / at.z**2)}, _static(lambda z, v, t, u: -k * z * z * z))),
    Kind(name="quadratic-stiffness", family="nonlinear-stiffness", on="any", shapes={"sign": "sign"}, most=0.3,
         make=lambda s, p, at: ({"k2": (k := p["sign"] * s * at.k / at.z)}, _static(lambda z, v, t, u: -k * z * z))),
    Kind(name="quadratic-cubic-stiffness", family="nonlinear-stiffness", on="any", make=_polynomial,
         shapes={"sign": "sign", "cubic": (0.5, 1.5)}),
    Kind(name="coulomb-friction", family="friction", on="any", make=_friction),
    Kind(name="stribeck-friction", family="friction", on="any", make=_stribeck,
         shapes={"excess": (0.4, 1.2), "speed": (0.05, 0.3, "log")}),
    Kind(name="lugre-friction", family="friction", on="any", make=_lugre,
         shapes={"bristle": (0.02, 0.2, "log"), "excess": (0.3, 1.0), "speed": (0.05, 0.3, "log")}),
    Kind(name="dead-band", family="clearance", on="element", make=_dead_band, most=2.0),
    Kind(name="stop", family="contact", on="any", make=_stop, shapes={"gap": (0.8, 1.8)}, start=0.3),
    Kind(name="one-sided-stiffness", family="contact", on="any", make=_one_sided, shapes={"gap": (0.05, 1.0), "sign": "sign"}, start=0.1),
    Kind(name="force-offset", family="bias", on="point", shapes={"sign": "sign"},
         make=lambda s, p, at: ({"force": (f := p["sign"] * s * at.k * at.z)}, _static(lambda z, v, t, u: f + 0.0 * z))),
    Kind(name="sinusoidal-force", family="disturbance", on="point", make=_sine,
         shapes={"where": (0.2, 0.8), "phase": (0.0, 6.28)}),
    Kind(name="jenkins-slip", family="hysteresis", on="any", make=_slider, shapes={"slip": (0.2, 0.8)}),
    Kind(name="bouc-wen", family="hysteresis", on="any", make=_bouc_wen, shapes={"yield": (0.2, 0.8)}),
    Kind(name="drifting-stiffness", family="time-variation", on="any", shapes={"sign": "sign"}, most=0.8,
         make=lambda s, p, at: ({"rate": (r := p["sign"] * s * at.k / at.T)}, _static(lambda z, v, t, u: -r * t * z))),
    Kind(name="plastic-set", family="hysteresis", on="element", make=_plastic, start=0.2, most=1.5),
    Kind(name="attached-oscillator", family="substructure", on="point", make=_oscillator, angular=None, most=0.5,
         shapes={"where": (0.3, 0.7), "zeta": (0.005, 0.05, "log")}),
    Kind(name="actuator-gain", family="gain", on="actuator", shapes={"sign": "sign"}, most=0.5,
         make=lambda s, p, at: ({"gain": (g := p["sign"] * s)}, _command(lambda u, x: (1 + g) * u))),
    Kind(name="actuator-offset", family="bias", on="actuator", shapes={"sign": "sign"},
         make=lambda s, p, at: ({"offset": (o := p["sign"] * s * at.u)}, _command(lambda u, x: u + o))),
    Kind(name="actuator-clipping", family="saturation", on="actuator", most=3.0,
         make=lambda s, p, at: ({"limit": (most := at.peak * np.exp(-s))}, _command(lambda u, x: np.clip(u, -most, most)))),
    Kind(name="soft-saturation", family="saturation", on="actuator", start=0.3, most=8.0,
         make=lambda s, p, at: ({"limit": (most := at.peak / s)}, _command(lambda u, x: most * np.tanh(u / most)))),
    Kind(name="actuator-dead-zone", family="clearance", on="actuator", most=1.5,
         make=lambda s, p, at: ({"threshold": (d := s * at.u)}, _command(lambda u, x: u - np.clip(u, -d, d)))),
    Kind(name="slew-limit", family="saturation", on="actuator", start=0.3, most=3.0,
         make=lambda s, p, at: ({"slope": (r := at.slope * np.exp(-s))}, _command(lambda u, x: _slew(u, r, x.h)))),
    Kind(name="actuator-delay", family="timing", on="actuator", start=0.5, most=20.0,
         make=lambda s, p, at: ({"delay": (d := s * at.h)}, _force(lambda f, x: late(f, d / x.h)))),
    Kind(name="actuator-lag", family="timing", on="actuator", start=0.5, most=20.0,
         make=lambda s, p, at: ({"time_constant": (d := s * at.h)}, _force(lambda f, x: low_passed(f, 1 / d, x.h)))),
    Kind(name="actuator-quantisation", family="resolution", on="actuator", most=2.0,
         make=lambda s, p, at: ({"step": (q := s * at.u)}, _command(lambda u, x: q * np.round(u / q)))),
    Kind(name="actuator-hold", family="timing", on="actuator", start=3.0, most=20.0,
         make=lambda s, p, at: ({"period": (n := max(2, round(s))) * at.h}, _command(lambda u, x: _held(u, n)))),
    Kind(name="actuator-jitter", family="timing", on="actuator", start=0.8, most=0.95,
         make=lambda s, p, at: ({"jitter": (d := s * at.h)}, _force(lambda f, x: _jittered(f, d / x.h, x)))),
    Kind(name="coil-force-over-travel", family="actuator-position", on="coil", most=0.3,
         make=lambda s, p, at: ({"loss": (c := s / at.z**2)}, _static(lambda z, v, t, u: -u * c * z * z))),
    Kind(name="sensor-gain", family="gain", on="sensor", shapes={"sign": "sign"}, most=0.5,
         make=lambda s, p, at: ({"gain": (g := p["sign"] * s)}, _sensor(lambda y, x: (1 + g) * y))),
    Kind(name="sensor-offset", family="bias", on="sensor", shapes={"sign": "sign"},
         make=lambda s, p, at: ({"offset": (o := p["sign"] * s * at.z)}, _sensor(lambda y, x: y + o))),
    Kind(name="sensor-drift", family="bias", on="sensor", shapes={"sign": "sign"},
         make=lambda s, p, at: ({"rate": (r := p["sign"] * s * at.z / at.T)}, _sensor(lambda y, x: _ramp(y, r, x.h)))),
    Kind(name="sensor-clipping", family="saturation", on="sensor", most=2.0,
         make=lambda s, p, at: ({"limit": (most := at.peak * np.exp(-s))}, _reading(lambda y, x: np.clip(y, -most, most)))),
    Kind(name="sensor-delay", family="timing", on="sensor", start=0.5, most=20.0,
         make=lambda s, p, at: ({"delay": (d := s * at.h)}, _sensor(lambda y, x: moved(y, d, x.h)))),
    Kind(name="sensor-lag", family="timing", on="sensor", start=0.5, most=20.0,
         make=lambda s, p, at: ({"time_constant": (d := s * at.h)}, _sensor(lambda y, x: filtered(y, [1.0], [d, 1.0], x.h)))),
    Kind(name="sensor-high-pass", family="sensor-dynamics", on="sensor", most=2.0,
         make=lambda s, p, at: ({"time_constant": (d := 1 / (s * 2 * np.pi * at.low_hz))},
                                _sensor(lambda y, x: filtered(y, [d, 0.0], [d, 1.0], x.h)))),
    Kind(name="sensor-quantisation", family="resolution", on="sensor", most=2.0,
         make=lambda s, p, at: ({"step": (q := s * at.z)}, _reading(lambda y, x: q * np.round(y / q)))),
    Kind(name="mains-hum", family="disturbance", on="sensor", make=_interference,
         shapes={"f": (49.9, 50.1), "phase": (0.0, 6.28)}),
    Kind(name="sensor-resonance", family="sensor-dynamics", on="sensor", make=_resonance, start=0.2, most=0.9,
         shapes={"zeta": (0.05, 0.4, "log")}),
    Kind(name="crosstalk", family="pick-up", on="sensor and coil", shapes={"sign": "sign"},
         make=lambda s, p, at: ({"share": (d := p["sign"] * s * at.z / at.u)}, _second(d))),
    Kind(name="cross-axis", family="pick-up", on="two sensors", shapes={"sign": "sign"}, most=0.4,
         make=lambda s, p, at: ({"share": (d := p["sign"] * s)}, _second(d))),
)  # fmt: skip
"""LIBRARY: all kinds in the form of the vocabulary."""
