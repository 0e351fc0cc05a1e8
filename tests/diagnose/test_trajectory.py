"""The linear system along a motion, and its filter and smoother beside one large linear regression."""

import dataclasses

import numpy as np
import pytest
import rig_swinging
from rig_swinging import driven_arm, swinging_pendulum
from scipy.stats import multivariate_normal
from test_trajectory_diagnosis import shorter

from vlab.cases import load_case
from vlab.diagnose.predictors.step_jacobian import Substeps
from vlab.diagnose.predictors.trajectory import (
    SystemBatch,
    filtered,
    gains_of,
    innovations,
    linearise_along,
    pad_and_stack,
    smoothed,
    smoothed_motions,
    stack,
    tuned,
)
from vlab.diagnose.predictors.trajectory_data import Motion
from vlab.diagnose.predictors.trajectory_problem import prepare_trajectory
from vlab.diagnose.settings import TRAJECTORY

INTENSITY = 0.3
LENGTHS = (9, 6)


# ---- a made-up system that varies -----------------------------------------------------------------------------------


def varying(lengths=LENGTHS, seed=0, direct=1.0) -> SystemBatch:
    """Return runs of one degree of freedom with two channels, whose matrices are drawn anew for every sample."""
    rng, n, r = np.random.default_rng(seed), max(lengths), len(lengths)
    alive = (np.arange(n)[:, None] < np.array(lengths)).astype(float)

    def drawn(*shape):
        return rng.standard_normal((n, r, *shape)) * alive.reshape(n, r, *(1,) * len(shape))

    A = 0.6 * drawn(2, 2)
    return SystemBatch(
        A=A,
        G=drawn(2, 1),
        fine_A=A,
        fine_G=drawn(2, 1),
        C=drawn(2, 2),
        D=direct * drawn(2, 1),
        M=np.full((n, r, 1, 1), 2.0),
        defect=0.3 * drawn(2),
        e=drawn(2),
        h=np.full((n, r), 0.01) * alive,
        lengths=np.array(lengths),
        spread=np.array([[0.7, 1.5]] * r),
        noise=np.array([0.2, 0.5]),
        usable=np.repeat(alive[:, :, None], 2, axis=2),
    )


def joint(s, r):
    """Return mean and covariance of a run's states and readings, by one linear map of start, forces and noise."""
    n = int(s.lengths[r])
    size = 2 + n + 2 * n  # start, a force for every sample, noise of both channels
    x, mean = np.zeros((2, size)), np.zeros(2)
    x[:, :2] = np.eye(2)
    states, readings, centres, seen = [], [], [], []
    for k in range(n):
        states.append(x.copy())
        centres.append(mean.copy())
        y = s.C[k, r] @ x
        y[:, 2 + k] += s.D[k, r, :, 0]
        y[:, 2 + n + 2 * k : 2 + n + 2 * k + 2] += np.eye(2)
        readings.append(y)
        seen.append(s.C[k, r] @ mean)
        x = s.A[k, r] @ x
        x[:, 2 + k] += s.G[k, r, :, 0]
        mean = s.A[k, r] @ mean - s.defect[k, r]
    variance = np.concatenate(
        [s.spread[r] ** 2, np.full(n, INTENSITY * s.M[0, r, 0, 0]), np.tile(s.noise**2, n)]
    )  # a force in units of the inertia
    S, Y = np.concatenate(states), np.concatenate(readings)
    return (
        np.concatenate(centres),
        np.concatenate(seen),
        (S * variance) @ S.T,
        (S * variance) @ Y.T,
        (Y * variance) @ Y.T,
    )


