"""Made-up rigs with something hidden in them, integrated without MuJoCo: each function writes a complete case folder.

`pendulum_case` and `two_link_case` have nominal models that are themselves nonlinear; their equations of motion are written
out here and integrated by scipy (DOP853, relative tolerance 1e-9). `oscillator_case` has a linear nominal model and a
choice of effects, see `rig_oscillator`. All have benign errors of the nominal parameters besides the effect; `benign`
multiplies them.
"""

from math import cos, sin, tanh
from pathlib import Path

import numpy as np
from rig_folder import Channel, Record, Rig, multisine, write_case
from rig_oscillator import EFFECTS, oscillator_case
from scipy.integrate import solve_ivp

__all__ = ["EFFECTS", "oscillator_case", "pendulum_case", "two_link_case"]

GRAVITY = 9.80665
NOISE = 1e-3
"""Standard deviation of every position [rad]."""

# ---- pendulum -------------------------------------------------------------------------------------------------------

PENDULUM = """<mujoco model="pendulum">
  <option timestep="0.001" integrator="RK4" gravity="0 0 -9.80665"><flag contact="disable"/></option>
  <compiler angle="radian"/>
  <worldbody>
    <body name="arm" pos="0 0 1">
      <joint name="pivot" type="hinge" axis="0 1 0" damping="0.001"/>
      <geom name="rod" type="capsule" size="0.004" fromto="0 0 0 0 0 -0.5" mass="0"/>
      <geom name="bob" type="sphere" size="0.03" pos="0 0 -0.5" mass="0.4"/>
    </body>
  </worldbody>
  <sensor><jointpos name="angle" joint="pivot"/></sensor>
</mujoco>
"""
_BOB, _LENGTH, _RADIUS, _VISCOUS = 0.4, 0.5, 0.03, 0.001
_DRAG = 0.0015
"""Hidden: torque -drag |rate| rate [N m s2/rad2]; 120 degrees become 53 in 20 s."""


def pendulum_case(folder: Path | str, *, effect: bool = True, seed: int = 0, benign: float = 1.0) -> Rig:
    """Write the case of a pendulum let go at up to 120 degrees: position only, no input, irregular time stamps.

    The nominal model knows mass, length and viscous friction of the pivot; hidden is a drag that goes with the square
    of the speed. Fit: 120, 90, 45 degrees; held out: 105, 60 degrees. The clock starts some 0.3 s after the release.
    """
    rng = np.random.default_rng([seed, 1])
    mass, length = (
        _BOB * (1 + 0.02 * benign * rng.standard_normal()),
        _LENGTH * (1 + 0.003 * benign * rng.standard_normal()),
    )
    viscous = _VISCOUS * (1 + 0.2 * benign * rng.standard_normal())
    inertia = mass * (length**2 + 0.4 * _RADIUS**2)
    drag = _DRAG if effect else 0.0

    def rate(_, x):
        torque = -mass * GRAVITY * length * sin(x[0]) - viscous * x[1] - drag * abs(x[1]) * x[1]
        return [x[1], torque / inertia]

    records, starts = [], {}
    for degrees, role in ((120, "fit"), (90, "fit"), (45, "fit"), (105, "holdout"), (60, "holdout")):
        time = np.cumsum(rng.uniform(0.004, 0.016, 2000))
        start = 0.3 + 0.1 * rng.random()
        run = solve_ivp(
            rate, (0, start + time[-1]), [np.radians(degrees), 0.0], "DOP853", start + time, rtol=1e-9, atol=1e-12
        )
        angle = run.y[0] + NOISE * rng.standard_normal(time.size)
        starts[f"{degrees} degrees"] = tuple(float(v) for v in run.y[:, 0])
        columns = {"time": time, "angle": angle}
        records.append(Record(name=f"{degrees} degrees", role=role, columns=columns, initial="estimated"))
    write_case(
        Path(folder),
        title="Pendulum",
        mjcf=PENDULUM,
        uncertain={"mass": 0.02, "length": 0.005, "damping": 0.3},
        channels=[Channel(column="angle", at="angle", kind="angle", unit="rad")],
        records=records,
    )
    if not effect:
        return Rig(folder=Path(folder), effect="none", place="", parameters={}, starts=starts)
    hidden = {"coefficient": drag}
    return Rig(folder=Path(folder), effect="quadratic-drag", place="joint:pivot", parameters=hidden, starts=starts)


# ---- two-link arm ---------------------------------------------------------------------------------------------------

