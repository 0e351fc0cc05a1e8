"""The sequential programme on problems whose optimum is known in closed form or from the literature."""

import numpy as np
import pytest

from vlab.design.sequential import Evaluation, LinearConstraints, Settings, minimise
from vlab.errors import BadDesign


def problem(f, gradient, constraints=(), slopes=()):
    """Turn functions of one point into those of many."""

    def evaluate(x, which):
        k, n = x.shape
        c = np.array([[g(p) for g in constraints] for p in x]).reshape(k, len(constraints))
        J = np.array([[g(p) for g in slopes] for p in x]).reshape(k, len(slopes), n)
        return Evaluation(
            f=np.array([f(p) for p in x]), f_gradient=np.array([gradient(p) for p in x]), c=c, c_gradient=J
        )

    return evaluate


def free(n: int) -> LinearConstraints:
    return LinearConstraints(A=np.zeros((0, n)), lower=np.zeros(0), upper=np.zeros(0))


def test_nearest_point_of_a_half_plane():
    evaluate = problem(lambda x: x @ x, lambda x: 2 * x, [lambda x: x[0] + x[1] - 1], [lambda x: np.array([1.0, 1.0])])
    found = minimise(evaluate, np.array([[3.0, -2.0]]), free(2))
    assert found.x[0] == pytest.approx([0.5, 0.5], abs=1e-5)
    assert found.multipliers[0] == pytest.approx([1.0], abs=1e-4)  # df*/d(bound) of f* = bound^2 / 2
    assert found.converged[0]


def test_rosen_and_suzuki():
    # Hock and Schittkowski, Test Examples for Nonlinear Programming Codes, 1981, problem 43: f* = -44 at (0, 1, 2, -1),
    # the first and the third constraint active with multipliers 1 and 2
    linear = np.array([5.0, 5.0, 21.0, -7.0])
    curved = np.array([1.0, 1.0, 2.0, 1.0])
    parts = [
        (8.0, [1.0, 1.0, 1.0, 1.0], [1.0, -1.0, 1.0, -1.0]),
        (10.0, [1.0, 2.0, 1.0, 2.0], [-1.0, 0.0, 0.0, -1.0]),
        (5.0, [2.0, 1.0, 1.0, 0.0], [2.0, -1.0, 0.0, -1.0]),
    ]
    constraints = [lambda x, p=p: p[0] - np.array(p[1]) @ x**2 - np.array(p[2]) @ x for p in parts]
    slopes = [lambda x, p=p: -2 * np.array(p[1]) * x - np.array(p[2]) for p in parts]
    evaluate = problem(lambda x: curved @ x**2 - linear @ x, lambda x: 2 * curved * x - linear, constraints, slopes)
    starts = np.vstack([np.zeros(4), np.random.default_rng(0).uniform(-3, 3, (4, 4))])
    found = minimise(evaluate, starts, free(4))
    assert found.f == pytest.approx(np.full(5, -44.0), abs=1e-5)
    assert found.x[found.best] == pytest.approx([0.0, 1.0, 2.0, -1.0], abs=1e-3)
    assert found.multipliers[found.best] == pytest.approx([1.0, 0.0, 2.0], abs=1e-2)
    assert found.reached(1e-4) == 5


def test_minimax_of_distances_is_the_circumscribed_circle():
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, np.sqrt(0.75)]])
    constraints = [lambda x, p=p: x[2] - np.hypot(*(x[:2] - p)) for p in corners]
    slopes = [lambda x, p=p: np.append(-(x[:2] - p) / np.hypot(*(x[:2] - p)), 1.0) for p in corners]
    evaluate = problem(lambda x: x[2], lambda x: np.array([0.0, 0.0, 1.0]), constraints, slopes)
    found = minimise(evaluate, np.array([[0.9, 0.7, 2.0]]), free(3))
    assert found.f[0] == pytest.approx(1 / np.sqrt(3), abs=1e-7)
    assert found.multipliers[0] == pytest.approx(np.full(3, 1 / 3), abs=1e-4)


def test_linear_constraints_hold_exactly_and_say_their_price():
    linear = LinearConstraints(A=np.eye(2), lower=np.array([-1.0, 0.25]), upper=np.array([1.0, np.inf]))
    evaluate = problem(lambda x: x[1] ** 2 - x[0], lambda x: np.array([-1.0, 2 * x[1]]))
    found = minimise(evaluate, np.array([[0.0, 3.0]]), linear)
    assert found.x[0] == pytest.approx([1.0, 0.25], abs=1e-8)
    assert found.linear_multipliers[0] == pytest.approx([1.0, -0.5], abs=1e-6)


def test_of_two_minima_the_lower_one_is_best():
    # (x^2 - 1)^2 + x/5: the minimum near x = -1 lies about 0.4 below the one near x = 1
    evaluate = problem(lambda x: (x[0] ** 2 - 1) ** 2 + 0.2 * x[0], lambda x: 4 * x * (x**2 - 1) + 0.2)
    found = minimise(evaluate, np.linspace(-2, 2, 9)[:, None], free(1))
    roots = np.roots([4.0, 0.0, -4.0, 0.2])
    lowest = min(roots.real, key=lambda x: (x**2 - 1) ** 2 + 0.2 * x)
    assert found.x[found.best, 0] == pytest.approx(lowest, abs=1e-4)
    assert 1 <= found.reached(1e-4) < 9


def test_an_infeasible_problem_ends_where_the_least_is_lacking():
    evaluate = problem(
        lambda x: x[0],
        lambda x: np.ones(1),
        [lambda x: x[0] - 1, lambda x: -x[0]],
        [lambda x: np.ones(1), lambda x: -np.ones(1)],
    )
    found = minimise(evaluate, np.array([[5.0], [-5.0]]), free(1))
    assert not found.feasible.any()
    assert found.violation == pytest.approx([1.0, 1.0], abs=1e-6)  # anywhere between 0 and 1 the sum lacking is 1


def test_the_same_starts_give_the_same_bits():
    evaluate = problem(lambda x: (1 - x[0]) ** 2 + 100 * (x[1] - x[0] ** 2) ** 2, lambda x: np.array(
        [-2 * (1 - x[0]) - 400 * x[0] * (x[1] - x[0] ** 2), 200 * (x[1] - x[0] ** 2)]
    ))  # fmt: skip
    starts = np.array([[-1.2, 1.0], [2.0, 2.0]])
    first, second = (minimise(evaluate, starts, free(2), Settings(iterations=200)) for _ in range(2))
    assert first.x.tobytes() == second.x.tobytes()
    assert first.x[0] == pytest.approx([1.0, 1.0], abs=1e-3)  # Rosenbrock's valley


def test_what_does_not_fit_is_refused():
    evaluate = problem(lambda x: x[0], lambda x: np.ones(1))
    bounded = LinearConstraints(A=np.eye(1), lower=np.zeros(1), upper=np.ones(1))
    with pytest.raises(BadDesign, match="start 1 violates"):
        minimise(evaluate, np.array([[2.0]]), bounded)
    with pytest.raises(BadDesign, match="do not fit"):
        minimise(evaluate, np.zeros((1, 2)), bounded)
    with pytest.raises(BadDesign, match="above its upper"):
        LinearConstraints(A=np.eye(1), lower=np.ones(1), upper=np.zeros(1))
