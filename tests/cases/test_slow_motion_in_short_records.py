"""Coherence of short records: lines below the motion tell nothing of it."""

import numpy as np
from test_file_checks import found

from vlab.cases.case import load_case

HUB = """<mujoco model="hub"><compiler angle="radian"/><option timestep="0.001" gravity="0 0 0"/><worldbody><body>
<inertial pos="0 0 0" mass="0.3" diaginertia="0.001 0.001 0.001"/><joint name="hub" axis="0 0 1" damping="0.037"/></body></worldbody>
<actuator><motor name="motor" joint="hub" gear="0.00266"/></actuator></mujoco>"""
PERIOD, EVERY = 0.004, 8
COUNT = 0.00628


def closed_loop(samples, target):
    """Return command and encoder of a hub with an arm of 2.5 Hz; the dither moves less than a count."""
    stiffness, step = 1.73e-3 * (2 * np.pi * 2.53) ** 2, PERIOD / EVERY
    q, v = np.zeros(2), np.zeros(2)  # hub, and arm beside it
    rows, dither = np.zeros((samples, 2)), np.random.default_rng(3).normal(size=samples)
    for k in range(samples):
        angle = COUNT * np.rint(q[0] / COUNT)
        command = np.rint(200.0 * (target[k] - angle) + 20.0 * dither[k])
        rows[k] = command, angle
        for _ in range(EVERY):
            spring = stiffness * q[1] + 3e-4 * v[1]
            first = (0.00266 * command - 0.037 * v[0] + spring) / 1e-3
            v = v + step * np.array([first, -spring / 1.73e-3 - first])
            q = q + step * v
    return rows


def test_a_step_of_a_second_is_no_unrelated_input(tmp_path):
    (tmp_path / "hub.xml").write_text(HUB)
    rows = closed_loop(255, np.where(np.arange(255) > 25, 0.6, 0.0))
    table = np.column_stack([PERIOD * np.arange(255), rows])
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header="t,motor,hub", comments="")
    (tmp_path / "case.toml").write_text(
        '[model]\nmjcf = "hub.xml"\n[[recording]]\nfile = "log.csv"\nrole = "fit"\ntime = "t"\n'
        '[[recording.channel]]\ncolumn = "motor"\nat = "motor"\nkind = "command"\ninput = true\n'
        '[[recording.channel]]\ncolumn = "hub"\nat = "joint:hub"\nkind = "angle"\nunit = "rad"\n'
    )
    assert not [text for _, text in found(load_case(tmp_path)) if "no recorded output" in text]
