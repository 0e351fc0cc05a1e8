"""Discrete linear laws: the runtime, sampling with delay, block-diagonal form, a design with the delay in it."""

import itertools

import numpy as np
import pytest
from scipy import linalg
from scipy.integrate import solve_ivp
from vlab.controllers.block_diagonal import block_diagonal, real_modal_form
from vlab.controllers.sampling import hold, sample_with_delay

from vlab.controllers import (
    Controller,
    DirectRateFeedback,
    LinearController,
    LinearLaw,
    ObserverFeedback,
    delayed_lqg,
    lqg,
)
from vlab.design.state_model import state_model
from vlab.design.weights import identity_weights, published_noise
from vlab.errors import BadController, BadDesign
from vlab.fe.reduced import build_reduced_model
from vlab.lab.prediction import loop_on

PLACES = ("40in", "20in", "base")


def law(n: int = 4, seed: int = 0, **settings) -> LinearLaw:
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n))
    A *= 0.9 / max(np.abs(np.linalg.eigvals(A)).max(initial=0.0), 1e-9) if n else 1.0
    parts = [rng.standard_normal(shape) for shape in ((n, 3), (2, n), (2, 3))]
    return LinearLaw(A, *parts, **{"sensors": ("a", "b", "c"), "actuators": ("a", "b")} | settings)


@pytest.fixture(scope="module")
def design_model(beam):
    return state_model(build_reduced_model(beam, "exact"))


@pytest.mark.parametrize("n", [0, 1, 24])
def test_a_linear_law_is_its_recursion(n):
    given = law(n)
    A, B, C, D = given.matrices
    y = np.random.default_rng(1).standard_normal((50, 3))
    x, expected = np.zeros(n), []
    for sample in y:
        expected.append(C @ x + D @ sample)
        x = A @ x + B @ sample
    assert np.array([given.step(s) for s in y]) == pytest.approx(np.array(expected), abs=1e-12)  # sums in another order
    assert given.state == pytest.approx(x, abs=1e-12)
    assert isinstance(given, Controller)
    assert isinstance(given, LinearController)


def test_a_command_once_given_does_not_change():
    given = law()
    first = given.step(np.ones(3))
    kept = first.copy()
    for _ in range(5):
        given.step(np.full(3, 7.0))
    assert np.array_equal(first, kept)


def test_reset_forgets():
    given = law()
    once = [given.step(np.ones(3)) for _ in range(4)]
    given.reset()
    assert np.array_equal(once, [given.step(np.ones(3)) for _ in range(4)])


@pytest.mark.parametrize("make", ["rate", "observer"])
def test_other_linear_laws_say_their_matrices(make):
    if make == "rate":
        given = DirectRateFeedback([[2.0, 1.0], [0.5, 3.0]], sensors=("a", "b"), actuators=("a", "b"))
    else:
        given = ObserverFeedback(
            [[0.9, 0.1], [0.0, 0.8]], [[0.0, 0.1], [1.0, 0.2]], np.eye(2), K=[[0.5, 1.0], [0.1, 0.2]], M=0.3 * np.eye(2), sensors=("a", "b"), actuators=("a", "b")
        )  # fmt: skip
    same = LinearLaw(*given.matrices, sensors=given.sensors, actuators=given.actuators)
    y = np.random.default_rng(2).standard_normal((30, 2))
    assert np.array([same.step(s) for s in y]) == pytest.approx(np.array([given.step(s) for s in y]), abs=1e-12)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"sensors": ("a", "b")}, "the law's B has shape"),
        ({"actuators": ("a",)}, "the law's C has shape"),
        ({"rate": 0.0}, "not a positive number"),
        ({"rate": float("nan")}, "not a positive number"),
    ],
)
def test_laws_that_do_not_fit_are_refused(settings, message):
    with pytest.raises(BadController, match=message):
        law(**settings)


def test_the_wrong_number_of_samples_is_refused():
    with pytest.raises(BadController, match="1 samples were given; the law reads 3"):
        law().step(np.zeros(1))


@pytest.mark.parametrize("delay", [0.0, 0.35, 1.0, 1.35, 2.9])
def test_sampling_with_delay_is_the_integral_of_the_delayed_staircase(delay):
    # an independent integrator over a staircase with a stair inside the period
    rng = np.random.default_rng(3)
    A, B, C = rng.standard_normal((3, 3)) - 2 * np.eye(3), rng.standard_normal((3, 2)), rng.standard_normal((1, 3))
    rate, u = 20.0, rng.standard_normal((12, 2))
    Ad, Bd, Cd = sample_with_delay(A, B, C, rate=rate, delay_samples=delay)
    z, ours = np.zeros(len(Ad)), []
    for command in u:
        ours.append((Cd @ z)[0])
        z = Ad @ z + Bd @ command
    x, theirs = np.zeros(3), []
    for k in range(12):
        theirs.append((C @ x)[0])
        edges = sorted({0.0, delay % 1.0, 1.0})
        for a, b in itertools.pairwise(edges):
            i = int(np.floor(k + (a + b) / 2 - delay))
            w = u[i] if i >= 0 else np.zeros(2)
            x = solve_ivp(lambda t, x, w=w: A @ x + B @ w, (0, (b - a) / rate), x, rtol=1e-10, atol=1e-13).y[:, -1]
    assert np.array(ours) == pytest.approx(np.array(theirs), abs=1e-9)  # tolerance of the integrator


