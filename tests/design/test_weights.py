"""The published weights in SI: the same design, whatever the units it is computed in."""

from dataclasses import replace

import numpy as np
import pytest
from vlab.controllers.catalogue import IN_UNITS, Asked, requested_of

from vlab.design.riccati import kalman_filter, lqr
from vlab.design.state_model import state_model
from vlab.design.weights import Noise, Weights, energy_weights, identity_weights, noise_of, published_noise, weights_of
from vlab.errors import BadDesign
from vlab.fe.reduced import build_reduced_model
from vlab.structure import load_structure

INCH, LBF, CS = 0.0254, 4.4482216152605, 0.01


@pytest.fixture(scope="module")
def model(beam):
    return state_model(build_reduced_model(beam, "full"))  # displacements and rotations


def in_inches(model):
    """A, B, C for x in inches, radians and centiseconds, forces in pounds: the second way, by scaling the model."""
    length = np.where(model.is_translation, 1 / INCH, 1.0)
    size = np.concatenate([length * CS, length])
    A = size[:, None] * model.A / size * CS
    return A, size[:, None] * model.B * LBF * CS, model.C / size / INCH * CS, size


def test_gain_and_index_are_those_of_a_design_in_inches_and_centiseconds(model):
    A, B, _, size = in_inches(model)
    theirs = lqr(A, B, np.eye(len(A)), 0.22 * np.eye(3))
    weights = identity_weights(model, 1.0, 0.22)
    ours = lqr(model.A, model.B, weights.Q, weights.R)
    scale = np.abs(theirs.F).max()
    assert ours.F / size / LBF == pytest.approx(theirs.F, abs=1e-7 * scale)  # two solutions of a stiff equation
    assert ours.S / size / size[:, None] == pytest.approx(theirs.S, abs=1e-7 * np.abs(theirs.S).max())


def test_the_filter_is_that_of_a_design_in_inches_and_centiseconds(model):
    A, _, C, size = in_inches(model)
    theirs = kalman_filter(A, C, 1e-6 * np.eye(len(A)), 5e-4 * np.eye(3), 0.2)
    noise = published_noise(model, 1e-6, 5e-4, 0.2)
    ours = kalman_filter(model.A, model.C, noise.V1, noise.V2, noise.alpha)
    assert noise.alpha == pytest.approx(20.0)  # 0.2 per centisecond
    K = size[:, None] * ours.K * INCH  # rate of the states per velocity: the two units of time cancel
    assert pytest.approx(theirs.K, abs=1e-6 * np.abs(theirs.K).max()) == K


def test_factors_in_si_weigh_the_states_of_the_model_themselves(model):
    asked = Asked(q=3.0, r=0.02, v1=1e-5, v2=1e-4, alpha=2.0, modes=2, shapes=2, si=frozenset(IN_UNITS))
    weights, noise, n = weights_of(asked, model), noise_of(asked, model), len(model.A)
    np.testing.assert_allclose(weights.Q, 3.0 * np.eye(n))
    np.testing.assert_allclose(weights.R, 0.02 * np.eye(3))
    np.testing.assert_allclose(noise.V1, 1e-5 * np.eye(n))
    np.testing.assert_allclose(noise.V2, 1e-4 * np.eye(3))
    assert noise.alpha == 2.0


def test_each_factor_has_units_of_its_own(model):
    """R converts by a plain factor, so the same R in SI and in pounds and centiseconds is the same design."""
    printed = requested_of(load_structure("beam"), "full")
    in_si = replace(printed, r=printed.r / LBF**2 / CS, alpha=printed.alpha / CS, si=frozenset({"r", "alpha"}))
    a, b = weights_of(printed, model), weights_of(in_si, model)
    np.testing.assert_allclose(a.Q, b.Q, rtol=1e-12)
    np.testing.assert_allclose(a.R, b.R, rtol=1e-12)
    assert noise_of(in_si, model).alpha == pytest.approx(noise_of(printed, model).alpha)


def test_energy_weights_are_twice_the_energy(model):
    x = np.random.default_rng(1).standard_normal(2 * model.n)
    n = model.n
    energy = x[:n] @ model.M @ x[:n] + x[n:] @ model.K @ x[n:]
    Q = energy_weights(model, 1.0).Q
    assert x @ Q @ x * CS == pytest.approx(energy / (LBF * INCH), rel=1e-12)  # integrated over centiseconds


def test_weights_are_read_only(model):
    with pytest.raises(ValueError, match="read-only"):
        identity_weights(model, 1.0, 1.0).Q[0, 0] = 2.0


@pytest.mark.parametrize("factor", [0.0, -1.0, float("nan"), float("inf")])
def test_a_factor_that_is_not_positive_is_refused(model, factor):
    with pytest.raises(BadDesign, match="the factor r"):
        identity_weights(model, 1.0, factor)
    with pytest.raises(BadDesign, match="the factor q"):
        identity_weights(model, factor, 1.0)


def test_indefinite_weights_are_refused_whatever_their_scale():
    small = np.diag([1e6, 1e-3])
    small[0, 1] = small[1, 0] = 40.0  # its determinant is negative: 1e3 - 1.6e3
    with pytest.raises(BadDesign, match="Q is indefinite"):
        Weights(Q=small, R=np.eye(1))
    with pytest.raises(BadDesign, match="R is not positive definite"):
        Weights(Q=np.eye(2), R=np.zeros((1, 1)))
    with pytest.raises(BadDesign, match="alpha"):
        Noise(V1=np.eye(2), V2=np.eye(1), alpha=-0.1)
