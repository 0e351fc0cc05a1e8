"""Two cases of hysteresis without MuJoCo: a joint in micro-slip that rings down, a mass behind a hysteretic drive.

The hidden laws are sums of many more elements than the catalogue's, evenly spread over logs of limits or over
thresholds, and integrated by the leapfrog rule.
"""

from pathlib import Path

import numpy as np
from rig_folder import Channel, Record, Rig, multisine, write_case

RATE, FINE = 200.0, 10
"""Sampling rate [Hz] of both cases, and steps of integration per sample."""
NOISE = 0.002
"""Noise over the rms of each channel at the largest level."""

JOINTED = """<mujoco model="two masses with a joint">
  <option timestep="0.001" integrator="RK4" gravity="0 0 0"><flag contact="disable"/></option>
  <default><joint type="slide" axis="1 0 0"/><geom type="box" size="0.05 0.05 0.05" mass="1"/></default>
  <worldbody>
    <body name="lower"><joint name="lower" stiffness="2000" damping="0.2"/><geom/></body>
    <body name="upper" pos="0.3 0 0"><joint name="upper"/><geom/></body>
  </worldbody>
  <tendon><fixed name="link" stiffness="3000" damping="0.2" springlength="0">
    <joint joint="lower" coef="-1"/><joint joint="upper" coef="1"/></fixed></tendon>
  <sensor><jointpos name="y1" joint="lower"/><jointpos name="y2" joint="upper"/></sensor>
</mujoco>
"""
DRIVEN = """<mujoco model="a driven stage">
  <option timestep="0.001" integrator="RK4" gravity="0 0 0"><flag contact="disable"/></option>
  <worldbody><body name="stage"><joint name="stage" type="slide" axis="1 0 0" stiffness="8000" damping="3"/>
    <geom type="box" size="0.05 0.05 0.05" mass="1"/></body></worldbody>
  <actuator><motor name="stack" joint="stage"/></actuator>
  <sensor><jointpos name="y" joint="stage"/></sensor>
</mujoco>
"""


class Sliders:
    """Springs with dry sliders in parallel, their limits spread over a power law."""

    def __init__(self, force: float, limit: float, exponent: float, count: int = 120) -> None:
        ends = limit * np.concatenate([[0.0], np.geomspace(1e-4, 1.0, count)])
        self.limits = np.sqrt(ends[1:] * np.maximum(ends[:-1], 0.25 * ends[1:]))
        stiffness = force / limit * (1 + exponent) / exponent
        self.weights = stiffness * np.diff((ends / limit) ** exponent)
        self.places = np.zeros(count)

    def __call__(self, z: float) -> float:
        stretch = np.clip(z - self.places, -self.limits, self.limits)
        self.places = z - stretch
        return float(stretch @ self.weights)


