"""Pendulum, two-link arm and cart-pole with something hidden, moving far: equations of motion written out, DOP853.

Every case has benign errors of masses, inertias, lengths and dampers within what it states. `CASES` says for each rig what
can be hidden, where, and which answers are right: those that the recordings cannot tell from the truth count as well.
"""

from dataclasses import dataclass
from math import cos, exp, sin, tanh
from pathlib import Path

import numpy as np
from rig_folder import Channel, Record, Rig, multisine, write_case
from rigs import GRAVITY, PENDULUM, TWO_LINK, arm_rate
from scipy.integrate import solve_ivp

RATE = 100.0
BENIGN = 1.0
"""Multiplies the benign errors of the nominal parameters."""
ANGLES = ((120, "fit"), (80, "fit"), (45, "fit"), (105, "holdout"), (60, "holdout"))
"""Degrees at which the pendulum is let go."""


@dataclass(frozen=True)
class Hidden:
    """What is hidden: parameters, where, and the (effect, place) pairs that count as right."""

    values: dict[str, float]
    place: str
    right: tuple[tuple[str, str], ...]


def _solved(rate, start, time, longest=np.inf):
    return solve_ivp(rate, (0, time[-1]), start, "DOP853", time, rtol=1e-9, atol=1e-11, max_step=longest).y


# ---- pendulum -------------------------------------------------------------------------------------------------------

PIVOT = "joint:pivot"
PENDULUM_CASES = {
    "none": Hidden({}, "", ()),
    "quadratic-drag": Hidden({"coefficient": 0.0015}, PIVOT, (("quadratic-drag", PIVOT),)),
    "coulomb-friction": Hidden({"force": 0.02}, PIVOT, (("coulomb-friction", PIVOT), ("lugre-friction", PIVOT))),
    "stribeck-friction": Hidden(
        {"force": 0.01, "excess": 0.05, "speed": 1.0}, PIVOT, (("stribeck-friction", PIVOT), ("lugre-friction", PIVOT))
    ),
    "viscous-damping": Hidden({"damping": 0.006}, PIVOT, (("viscous-damping", PIVOT),)),
    "stiffness-to-ground": Hidden({"stiffness": 0.25}, PIVOT, (("stiffness-to-ground", PIVOT),)),
    "rotary-inertia": Hidden({"inertia": 0.008}, PIVOT, (("rotary-inertia", PIVOT), ("added-mass", "body:arm"))),
    "stop": Hidden({"stiffness": 6.0, "gap": 1.3}, PIVOT, (("stop", PIVOT),)),
    "cubic-stiffness": Hidden({"k3": 0.12}, PIVOT, (("cubic-stiffness", PIVOT), ("quadratic-cubic-stiffness", PIVOT))),
    "force-offset": Hidden({"force": 0.08}, PIVOT, (("force-offset", PIVOT), ("sensor-offset", "sensor:angle"))),
}