TWO_LINK = """<mujoco model="two-link arm">
  <option timestep="0.001" integrator="RK4" gravity="0 0 -9.80665"><flag contact="disable"/></option>
  <compiler angle="radian"/>
  <worldbody>
    <body name="upper" pos="0 0 1">
      <inertial pos="0 0 -0.2" mass="1.2" diaginertia="0.018 0.018 0.001"/>
      <joint name="shoulder" type="hinge" axis="0 1 0" damping="0.12"/>
      <geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.4" mass="0"/>
      <body name="fore" pos="0 0 -0.4">
        <inertial pos="0 0 -0.15" mass="0.7" diaginertia="0.006 0.006 0.0005"/>
        <joint name="elbow" type="hinge" axis="0 1 0" damping="0.05"/>
        <geom type="capsule" size="0.016" fromto="0 0 0 0 0 -0.3" mass="0"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="shoulder" joint="shoulder"/>
    <motor name="elbow" joint="elbow"/>
  </actuator>
  <sensor>
    <jointpos name="shoulder" joint="shoulder"/>
    <jointpos name="elbow" joint="elbow"/>
  </sensor>
</mujoco>
"""
_MASSES, _INERTIAS, _DAMPING = np.array([1.2, 0.7]), np.array([0.018, 0.006]), np.array([0.12, 0.05])
_UPPER, _CENTRES = 0.4, (0.2, 0.15)
_COULOMB = 0.06
"""Hidden in the elbow [N m]; its commands have 0.1 to 0.23 N m rms."""
_CREEP = 0.02
"""Speed over which the friction turns round [rad/s]: the law of the rig is smooth, F tanh(v/creep)."""


def arm_rate(masses, inertias, damping, elbow, torque):
    """Return the rate of [q1, q2, q1', q2'] of a double pendulum with relative angles; Spong, Robot Modeling, 6.4.

    `elbow(angle, speed)` is what acts in the elbow besides its damper [N m]; `torque(t)` are both drives.
    """
    (m1, m2), (i1, i2), (c1, c2) = masses, inertias, _CENTRES

    def rate(t, x):
        a, b, v, w = x
        coupling = m2 * _UPPER * c2
        m22 = i2 + m2 * c2**2
        m12 = m22 + coupling * cos(b)
        m11 = i1 + m1 * c1**2 + m22 + m2 * _UPPER**2 + 2 * coupling * cos(b)
        h = coupling * sin(b)
        weight2 = m2 * GRAVITY * c2 * sin(a + b)
        weight1 = (m1 * c1 + m2 * _UPPER) * GRAVITY * sin(a) + weight2
        drive = torque(t)
        f1 = drive[0] - damping[0] * v + h * (2 * v * w + w * w) - weight1
        f2 = drive[1] - damping[1] * w + elbow(b, w) - h * v * v - weight2
        det = m11 * m22 - m12 * m12
        return [v, w, (m22 * f1 - m12 * f2) / det, (m11 * f2 - m12 * f1) / det]

    return rate


def two_link_case(folder: Path | str, *, effect: bool = True, seed: int = 0, benign: float = 1.0) -> Rig:
    """Write the case of a planar arm of two links, hanging, driven by torques at both joints; both angles measured.

    Hidden is dry friction in the elbow. Fit: three levels of a multisine; held out: two other ones. 10 s at 250 Hz.
    """
    rng = np.random.default_rng([seed, 2])
    masses = _MASSES * (1 + 0.02 * benign * rng.standard_normal(2))
    inertias = _INERTIAS * (1 + 0.02 * benign * rng.standard_normal(2))
    damping = _DAMPING * (1 + 0.2 * benign * rng.standard_normal(2))
    coulomb = _COULOMB if effect else 0.0
    rate_hz, time = 250.0, np.arange(2500) / 250.0
    records = []
    for name, level, role in (
        ("small", 0.2, "fit"),
        ("medium", 0.3, "fit"),
        ("large", 0.45, "fit"),
        ("other medium", 0.35, "holdout"),
        ("other large", 0.4, "holdout"),
    ):
        first, second = (multisine(rng, 0.2, 2.0, 10.0, level * size) for size in (2.0, 0.5))

        def torque(t, first=first, second=second):
            fade = np.minimum(t / 0.5, 1.0)  # from rest without a jump
            return fade * first(t), fade * second(t)

        motion = solve_ivp(
            arm_rate(masses, inertias, damping, lambda b, w: -coulomb * tanh(w / _CREEP), torque),
            (0, time[-1]),
            np.zeros(4),
            "DOP853",
            time,
            rtol=1e-9,
            atol=1e-11,
        ).y
        angles = motion[:2] + NOISE * rng.standard_normal((2, time.size))
        drive = torque(time)
        columns = {"shoulder": angles[0], "elbow": angles[1], "torque1": drive[0], "torque2": drive[1]}
        records.append(Record(name=name, role=role, columns=columns, rate_hz=rate_hz))
    drives = [
        Channel(column=f"torque{i + 1}", at=at, kind="moment", unit="N m", is_input=True, hold="linear")
        for i, at in enumerate(("shoulder", "elbow"))
    ]
    angles = [Channel(column=at, at=at, kind="angle", unit="rad") for at in ("shoulder", "elbow")]
    write_case(
        Path(folder),
        title="Two-link arm",
        mjcf=TWO_LINK,
        uncertain={"mass": 0.02, "inertia": 0.02, "damping": 0.3},
        channels=[*drives, *angles],
        records=records,
    )
    if not effect:
        return Rig(folder=Path(folder), effect="none", place="", parameters={})
    return Rig(folder=Path(folder), effect="coulomb-friction", place="joint:elbow", parameters={"force": coulomb})
