"""LQG: separation, margin, and the discrete law against the continuous one."""

import numpy as np
import pytest
from scipy import linalg

from vlab.controllers import Controller, lqg
from vlab.design.performance import match_poles
from vlab.design.state_model import state_model
from vlab.design.weights import identity_weights, published_noise
from vlab.errors import BadController, BadDesign
from vlab.fe.reduced import build_reduced_model
from vlab.structure import load_structure

ALPHA = 20.0
"""0.2 per centisecond [1/s]."""


@pytest.fixture(scope="module")
def model(beam):
    return state_model(build_reduced_model(beam, "exact"))


def designed(model, rate=1000.0):
    noise = published_noise(model, 1e-6, 5e-4, 0.2)
    return lqg.design(model, identity_weights(model, 1.0, 0.22), noise, rate=rate)


@pytest.fixture(scope="module")
def law(model):
    return designed(model)


def test_regulator_and_filter_separate(law):
    # the poles of (4.24) on the design model are those of A - B F and of A - K C
    whole = np.linalg.eigvals(law.A_on(law.model))
    apart = np.concatenate(
        [np.linalg.eigvals(law.regulator.A_closed), np.linalg.eigvals(law.model.A - law.K @ law.model.C)]
    )
    assert np.abs(match_poles(apart, whole) / apart - 1).max() < 1e-8


def test_both_forms_of_the_loop_have_the_same_poles(law):
    # [x, e] of (4.16) and [x, x_est] of (4.24)
    one, other = np.linalg.eigvals(law.A_closed), np.linalg.eigvals(law.A_on(law.model))
    assert np.abs(match_poles(one, other) / one - 1).max() < 1e-8


def test_filter_poles_lie_left_of_the_margin(law):
    assert law.filter_poles.s.real.max() < -ALPHA


def test_table_8_lqg_within_one_per_cent(law, beam):
    on_full, _ = law.poles_on(state_model(build_reduced_model(beam, "full")))
    assert on_full.zeta[:6] == pytest.approx([0.6216, 0.2270, 0.1437, 0.0666, 0.0563, 0.0298], rel=0.01)


@pytest.mark.parametrize("rate", [1000.0, 2000.0])
def test_the_discrete_law_is_5_2_to_5_5(model, rate):
    law = designed(model, rate)
    A, dt = law.A_estimator, 1 / rate
    F22 = linalg.expm(A * dt)
    F21 = (F22 - np.eye(len(A))) @ np.linalg.solve(A, law.K)
    scale = np.abs(F21).max()
    assert pytest.approx(F22, abs=1e-10 * np.abs(F22).max()) == law.controller.A
    assert pytest.approx(F21, abs=1e-8 * scale) == law.controller.B  # the printed form loses digits in F22 - I
    assert pytest.approx(-law.F) == law.controller.C
    assert not law.controller.D.any()
    assert law.controller.rate == rate


def test_z_plane_roots_are_those_of_the_s_plane(law):
    # section 5.3: z = exp(s dt) checks the discretisation
    z = np.linalg.eigvals(law.controller.A)
    s = np.linalg.eigvals(law.A_estimator)
    assert np.abs(match_poles(s, np.log(z) * 1000.0) / s - 1).max() < 1e-8


def test_the_controller_steps_as_the_matrices_say(law):
    y = np.random.default_rng(4).standard_normal((50, 3))
    law.controller.reset()
    given = np.array([law.controller.step(sample) for sample in y])
    x, expected = np.zeros(20), []
    for sample in y:
        expected.append(law.controller.C @ x)
        x = law.controller.A @ x + law.controller.B @ sample
    assert given == pytest.approx(np.array(expected), rel=1e-9, abs=1e-12 * np.abs(given).max())
    assert isinstance(law.controller, Controller)
    assert not given[0].any()  # no feedthrough: F11 = 0


def test_the_sampled_loop_tends_to_the_continuous_one(model):
    # held samples delay by half a period: the pole error halves with the period
    law = designed(model)
    s = np.linalg.eigvals(law.A_on(model))
    error = []
    for rate in (16000.0, 32000.0, 64000.0):
        controller = lqg.discrete_law(model, law.F, law.K, rate=rate)
        n = 2 * model.n
        block = linalg.expm(np.block([[model.A, model.B], [np.zeros((3, n + 3))]]) / rate)
        Ad, Bd = block[:n, :n], block[:n, n:]
        loop = np.block([[Ad, Bd @ controller.C], [controller.B @ model.C, controller.A]])
        found = np.log(np.linalg.eigvals(loop)) * rate
        error.append(np.abs(match_poles(s, found) / s - 1).max())
    assert error[0] / error[1] == pytest.approx(2, rel=0.1)  # the next term
    assert error[1] / error[2] == pytest.approx(2, rel=0.05)


def test_python_control_sees_the_same_law(law):
    theirs = law.to_control()
    omega = 2 * np.pi * 4.8
    H = -law.F @ np.linalg.solve(1j * omega * np.eye(20) - law.A_estimator, law.K)
    assert theirs(1j * omega) == pytest.approx(H, rel=1e-8)


def test_a_mode_that_no_sensor_sees_is_named(beam):
    # the physical variant's arms swing against each other; no velocity sensor sees them, and they decay slower than alpha
    physical = state_model(build_reduced_model(beam, "full", "physical"))
    with pytest.raises(BadDesign, match=r"not detectable: no sensor sees the mode at [\d.]+ Hz"):
        designed(physical)


def test_what_does_not_fit_is_refused(model, law):
    other = state_model(build_reduced_model(load_structure("grid"), "exact"))
    noise = published_noise(other, 1e-10, 0.5, 0.05)
    with pytest.raises(BadDesign, match="does not fit the model's 20 states and 3 sensors"):
        lqg.design(model, law.weights, noise)
    for rate in (0.0, -1.0, float("nan")):
        with pytest.raises((BadDesign, BadController), match="rate"):
            designed(model, rate)