def swinging_pendulum(folder, effect="none", *, seed=0, noise=0.002, is_even=True):
    """Write the case of a pendulum let go at up to 120 degrees; `noise` is a share of each record's rms."""
    rng = np.random.default_rng([seed, 11])
    hidden, bob, length, radius = PENDULUM_CASES[effect], 0.4, 0.5, 0.03
    mass, long = (
        bob * (1 + BENIGN * 0.02 * rng.standard_normal()),
        length * (1 + BENIGN * 0.002 * rng.standard_normal()),
    )
    viscous = 0.001 * (1 + BENIGN * 0.2 * rng.standard_normal())
    p = hidden.values
    inertia = mass * (long**2 + 0.4 * radius**2) + p.get("inertia", 0.0)

    def torque(z, v):
        if effect == "quadratic-drag":
            return -p["coefficient"] * abs(v) * v
        if effect == "coulomb-friction":
            return -p["force"] * tanh(v / 0.005)
        if effect == "stribeck-friction":
            return -(p["force"] + p["excess"] * exp(-((v / p["speed"]) ** 2))) * tanh(v / 0.005)
        if effect == "stop":
            return -p["stiffness"] * (z - min(max(z, -p["gap"]), p["gap"]))
        return (
            -p.get("damping", 0.0) * v - p.get("stiffness", 0.0) * z - p.get("k3", 0.0) * z**3
            + (p["force"] if effect == "force-offset" else 0.0)
        )  # fmt: skip

    def rate(_, x):
        return [x[1], (-mass * GRAVITY * long * sin(x[0]) - viscous * x[1] + torque(x[0], x[1])) / inertia]

    records = []
    for degrees, role in ANGLES:
        steps = np.full(1500, 1 / RATE) if is_even else rng.uniform(0.004, 0.016, 1500)
        time = np.cumsum(steps) - steps[0]
        start = 0.2 + 0.1 * rng.random()
        angle = _solved(rate, [np.radians(degrees), 0.0], np.concatenate([[0.0], start + time]))[0, 1:]
        angle = angle + noise * np.std(angle) * rng.standard_normal(time.size)
        columns = {"angle": angle} if is_even else {"time": time, "angle": angle}
        rate_hz = RATE if is_even else None
        name = f"{degrees} degrees"
        records.append(Record(name=name, role=role, columns=columns, initial="estimated", rate_hz=rate_hz))
    write_case(
        Path(folder),
        title="Pendulum",
        mjcf=PENDULUM,
        uncertain={"mass": 0.02, "length": 0.003, "damping": 0.3},
        channels=[Channel(column="angle", at="angle", kind="angle", unit="rad")],
        records=records,
    )
    return Rig(folder=Path(folder), effect=effect, place=hidden.place, parameters=p)


# ---- two-link arm ---------------------------------------------------------------------------------------------------

ELBOW, SHOULDER = "joint:elbow", "joint:shoulder"
ARM_CASES = {
    "none": Hidden({}, "", ()),
    "coulomb-friction": Hidden({"force": 0.06}, ELBOW, (("coulomb-friction", ELBOW), ("lugre-friction", ELBOW))),
    "viscous-damping": Hidden({"damping": 0.6}, SHOULDER, (("viscous-damping", SHOULDER),)),
    "added-mass": Hidden({"mass": 0.15}, "body:fore", (("added-mass", "body:fore"),)),
    "stiffness-to-ground": Hidden({"stiffness": 0.5}, ELBOW, (("stiffness-to-ground", ELBOW),)),
    "stop": Hidden({"stiffness": 10.0, "gap": 0.6}, ELBOW, (("stop", ELBOW),)),
    "actuator-gain": Hidden({"gain": -0.25}, "actuator:shoulder", (("actuator-gain", "actuator:shoulder"),)),
    "actuator-clipping": Hidden(
        {"limit": 0.9}, "actuator:shoulder", (("actuator-clipping", "actuator:shoulder"), ("soft-saturation", "actuator:shoulder"))
    ),
    "sensor-delay": Hidden(
        {"delay": 0.012}, "sensor:angle:elbow", (("sensor-delay", "sensor:angle:elbow"), ("sensor-lag", "sensor:angle:elbow"))
    ),
    "quadratic-drag": Hidden({"coefficient": 0.03}, ELBOW, (("quadratic-drag", ELBOW),)),
}  # fmt: skip


