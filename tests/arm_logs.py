"""Logs of an arm as a newcomer has them: degrees, milliseconds, names of a robot's log."""

from pathlib import Path

import mujoco
import numpy as np

ARM = """<mujoco model="arm">
  <option timestep="0.002" integrator="implicitfast"/>
  <default>
    <joint damping="0.1" armature="0.02"/>
    <geom contype="0" conaffinity="0"/>
  </default>
  <worldbody>
    <body name="upper" pos="0 0 0.5">
      <joint name="shoulder_pan" axis="0 1 0" range="-110 110"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.25" size="0.02" mass="0.5"/>
      <body name="fore" pos="0 0 -0.25">
        <joint name="elbow_flex" axis="0 1 0" range="-100 100"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.015" mass="0.3"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="shoulder_pan" joint="shoulder_pan" kp="12" kv="0.6"/>
    <position name="elbow_flex" joint="elbow_flex" kp="8" kv="0.4"/>
  </actuator>
</mujoco>
"""
"""Two position servos on hinges, without sensors."""
JOINTS = ("shoulder_pan", "elbow_flex")
PERIOD = 0.02  # s


def moved(seed: int, seconds: float, *, friction: float = 0.0, xml: str = ARM) -> tuple[np.ndarray, ...]:
    """Return times [s], targets and angles [rad] of a run; dry friction [N m] is in the elbow."""
    model = mujoco.MjModel.from_xml_string(xml)
    model.dof_frictionloss[1] = friction
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    count, every = round(seconds / PERIOD), round(PERIOD / model.opt.timestep)
    time = PERIOD * np.arange(count)
    lines, phases = np.arange(1, 12), rng.uniform(0, 2 * np.pi, (2, 11))
    waves = np.cos(2 * np.pi * 0.2 * lines * time[:, None, None] + phases).sum(axis=2)
    targets = 0.35 * waves / waves.std(axis=0) * np.minimum(1.0, time / 0.5)[:, None]
    angles = np.empty((count, 2))
    for k in range(count):
        angles[k] = data.qpos
        data.ctrl[:] = targets[k]
        for _ in range(every):
            mujoco.mj_step(model, data)
    return time, targets, angles + 2e-4 * rng.standard_normal(angles.shape)


def write_log(path: Path, seed: int, seconds: float = 8.0, *, friction: float = 0.0, xml: str = ARM) -> Path:
    """Write a log in degrees and milliseconds, with columns that no case needs."""
    time, targets, angles = moved(seed, seconds, friction=friction, xml=xml)
    rates = np.gradient(np.degrees(angles), PERIOD, axis=0)
    columns = {"frame": np.arange(len(time)), "timestamp": 1e3 * time}
    for i, joint in enumerate(JOINTS):
        columns[f"{joint}.pos"] = np.degrees(angles[:, i])
        columns[f"{joint}.vel"] = rates[:, i]
        columns[f"action.{joint}.pos"] = np.degrees(targets[:, i])
        columns[f"{joint} temperature"] = 30.0 + 0.01 * time
    table = np.column_stack(list(columns.values()))
    header = ",".join(columns)
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.6g")
    return path


def write_arm(folder: Path, *, logs: int = 3, seconds: float = 8.0, friction: float = 0.0) -> tuple[Path, list[Path]]:
    """Write the model and its logs; return their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "arm.xml").write_text(ARM)
    names = [folder / f"run{i}.csv" for i in range(1, logs + 1)]
    return folder / "arm.xml", [write_log(p, i, seconds, friction=friction) for i, p in enumerate(names)]