def test_hold_of_an_integrator_needs_no_inverse():
    transition, entering = hold(np.zeros((1, 1)), np.ones((1, 1)), 0.25)
    assert (transition[0, 0], entering[0, 0]) == pytest.approx((1.0, 0.25), abs=1e-15)


def test_block_diagonal_law_is_that_of_equations_5_11_to_5_13(design_model):
    # transform the continuous observer first and discretise then, as the text does, with F_R T in (5.13)
    m = design_model
    design = lqg.design(m, identity_weights(m, 1.0, 0.22), published_noise(m, 1e-6, 5e-4, 0.2))
    T, blocks = real_modal_form(design.A_estimator)
    inside = linalg.solve(T, design.A_estimator @ T)
    assert inside == pytest.approx(linalg.block_diag(*blocks), abs=1e-7 * np.abs(inside).max())
    F22 = linalg.expm(inside * 1e-3)
    F21 = (F22 - np.eye(len(F22))) @ linalg.solve(inside, linalg.solve(T, design.K))
    text = LinearLaw(F22, F21, -design.F @ T, np.zeros((3, 3)), sensors=PLACES, actuators=PLACES)
    ours = block_diagonal(design.controller)
    y = np.random.default_rng(4).standard_normal((400, 3))
    expected = np.array([text.step(s) for s in y])
    size = np.abs(expected).max()
    assert np.array([ours.step(s) for s in y]) == pytest.approx(
        expected, abs=1e-7 * size
    )  # condition of T, 1e4, squared
    assert np.array([design.controller.step(s) for s in y]) == pytest.approx(expected, abs=1e-7 * size)
    assert ours.rate == design.controller.rate


def test_a_defective_law_has_no_block_diagonal_form():
    double = LinearLaw([[0.5, 1.0], [0.0, 0.5]], np.eye(2), np.eye(2), np.zeros((2, 2)), sensors="ab", actuators="ab")
    with pytest.raises(BadController, match="nearly dependent"):
        block_diagonal(double)


def test_design_with_delay_separates_and_keeps_its_margin(design_model):
    # separation: the loop of the discrete plant and the law has the poles of regulator and filter and no others
    m, rate = design_model, 1000.0
    noise = published_noise(m, 1e-6, 5e-4, 0.2)
    design = delayed_lqg.design(m, identity_weights(m, 1.0, 0.22), noise, rate=rate, delay_samples=1.35)
    a, b, c, _ = design.controller.matrices
    loop = np.linalg.eigvals(np.block([[design.A, design.B @ c], [b @ design.C, a]]))
    expected = np.concatenate([design.regulator_poles, design.filter_poles])
    distance = np.abs(loop[:, None] - expected[None, :])
    assert distance.min(axis=1).max() < 1e-4  # the delay's eigenvalues at zero are multiple: rounding to the power 1/2
    assert np.abs(design.filter_poles).max() <= np.exp(-noise.alpha / rate) + 1e-9


def test_design_with_delay_bears_more_delay_than_the_one_without(design_model, fe, laboratory):
    m, hardware = design_model, laboratory.at_rate(1000.0)
    weights, noise = identity_weights(m, 1.0, 0.22), published_noise(m, 1e-6, 5e-4, 0.2)
    without = lqg.design(m, weights, noise, rate=1000.0).controller
    within = delayed_lqg.design(m, weights, noise, rate=1000.0, delay_samples=1.35).controller
    loops = [loop_on(fe, given, hardware.converter).with_delay(2.0) for given in (without, within)]
    assert [loop.radius < 1 for loop in loops] == [False, True]


def test_design_with_delay_tends_to_the_continuous_one(design_model):
    # without delay and at fast sampling: same feedback from the plant's states, to first order in the step
    m = design_model
    weights, noise = identity_weights(m, 1.0, 0.22), published_noise(m, 1e-6, 5e-4, 0.2)
    F = lqg.design(m, weights, noise).F
    errors = []
    for rate in (40e3, 80e3):
        design = delayed_lqg.design(m, weights, noise, rate=rate, delay_samples=0.0)
        errors.append(np.abs(design.F - F).max() / np.abs(F).max())
    assert errors[0] < 0.05
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.1)


def test_design_with_delay_refuses_weights_of_another_model(design_model):
    m = design_model
    noise, weights = published_noise(m, 1e-6, 5e-4, 0.2), identity_weights(m, 1.0, 0.22)
    smaller = type(weights)(Q=weights.Q[:4, :4], R=weights.R)
    with pytest.raises(BadDesign, match="do not fit 20 states"):
        delayed_lqg.design(m, smaller, noise, rate=1000.0, delay_samples=1.35)
