"""The regulator: optimal, and the same in every form."""

import numpy as np
import pytest

from vlab.controllers import Controller, lqr
from vlab.design import performance
from vlab.design.state_model import state_model
from vlab.design.weights import Weights, identity_weights
from vlab.errors import BadDesign
from vlab.fe.reduced import build_reduced_model


@pytest.fixture(scope="module")
def design(fe):
    return lqr.design(fe, identity_weights(state_model(fe), 1.0, 0.22))


def test_published_weights_give_three_per_cent_damping(design):
    # section 6.1: Q = I, R = 0.22 I were chosen for at least 3 % in the first six modes
    assert design.poles.zeta[:6].min() == pytest.approx(0.0303, abs=5e-5)


def test_perturbed_gains_do_worse(design):
    # J(F + e dF) - J(F) = e^2 times a positive number: no first-order gain in any direction
    rng = np.random.default_rng(11)
    x0 = performance.initial_states(design.model, 6)
    best = design.indices(6)
    for _ in range(10):
        change = rng.standard_normal(design.F.shape) * np.abs(design.F).mean(axis=0)
        rise = [
            performance.regulator_index(design.model, design.F + e * change, design.weights, x0).sum() - best.sum()
            for e in (0.01, 0.02, -0.02)
        ]
        assert min(rise) > 0
        assert rise[1] == pytest.approx(4 * rise[0], rel=0.1)  # quadratic; the cubic term is of the order of e
        assert rise[2] == pytest.approx(4 * rise[0], rel=0.1)


def test_it_is_better_than_the_published_rate_feedback_in_every_mode(design):
    from vlab.reproduce.study import Study

    study = Study("beam")
    for law in ("mfdrf", "lqdrf"):
        gains = study.printed_gains("7", law)
        assert np.all(study.rate_feedback_index("full", gains, 6) >= design.indices(6))


def test_the_controller_is_minus_f_x(design):
    assert isinstance(design.controller, Controller)
    x = np.random.default_rng(1).standard_normal(2 * design.model.n)
    assert design.controller.step(x) == pytest.approx(-design.F @ x, rel=1e-12)
    assert design.controller.sensors[0] == "v:base'"
    assert design.controller.actuators == ("40in", "20in", "base")


def test_python_control_sees_the_same_poles(design):
    theirs = np.sort_complex(design.to_control().poles())
    assert theirs == pytest.approx(np.sort_complex(np.linalg.eigvals(design.A_closed)), rel=1e-9)
    opened = design.model.to_control()
    assert opened.ninputs == opened.noutputs == 3


def test_weights_of_another_model_are_refused(beam, design):
    small = build_reduced_model(beam, "exact")
    with pytest.raises(BadDesign, match="do not fit the model's 20 states"):
        lqr.design(small, design.weights)


def test_a_mode_out_of_reach_is_left_to_its_own_damping(beam):
    # the physical variant has arms that swing against each other: no coil moves them, but they are damped
    physical = build_reduced_model(beam, "full", "physical")
    found = lqr.design(physical, identity_weights(state_model(physical), 1.0, 0.22))
    assert np.linalg.eigvals(found.A_closed).real.max() < 0


def test_r_alone_scales_the_index(design):
    # J is homogeneous in (Q, R): twice both weights, the same gain
    double = lqr.design(design.model, Weights(Q=2 * design.weights.Q, R=2 * design.weights.R))
    assert pytest.approx(design.F, rel=1e-6, abs=1e-6 * np.abs(design.F).max()) == double.F
    assert double.indices(6) == pytest.approx(2 * design.indices(6), rel=1e-9)