@pytest.mark.parametrize("direct", [0.0, 1.0])
@pytest.mark.parametrize("run", [0, 1])
def test_smoothed_states_are_those_of_one_large_regression(run, direct):
    s = varying(direct=direct)
    gains = gains_of(s, INTENSITY)
    found = smoothed(s, gains, *innovations(s, gains))
    n = LENGTHS[run]
    x, y, _, cross, cov = joint(s, run)
    exact = x + cross @ np.linalg.solve(cov, s.e[:n, run].ravel() - y)
    np.testing.assert_allclose(found[:n, run], exact.reshape(n, 2), atol=1e-8)


@pytest.mark.parametrize("run", [0, 1])
def test_filtered_and_predicted_states_know_the_samples_so_far_and_no_more(run):
    s = varying(direct=0.0)
    gains = gains_of(s, INTENSITY)
    left, predicted = innovations(s, gains)
    own = filtered(s, gains, left, predicted)
    x, y, states, cross, cov = joint(s, run)
    e = s.e[: LENGTHS[run], run].ravel()
    for k in range(LENGTHS[run]):
        here = slice(2 * k, 2 * k + 2)
        for found, known in ((own, 2 * k + 2), (predicted, 2 * k)):
            gain = cross[here, :known] @ np.linalg.pinv(cov[:known, :known]) if known else np.zeros((2, 0))
            np.testing.assert_allclose(found[k, run], x[here] + gain @ (e - y)[:known], atol=1e-8)
        gain = cross[here, : 2 * k] @ np.linalg.pinv(cov[: 2 * k, : 2 * k]) if k else np.zeros((2, 0))
        spread = states[here, here] - gain @ cross[here, : 2 * k].T
        np.testing.assert_allclose(gains.P[k, run], spread, atol=1e-8)


@pytest.mark.parametrize("direct", [0.0, 1.0])
def test_innovations_are_as_likely_as_the_readings(direct):
    """Their covariances are independent of each other, so the logarithms of their densities add up."""
    s = varying(direct=direct)
    gains = gains_of(s, INTENSITY)
    left, _ = innovations(s, gains)
    for run, n in enumerate(LENGTHS):
        _, y, _, _, cov = joint(s, run)
        whole = multivariate_normal(y, cov).logpdf(s.e[:n, run].ravel())
        parts = [multivariate_normal(np.zeros(2), gains.S[k, run]).logpdf(left[k, run]) for k in range(n)]
        assert sum(parts) == pytest.approx(whole, abs=1e-8)


def test_intensities_side_by_side_are_those_of_each_alone():
    s, several = varying(), np.array([0.01, 0.3, 5.0])
    together = gains_of(s, several[:, None])
    left, predicted = innovations(s, together)
    for i, intensity in enumerate(several):
        alone = gains_of(s, intensity)
        np.testing.assert_allclose(together.K[:, i], alone.K, atol=1e-10)
        own = innovations(s, alone)
        np.testing.assert_allclose(left[:, i], own[0], atol=1e-10)
        np.testing.assert_allclose(predicted[:, i], own[1], atol=1e-10)


def test_a_sample_that_says_nothing_is_as_good_as_one_of_endless_noise():
    s = varying(direct=0.0)
    usable = s.usable.copy()
    usable[3, 0] = 0.0
    gains = gains_of(s, INTENSITY)
    left, _ = innovations(dataclasses.replace(s, usable=usable), gains)
    np.testing.assert_array_equal(left[3, 0], 0.0)
    other = s.e.copy()
    other[3, 0] = 1e9
    ignored, _ = innovations(dataclasses.replace(s, usable=usable), gains, other)
    np.testing.assert_array_equal(ignored, left)


# ---- the intensity --------------------------------------------------------------------------------------------------


