"""Black boxes on systems with closed forms, and the errors that are printed beside them."""

import numpy as np
import pytest

from vlab.proof.real.black_box import PER_PERIOD, choose_linear, choose_nonlinear, prepared
from vlab.proof.real.errors import errors_of
from vlab.proof.real.kernels import normal_equations
from vlab.proof.real.state_space import Model, Samples, estimated_start, fit
from vlab.proof.real.subspace import fit_linear, observability

RATES = np.array([[0.9, 0.3, 0.0], [-0.3, 0.9, 0.1], [0.0, 0.0, 0.7]])
"""RATES: step of a linear system with poles 0.9 +- 0.3i and 0.7."""


def samples_of(u, y):
    return Samples(u=u, y=y, weight=np.ones_like(y) / np.std(y, axis=0) / np.sqrt(y.size))


def linear_system():
    random = np.random.default_rng(3)
    return Model(
        A=RATES,
        B=random.normal(size=(3, 2)),
        C=random.normal(size=(2, 3)),
        D=random.normal(size=(2, 2)),
        y0=np.array([0.3, -0.2]),
    )


def driven(model, count, seed):
    random = np.random.default_rng(seed)
    u = random.normal(size=(count, model.B.shape[1]))
    return samples_of(u, model.simulated(random.normal(size=model.order), u))


def decay(count, start):
    """Two free modes, 0.05 and 0.13 cycles a sample, as closed forms."""
    k = np.arange(count)[:, None]
    modes = [
        np.exp(-d * k) * np.cos(2 * np.pi * f * k + p)
        for (f, d), p in zip(((0.05, 0.004), (0.13, 0.01)), start, strict=True)
    ]
    y = np.hstack([modes[0] + 0.5 * modes[1], modes[0] - 0.8 * modes[1]])
    return samples_of(np.zeros((count, 0)), y)


def duffing(count, seed, size):
    """Symplectic steps of x'' + 0.1 x' + x + x^3 = u."""
    random, (x, v), y = np.random.default_rng(seed), (0.0, 0.0), []
    u = size * random.normal(size=(count, 1))
    for force in u[:, 0]:
        y.append(x)
        v += 0.1 * (force - x - 0.1 * v - x**3)
        x += 0.1 * v
    return samples_of(u, np.array(y)[:, None])


def relative(model, own, window=40):
    y = model.simulated(estimated_start(model, own, window), own.u)
    return float(np.sqrt(np.mean((y - own.y) ** 2)) / np.std(own.y))


def test_a_linear_system_is_recovered_from_two_recordings():
    true = linear_system()
    recordings = [driven(true, 600, 1), driven(true, 500, 2)]
    found = fit_linear(observability(recordings, 8), recordings, 3, steps=40).model
    poles = np.sort_complex(np.linalg.eigvals(found.A))
    assert poles == pytest.approx(np.sort_complex(np.linalg.eigvals(RATES)), abs=1e-6)
    gain = true.C @ np.linalg.solve(np.eye(3) - RATES, true.B) + true.D
    assert found.C @ np.linalg.solve(np.eye(3) - found.A, found.B) + found.D == pytest.approx(gain, abs=1e-6)
    assert relative(found, driven(true, 400, 3)) < 1e-6


def test_free_decays_are_predicted_from_their_first_samples():
    chosen = choose_linear([decay(400, (0.0, 0.4)), decay(500, (1.0, 2.0))])
    assert chosen.model.order == 4
    assert relative(chosen.model, decay(600, (0.3, -1.0)), window=30) < 1e-6


def test_the_order_of_a_driven_system_is_chosen_on_unseen_samples():
    chosen = choose_linear([driven(linear_system(), 900, 5)])
    assert chosen.model.order == 3


def test_the_nonlinear_model_follows_a_duffing_oscillator_that_no_linear_one_does():
    recordings = [duffing(800, 1, 1.0), duffing(800, 2, 2.0)]
    linear = choose_linear(recordings)
    nonlinear = choose_nonlinear(recordings, linear)
    unseen = duffing(800, 5, 1.5)
    assert relative(linear.model, unseen) > 0.3
    assert relative(nonlinear.model, unseen) < 0.1


def test_hyperbolic_tangents_begin_without_effect():
    true = linear_system()
    own = driven(true, 200, 7)
    wide = true.with_units(4, np.ones(5), seed=1)
    start = np.array([0.1, -0.2, 0.3])
    assert wide.simulated(start, own.u) == pytest.approx(true.simulated(start, own.u), abs=1e-12)


