"""Runs written answers in plain MuJoCo, in a process without vlab: python plain_mujoco.py JOBS.json RESULT.npz.

Each job names a folder with the written files, the commands of a run and the sensors to read. A reading belongs to the
time of the velocity, so the positions of a staggered integrator go back by half a step, as in vlab's own replay.
"""

import importlib.util
import json
import sys
from pathlib import Path

import mujoco
import numpy as np

STAGGERED = (0, 2, 3)


def law_of(folder):
    if not (folder / "law.py").exists():
        return None
    spec = importlib.util.spec_from_file_location(f"law_{folder.name.replace('-', '_')}", folder / "law.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def run(folder, commands, steps, sensors):
    model = mujoco.MjModel.from_xml_path(str(folder / "model.xml"))
    law = law_of(folder)
    if law is not None:
        law.install(model)
    data, look = mujoco.MjData(model), mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    back = model.opt.timestep / 2 if model.opt.integrator in STAGGERED else 0.0
    out = np.zeros((len(commands), len(sensors)))
    for k, u in enumerate(commands):
        mujoco.mj_copyState(model, data, look, int(mujoco.mjtState.mjSTATE_INTEGRATION))
        mujoco.mj_integratePos(model, look.qpos, look.qvel, -back)
        mujoco.mj_fwdPosition(model, look)
        mujoco.mj_sensorPos(model, look)
        mujoco.mj_fwdVelocity(model, look)
        mujoco.mj_sensorVel(model, look)
        values = {name: float(look.sensor(name).data[0]) for name in sensors}
        if law is not None:
            values |= {name: value for name, value in law.read(model, look).items() if name in values}
        out[k] = [values[name] for name in sensors]
        for _ in range(steps):
            data.ctrl[:] = u if law is None else law.command(model, data, u)
            mujoco.mj_step(model, data)
    if law is not None:
        law.uninstall()
    return out


def main(jobs, result):
    listed = json.loads(Path(jobs).read_text(encoding="utf-8"))
    inputs = np.load(listed["inputs"])
    done = {
        job["name"]: run(Path(job["folder"]), inputs[job["inputs"]], job["steps"], job["sensors"])
        for job in listed["jobs"]
    }
    np.savez(result, without_vlab=not any(name.split(".")[0] == "vlab" for name in sys.modules), **done)


if __name__ == "__main__":
    main(*sys.argv[1:])
