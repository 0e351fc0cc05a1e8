"""Closed-loop poles, their modes and their gradients against closed forms, a second method and differences."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from toys import oscillators, toy

from vlab.design import performance
from vlab.design.closed_loop import RateFeedbackLoop
from vlab.design.index_gradients import IndexGradients
from vlab.design.state_model import state_model
from vlab.design.weights import identity_weights
from vlab.errors import BadDesign
from vlab.fe.reduced import build_reduced_model
from vlab.structure import load_structure


@pytest.fixture(scope="module")
def beam_loop(fe) -> RateFeedbackLoop:
    return RateFeedbackLoop(fe.linear, fe.coils)


@pytest.fixture(scope="module")
def grid_fe():
    return build_reduced_model(load_structure("grid"), "exact")


def random_gains(coils: int, count: int, scale: float, seed: int = 0) -> np.ndarray:
    X = np.random.default_rng(seed).standard_normal((count, coils, coils))
    return scale * X @ X.transpose(0, 2, 1)


def test_single_mass_has_the_textbook_poles():
    fe = toy([[2.0]], [[0.3]], [[50.0]], [[1.0]])
    modes = RateFeedbackLoop(fe.linear, fe.coils).track(np.array([[1.7]]), 1)
    damped = (0.3 + 1.7) / (2 * 2.0)
    expected = -damped + 1j * np.sqrt(25.0 - damped**2)
    assert modes.poles[0, 0] == pytest.approx(expected, rel=1e-12)
    assert modes.zeta[0, 0] == pytest.approx(damped / 5.0, rel=1e-12)


def test_poles_are_those_of_the_second_order_model(fe, beam_loop):
    D = random_gains(3, 1, 5.0)[0]
    damped = fe.linear.with_rate_feedback(fe.coils, D)
    freq, zeta = damped.complex_modes()
    s = beam_loop.closed(D).s[0]
    s = s[s.imag >= 0]
    s = s[np.argsort(np.abs(s))]
    # two eigenvalue solvers on differently scaled states of order 1e4 rad/s: 1e-8 leaves room for the higher modes
    np.testing.assert_allclose(np.abs(s) / (2 * np.pi), freq, rtol=1e-8)
    np.testing.assert_allclose(-s.real / np.abs(s), zeta, rtol=1e-6, atol=1e-9)


def test_a_mode_keeps_its_number_when_another_passes_it_overdamped():
    fe = oscillators([1.0, 3.0, 4.0], [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]], zeta=0.01)
    modes = RateFeedbackLoop(fe.linear, fe.coils).track(np.diag([30.0, 0.5]), 3)
    assert modes.overdamped[0].tolist() == [False, True, False]
    assert modes.freq[0, [0, 2]] * 2 * np.pi == pytest.approx([1.0, 4.0], rel=1e-9)  # |s| is the undamped frequency
    assert modes.zeta[0] == pytest.approx([0.01, 1.0, (0.08 + 0.5) / 8], rel=1e-9)


def test_numbers_do_not_follow_from_sorting():
    # A light mass on a stiff base: the coil clamps the base, whose mode turns into one of the clamped mass below it
    fe = toy(np.diag([1.0, 0.05]), np.zeros((2, 2)) + 1e-6 * np.eye(2), [[3.0, -1.0], [-1.0, 1.0]], [[1.0], [0.0]])
    loop = RateFeedbackLoop(fe.linear, fe.coils)
    modes = loop.track(np.array([[[0.1]], [[50.0]]]), 2)
    weak, strong = modes.zeta
    assert np.all(weak < 0.1)
    assert np.count_nonzero(modes.overdamped[1]) == 1
    # at infinite gain the base stands still: one mode is left, the mass on its spring, sqrt(1/0.05) rad/s
    left = np.flatnonzero(~modes.overdamped[1])[0]
    assert modes.freq[1, left] * 2 * np.pi == pytest.approx(np.sqrt(20.0), rel=1e-3)
    assert strong[left] < 0.01


@pytest.mark.parametrize("name", ["beam", "grid"])
def test_gradients_of_damping_are_central_differences(name, beam_loop, grid_fe):
    loop = beam_loop if name == "beam" else RateFeedbackLoop(grid_fe.linear, grid_fe.coils)
    coils, count = loop.at_coils.shape[1], 6 if name == "beam" else 12
    scale = 3.0 if name == "beam" else 0.3
    D = random_gains(coils, 6, scale, seed=1)
    E = np.random.default_rng(2).standard_normal(D.shape)
    E = E + E.transpose(0, 2, 1)
    h = 1e-6 * scale
    difference = (loop.track(D + h * E, count).zeta - loop.track(D - h * E, count).zeta) / (2 * h)
    gradient = np.einsum("kmij,kij->km", loop.track(D, count).zeta_gradients, E)
    # rounding of zeta near 1e-13 over a step of 1e-6 of the gains
    np.testing.assert_allclose(gradient, difference, atol=2e-6 * np.abs(difference).max())


def test_gradients_of_poles_are_central_differences(beam_loop):
    D = random_gains(3, 1, 3.0, seed=3)[0]
    slopes, h = beam_loop.track(D, 6).slopes[0], 1e-5
    for i, j in ((0, 0), (0, 2), (1, 2)):
        E = np.zeros((3, 3))
        E[i, j] = E[j, i] = h
        difference = (beam_loop.track(D + E, 6).poles - beam_loop.track(D - E, 6).poles)[0] / (2 * h)
        expected = slopes[:, i, j] + (slopes[:, j, i] if i != j else 0.0)
        np.testing.assert_allclose(expected, difference, atol=1e-6 * np.abs(difference).max())


@settings(max_examples=40, deadline=None)
@given(
    numbers=st.lists(st.floats(-1.0, 1.0), min_size=9, max_size=9),
    rank=st.integers(1, 3),
    decade=st.floats(-4.0, 4.0),
)
def test_dissipative_gains_never_destabilise(beam_loop_module, numbers, rank, decade):
    X = np.array(numbers).reshape(3, 3)[:, :rank]
    D = 10.0**decade * X @ X.T
    s = beam_loop_module.closed((D + D.T) / 2).s[0]
    # D >= 0 only takes energy out of a damped structure; rounding is that of eigenvalues as large as the fastest pole
    assert s.real.max() <= 1e-13 * np.abs(s).max()


@pytest.fixture(scope="module")
def beam_loop_module(beam_loop):
    return beam_loop


def test_index_agrees_with_the_lyapunov_equation_and_its_gradient_with_differences(fe, beam_loop):
    model = state_model(fe)
    weights, x0 = identity_weights(model, 1.0, 0.22), performance.initial_states(model, 6)
    indices = IndexGradients(loop=beam_loop, weights=weights, x0=x0)
    D = random_gains(3, 3, 4.0, seed=4)
    J, slopes = indices(beam_loop.closed(D))
    for row, gains in zip(J, D, strict=True):
        # modal against Schur form: a condition of the eigenvectors near 1e4 leaves ten digits
        np.testing.assert_allclose(row, performance.rate_feedback_index(model, gains, weights, x0), rtol=1e-8)
    E, h = np.array([[1.0, 0.3, -0.2], [0.3, 0.5, 0.1], [-0.2, 0.1, 0.8]]), 1e-4
    difference = (indices(beam_loop.closed(D + h * E))[0] - indices(beam_loop.closed(D - h * E))[0]) / (2 * h)
    np.testing.assert_allclose(np.einsum("kmij,ij->km", slopes, E), difference, rtol=1e-5, atol=1e-5)


def test_index_of_an_unstable_loop_is_infinite(fe, beam_loop):
    model = state_model(fe)
    indices = IndexGradients(
        loop=beam_loop, weights=identity_weights(model, 1.0, 0.22), x0=performance.initial_states(model, 2)
    )
    J, _ = indices(beam_loop.closed(-np.eye(3)))
    assert np.all(np.isinf(J))


@pytest.mark.parametrize(
    ("gains", "words"),
    [
        (np.eye(2), "3 x 3 is needed"),
        (np.array([[1.0, 0.2, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), "not symmetric"),
        (np.full((3, 3), np.nan), "not finite"),
    ],
)
def test_gains_that_do_not_fit_are_refused(beam_loop, gains, words):
    with pytest.raises(BadDesign, match=words):
        beam_loop.closed(gains)


def test_models_that_do_not_fit_are_refused(fe, beam_loop):
    with pytest.raises(BadDesign, match="19 coordinates"):
        RateFeedbackLoop(fe.linear, fe.coils[:5])
    falling = toy([[1.0]], [[0.0]], [[-1.0]], [[1.0]])
    with pytest.raises(BadDesign, match="not positive definite"):
        RateFeedbackLoop(falling.linear, falling.coils)
    with pytest.raises(BadDesign, match="cannot be followed"):
        beam_loop.open_modes(99)
