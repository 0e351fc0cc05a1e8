"""Noise between periods: only periods of a settled motion tell it."""

import mujoco
import numpy as np
import pytest
from rig_folder import Channel, Record, write_case

from vlab.cases import load_case
from vlab.diagnose.data.noise import estimate_noise
from vlab.diagnose.data.settled import with_unsettled
from vlab.diagnose.parameters.recorded_runs import read_runs

CRANE = """
<mujoco>
  <option timestep="0.002" integrator="RK4"/>
  <worldbody>
    <body>
      <joint name="slide" type="slide" axis="1 0 0" damping="{damping}" stiffness="{stiffness}"/>
      <geom type="box" size="0.1 0.05 0.05" mass="2" contype="0" conaffinity="0"/>
      <body>
        <joint name="swivel" axis="0 1 0" damping="{swivel}"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.01" mass="0.3" contype="0" conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="slide"/></actuator>
  <sensor><jointpos name="x" joint="slide"/><jointpos name="angle" joint="swivel"/></sensor>
</mujoco>
"""
SIGMA = np.array([1.5e-4, 1e-3])
"""Noise of both sensors [m], [rad]."""


def estimated(folder, *, damping, stiffness, swivel):
    """Return the noise of a recording of two periods from rest, estimated on a case with a model 5 % too stiff."""
    own = CRANE.format(damping=damping, stiffness=stiffness, swivel=swivel)
    model, rng = mujoco.MjModel.from_xml_string(own), np.random.default_rng(7)
    time = np.arange(800) / 100
    lines = np.arange(1, 13) / 4.0
    force = 4.0 * np.sum(np.sin(2 * np.pi * lines[:, None] * time + rng.uniform(0, 6, (12, 1))), axis=0)
    data, read = mujoco.MjData(model), []
    for value in force:
        read.append(data.qpos.copy())
        data.ctrl[0] = value
        mujoco.mj_step(model, data, nstep=5)
    x, angle = (np.array(read) + SIGMA * rng.standard_normal((800, 2))).T
    channels = [
        Channel(column="u", at="motor", kind="force", unit="N", is_input=True, hold="zero"),
        Channel(column="x", at="x", kind="displacement", unit="m"),
        Channel(column="angle", at="angle", kind="angle", unit="rad"),
    ]
    record = Record(name="run", role="fit", columns={"u": force, "x": x, "angle": angle}, rate_hz=100.0)
    nominal = CRANE.format(damping=damping, stiffness=1.05 * stiffness, swivel=1.2 * swivel)
    write_case(folder, title="crane", mjcf=nominal, uncertain={}, channels=channels, records=[record])
    (run,) = read_runs(load_case(folder), ("fit",)).runs
    return [estimate_noise(run, name) for name in ("x", "angle")]


def test_periods_of_a_motion_that_does_not_settle_tell_no_noise(tmp_path):
    """The load swings on for a minute, and nothing holds the carriage."""
    found = estimated(tmp_path, damping=14.0, stiffness=0.0, swivel=2e-3)
    assert "periods" not in {noise.source for noise in found}
    assert [noise.sigma for noise in found] == pytest.approx(SIGMA, rel=0.25)


def test_periods_of_a_settled_motion_tell_the_noise(tmp_path):
    found = estimated(tmp_path, damping=60.0, stiffness=900.0, swivel=0.1)
    assert {noise.source for noise in found} == {"periods"}
    assert [noise.sigma for noise in found] == pytest.approx(SIGMA, rel=0.25)


def test_a_settled_run_stays_the_run_whose_noise_is_known(tmp_path):
    estimated(tmp_path, damping=60.0, stiffness=900.0, swivel=0.1)
    case = load_case(tmp_path)
    repeated = case.runs(("fit",))
    assert all(one is other for one, other in zip(with_unsettled(repeated, case.plant), repeated, strict=True))