def shaken(intensity, size=1.0, n=400) -> SystemBatch:
    """Return a mass on a spring that an unknown force of some intensity shakes, seen with noise."""
    rng, h = np.random.default_rng(4), 0.02
    A, G = np.array([[1.0, h], [-30.0 * h, 1.0 - 0.5 * h]]), np.array([[h * h / 4.0], [h / 2.0]])
    x, e = np.zeros(2), np.zeros((n, 1, 1))
    for k in range(n):
        e[k, 0] = x[:1] + 1e-4 * rng.standard_normal()
        x = A @ x + G[:, 0] * np.sqrt(2.0 * intensity) * rng.standard_normal()
    whole = {
        name: np.broadcast_to(v, (n, 1, *v.shape)) for name, v in (("A", A), ("G", G), ("fine_A", A), ("fine_G", G))
    }
    return SystemBatch(
        **whole,
        C=np.broadcast_to(np.array([[1.0, 0.0]]), (n, 1, 1, 2)),
        D=np.zeros((n, 1, 1, 1)),
        M=np.full((n, 1, 1, 1), 2.0),
        defect=np.zeros((n, 1, 2)),
        e=size * e,
        h=np.full((n, 1), h),
        lengths=np.array([n]),
        spread=size * np.full((1, 2), 1e-3),
        noise=size * np.array([1e-4]),
        usable=np.ones((n, 1, 1)),
    )  # fmt: skip


@pytest.mark.parametrize("intensity", [0.03, 3.0])
def test_the_likeliest_intensity_is_the_true_one(intensity):
    """Of four hundred samples it is known to some tenths of a decade, which is as fine as it is sought."""
    found = tuned(shaken(intensity))
    assert abs(np.log10(found / intensity)) < 0.5
    assert abs(np.log10(tuned(shaken(intensity), near=found) / intensity)) < 0.5


def test_an_intensity_goes_with_the_square_of_the_motion():
    assert tuned(shaken(0.3, size=100.0)) == pytest.approx(1e4 * tuned(shaken(0.3)), rel=1e-9)


# ---- runs side by side ----------------------------------------------------------------------------------------------


def test_shorter_runs_end_in_zeros():
    parts = [np.ones((3, 2)), np.full((5, 2), 2.0)]
    out = pad_and_stack(parts)
    assert out.shape == (5, 2, 2)
    for i, part in enumerate(parts):
        np.testing.assert_array_equal(out[: len(part), i], part)
        np.testing.assert_array_equal(out[len(part) :, i], 0.0)


# ---- along a motion -------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """Return the driven arm of two links: a course of 120 samples, its stepper, and its motion."""
    folder = tmp_path_factory.mktemp("arm")
    driven_arm(folder)
    case = shorter(load_case(folder), 120)
    problem, moving = prepare_trajectory(case)
    stepper = moving.stepper(problem.plant, problem.channels)
    stepper.take(Substeps(count=4))
    return moving, stepper


def test_a_motion_of_the_model_itself_has_no_defect(arm):
    moving, stepper = arm
    trajectory = moving.trajectories[0]
    q, v = [np.array([0.4, -0.7])], [np.array([1.0, 2.0])]
    for k in range(len(trajectory) - 1):
        after = stepper.advance(q[-1], v[-1], *trajectory.inputs(k), float(trajectory.h[k]))
        q.append(after[0])
        v.append(after[1])
    motion = Motion(q=np.array(q), v=np.array(v))
    along = linearise_along(trajectory, motion, stepper, moving.driven)
    np.testing.assert_allclose(along.defect, 0.0, atol=1e-12)
    np.testing.assert_allclose(along.read, motion.q, atol=1e-12)  # its sensors are its joints
    s = stack([trajectory], [along])
    gains = gains_of(s, 1e-3)
    left, predicted = innovations(s, gains, np.zeros_like(s.e))
    np.testing.assert_allclose(left, 0.0, atol=1e-9)
    np.testing.assert_allclose(predicted, 0.0, atol=1e-9)


