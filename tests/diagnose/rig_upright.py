"""A link that stands up: the torques of a tracking controller were logged with its angle, and something is hidden.

The torques act open loop in the model, so every small error grows exponentially. Own equation of motion, DOP853.
"""

from math import sin, tanh
from pathlib import Path

import numpy as np
from rig_folder import Channel, Record, Rig, multisine, write_case
from scipy.integrate import solve_ivp

GRAVITY, MASS, LENGTH, INERTIA, DAMPING = 9.81, 0.8, 0.3, 0.02, 0.05
RATE, SECONDS, NOISE = 200.0, 8.0, 1.5e-4
GROWTH = np.sqrt(MASS * GRAVITY * LENGTH / (INERTIA + MASS * LENGTH**2))
"""GROWTH [1/s]: rate at which errors grow about the upright position, without damping."""
MJCF = f"""<mujoco model="upright">
  <compiler angle="radian"/>
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <body name="link">
      <inertial pos="0 0 {LENGTH}" mass="{MASS}" diaginertia="{INERTIA} {INERTIA} 1e-3"/>
      <joint name="shoulder" axis="0 1 0" damping="{DAMPING}"/>
      <geom type="capsule" fromto="0 0 0 0 0 {2 * LENGTH}" size="0.01" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="shoulder"/></actuator>
</mujoco>"""
PLACE = "joint:shoulder"


def standing_link(folder, friction=0.0, *, seed=0):
    """Write the case of a standing link with dry friction [N m] in its joint."""
    rng = np.random.default_rng([seed, 17])
    mass, damping = MASS * (1 + 0.01 * rng.standard_normal()), DAMPING * (1 + 0.05 * rng.standard_normal())
    inertia = INERTIA + mass * LENGTH**2
    time = np.arange(round(SECONDS * RATE)) / RATE
    records = []
    for i in range(3):
        reference = multisine(rng, 0.2, 1.5, SECONDS, 0.35)
        x, angle, torque = np.zeros(2), np.zeros(time.size), np.zeros(time.size)
        for k, t in enumerate(time):
            angle[k] = x[0]
            aim, ahead = reference(np.array([t, t + 1e-4]))
            torque[k] = 25.0 * (aim - x[0]) + 3.0 * ((ahead - aim) / 1e-4 - x[1])  # held until the next sample

            def rate(_, x, held=torque[k]):
                gravity = mass * GRAVITY * LENGTH * sin(x[0])
                return [x[1], (held + gravity - damping * x[1] - friction * tanh(x[1] / 0.01)) / inertia]

            x = solve_ivp(rate, (0, 1 / RATE), x, "DOP853", rtol=1e-9, atol=1e-11).y[:, -1]
        angle += NOISE * rng.standard_normal(time.size)
        columns, role = {"torque": torque, "angle": angle}, "fit" if i < 2 else "holdout"
        records.append(Record(name=f"run {i}", role=role, columns=columns, rate_hz=RATE, initial="auto"))
    write_case(
        Path(folder),
        title="Standing link",
        mjcf=MJCF,
        uncertain={"mass": 0.02, "damping": 0.1},
        channels=[
            Channel(column="torque", at="motor", kind="torque", unit="N m", is_input=True, hold="zero"),
            Channel(column="angle", at=PLACE, kind="angle", unit="rad"),
        ],
        records=records,
    )
    values = {"force": friction} if friction else {}
    return Rig(
        folder=Path(folder), effect="coulomb-friction" if friction else "none", place=PLACE if friction else "",
        parameters=values,
    )  # fmt: skip
