"""Riccati equations: optimality, the prescribed margin, and the reasons why there is no solution."""

import control
import numpy as np
import pytest

from vlab.design.riccati import kalman_filter, lqr, unreachable
from vlab.errors import BadDesign

SEED = np.random.default_rng(7)


def oscillators(freq=(1.0, 2.5), zeta=(0.01, 0.02)):
    """Modes with unit mass, each its own block."""
    n = len(freq)
    omega = 2 * np.pi * np.array(freq)
    return np.block([[-np.diag(2 * np.array(zeta) * omega), -np.diag(omega**2)], [np.eye(n), np.zeros((n, n))]])


def test_the_double_integrator_has_the_gain_of_the_textbook():
    # x'' = u, Q = diag(q, 0) on the position, R = 1: F = [sqrt(q), sqrt(2 sqrt(q))]  [Kwakernaak & Sivan 1972, sec. 3.4]
    q = 3.0
    found = lqr([[0, 1], [0, 0]], [[0], [1]], np.diag([q, 0]), [[1.0]])
    assert found.F[0] == pytest.approx([np.sqrt(q), np.sqrt(2 * np.sqrt(q))], rel=1e-10)  # rounding of the solver


def test_the_regulator_agrees_with_python_control():
    A, B = oscillators(), np.array([[1.0, 0.3], [0.2, -1.0], [0, 0], [0, 0]])
    Q, R = np.diag([1.0, 2.0, 30.0, 40.0]), np.array([[0.5, 0.1], [0.1, 0.7]])
    ours = lqr(A, B, Q, R)
    F, S, _ = control.lqr(A, B, Q, R, method="scipy")
    assert pytest.approx(F, rel=1e-8) == ours.F
    assert pytest.approx(S, rel=1e-8) == ours.S


@pytest.mark.parametrize("alpha", [0.0, 0.5, 3.0, 12.0])
def test_every_filter_pole_lies_left_of_the_margin(alpha):
    A, C = oscillators(), np.array([[1.0, 0.4, 0, 0]])
    found = kalman_filter(A, C, 1e-3 * np.eye(4), [[0.5]], alpha)
    assert np.linalg.eigvals(A - found.K @ C).real.max() < -alpha


def test_the_filter_is_the_regulator_of_the_transposed_pair():
    A, C = oscillators(), np.array([[1.0, 0.4, 0, 0]])
    found = kalman_filter(A, C, np.diag([1.0, 2, 3, 4]), [[0.5]], 1.5)
    dual = lqr(A.T + 1.5 * np.eye(4), C.T, np.diag([1.0, 2, 3, 4]), [[0.5]])
    assert pytest.approx(dual.F.T, rel=1e-12) == found.K
    L, _, _ = control.lqe(A + 1.5 * np.eye(4), np.eye(4), C, np.diag([1.0, 2, 3, 4]), [[0.5]], method="scipy")
    assert pytest.approx(L, rel=1e-8) == found.K


def test_an_unstable_mode_that_no_coil_moves_is_named():
    A = oscillators(zeta=(0.01, -0.02))
    B = np.array([[1.0], [0.0], [0], [0]])  # drives the first mode only; the second grows at 2.5 Hz
    with pytest.raises(BadDesign, match=r"cannot be stabilised: no input moves the mode at 2\.5 Hz"):
        lqr(A, B, np.eye(4), [[1.0]])
    assert lqr(oscillators(), B, np.eye(4), [[1.0]]).F[0, 1] == pytest.approx(0, abs=1e-9)  # damped: left alone


def test_a_mode_slower_than_the_margin_that_no_sensor_sees_is_named():
    C = np.array([[1.0, 0.0, 0, 0]])
    with pytest.raises(BadDesign, match=r"not detectable: no sensor sees the mode at 2\.5 Hz .* alpha = 2 1/s"):
        kalman_filter(oscillators(), C, np.eye(4), [[1.0]], 2.0)
    kalman_filter(oscillators(), C, np.eye(4), [[1.0]])  # without a margin it decays by itself


