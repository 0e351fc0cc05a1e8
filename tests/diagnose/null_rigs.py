"""Rigs with nothing hidden whose recordings are noisy, and whose models are rough, as real ones are.

Three rigs: two carriages (linear, force to displacements), a shaft of three discs (linear, torque to angular velocities), a driven
pendulum that swings about 1 rad (nonlinear). They are integrated without MuJoCo and written as case folders. `NOISES` names what is
wrong with the recordings, `ROUGH` what is wrong with the model beside its parameters: a small force that nobody recorded, a second
mode whose frequency no parameter gives, a simulation with coarse steps. Stiffness and damping of the model are off by a per cent or
two, as stated in `[model.uncertain]`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rig_folder import Channel, Record, multisine, write_case
from scipy import linalg, signal
from scipy.integrate import solve_ivp

RATE = 250.0
DURATION = 12.0
WHITE = 0.001
"""White noise that every channel has, as a share of its rms."""


def white(rng: np.random.Generator, n: int) -> np.ndarray:
    return rng.standard_normal(n)


def pink(rng: np.random.Generator, n: int) -> np.ndarray:
    """Return noise of power 1/f down to the first line of the record, rms 1."""
    spectrum = np.fft.rfft(rng.standard_normal(n))
    spectrum[1:] /= np.sqrt(np.arange(1, len(spectrum)))
    spectrum[0] = 0.0
    x = np.fft.irfft(spectrum, n)
    return x / np.std(x)


def autoregressive(rng: np.random.Generator, n: int) -> np.ndarray:
    """Return first-order autoregressive noise with coefficient 0.95, rms 1."""
    return signal.lfilter([np.sqrt(1 - 0.95**2)], [1.0, -0.95], rng.standard_normal(n + 500))[500:]


def walk(rng: np.random.Generator, n: int) -> np.ndarray:
    """Return a random walk from zero, rms 1 at its end."""
    return np.cumsum(rng.standard_normal(n)) / np.sqrt(n)


def low_passed(rng: np.random.Generator, n: int) -> np.ndarray:
    """Return white noise below 0.3 of half the sample rate, as a logger's anti-alias filter leaves it, rms 1."""
    x = signal.sosfilt(signal.butter(6, 0.3, output="sos"), rng.standard_normal(n + 500))[500:]
    return x / np.std(x)


NOISES: dict[str, dict] = {
    "white": {"sensor": (white, 0.005)},
    "pink": {"sensor": (pink, 0.005)},
    "strong pink": {"sensor": (pink, 0.02)},
    "autoregressive": {"sensor": (autoregressive, 0.01)},
    "random walk": {"sensor": (walk, 0.01)},
    "common to channels": {"sensor": (pink, 0.01), "common": True},
    "low-passed": {"sensor": (low_passed, 0.01)},
    "white on the input": {"input": (white, 0.03)},
    "pink on the input": {"input": (pink, 0.03)},
    "coarse readings": {"sensor": (pink, 0.003), "step": 0.01},
    "coarse model steps": {"coarse": True},
}


ROUGH: dict[str, dict] = {
    "stochastic force": {"force": 0.01},
    "slow stochastic force": {"force": 0.02, "edge_hz": 1.0},
    "wrong second mode": {"second": 1.003},
    "coarse rig steps": {"steps": 2},
    "all at once": {"sensor": (pink, 0.005), "input": (white, 0.01), "force": 0.005, "second": 1.001},
}
"""Kinds of model error. ``force``: rms of a random force that nobody recorded over that of the drive, below ``edge_hz`` (5 Hz where
none is named). ``second``: factor on the frequency of the second mode, whose shape stays. ``steps``: steps of the midpoint rule to a
sample, in place of an exact integration."""
KINDS = {**NOISES, **ROUGH}


def unrecorded(rng: np.random.Generator, n: int, edge_hz: float) -> np.ndarray:
    """Return a random force below a frequency, rms 1, from rest."""
    x = signal.sosfilt(signal.butter(2, edge_hz, fs=RATE, output="sos"), rng.standard_normal(n + 500))[500:]
    return x / np.std(x) * np.minimum(np.arange(n) / RATE / 0.5, 1.0)