def test_the_normal_equations_are_those_of_finite_differences():
    random = np.random.default_rng(11)
    model = linear_system().with_units(2, np.ones(5), seed=2)
    model = model.with_vector(model.vector + 0.1 * random.normal(size=model.vector.size))
    own, start = driven(linear_system(), 60, 9), 0.1 * random.normal(size=3)
    _, right, cost = normal_equations(*model.parts, start, own.u, own.y, own.weight)

    def error(vector, x0):
        left = own.weight * (own.y - model.with_vector(vector).simulated(x0, own.u))
        return float(np.sum(left**2))

    assert cost == pytest.approx(error(model.vector, start), rel=1e-12)
    step, slopes = 1e-6, []
    for i in range(model.vector.size):
        move = step * np.eye(model.vector.size)[i]
        slopes.append((error(model.vector + move, start) - error(model.vector - move, start)) / (2 * step))
    of_start = [
        (error(model.vector, start + step * e) - error(model.vector, start - step * e)) / (2 * step) for e in np.eye(3)
    ]
    before = 9 + 6 + 6 + 10 + 2  # A, B, W, V, b
    expected = np.array([*slopes[:before], *of_start, *slopes[before:]])
    assert -2.0 * right == pytest.approx(expected, rel=1e-5, abs=1e-8 * np.abs(expected).max())


def test_a_run_that_grows_without_bound_has_diverged():
    model = Model(A=np.array([[1.5]]), B=np.ones((1, 1)), C=np.ones((1, 1)), D=np.zeros((1, 1)), y0=np.zeros(1))
    y = model.simulated(np.ones(1), np.zeros((100, 1)))
    assert np.isnan(y[-1, 0])
    own = samples_of(np.zeros((100, 1)), np.sin(np.arange(100.0))[:, None])
    assert fit(model, [own], [np.ones(1)], steps=3).cost == np.inf


# ---- on a case ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def carriage():
    """An arm's slide on a spring, driven at 200 Hz; two recordings to fit and one held out."""
    from vlab import Case

    xml = """<mujoco><option timestep="0.001" gravity="0 0 0"/><worldbody><body><joint name="x" type="slide" axis="1 0 0"
    stiffness="400" damping="0.8"/><geom size="0.1" mass="1"/></body></worldbody><actuator><motor name="push" joint="x"/>
    </actuator><sensor><jointpos name="position" joint="x"/></sensor></mujoco>"""
    t = np.arange(0, 6, 0.005)
    forces = [np.sin(2 * np.pi * f * t + p) + 0.5 * np.sin(7.0 * t**1.3) for f, p in ((1.0, 0), (2.5, 1), (1.7, 2))]
    from scipy.signal import StateSpace, lsim

    system = StateSpace([[0, 1], [-400, -0.8]], [[0], [1]], [[1, 0]], [[0]])
    readings = [lsim(system, force, t)[1] for force in forces]
    return Case.from_arrays(
        xml,
        [t] * 3,
        [{"push": f} for f in forces],
        [{"position": y} for y in readings],
        holdout=[2],
        initial="estimated",
    )


def test_errors_are_those_of_the_diagnosis(carriage):
    from vlab.diagnose.validation.simulation import ExtendedModel, check

    (run,) = carriage.runs(("holdout",))
    (checked,) = check([run], ExtendedModel(plant=carriage.plant), None)
    found = errors_of(run, checked.simulated[1], skip=100)
    assert found.nrmse == pytest.approx(checked.calibrated, rel=1e-12)
    (channel,) = found.channels
    left = (checked.simulated[1][channel] - run.measured[channel])[100:]
    assert found.absolute[channel] == pytest.approx(np.sqrt(np.mean(left**2)), rel=1e-12)
    assert found.size[channel] == pytest.approx(np.sqrt(np.mean(run.measured[channel][100:] ** 2)), rel=1e-12)
    assert errors_of(run, None).nrmse == np.inf


@pytest.mark.slow
def test_the_black_boxes_of_a_linear_carriage_predict_the_hold_out(carriage):
    from vlab.proof.real.black_box import black_boxes

    found = black_boxes(carriage, {})
    assert found["linear"]["nrmse"] < 0.01
    assert found["linear"]["order"] <= 4
    assert found["nonlinear"]["nrmse"] < 0.05
    again = black_boxes(carriage, {"recording3": 2})  # in two parts, each from a state of its own
    assert again["linear"]["nrmse"] < 0.01


def test_recordings_are_thinned_to_their_motion(carriage):
    data = prepared(carriage)
    assert data.period_s <= 1.0 / (PER_PERIOD * 3.0)
    own = data.samples(data.fit[0])
    assert own.u.shape[0] == own.y.shape[0] >= 400
    mean = float(np.mean(data.fit[0].measured["push"]))
    assert float(np.mean(own.u)) * data.force[0] == pytest.approx(mean, abs=0.01)
