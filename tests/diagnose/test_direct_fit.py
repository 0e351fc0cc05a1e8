"""Fits with MuJoCo as predictor, where the motion along the recording says little about the model."""

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from vlab.cases.case import load_case
from vlab.cases.simulate import simulate
from vlab.diagnose.inference.direct_least_squares import DirectLeastSquares, is_affordable, state_at
from vlab.diagnose.inference.simulator_least_squares import SimulatorLeastSquares
from vlab.diagnose.inference.trajectory_least_squares import TrajectoryLeastSquares
from vlab.diagnose.parameters.terms import Term, with_effects
from vlab.diagnose.search.model_class import TrajectoryLinearised, choose_model_class
from vlab.errors import Diverged
from vlab.physics.catalogue import CANDIDATES

INERTIA, DAMPING, GAIN, RATE, WEIGHT = 0.02, 0.05, 8.0, 0.4, 0.3 * 9.81 * 0.05  # the last is a moment, hanging
MODEL = f"""<mujoco><option timestep="0.002" integrator="implicitfast" gravity="0 0 -9.81"/><worldbody>
<body><joint name="hinge" type="hinge" axis="0 1 0" damping="{DAMPING}"/>
<inertial pos="0 0 -0.05" mass="0.3" diaginertia="0.02 0.01925 0.001"/></body></worldbody>
<actuator><position name="servo" joint="hinge" kp="{GAIN}" kv="{RATE}" forcerange="-5 5"/></actuator>
<sensor><jointpos name="angle" joint="hinge"/></sensor></mujoco>"""


def turned(most: float) -> np.ndarray:
    """Return time, command and angle (400, 3) of a servo whose torque ends at `most`, by a Runge-Kutta pair."""
    t = np.arange(400) * 0.01
    command = np.sign(np.sin(2 * np.pi * 0.45 * t + 0.1)) + 0.3 * np.sign(np.sin(2 * np.pi * 1.1 * t))

    def rate(time: float, x: np.ndarray) -> np.ndarray:
        u = command[min(int(time / 0.01 + 1e-9), 399)]
        torque = np.clip(GAIN * (u - x[0]) - RATE * x[1], -most, most)
        return np.array([x[1], (torque - DAMPING * x[1] - WEIGHT * np.sin(x[0])) / INERTIA])

    angles, x = [0.0], np.zeros(2)
    for k in range(399):
        x = solve_ivp(rate, (t[k], t[k + 1] - 1e-12), x, rtol=1e-9, atol=1e-12, max_step=0.002).y[:, -1]
        angles.append(x[0])
    return np.column_stack([t, command, angles])


def servo(tmp_path: Path, most: float, noise: float = 1e-3) -> TrajectoryLinearised:
    """Return the model class of a recording of a servo with a weak supply."""
    table = turned(most)
    table[:, 2] += noise * np.random.default_rng(3).standard_normal(len(table))
    (tmp_path / "rig.xml").write_text(MODEL)
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header="time,command,angle", comments="")
    (tmp_path / "case.toml").write_text(
        """title = "servo"
[model]
mjcf = "rig.xml"
[model.uncertain]
damping = 0.2
inertia = 0.05
[[recording]]
file = "log.csv"
role = "fit"
time = "time"
channel = [
  { column = "command", at = "servo", kind = "command", unit = "rad", input = true, hold = "zero" },
  { column = "angle", at = "angle", kind = "angle", unit = "rad" },
]
"""
    )
    found = choose_model_class(load_case(tmp_path))
    assert isinstance(found, TrajectoryLinearised)
    return found


def force_limit(found: TrajectoryLinearised, most: float) -> Term:
    """Return a limit of the servo's force as a term."""
    (effect,) = (e for e in CANDIDATES if e.name == "servo-force-limit")
    (place,) = (p for p in found.problem.places if p.name == "actuator:servo")
    return Term(effect=effect, place=place, values={"limit": most})


@pytest.fixture(scope="module")
def weak(tmp_path_factory) -> TrajectoryLinearised:
    """Return a servo whose supply allows a tenth of its data sheet's torque."""
    return servo(tmp_path_factory.mktemp("weak"), 0.5)


def residual(of: SimulatorLeastSquares | DirectLeastSquares, cost: float) -> float:
    return float(np.sqrt(cost / sum(run.y.size for run in of.runs)))


def test_a_limit_far_below_the_data_sheet_is_found_in_mujoco(weak):
    screen = weak.screen
    linear = TrajectoryLeastSquares(screen, whole=True).fit([force_limit(weak, 2.5)])
    exact = SimulatorLeastSquares(screen, is_final=True)
    found = exact.fit([force_limit(weak, 2.5)])
    found = exact.fit(found.terms, found)
    assert abs(np.log(linear.terms[0].values["limit"] / 0.5)) > 1.0  # the motion along the recording does not tell it
    assert found.terms[0].values["limit"] == pytest.approx(0.5, rel=0.05)
    assert residual(exact, found.cost) < 3.0
    assert residual(exact, exact.fit().cost) > 100.0  # nothing but the limit explains the recording


def test_the_predictor_is_mujoco_itself(weak):
    direct = DirectLeastSquares(weak.screen)
    fit = direct.fit([force_limit(weak, 0.5)], None, 0)
    y = direct.move_starts(fit.terms, fit.theta, [dict(t.values) for t in fit.terms], fit.offsets)
    plant = with_effects(weak.problem.adjusted(fit.theta), fit.terms, weak.problem.names)
    run = weak.problem.runs[0]
    start = state_at(direct, 0, direct.runs[0].start)
    stepped = simulate(plant, run, initial=start).recording["angle"]
    assert np.allclose(
        y[: len(stepped), 0, 0], direct.reduced_model.gains(fit.theta[None])[1][0, 0] * stepped, atol=1e-9
    )


def test_a_corrected_linear_system_has_the_residual_of_mujoco(tmp_path):
    screen = servo(tmp_path, 5.0, noise=0.02).screen  # as the data sheet says
    exact = SimulatorLeastSquares(screen)
    fit = exact.fit()
    own = exact.about(fit)
    vector = own.vector(fit.terms)
    rows = own.residual(vector, own.initial(vector, [], fit.theta, fit)[None])[0]
    assert np.sqrt(np.mean(rows[vector.priors :] ** 2)) <= 1.05 * exact.residual_in_mujoco(fit)


def test_large_models_keep_the_linear_system(weak, monkeypatch):
    exact = SimulatorLeastSquares(weak.screen)
    assert is_affordable(exact, [force_limit(weak, 0.5)])
    monkeypatch.setattr(weak.screen.problem.plant.model.opt, "timestep", 1e-5)
    assert not is_affordable(exact, [force_limit(weak, 0.5)])


def test_earlier_fits_have_no_influence(weak):
    fresh, used = (TrajectoryLeastSquares(weak.screen, whole=True) for _ in range(2))
    used.fit([force_limit(weak, 0.2)])
    (one, other) = (of.fit([force_limit(weak, 2.5)]) for of in (fresh, used))
    assert one.cost == other.cost
    assert one.terms[0].values == other.terms[0].values


def test_a_run_that_diverges_is_worse_than_every_other(weak, monkeypatch):
    exact = SimulatorLeastSquares(weak.screen)
    followed = exact.fit()

    def diverges(*_: object) -> np.ndarray:
        raise Diverged("by order")

    monkeypatch.setattr("vlab.diagnose.inference.simulator_least_squares.run_in_mujoco", diverges)
    lost = exact.fit()
    assert lost.cost > 1e3 * followed.cost
    assert lost.prior_cost == pytest.approx(followed.prior_cost, rel=0.5)