def cases() -> list[tuple[str, str, int]]:
    """Return rig, kind and seed of all null cases; a pendulum has no second mode."""
    whole = [(rig, kind, 0) for rig in RIGS for kind in KINDS]
    more = [(rig, kind, seed) for rig in RIGS for kind in AGAIN for seed in (1, 2)]
    return [case for case in (*whole, *more) if not (case[0] == "pendulum" and case[1] == "wrong second mode")]


AGAIN = ("pink", "white on the input", "stochastic force")
"""Kinds with two more seeds."""


def add_noise(
    rng: np.random.Generator, kind: str, force: np.ndarray, outputs: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return a recorded input (n,) and recorded outputs (n, k) with noise of a kind; the input's was never felt by the rig."""
    spec, n = KINDS[kind], len(force)
    scale = outputs.std(axis=0)
    recorded = outputs + WHITE * scale * rng.standard_normal(outputs.shape)
    if "sensor" in spec:
        make, share = spec["sensor"]
        shared = make(rng, n)
        for k in range(outputs.shape[1]):
            recorded[:, k] += share * scale[k] * (shared if spec.get("common") else make(rng, n))
    if "step" in spec:
        recorded = np.round(recorded / (spec["step"] * scale)) * (spec["step"] * scale)
    if "input" in spec:
        make, share = spec["input"]
        force = force + share * force.std() * make(rng, n)
    return force, recorded


# ---- two linear rigs --------------------------------------------------------------------------------------------------

CARRIAGES = """<mujoco model="two carriages">
  <option timestep="{step}" integrator="{integrator}" gravity="0 0 0"><flag contact="disable"/></option>
  <worldbody>
    <body name="one">
      <joint name="j1" type="slide" axis="1 0 0" stiffness="{k[0]}" damping="{c[0]}"/>
      <geom name="g1" type="box" size=".05 .05 .05" mass="1.0"/>
      <body name="two" pos=".3 0 0">
        <joint name="j2" type="slide" axis="1 0 0" stiffness="{k[1]}" damping="{c[1]}"/>
        <geom name="g2" type="box" size=".05 .05 .05" mass="0.6"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="j1"/></actuator>
  <sensor><jointpos name="x1" joint="j1"/><jointpos name="x2" joint="j2"/></sensor>
</mujoco>
"""
SHAFT = """<mujoco model="shaft of three discs">
  <option timestep="{step}" integrator="{integrator}" gravity="0 0 0"><flag contact="disable"/></option>
  <worldbody>
    <body name="one">
      <inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.02"/>
      <joint name="j1" type="hinge" axis="0 0 1" stiffness="{k[0]}" damping="{c[0]}"/>
      <body name="two">
        <inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.015"/>
        <joint name="j2" type="hinge" axis="0 0 1" stiffness="{k[1]}" damping="{c[1]}"/>
        <body name="three">
          <inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
          <joint name="j3" type="hinge" axis="0 0 1" stiffness="{k[2]}" damping="{c[2]}"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="j1"/></actuator>
  <sensor><jointvel name="w1" joint="j1"/><jointvel name="w3" joint="j3"/></sensor>
</mujoco>
"""


def chain_response(
    m: np.ndarray,
    k: np.ndarray,
    c: np.ndarray,
    force: np.ndarray,
    other: np.ndarray | float = 0.0,
    second: float = 1.0,
    steps: int = 0,
) -> np.ndarray:
    """Return relative positions and velocities (n, 2d) of a chain of masses from ground, by a first-order hold.

    `force` acts on the first mass and `other` on the last one; both are linear between samples. `second` is a factor on the
    frequency of the second mode. With `steps` the midpoint rule replaces the matrix exponential, that many times a sample.
    """
    d = len(m)
    below = np.tril(np.ones((d, d)))  # absolute from relative coordinates
    mass, K = below.T @ np.diag(m) @ below, np.diag(k)
    squared, shapes = linalg.eigh(K, mass)
    row = mass @ shapes[:, 1]
    K = K + (second**2 - 1.0) * squared[1] * np.outer(row, row)
    loads = np.linalg.solve(mass, below.T[:, [0, -1]])
    u = np.column_stack([force, np.zeros(len(force)) + other])
    time = np.arange(len(force)) / RATE
    A = np.block([[np.zeros((d, d)), np.eye(d)], [-np.linalg.solve(mass, K), -np.linalg.solve(mass, np.diag(c))]])
    if steps:
        return _midpoint(lambda x, push: A[d:] @ x + loads @ push, 2 * d, u, steps)
    B = np.vstack([np.zeros((d, 2)), loads])
    return signal.lsim(signal.StateSpace(A, B, np.eye(2 * d), np.zeros((2 * d, 2))), u, time, interp=True)[1]


def _midpoint(rate: Callable, states: int, u: np.ndarray, steps: int) -> np.ndarray:
    """Return the states (n, 2d), positions first, of x' = v, v' = rate(x, u), from rest, by the explicit midpoint rule.

    The rule is of second order: its frequencies are off by a share (omega h)^2 / 6. Semi-implicit Euler would not do for a rig with
    nothing hidden: its velocities are late by half a step, and a delay of just so much is rightly found.
    """
    d, h, x = states // 2, 1.0 / RATE / steps, np.zeros(states)
    out = np.zeros((len(u), states))

    def slope(x, push):
        return np.concatenate([x[d:], np.atleast_1d(rate(x, push))])

    for i in range(len(u) - 1):
        out[i] = x
        for j in range(steps):
            start, middle = (u[i] + (u[i + 1] - u[i]) * (j + part) / steps for part in (0.0, 0.5))
            x = x + h * slope(x + h / 2 * slope(x, start), middle)
    out[-1] = x
    return out


@dataclass(frozen=True, kw_only=True, eq=False)
class Chain:
    """Masses in a row, from ground, with a spring and a damper before each.

    Parameters
    ----------
    m, k, c : (d,) array
        Masses, stiffnesses and damping constants [SI].
    outputs : dict of str to int
        Sensors and the coordinate each reads: relative positions first, then relative velocities.
    band : (low, high)
        Of the excitation [Hz]; `level` is its rms.
    """

    mjcf: str
    m: np.ndarray
    k: np.ndarray
    c: np.ndarray
    outputs: dict[str, int]
    drive: Channel
    kind: str
    unit: str
    band: tuple[float, float]
    level: float


CHAINS = {
    "carriages": Chain(
        mjcf=CARRIAGES,
        m=np.array([1.0, 0.6]),
        k=np.array([400.0, 300.0]),
        c=np.array([0.8, 0.5]),
        outputs={"x1": 0, "x2": 1},
        drive=Channel(column="u", at="motor", kind="force", unit="N", is_input=True, hold="linear"),
        kind="displacement",
        unit="m",
        band=(0.5, 12.0),
        level=2.0,
    ),
    "shaft": Chain(
        mjcf=SHAFT,
        m=np.array([0.02, 0.015, 0.01]),
        k=np.array([20.0, 30.0, 15.0]),
        c=np.array([0.02, 0.01, 0.01]),
        outputs={"w1": 3, "w3": 5},
        drive=Channel(column="u", at="motor", kind="moment", unit="N m", is_input=True, hold="linear"),
        kind="angular-velocity",
        unit="rad/s",
        band=(1.0, 15.0),
        level=0.5,
    ),
}


# ---- a pendulum that swings far ---------------------------------------------------------------------------------------

PENDULUM = """<mujoco model="driven pendulum">
  <option timestep="{step}" integrator="{integrator}" gravity="0 0 -9.81"><flag contact="disable"/></option>
  <compiler angle="radian"/>
  <worldbody>
    <body name="arm" pos="0 0 1">
      <inertial pos="0 0 -0.4" mass="0.5" diaginertia="0.004 0.004 0.001"/>
      <joint name="pivot" type="hinge" axis="0 1 0" damping="0.1"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="pivot"/></actuator>
  <sensor><jointpos name="angle" joint="pivot"/></sensor>
</mujoco>
"""
_INERTIA, _WEIGHT, _VISCOUS = 0.004 + 0.5 * 0.4**2, 0.5 * 9.81 * 0.4, 0.1
"""About the pivot [kg m2], at a right angle [N m], of the pivot [N m s/rad]."""


def pendulum_response(
    heavier: float, viscous: float, torque: Callable[[float], float], time: np.ndarray, steps: int = 0
) -> np.ndarray:
    """Return the angle (n,) from rest of a driven pendulum whose mass is a multiple of the model's, with its inertia.

    With `steps` the midpoint rule integrates, that many times a sample.
    """

    def turn(x, push):
        return (push - heavier * _WEIGHT * np.sin(x[0]) - viscous * x[1]) / (heavier * _INERTIA)

    def rate(t, x):
        return [x[1], turn(x, torque(t))]

    if steps:
        return _midpoint(turn, 2, torque(time), steps)[:, 0]
    return solve_ivp(rate, (0, time[-1]), [0.0, 0.0], "DOP853", time, rtol=1e-9, atol=1e-11).y[0]


RIGS = ("carriages", "shaft", "pendulum")


def null_case(folder: Path, rig: str, noise: str, seed: int = 0) -> None:
    """Write a case with nothing hidden: two recordings to fit, two held out, with a kind of `KINDS`."""
    rng = np.random.default_rng([seed, RIGS.index(rig), list(KINDS).index(noise)])
    spec = KINDS[noise]
    steps, edge = spec.get("steps", 0), spec.get("edge_hz", 5.0)
    time = np.arange(int(DURATION * RATE)) / RATE
    records = []
    if rig == "pendulum":
        heavier, viscous = 1 + 0.01 * rng.standard_normal(), _VISCOUS * (1 + 0.1 * rng.standard_normal())
        drive = Channel(column="u", at="motor", kind="moment", unit="N m", is_input=True, hold="linear")
        outputs, kind, unit, uncertain = ["angle"], "angle", "rad", {"mass": 0.03, "damping": 0.3, "gain": 0.02}
        mjcf, values = PENDULUM, {}
    else:
        chain = CHAINS[rig]
        k = chain.k * (1 + 0.02 * rng.standard_normal(chain.k.size))
        c = chain.c * (1 + 0.1 * rng.standard_normal(chain.c.size))
        drive, outputs, kind, unit = chain.drive, list(chain.outputs), chain.kind, chain.unit
        uncertain = {"stiffness": 0.05, "damping": 0.3, "mass": 0.03, "gain": 0.02}
        mjcf, values = chain.mjcf, {"k": chain.k, "c": chain.c}
    for name, level, role in (
        ("one", 1.0, "fit"),
        ("two", 0.6, "fit"),
        ("three", 0.8, "holdout"),
        ("four", 1.1, "holdout"),
    ):
        if rig == "pendulum":
            sine = multisine(rng, 0.2, 2.5, DURATION, 0.5 * level)

            def torque(t, sine=sine):
                return sine(t) * np.minimum(t / 0.5, 1.0)

            force = torque(time)
            felt = torque
            if "force" in spec:
                other = spec["force"] * force.std() * unrecorded(rng, len(time), edge)

                def felt(t, torque=torque, other=other):
                    return torque(t) + np.interp(t, time, other)

            motion = pendulum_response(heavier, viscous, felt, time, steps)[:, None]
        else:
            force = multisine(rng, *chain.band, DURATION, level * chain.level)(time) * np.minimum(time / 0.5, 1.0)
            other = spec["force"] * force.std() * unrecorded(rng, len(time), edge) if "force" in spec else 0.0
            motion = chain_response(chain.m, k, c, force, other, spec.get("second", 1.0), steps)
            motion = motion[:, list(chain.outputs.values())]
        force, motion = add_noise(rng, noise, force, motion)
        columns = {"u": force, **dict(zip(outputs, motion.T, strict=True))}
        records.append(Record(name=name, role=role, columns=columns, rate_hz=RATE))
    is_coarse = bool(spec.get("coarse"))
    step, integrator = (0.004, "Euler") if is_coarse else (0.001, "RK4")
    channels = [drive, *(Channel(column=name, at=name, kind=kind, unit=unit) for name in outputs)]
    text = mjcf.format(step=step, integrator=integrator, **values)
    write_case(folder, title=f"{rig}, {noise}", mjcf=text, uncertain=uncertain, channels=channels, records=records)
