"""Calibration along a motion, beside an independent integration of a double pendulum."""

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from vlab.cases.case import load_case
from vlab.diagnose.inference.calibration import calibrate
from vlab.diagnose.inference.prior_check import has_plausible_parameters
from vlab.diagnose.inference.simulator_least_squares import SimulatorLeastSquares
from vlab.diagnose.search.model_class import TrajectoryLinearised, choose_model_class

GRAVITY = 9.81
MODEL = """<mujoco><option timestep="0.001" integrator="RK4" gravity="0 0 -9.81"/><worldbody>
<body name="first"><joint name="pivot" type="hinge" axis="0 1 0" damping="3e-4"/>
<inertial pos="0 0 -0.10" mass="0.2" diaginertia="7e-4 7e-4 1e-6"/>
<body name="second" pos="0 0 -0.20"><joint name="elbow" type="hinge" axis="0 1 0" damping="1e-4"/>
<inertial pos="0 0 -0.15" mass="0.1" diaginertia="8e-4 8e-4 1e-6"/></body></body></worldbody>
<tendon><fixed name="lower"><joint joint="pivot" coef="1"/><joint joint="elbow" coef="1"/></fixed></tendon>
<sensor><jointpos name="upper" joint="pivot"/><tendonpos name="lower" tendon="lower"/></sensor></mujoco>"""


def swing(a: float, b: float, length: float, inertia: float, spring: float) -> np.ndarray:
    """Return time and absolute angles (2 000, 3) of a double pendulum from rest, by Lagrange's equations."""
    m1, m2, c1, c2 = 0.2, 0.1, 0.10, 0.15  # the second body hangs at `length`; both inertias differ by a factor
    i1, i2 = 7e-4 * inertia + m1 * c1**2 + m2 * length**2, 8e-4 + m2 * c2**2
    coupling, g1, g2 = m2 * length * c2, (m1 * c1 + m2 * length) * GRAVITY, m2 * c2 * GRAVITY

    def rate(_: float, x: np.ndarray) -> np.ndarray:
        d, relative = x[0] - x[1], x[3] - x[2]
        mass = [[i1, coupling * np.cos(d)], [coupling * np.cos(d), i2]]
        first = -coupling * np.sin(d) * x[3] ** 2 - g1 * np.sin(x[0]) - 3e-4 * x[2] + 1e-4 * relative - spring * x[0]
        second = coupling * np.sin(d) * x[2] ** 2 - g2 * np.sin(x[1]) - 1e-4 * relative
        return np.concatenate([x[2:], np.linalg.solve(mass, [first, second])])

    t = np.arange(2000) * 1e-3
    motion = solve_ivp(rate, (0.0, 2.0), [a, b, 0.0, 0.0], t_eval=t, rtol=1e-10, atol=1e-12).y[:2]
    return np.column_stack([t, motion.T])


def swings(tmp_path: Path, *, length: float = 0.20, inertia: float = 1.0, spring: float = 0.0) -> TrajectoryLinearised:
    """Return the model class of two swings of a double pendulum that differs from its drawing."""
    rng = np.random.default_rng(7)
    (tmp_path / "rig.xml").write_text(MODEL)
    lines = ['title = "swings"', "[model]", 'mjcf = "rig.xml"', "[model.uncertain]"]
    lines += ["length = 0.2", "inertia = 0.3", "mass = 0.02", "damping = 0.1", "sensor = 0.0005"]
    for k, start in enumerate([(0.6, 0.9), (-0.3, 0.7)]):
        table = swing(*start, length=length, inertia=inertia, spring=spring)
        table[:, 1:] += 1e-4 * rng.standard_normal((len(table), 2))
        head = "time,upper,lower"
        np.savetxt(tmp_path / f"{k}.csv", table, delimiter=",", header=head, comments="", fmt="%.9g")
        lines += [
            "[[recording]]",
            f'name = "{k}"',
            f'file = "{k}.csv"',
            'role = "fit"',
            'initial = "estimated"',
            'time = "time"',
        ]
        for name in ("upper", "lower"):
            lines += ["[[recording.channel]]", f'column = "{name}"', f'at = "{name}"', 'kind = "angle"', 'unit = "rad"']
    (tmp_path / "case.toml").write_text("\n".join(lines))
    found = choose_model_class(load_case(tmp_path))
    assert isinstance(found, TrajectoryLinearised)
    return found


def test_calibration_follows_an_arm_far_from_its_drawing(tmp_path):
    found = swings(tmp_path, length=0.176, inertia=1.3)  # 12 % shorter, with 30 % more inertia
    screen = found.screen
    once = SimulatorLeastSquares(screen)
    residual_of_one_linearisation = once.residual_in_mujoco(once.fit())
    renewed, fit = calibrate(screen)
    assert fit is not None
    residual = SimulatorLeastSquares(renewed).residual_in_mujoco(fit)
    assert residual < 1.5  # noise and the allowed model error of 0.2 %
    assert residual_of_one_linearisation > 2.0 * residual
    length = sum(v for p, v in zip(found.problem.parameters, fit.theta, strict=True) if p.name in OF_THE_ARM)
    assert np.exp(length) == pytest.approx(0.88, abs=0.03)


OF_THE_ARM = ("length", "body:first:length")
"""Common and own factor of the first arm's length."""


def test_calibration_does_not_follow_missing_physics(tmp_path):
    screen = swings(tmp_path, spring=0.35).screen  # a third of the stiffness of gravity
    renewed, fit = calibrate(screen)
    assert fit is None or not has_plausible_parameters(fit)
    assert fit is not None or renewed is screen