def test_two_like_modes_need_two_coils():
    A = oscillators(freq=(2.0, 2.0), zeta=(0.0, 0.0))
    one = np.array([[1.0], [0.7], [0], [0]])
    assert len(unreachable(A, one)) == 1  # a combination of the two does not move the coil
    two = np.array([[1.0, 0.0], [0.7, 0.5], [0, 0], [0, 0]])
    assert unreachable(A, two) == []
    with pytest.raises(BadDesign, match=r"no input moves the mode at 2 Hz"):
        lqr(A, one, np.eye(4), [[1.0]])


def test_an_undamped_mode_that_q_does_not_see_is_refused():
    with pytest.raises(BadDesign, match="no stabilising solution: Q does not see"):
        lqr(oscillators(zeta=(0.01, 0.0)), np.ones((4, 1)), np.diag([1.0, 0, 1, 0]), [[1.0]])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"Q": np.diag([1.0, -1, 1, 1])}, "state weight Q is indefinite"),
        ({"Q": np.eye(3)}, "do not fit 4 states"),
        ({"Q": np.arange(16.0).reshape(4, 4)}, "not symmetric"),
        ({"Q": np.full((4, 4), np.nan)}, "not a finite square matrix"),
        ({"Q": [["a"]]}, "not a matrix of numbers"),
        ({"R": [[0.0]]}, "control weight R is not positive definite"),
        ({"R": np.eye(2)}, "do not fit 4 states and 1 inputs"),
        ({"B": np.ones((3, 1))}, "B of shape .* 4 rows"),
        ({"B": np.ones((4, 0))}, "B of shape"),
        ({"A": np.ones((4, 3))}, "A of shape"),
        ({"A": np.full((4, 4), np.inf)}, "A of shape"),
    ],
)
def test_what_makes_no_regulator_is_refused(change, message):
    given = {"A": oscillators(), "B": np.ones((4, 1)), "Q": np.eye(4), "R": [[1.0]]} | change
    with pytest.raises(BadDesign, match=message):
        lqr(**given)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"V1": -np.eye(4)}, "excitation intensity V1 is indefinite"),
        ({"V2": [[-1.0]]}, "measurement noise V2 is not positive definite"),
        ({"V2": np.eye(2)}, "do not fit 4 states and 1 outputs"),
        ({"C": np.ones(4)}, "no matrix"),
        ({"C": np.ones((1, 3))}, "C\\^T of shape"),
        ({"alpha": -1.0}, "alpha = -1"),
        ({"alpha": float("nan")}, "alpha = nan"),
    ],
)
def test_what_makes_no_filter_is_refused(change, message):
    given = {"A": oscillators(), "C": np.ones((1, 4)), "V1": np.eye(4), "V2": [[1.0]], "alpha": 0.0} | change
    with pytest.raises(BadDesign, match=message):
        kalman_filter(**given)


@pytest.mark.parametrize("seed", range(10))
def test_random_structures_obey_the_theory(seed):
    # any passive structure with collocated coils: S >= 0, the loop gain of the regulator keeps |1 + L| >= 1 (Kalman's
    # inequality, R = r I), and the filter keeps its margin
    rng = np.random.default_rng(seed)
    n, coils = int(rng.integers(2, 7)), int(rng.integers(1, 3))
    root = rng.standard_normal((n, n))
    M, K = root @ root.T + n * np.eye(n), np.diag(rng.uniform(10, 1000, n))
    C, U = 1e-3 * K, rng.standard_normal((n, coils))
    A = np.block([[-np.linalg.solve(M, C), -np.linalg.solve(M, K)], [np.eye(n), np.zeros((n, n))]])
    B = np.vstack([np.linalg.solve(M, U), np.zeros((n, coils))])
    found = lqr(A, B, np.eye(2 * n), 0.1 * np.eye(coils))
    assert np.linalg.eigvalsh(found.S).min() > 0
    for omega in rng.uniform(0.1, 30, 10):
        L = found.F @ np.linalg.solve(1j * omega * np.eye(2 * n) - A, B)
        assert np.linalg.svd(np.eye(coils) + L, compute_uv=False).min() >= 1 - 1e-8
    alpha = float(rng.uniform(0, 2))
    y = np.hstack([U.T, np.zeros((coils, n))])
    filtered = kalman_filter(A, y, np.eye(2 * n), np.eye(coils), alpha)
    assert np.linalg.eigvals(A - filtered.K @ y).real.max() < -alpha
