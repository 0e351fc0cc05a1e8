"""Performance of closed loops against integration in time, closed forms and what theory demands."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from vlab.controllers import lqg, lqr
from vlab.design import performance
from vlab.design.state_model import state_model
from vlab.design.weights import identity_weights, published_noise
from vlab.errors import BadDesign
from vlab.fe.reduced import build_reduced_model


@pytest.fixture(scope="module")
def full(beam):
    return state_model(build_reduced_model(beam, "full"))


@pytest.fixture(scope="module")
def reduced(beam):
    return state_model(build_reduced_model(beam, "exact"))


@pytest.fixture(scope="module")
def weights(full):
    return identity_weights(full, 1.0, 0.22)


@pytest.fixture(scope="module")
def law(reduced):
    return lqg.design(reduced, identity_weights(reduced, 1.0, 0.22), published_noise(reduced, 1e-6, 5e-4, 0.2))


D = np.diag([8.0, 6.0, 4.0])
"""A gain matrix of the size of Table 7 [N s/m]."""


def test_the_index_of_one_oscillator_has_its_closed_form():
    # m q'' + c q' + k q = 0 from q = 1: integral of q'^2 = k / (2 c); integral of q^2 = c / (2 k) + m / (2 c)
    m, c, k = 2.0, 0.3, 50.0
    A = np.array([[-c / m, -k / m], [1.0, 0.0]])
    found = [performance.quadratic_index(A, np.diag(q), [0.0, 1.0])[0] for q in ([1.0, 0.0], [0.0, 1.0])]
    assert found == pytest.approx([k / (2 * c), c / (2 * k) + m / (2 * c)], rel=1e-12)


def test_the_lyapunov_index_is_the_integral_over_time(full, weights):
    # independent of the Lyapunov equation: x' = A x, J' = x^T Q x, integrated until 1e-12 of the start is left
    x0 = performance.initial_states(full, [2])
    F = D @ full.C
    A, Q = full.A - full.B @ F, weights.Q + F.T @ weights.R @ F
    J = performance.rate_feedback_index(full, D, weights, x0)[0]

    # modal coordinates are exact at any time: x(t) = V exp(s t) c, J = sum of c_i c_j (V^T Q V)_ij (exp((s_i+s_j) T) - 1)/(s_i+s_j)
    s, V = np.linalg.eig(A)
    c = np.linalg.solve(V, x0[:, 0].astype(complex))
    both = s[:, None] + s[None, :]
    T = 60.0
    exact = (c[:, None] * c * (V.T @ Q @ V) * np.expm1(both * T) / both).sum().real
    assert exact == pytest.approx(J, rel=1e-8)


def test_the_lyapunov_index_is_the_integral_of_an_ode_solver():
    rng = np.random.default_rng(3)
    A = rng.standard_normal((4, 4)) - 4 * np.eye(4)
    Q = np.diag([1.0, 2.0, 3.0, 4.0])
    x0 = rng.standard_normal(4)
    run = solve_ivp(
        lambda t, z: np.append(A @ z[:4], z[:4] @ Q @ z[:4]), (0, 40), np.append(x0, 0), rtol=1e-11, atol=1e-14
    )
    assert run.y[4, -1] == pytest.approx(performance.quadratic_index(A, Q, x0)[0], rel=1e-8)


def test_the_index_of_the_optimal_regulator_is_the_riccati_solution(full, weights):
    # (4.7) and the Lyapunov equation of A - B F must agree
    optimal = lqr.design(full, weights)
    found = performance.regulator_index(full, optimal.F, weights, performance.initial_states(full, 6))
    assert found == pytest.approx(optimal.indices(6), rel=1e-8)


def test_lqg_on_its_own_model_is_both_systems(reduced, law):
    # (4.20) in [x, e] and (4.26) in [x, x_est] describe the same loop
    x0 = performance.initial_states(reduced, 6)
    augmented = performance.reduced_controller_index(reduced, reduced, law.F, law.K, law.weights, x0)
    assert augmented == pytest.approx(law.indices(6), rel=1e-8)


def test_an_unstable_loop_has_no_index(full, weights):
    with pytest.raises(BadDesign, match="closed loop is unstable at .* Hz"):
        performance.rate_feedback_index(full, -D, weights, performance.initial_states(full, 2))


def test_dissipation_takes_damping_from_no_mode(full):
    # D >= 0 only dissipates: no pole moves to the right of the least damped one, and energy never grows
    rng = np.random.default_rng(5)
    for _ in range(20):
        root = rng.standard_normal((3, 3))
        A = performance.rate_feedback_loop(full, 10 * root @ root.T)
        assert np.linalg.eigvals(A).real.max() < 0
        n = full.n
        energy = np.zeros_like(A)
        energy[:n, :n], energy[n:, n:] = full.M, full.K
        power = energy @ A
        scale = np.abs(power).max()
        assert np.linalg.eigvalsh(power + power.T).max() <= 1e-8 * scale  # energy rate 2 x^T E A x <= 0


def test_initial_shapes_have_one_inch_at_the_largest_translation(full, reduced):
    for model in (full, reduced):
        shapes = performance.initial_shapes(model, 6)
        assert np.abs(shapes[model.is_translation]).max(axis=0) == pytest.approx(0.0254, rel=1e-12)
    kept = [full.coordinates.index(label) for label in reduced.coordinates]
    assert np.abs(performance.initial_shapes(full, 6)[kept]) == pytest.approx(
        np.abs(performance.initial_shapes(reduced, 6)), abs=1e-9
    )  # an exact reduction keeps the shapes
    with pytest.raises(BadDesign, match="initial shapes 11 of a model with 10 modes"):
        performance.initial_shapes(reduced, 11)


def test_poles_of_modes_that_cross_are_not_swapped():
    expected = np.array([-0.1 + 10j, -2.0 + 10.5j])
    found = np.array([-2.1 + 9.9j, -0.1 + 10.1j])  # the damped one is lower in frequency now
    assert performance.match_poles(expected, found) == pytest.approx(found[::-1])
    with pytest.raises(BadDesign, match="2 poles are expected but only 1"):
        performance.match_poles(expected, found[:1])


def test_an_exact_reduction_spills_over_but_keeps_the_regulator(full, reduced, law):
    on_full, spilled = law.poles_on(full)
    assert spilled.modes == tuple(range(11, 20))
    assert spilled.before == pytest.approx(0.001, rel=1e-6)  # the inherent ratio of the higher modes
    assert on_full.zeta[:6] == pytest.approx(law.poles.zeta[:6], rel=2e-3)  # observation spillover is small, not zero
    assert spilled.losing() == ()
    # with no feedback nothing spills over
    idle = performance.reduced_controller_poles(full, reduced, 0 * law.F, law.K)[1]
    assert idle.change == pytest.approx(0, abs=1e-10)


def test_shared_modes_follow_shapes_and_poles(grid_models):
    whole, exact = grid_models
    assert performance.shared_modes(whole, exact).tolist() == [*range(11), 12]  # the grid keeps mode 13 for mode 12
    assert performance.shared_modes(whole, whole).tolist() == list(range(whole.n))
    with pytest.raises(BadDesign, match="has 64 modes, the model only 12"):
        performance.shared_modes(exact, whole)


@pytest.fixture(scope="module")
def grid_models():
    from vlab.structure import load_structure

    grid = load_structure("grid")
    return tuple(state_model(build_reduced_model(grid, name)) for name in ("full", "exact"))


def test_force_bounds_are_row_sums():
    assert performance.force_bounds([[1.0, -2.0], [0.5, 0.25]]) == pytest.approx([3.0, 0.75])
    with pytest.raises(BadDesign, match="no matrix"):
        performance.force_bounds([1.0, 2.0])


def test_force_bounds_are_reached_by_some_velocities():
    rng = np.random.default_rng(2)
    gain = rng.standard_normal((3, 3))
    worst = np.abs(gain @ np.array(np.meshgrid(*[[-1.0, 1.0]] * 3)).reshape(3, -1)).max(axis=1)
    assert performance.force_bounds(gain) == pytest.approx(worst)


@pytest.mark.parametrize("gain", [np.eye(2), np.full((3, 3), np.nan)])
def test_gains_of_the_wrong_size_are_refused(full, weights, gain):
    with pytest.raises(BadDesign, match="is not a finite 3 x 3 matrix"):
        performance.rate_feedback_index(full, gain, weights, performance.initial_states(full, 1))


def test_controllers_of_other_coils_are_refused(full, grid_models, law):
    with pytest.raises(BadDesign, match="the model has the coils"):
        performance.reduced_controller_loop(grid_models[0], law.model, law.F, law.K)