def driven_arm(folder, effect="none", *, seed=0, noise=0.002):
    """Write the case of a hanging arm of two links driven by torques at both joints; Spong, Robot Modeling, 6.4."""
    rng = np.random.default_rng([seed, 12])
    hidden = ARM_CASES[effect]
    p = hidden.values
    m1, m2 = np.array([1.2, 0.7]) * (1 + BENIGN * 0.015 * rng.standard_normal(2))
    i1, i2 = np.array([0.018, 0.006]) * (1 + BENIGN * 0.02 * rng.standard_normal(2))
    d1, d2 = np.array([0.12, 0.05]) * (1 + BENIGN * 0.2 * rng.standard_normal(2))
    m2 += p.get("mass", 0.0)  # at the centre of the forearm
    d1 += p.get("damping", 0.0)
    time, records = np.arange(1500) / (1.5 * RATE), []

    def extra(b, w):
        if effect == "coulomb-friction":
            return -p["force"] * tanh(w / 0.01)
        if effect == "stop":
            return -p["stiffness"] * (b - min(max(b, -p["gap"]), p["gap"]))
        return -p.get("stiffness", 0.0) * b - p.get("coefficient", 0.0) * w * abs(w)

    for name, level, role in (
        ("small", 0.2, "fit"), ("medium", 0.3, "fit"), ("large", 0.42, "fit"),
        ("other medium", 0.33, "holdout"), ("other large", 0.38, "holdout"),
    ):  # fmt: skip
        first, second = (multisine(rng, 0.2, 2.0, 10.0, level * size) for size in (2.0, 0.5))

        def torque(t, first=first, second=second):
            fade = np.minimum(t / 0.5, 1.0)
            one = fade * first(t) * (1 + p.get("gain", 0.0))
            return (np.clip(one, -p["limit"], p["limit"]) if "limit" in p else one), fade * second(t)

        rate = arm_rate((m1, m2), (i1, i2), (d1, d2), extra, torque)
        late = np.maximum(time - p.get("delay", 0.0), 0.0)
        angles = _solved(rate, np.zeros(4), time, 0.02)[:2]
        if "delay" in p:
            angles[1] = np.interp(late, time, angles[1])
        angles = angles + noise * np.std(angles, axis=1, keepdims=True) * rng.standard_normal(angles.shape)
        fade = np.minimum(time / 0.5, 1.0)
        columns = {
            "shoulder": angles[0], "elbow": angles[1], "torque1": fade * first(time), "torque2": fade * second(time)
        }  # fmt: skip
        records.append(Record(name=name, role=role, columns=columns, rate_hz=1.5 * RATE))
    drives = [
        Channel(column=f"torque{i + 1}", at=at, kind="moment", unit="N m", is_input=True, hold="linear")
        for i, at in enumerate(("shoulder", "elbow"))
    ]
    write_case(
        Path(folder),
        title="Two-link arm",
        mjcf=TWO_LINK,
        uncertain={"mass": 0.015, "inertia": 0.02, "damping": 0.3},
        channels=[*drives, *(Channel(column=at, at=at, kind="angle", unit="rad") for at in ("shoulder", "elbow"))],
        records=records,
    )
    return Rig(folder=Path(folder), effect=effect, place=hidden.place, parameters=p)


# ---- cart-pole ------------------------------------------------------------------------------------------------------

CART_POLE = """<mujoco model="cart-pole">
  <option timestep="0.001" integrator="RK4" gravity="0 0 -9.80665"><flag contact="disable"/></option>
  <compiler angle="radian"/>
  <worldbody>
    <body name="cart" pos="0 0 1">
      <inertial pos="0 0 0" mass="1.0" diaginertia="0.01 0.01 0.01"/>
      <joint name="slide" type="slide" axis="1 0 0" damping="0.8" stiffness="2"/>
      <geom type="box" size="0.1 0.05 0.05" mass="0"/>
      <body name="pole">
        <inertial pos="0 0 -0.3" mass="0.3" diaginertia="0.004 0.004 0.0001"/>
        <joint name="hinge" type="hinge" axis="0 1 0" damping="0.002"/>
        <geom type="capsule" size="0.01" fromto="0 0 0 0 0 -0.6" mass="0"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="push" joint="slide"/></actuator>
  <sensor>
    <jointpos name="position" joint="slide"/>
    <gyro name="gyro" site="imu"/>
    <jointpos name="angle" joint="hinge"/>
  </sensor>
</mujoco>
""".replace('<geom type="capsule" size="0.01"', '<site name="imu" pos="0 0 -0.5"/><geom type="capsule" size="0.01"')
SLIDE, HINGE = "joint:slide", "joint:hinge"
CART_CASES = {
    "none": Hidden({}, "", ()),
    "coulomb-friction": Hidden({"force": 0.35}, SLIDE, (("coulomb-friction", SLIDE), ("lugre-friction", SLIDE))),
    "quadratic-drag": Hidden({"coefficient": 0.002}, HINGE, (("quadratic-drag", HINGE),)),
    "viscous-damping": Hidden({"damping": 0.012}, HINGE, (("viscous-damping", HINGE),)),
    "added-mass": Hidden({"mass": 0.25}, SLIDE, (("added-mass", SLIDE), ("added-mass", "body:cart"))),
    "actuator-gain": Hidden({"gain": 0.4}, "actuator:push", (("actuator-gain", "actuator:push"),)),
    "cubic-stiffness": Hidden({"k3": 12.0}, SLIDE, (("cubic-stiffness", SLIDE), ("quadratic-cubic-stiffness", SLIDE))),
}