def test_deviations_from_a_motion_follow_the_model(arm):
    """To first order: of a tenth of the deviation a hundredth of what is missed is left."""
    moving, stepper = arm
    trajectory, motion = moving.trajectories[2], moving.motions[2]
    along = linearise_along(trajectory, motion, stepper, moving.driven)
    rng = np.random.default_rng(2)
    for k in range(5, 115, 10):
        u, load, h = *trajectory.inputs(k), float(trajectory.h[k])
        here = stepper.advance(motion.q[k], motion.v[k], u, load, h)
        move, push = rng.standard_normal(4), np.diag(along.M[k]) * rng.standard_normal(2)

        def miss(size, k=k, here=here, move=move, push=push, u=u, load=load, h=h):
            q, v = motion.q[k] + size * move[:2], motion.v[k] + size * move[2:]
            there = stepper.advance(q, v, u, load, h, push=size * push)
            change = np.concatenate([there[0] - here[0], there[1] - here[1]])
            return np.abs(change - size * (along.A[k] @ move + along.G[k] @ push)).max() / size

        assert miss(1e-3) < 0.02 * np.abs(along.A[k] @ move).max()
        np.testing.assert_allclose(along.defect[k, :2], motion.q[k + 1] - here[0], atol=1e-12)
        np.testing.assert_allclose(along.defect[k, 2:], motion.v[k + 1] - here[1], atol=1e-12)


def test_a_sample_interval_is_its_equal_parts_one_after_the_other(arm):
    moving, stepper = arm
    along = linearise_along(moving.trajectories[0], moving.motions[0], stepper, moving.driven)
    power = np.array([np.linalg.matrix_power(a, TRAJECTORY.fine) for a in along.fine_A])
    np.testing.assert_allclose(along.A, power, atol=1e-12)
    held = sum(np.linalg.matrix_power(along.fine_A[7], i) @ along.fine_G[7] for i in range(TRAJECTORY.fine))
    np.testing.assert_allclose(along.G[7], held, atol=1e-14)
    np.testing.assert_allclose(along.drives, np.broadcast_to(np.eye(2), along.drives.shape), rtol=1e-4, atol=1e-4)
    first = moving.motions[0].q[0]  # two rods: the inertia about both joints, written out
    m12 = 0.006 + 0.7 * 0.15**2 + 0.7 * 0.4 * 0.15 * np.cos(first[1])
    assert along.M[0, 0, 1] == pytest.approx(m12, rel=1e-4)


def test_smoothing_brings_a_motion_nearer_to_the_true_one(tmp_path, monkeypatch):
    """From a first guess that noise of two hundredths has bent; the model lacks nothing."""
    monkeypatch.setattr(rig_swinging, "BENIGN", 0.0)
    swinging_pendulum(tmp_path, noise=0.01)
    problem, moving = prepare_trajectory(shorter(load_case(tmp_path), 150))
    stepper = moving.stepper(problem.plant, problem.channels)
    rng = np.random.default_rng(0)
    bent = [Motion(q=m.q + 0.02 * rng.standard_normal(m.q.shape), v=m.v + 0.2 * rng.standard_normal(m.v.shape))
            for m in moving.motions]  # fmt: skip
    systems, s, gains, intensity = smoothed_motions(moving.trajectories, bent, stepper, moving.driven, 1)
    for along, trajectory, first in zip(systems, moving.trajectories, bent, strict=True):
        energy = _energy(along.motion.q[:, 0], along.motion.v[:, 0])
        was = _energy(first.q[:, 0], first.v[:, 0])
        assert np.std(np.diff(energy)) < 0.1 * np.std(np.diff(was))  # a pendulum keeps nearly all of it
        assert np.std(along.motion.q[:, 0] - trajectory.y[:, 0]) < 1.2 * trajectory.noise[0]
    assert intensity > 0
    assert gains.K.shape[:2] == s.e.shape[:2]


def _energy(angle, rate):
    """Return the energy of the pendulum over its weight's moment: 0.4 kg at 0.5 m, a ball of 3 cm."""
    inertia = 0.4 * (0.5**2 + 0.4 * 0.03**2)
    return 0.5 * inertia * rate**2 - 0.4 * 9.80665 * 0.5 * np.cos(angle)
