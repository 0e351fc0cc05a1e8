"""Two carriages of which the first meets a stop in the recording to fit, and not in the one kept aside."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rig_folder import Channel, Record, Rig, multisine, write_case
from scipy.linalg import expm

RATE, SECONDS, SUBSTEPS = 500.0, 4.0, 8
GAP, STOP = 0.015, 4000.0
"""Of the stop [m, N/m], on one side."""
NOISE = 6e-5
"""Standard deviation of both displacements [m]: 0.5 to 1 % of the rms."""
BUILT = {"masses": (1.02, 0.595), "springs": (398.0, 303.0), "dampings": (0.85, 0.47)}
"""Half a per cent to 6 % off what the model says."""

CARRIAGES = """<mujoco model="two carriages">
  <option timestep="0.001" integrator="implicitfast" gravity="0 0 0"><flag contact="disable"/></option>
  <worldbody>
    <body name="one">
      <joint name="j1" type="slide" axis="1 0 0" stiffness="400" damping="0.8"/>
      <geom name="g1" type="box" size=".05 .05 .05" mass="1.0"/>
      <body name="two" pos=".3 0 0">
        <joint name="j2" type="slide" axis="1 0 0" stiffness="300" damping="0.5"/>
        <geom name="g2" type="box" size=".05 .05 .05" mass="0.6"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="j1"/></actuator>
  <sensor><jointpos name="x1" joint="j1"/><jointpos name="r2" joint="j2"/></sensor>
</mujoco>
"""


def motion(force: np.ndarray, *, masses, springs, dampings, gap: float) -> np.ndarray:
    """Return displacement of the first carriage and of the second beside it, (n, 2), of a force held between samples.

    The linear part moves exactly; the stop is a second-order predictor and corrector.
    """
    rows = np.array([[1.0, 0.0], [-1.0, 1.0]])  # of the springs, on absolute displacements
    inverse = np.diag(1 / np.array(masses))
    A = np.zeros((5, 5))
    A[:2, 2:4] = np.eye(2)
    A[2:4, :2] = -inverse @ (rows.T * springs) @ rows
    A[2:4, 2:4] = -inverse @ (rows.T * dampings) @ rows
    A[2, 4] = inverse[0, 0]
    move = expm(A / (RATE * SUBSTEPS))
    free, push = move[:4, :4], move[:4, 4]
    x, out = np.zeros(4), np.zeros((len(force), 2))
    for k, u in enumerate(force):
        out[k] = x[0], x[1] - x[0]
        for _ in range(SUBSTEPS):
            now = -STOP * max(x[0] - gap, 0.0)
            ahead = free @ x + push * (u + now)
            x = free @ x + push * (u + 0.5 * (now - STOP * max(ahead[0] - gap, 0.0)))
    return out


def stop_case(folder: Path | str, *, holdout: float = 0.4, gap: float = GAP, loud: Sequence[float] = (1.0,)) -> Rig:
    """Write the case: 4 s at 500 Hz from rest, recordings to fit that meet the stop, one held out.

    Parameters
    ----------
    holdout : float
        Level of the recording kept aside over that of the other one: 0.4 does not reach the stop, 0.9 does.
    gap : float
        Of the stop [m]; infinite for none.
    loud : sequence of float
        Levels of the recordings to fit.
    """
    rng = np.random.default_rng(5)
    time = np.arange(round(SECONDS * RATE)) / RATE
    records = []
    fitted = [("loud" if not i else f"loud {i + 1}", "fit", level) for i, level in enumerate(loud)]
    for name, role, level in (*fitted, ("aside", "holdout", holdout)):
        force = 2.4 * level * multisine(rng, 0.5, 12.0, SECONDS, 1.0)(time) * np.minimum(time / 0.2, 1.0)
        y = motion(force, gap=gap, **BUILT)
        y = y + NOISE * rng.standard_normal(y.shape)
        records.append(Record(name=name, role=role, columns={"u": force, "x1": y[:, 0], "r2": y[:, 1]}, rate_hz=RATE))
    write_case(
        Path(folder),
        title="Two carriages",
        mjcf=CARRIAGES,
        uncertain={"stiffness": 0.05, "damping": 0.3, "mass": 0.03, "gain": 0.02},
        channels=[
            Channel(column="u", at="motor", kind="force", unit="N", is_input=True, hold="zero"),
            Channel(column="x1", at="x1", kind="displacement", unit="m"),
            Channel(column="r2", at="r2", kind="displacement", unit="m"),
        ],
        records=records,
    )
    hidden = {"stiffness": STOP, "gap": gap}
    return Rig(folder=Path(folder), effect="one-sided-stiffness", place="joint:j1", parameters=hidden)