def pushed_cart(folder, effect="none", *, seed=0, noise=0.003, sees_pole="gyro"):
    """Write the case of a cart on a weak spring, pushed, with a pole that swings past 90 degrees.

    The pole is seen by a gyro alone, or by its angle (`sees_pole="angle"`); the cart by its position.
    """
    rng = np.random.default_rng([seed, 13])
    hidden = CART_CASES[effect]
    p = hidden.values
    cart = 1.0 * (1 + BENIGN * 0.015 * rng.standard_normal()) + p.get("mass", 0.0)
    pole, inertia = (
        0.3 * (1 + BENIGN * 0.015 * rng.standard_normal()),
        0.004 * (1 + BENIGN * 0.02 * rng.standard_normal()),
    )
    arm, spring = 0.3 * (1 + BENIGN * 0.002 * rng.standard_normal()), 2.0 * (1 + BENIGN * 0.03 * rng.standard_normal())
    d1, d2 = np.array([0.8, 0.002]) * (1 + BENIGN * 0.2 * rng.standard_normal(2))
    d2 += p.get("damping", 0.0)
    time, records = np.arange(1500) / RATE, []
    for name, level, role in (
        ("small", 0.8, "fit"), ("medium", 1.5, "fit"), ("large", 2.2, "fit"),
        ("other medium", 1.2, "holdout"), ("other large", 1.9, "holdout"),
    ):  # fmt: skip
        push = multisine(rng, 0.2, 1.6, 10.0, level)

        def rate(t, x, push=push):
            z, a, v, w = x
            fade = min(t / 0.5, 1.0)
            f = fade * float(push(t)) * (1 + p.get("gain", 0.0)) - d1 * v - spring * z - p.get("k3", 0.0) * z**3
            f -= p.get("force", 0.0) * tanh(v / 0.0003)
            f += pole * arm * w * w * sin(a)  # hanging pole: centre at z - arm sin(a), -arm cos(a)
            g = -pole * GRAVITY * arm * sin(a) - d2 * w - p.get("coefficient", 0.0) * w * abs(w)
            m12 = -pole * arm * cos(a)
            m11, m22 = cart + pole, inertia + pole * arm**2
            f -= 2 * pole * arm * w * w * sin(a)
            det = m11 * m22 - m12 * m12
            return [v, w, (m22 * f - m12 * g) / det, (m11 * g - m12 * f) / det]

        x = _solved(rate, np.zeros(4), time, 0.02)
        seen = {"position": x[0], "pole": x[3] if sees_pole == "gyro" else x[1]}
        seen = {k: y + noise * np.std(y) * rng.standard_normal(y.size) for k, y in seen.items()}
        columns = {**seen, "force": np.minimum(time / 0.5, 1.0) * push(time)}
        records.append(Record(name=name, role=role, columns=columns, rate_hz=RATE))
    channels = [
        Channel(column="force", at="push", kind="force", unit="N", is_input=True, hold="linear"),
        Channel(column="position", at="position", kind="displacement", unit="m"),
        Channel(column="pole", at="gyro.y", kind="angular-velocity", unit="rad/s")
        if sees_pole == "gyro"
        else Channel(column="pole", at="angle", kind="angle", unit="rad"),
    ]
    write_case(
        Path(folder),
        title="Cart-pole",
        mjcf=CART_POLE,
        uncertain={"mass": 0.015, "inertia": 0.02, "damping": 0.3, "stiffness": 0.03},
        channels=channels,
        records=records,
    )
    return Rig(folder=Path(folder), effect=effect, place=hidden.place, parameters=p)


CASES = {"pendulum": PENDULUM_CASES, "arm": ARM_CASES, "cart": CART_CASES}
WRITE = {"pendulum": swinging_pendulum, "arm": driven_arm, "cart": pushed_cart}
