"""A servo that moves two masses, with something late, held or slow in it; integrated exactly, without MuJoCo.

The motor of a position servo moves a slide. A second slide hangs on the first by a spring. Between the changes of the
command the equations are linear with constant coefficients, so matrix exponentials give the motion without error. A
delayed staircase changes within samples, and the intervals are cut there.
"""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from rig_folder import Channel, Record, Rig, multisine, write_case
from scipy.linalg import expm

RATE, SECONDS = 500.0, 6.0
NOISE = 2e-5
"""Standard deviation of every position [m]; the motion has 10 to 30 mm rms."""
M1, M2, KP, KV, DAMPING = 1.0, 0.4, 400.0, 24.0, 2.0
K, C = 150.0, 0.8
MODEL = f"""<mujoco model="servo slide">
  <option timestep="0.001" integrator="RK4"><flag contact="disable" gravity="disable"/></option>
  <worldbody>
    <body name="near">
      <inertial pos="0 0 0" mass="{M1}" diaginertia="1e-3 1e-3 1e-3"/>
      <joint name="near" type="slide" axis="1 0 0" damping="{DAMPING}"/>
      <geom size="0.02"/>
      <body name="far">
        <inertial pos="0 0 0" mass="{M2}" diaginertia="1e-3 1e-3 1e-3"/>
        <joint name="far" type="slide" axis="1 0 0" stiffness="{K}" damping="{C}"/>
        <geom size="0.02"/>
      </body>
    </body>
  </worldbody>
  <actuator><position name="servo" joint="near" kp="{KP}" kv="{KV}"/></actuator>
  <sensor><jointpos name="near" joint="near"/><jointpos name="far" joint="far"/></sensor>
</mujoco>
"""


@dataclass(frozen=True)
class Hidden:
    """What is hidden, where, and which names count as right; written down before any diagnosis.

    Parameters
    ----------
    tolerance : float
        Relative error of the parameter that counts as right.
    """

    effect: str
    place: str = ""
    values: dict[str, float] = field(default_factory=dict)
    right: tuple[str, ...] = ()
    tolerance: float = 0.03


SERVO, FAR = "actuator:servo", "sensor:far"
CASES = {
    "none": Hidden("none"),
    # at 0.3 ms the phase of the highest frequency, 8 Hz, is 0.9 degrees: a lag does the same
    "delay 0.3 ms": Hidden("actuator-delay", SERVO, {"delay": 3e-4}, ("actuator-delay", "actuator-lag"), 0.2),
    "delay 4 ms": Hidden("actuator-delay", SERVO, {"delay": 4e-3}, ("actuator-delay",)),
    "delay 60 ms": Hidden("actuator-delay", SERVO, {"delay": 0.0603}, ("actuator-delay",)),
    "delay 150 ms": Hidden("actuator-delay", SERVO, {"delay": 0.15}, ("actuator-delay",)),
    "late reading": Hidden("sensor-delay", FAR, {"delay": 0.0337}, ("sensor-delay",)),
    "hold 10 ms": Hidden("actuator-hold", SERVO, {"period": 0.01}, ("actuator-hold",)),
    "profile velocity": Hidden("slew-limit", SERVO, {"slope": 0.12}, ("slew-limit", "rate-limit")),
}


def matrices(scale=(1.0, 1.0, 1.0, 1.0)):
    """Return A and B of x' = A x + B u, x = near and far displacement, then their rates; far counts from near."""
    m1, m2 = M1 * scale[0], M2 * scale[1]
    damping, c = DAMPING * scale[2], C * scale[3]
    M = np.array([[m1 + m2, m2], [m2, m2]])
    stiffness, viscous = np.diag([KP, K]), np.diag([KV + damping, c])
    inverse = np.linalg.inv(M)
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-inverse @ stiffness, -inverse @ viscous]])
    return A, np.concatenate([[0.0, 0.0], inverse @ [KP, 0.0]])


