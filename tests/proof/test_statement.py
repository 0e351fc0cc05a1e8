"""Variations of concealed cases beside hidden effects: statement, noise, unrecorded forces, coarse steps."""

import mujoco
import numpy as np
import pytest
from scipy.special import erf

from vlab.proof.generator import statement
from vlab.proof.generator.bench import Benign
from vlab.proof.generator.hardware import Output, Pickup, red_noise
from vlab.proof.generator.integration import semi_implicit
from vlab.proof.generator.plan import plan
from vlab.proof.generator.rigs import SHAFT, SLIDER, STATED, _xml, shaft, slider
from vlab.proof.generator.simulate import Setup
from vlab.proof.suites import OWN_FE, SHARED_FE, make_case

MANY = 4000


@pytest.mark.parametrize(("build", "chain"), [(slider, SLIDER), (shaft, SHAFT)])
@pytest.mark.parametrize("step", [0.001, 0.002])
def test_the_coarse_step_is_that_of_the_simulator(build, chain, step):
    blueprint = build()
    commands = plan(blueprint, np.random.default_rng(2)).commands[:800]
    y = semi_implicit(blueprint.build({}, {}), commands, 0.002, step)
    model = mujoco.MjModel.from_xml_string(_xml(chain, step, "implicitfast"))
    data = mujoco.MjData(model)
    seen = np.zeros(y.shape[:2])
    for k, command in enumerate(commands[:, :, 0]):
        data.ctrl[:] = command
        mujoco.mj_forward(model, data)
        seen[k] = data.sensordata
        for _ in range(round(0.002 / step)):
            mujoco.mj_step(model, data)
    assert y[:, :, 0] == pytest.approx(seen, abs=1e-9 * np.abs(seen).max())


def test_a_fine_step_converges_to_the_exact_response():

    blueprint = slider()
    bench, commands = blueprint.build({}, {}), plan(blueprint, np.random.default_rng(2)).commands[:500]
    exact = Setup(bench=bench, output=Output(), rate_hz=500.0, substeps=20).run(commands, ())
    errors = [np.abs(semi_implicit(bench, commands, 0.002, h) - exact).max() for h in (5e-4, 2.5e-4)]
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.1)  # first order


def test_coloured_noise_is_stationary_and_of_first_order():
    red = red_noise(np.random.default_rng(1), (200, MANY), 500.0, 0.02)
    assert np.std(red[[0, 10, 199]], axis=1) == pytest.approx(np.ones(3), rel=0.05)
    lag = np.mean(red[100:] * red[:100])
    assert np.mean(red[1:] * red[:-1]) == pytest.approx(np.exp(-0.1), abs=0.02)
    assert lag == pytest.approx(0.0, abs=0.02)


def test_noise_keeps_its_size_with_a_coloured_part():
    pickup = Pickup(sigma=np.array([2.0]), hum=0.0, hum_hz=50.0, step=1.0, coloured=1.3, time_constant=0.005)
    assert np.std(pickup.noise(np.random.default_rng(1), 20_000, 3, 500.0)) == pytest.approx(2.0, rel=0.03)


def test_deviations_follow_the_statement_and_a_third_is_twice_as_far_off_where_it_is_wrong():
    benign = [Benign(name=f"mass:{i}", kind="mass", sd=0.01, stated=0.02) for i in range(MANY)]
    benign.append(Benign(name="local", kind="local", sd=0.01, stated=0.0))
    right = statement.deviations(benign, np.random.default_rng(1), is_wrong=False)
    values = np.array(list(right.values())[:-1]) / 0.01
    assert np.mean(np.abs(values) < 1.0) == pytest.approx(erf(1 / np.sqrt(2.0)), abs=0.03)
    wrong = statement.deviations(benign, np.random.default_rng(1), is_wrong=True)
    far = np.abs(list(wrong.values())[:-1]) / 0.02
    assert np.mean((far >= 1.5) & (far <= 2.5)) == pytest.approx(1 / 3, abs=0.03)
    assert abs(wrong["local"]) <= 0.025  # what the model has no parameter for stays as drawn


def test_a_varied_rig_states_round_numbers_and_keeps_its_recorded_commands():
    case = make_case("null", ("slider",), 3, 0)
    assert all(case.truth["stated"][kind] in values for kind, values in STATED.items())
    assert dict(case.blueprint.uncertain) == case.truth["stated"]
    again = make_case("null", ("slider",), 3, 0)
    assert np.array_equal(case.outputs, again.outputs)
    plain = make_case("null", ("slider",), 3, 0, structures=SHARED_FE)
    assert np.array_equal(case.plan.commands, plain.plan.commands)  # stray forces are not recorded
    assert "stated" not in plain.truth


@pytest.mark.slow
def test_some_varied_cases_have_each_variation():
    truths = [make_case("null", ("slider", "shaft"), 11, i, structures=OWN_FE).truth for i in range(24)]
    assert {t["twice_the_statement"] for t in truths} == {True, False}
    assert any(t["stray_force"] for t in truths)
    assert any(t["coarse_step"] for t in truths)
    assert any(t["coloured"]["over_white"] for t in truths)
    for t in truths:
        assert ("model_error" in t) == bool(t["stray_force"] or t["coarse_step"])