def _ring_down(speeds: np.ndarray, slip: dict[str, float], benign: np.ndarray, seconds: float) -> np.ndarray:
    """Return displacements (n, 2) after a blow from rest; `benign` are relative errors of stiffnesses and masses."""
    k = np.array([2000.0, 3000.0]) * (1 + benign[:2])
    m = 1 + benign[2:]
    c, law = 0.2, Sliders(**slip)
    h, z, v = 1 / (RATE * FINE), np.zeros(2), speeds.copy()
    out = np.zeros((round(seconds * RATE), 2))
    for i in range(len(out) * FINE):
        if i % FINE == 0:
            out[i // FINE] = z
        z = z + 0.5 * h * v
        apart = z[1] - z[0]
        pull = k[1] * apart + c * (v[1] - v[0]) + law(apart)
        v = v + h * np.array([pull - k[0] * z[0] - c * v[0], -pull]) / m
        z = z + 0.5 * h * v
    return out


def slipping_case(folder: Path, *, seed: int = 0, exponent: float = 0.5, force: float = 0.4) -> Rig:
    """Write the case of two masses whose link slips, ringing down after blows of three sizes.

    10 s at 200 Hz from a tenth of a second after the blow, when the sliders have a past. Two blows of other sizes, one
    on the other mass, are held out.
    """
    rng = np.random.default_rng([seed, 17])
    slip = {"force": force, "limit": 4e-3, "exponent": exponent}
    benign = 0.01 * rng.standard_normal(4)
    blows = [
        ("large", "fit", (0.0, 0.3)), ("middle", "fit", (0.0, 0.1)), ("small", "fit", (0.0, 0.03)),
        ("other", "holdout", (0.2, 0.0)), ("between", "holdout", (0.0, 0.17)),
    ]  # fmt: skip
    runs = [_ring_down(np.array(v), slip, benign, 10.1)[20:] for _, _, v in blows]
    noise = NOISE * runs[0].std(axis=0)
    records = []
    for (name, role, _), y in zip(blows, runs, strict=True):
        y = y + noise * 0.1 * rng.standard_normal(y.shape)
        columns = {"y1": y[:, 0], "y2": y[:, 1]}
        records.append(Record(name=name, role=role, columns=columns, rate_hz=RATE, initial="estimated"))
    write_case(
        folder,
        title="Two masses with a joint",
        mjcf=JOINTED,
        uncertain={"stiffness": 0.1, "mass": 0.02, "damping": 0.5},
        channels=[Channel(column=c, at=c, kind="displacement", unit="m") for c in ("y1", "y2")],
        records=records,
    )
    return Rig(folder=folder, effect="iwan-slip", place="tendon:link", parameters=slip)


def hysteretic(u: np.ndarray, growth: float, limit: float, count: int = 300) -> np.ndarray:
    """Return the force of a drive with evenly spread play operators."""
    thresholds = (np.arange(count) + 0.5) / count * limit
    past, out = np.zeros(count), np.empty(len(u))
    for i, x in enumerate(u):
        past = np.clip(past, x - thresholds, x + thresholds)
        out[i] = x + 2 * growth * limit * past.mean()
    return out


def driven_case(folder: Path, *, seed: int = 0, growth: float = 0.012, limit: float = 20.0) -> Rig:
    """Write the case of a stage at 14 Hz whose drive has hysteresis, under multisines of three levels.

    10 s at 200 Hz from rest. The gain is 3 % off, the stiffness 2 %. A fourth multisine and a sine sweep are held out.
    """
    rng = np.random.default_rng([seed, 18])
    time = np.arange(round(10 * RATE)) / RATE
    levels = [("low", "fit", 0.5), ("middle", "fit", 1.5), ("high", "fit", 4.0), ("other", "holdout", 2.5)]
    commands = [multisine(rng, 0.5, 25.0, 5.0, rms)(time) for _, _, rms in levels]
    sweep = 6.0 * np.sin(2 * np.pi * (0.5 * time + 0.5 * 2.0 * time**2))
    names = [*((name, role) for name, role, _ in levels), ("sweep", "holdout")]
    k, m, c, gain = 8000 * 1.02, 1.0, 3.0, 1.03
    step, move = 1 / RATE, _exact(k, m, c, 1 / RATE)
    records = []
    for (name, role), u in zip(names, [*commands, sweep], strict=True):
        force, x, y = gain * hysteretic(u, growth, limit), np.zeros(2), np.empty(len(u))
        for i, f in enumerate(force):
            y[i] = x[0]
            x = move[0] @ x + move[1] * f
        y += NOISE * y.std() * rng.standard_normal(len(y))
        records.append(Record(name=name, role=role, columns={"u": u, "y": y}, rate_hz=1 / step))
    write_case(
        folder,
        title="A stage behind a drive",
        mjcf=DRIVEN,
        uncertain={"stiffness": 0.03, "mass": 0.02, "damping": 0.3, "gain": 0.05},
        channels=[
            Channel(column="u", at="stack", kind="force", unit="N", is_input=True, hold="zero"),
            Channel(column="y", at="y", kind="displacement", unit="m"),
        ],
        records=records,
    )
    return Rig(folder=folder, effect="actuator-hysteresis", place="actuator:stack", parameters={"growth": growth})


def _exact(k: float, m: float, c: float, h: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the exact step of an oscillator under a held force."""
    from scipy.linalg import expm

    A = np.zeros((3, 3))
    A[0, 1], A[1] = 1.0, [-k / m, -c / m, 1 / m]
    whole = expm(A * h)
    return whole[:2, :2], whole[:2, 2]