def moved(A, B, h):
    """Return the maps of state and held input over an interval."""
    whole = expm(np.block([[A, B[:, None]], [np.zeros((1, 5))]]) * h)
    return whole[:4, :4], whole[:4, 4]


def motion(u, delay=0.0, scale=(1.0, 1.0, 1.0, 1.0)):
    """Return the states (n, 4) at the samples, from rest, under a staircase that acts later by a delay."""
    h = 1 / RATE
    whole = int(np.floor(delay / h + 1e-12))
    rest = delay - whole * h
    (A1, B1), (A2, B2) = moved(*matrices(scale), rest), moved(*matrices(scale), h - rest)
    late = np.concatenate([np.zeros(whole + 1), u])
    out, x = np.zeros((len(u), 4)), np.zeros(4)
    for k in range(len(u)):
        out[k] = x
        x = A2 @ (A1 @ x + B1 * late[k]) + B2 * late[k + 1]
    return out


def limited(u, slope, fine=40):
    """Return the states (n, 4) under a target that follows the staircase at a limited speed."""
    h = 1 / RATE / fine
    A, B = moved(*matrices(), h)
    out, x, target = np.zeros((len(u), 4)), np.zeros(4), 0.0
    for k in range(len(u)):
        out[k] = x
        for _ in range(fine):
            target += float(np.clip(u[k] - target, -slope * h, slope * h))
            x = A @ x + B * target
    return out


def commands(rng, name):
    """Return a command (n,): steps of 0.2 to 0.7 s, and a multisine of 0.3 to 8 Hz; steps alone for a limited speed."""
    time = np.arange(int(SECONDS * RATE)) / RATE
    edges = np.cumsum(rng.uniform(0.2, 0.7, 40))
    heights = np.concatenate([[0.0], rng.uniform(-0.04, 0.04, 40)])
    steps = heights[np.searchsorted(edges, time, side="right")]
    if name == "profile velocity":
        return steps
    fade = np.minimum(time / 0.3, 1.0)
    return steps + fade * multisine(rng, 0.3, 8.0, SECONDS, 0.01)(time)


def times_case(folder, name, *, seed=0):
    """Write a case of `CASES`."""
    rng = np.random.default_rng([seed, 7])
    hidden, records = CASES[name], []
    scale = 1.0 + np.array([0.01, 0.01, 0.1, 0.1]) * rng.standard_normal(4)
    for record, role in (("one", "fit"), ("two", "fit"), ("three", "holdout")):
        u = commands(rng, name)
        if hidden.effect == "slew-limit":
            x = limited(u, hidden.values["slope"])
        elif hidden.effect == "actuator-hold":
            every = round(hidden.values["period"] * RATE)
            x = motion(np.repeat(u[::every], every)[: len(u)], scale=scale)
        else:
            x = motion(u, hidden.values.get("delay", 0.0) if hidden.effect == "actuator-delay" else 0.0, scale)
        far = x[:, 1]
        if hidden.effect == "sensor-delay":  # the same system under a later command gives the same, later motion
            far = motion(u, hidden.values["delay"], scale)[:, 1]
        columns = {"command": u, "near": x[:, 0], "far": far}
        for key in ("near", "far"):
            columns[key] = columns[key] + NOISE * rng.standard_normal(len(u))
        records.append(Record(name=record, role=role, columns=columns, rate_hz=RATE))
    write_case(
        Path(folder),
        title="Servo slide",
        mjcf=MODEL,
        uncertain={"mass": 0.02, "damping": 0.3},
        channels=[
            Channel(column="command", at="servo", kind="command", unit="m", is_input=True, hold="zero"),
            Channel(column="near", at="near", kind="displacement", unit="m"),
            Channel(column="far", at="far", kind="displacement", unit="m"),
        ],
        records=records,
    )
    return Rig(folder=Path(folder), effect=hidden.effect, place=hidden.place, parameters=hidden.values)
