"""The observer against a textbook Kalman filter and smoother, and its innovations where nothing is missing."""

import numpy as np
import pytest
import rig_oscillator
from rigs import oscillator_case
from scipy.linalg import expm

from vlab.cases import load_case
from vlab.diagnose.inference.score_test import ScoreTest
from vlab.diagnose.parameters.discrete import Discrete
from vlab.diagnose.predictors.kalman import filter_gains, run_filter
from vlab.diagnose.predictors.modal_problem import prepare

H, NOISE, INTENSITY = 0.01, np.array([2e-3, 0.3]), 4.0


def system():
    """Return two modes, seen as a displacement and as an acceleration, which the unknown force enters at once."""
    omega, zeta = np.array([12.0, 31.0]), np.array([0.02, 0.01])
    A = np.zeros((6, 6))
    A[:2, 2:4], A[2:4, :2], A[2:4, 2:4] = np.eye(2), -np.diag(omega**2), -np.diag(2 * zeta * omega)
    A[2:4, 4:] = np.eye(2)
    whole = expm(A * H)
    C = np.zeros((2, 4))
    C[0, :2] = [1.0, 0.6]
    C[1] = np.array([0.8, -0.5]) @ A[2:4, :4]
    D = np.array([[0.0, 0.0], [0.8, -0.5]])
    return Discrete(A=whole[None, :4, :4], B=whole[None, :4, 4:], C=C[None], D=D[None])


def data(n=160):
    """Return known forces and noisy channels of one run, (n, 1, 2) each."""
    s, rng = system(), np.random.default_rng(5)
    x, forces, y = rng.standard_normal(4) * [0.05, 0.02, 0.5, 0.5], rng.standard_normal((n, 1, 2)), np.zeros((n, 1, 2))
    for k in range(n):
        f = forces[k, 0] + np.sqrt(INTENSITY) * rng.standard_normal(2)
        y[k, 0] = s.C[0] @ x + s.D[0] @ f + NOISE * rng.standard_normal(2)
        x = s.A[0] @ x + s.B[0] @ f
    return forces, y


def textbook(forces, y, start):
    """Filter and smooth with the unknown force as part of the state, which leaves the noises uncorrelated.

    The measurement update, the prediction and the Rauch-Tung-Striebel recursion as in Anderson and Moore, Optimal
    Filtering; returns innovations, smoothed states and the log-likelihood without its constant.
    """
    s = system()
    F, G = np.zeros((6, 6)), np.vstack([s.B[0], np.zeros((2, 2))])
    F[:4] = np.hstack([s.A[0], s.B[0]])
    H_ = np.hstack([s.C[0], s.D[0]])
    Q = np.diag([0, 0, 0, 0, INTENSITY, INTENSITY]).astype(float)
    R = np.diag(NOISE**2)
    x, P = np.zeros(6), np.zeros((6, 6))
    P[:4, :4], P[4:, 4:] = start, INTENSITY * np.eye(2)
    e, predicted, filtered, loglik = [], [], [], 0.0
    for f, row in zip(forces, y, strict=True):
        predicted.append((x, P))
        e.append(row - H_ @ x - s.D[0] @ f)
        S = H_ @ P @ H_.T + R
        loglik -= 0.5 * (e[-1] @ np.linalg.solve(S, e[-1]) + np.log(np.linalg.det(S)))
        gain = P @ H_.T @ np.linalg.inv(S)
        x, P = x + gain @ e[-1], (np.eye(6) - gain @ H_) @ P
        filtered.append((x, P))
        x, P = F @ x + G @ f, F @ P @ F.T + Q
    smooth = [filtered[-1][0]]
    for k in range(len(y) - 2, -1, -1):
        (x, P), (ahead, P_ahead) = filtered[k], predicted[k + 1]
        smooth.insert(0, x + P @ F.T @ np.linalg.solve(P_ahead, smooth[0] - ahead))
    return np.array(e), np.array(smooth)[:, :4], np.array([f[0] for f in filtered])[:, :4], loglik


def test_filter_and_smoother_are_the_textbooks():
    forces, y = data()
    start = np.diag([0.01, 0.01, 1.0, 1.0])
    gains = filter_gains(system(), NOISE, INTENSITY, start)
    assert len(gains.K) > 20  # the transient counts
    ours = run_filter(system(), gains, forces, y, np.array([len(y)]))
    e, smooth, filtered, loglik = textbook(forces[:, 0], y[:, 0], start)
    # the gains stop changing at 1e-7 of the covariance
    np.testing.assert_allclose(ours.e[:, 0], e, atol=1e-5 * np.abs(e).max())
    for i in range(4):
        scale = np.abs(smooth[:, i]).max()
        np.testing.assert_allclose(ours.x[:, 0, i], smooth[:, i], atol=1e-4 * scale)
        # its own sample corrects the state by its measurement alone, as here: the force is another part of the state
        np.testing.assert_allclose(ours.filtered[:, 0, i], filtered[:, i], atol=1e-4 * scale)
    assert ours.loglik == pytest.approx(loglik, abs=1e-3)


def test_a_shorter_run_beside_a_longer_one_is_filtered_as_if_alone():
    forces, y = data()
    gains = filter_gains(system(), NOISE, INTENSITY, np.diag([0.01, 0.01, 1.0, 1.0]))
    alone = run_filter(system(), gains, forces[:70], y[:70], np.array([70]))
    both_f, both_y = np.repeat(forces, 2, axis=1), np.repeat(y, 2, axis=1)
    both_f[70:, 1], both_y[70:, 1] = 0.0, 0.0
    both = run_filter(system(), gains, both_f, both_y, np.array([len(y), 70]))
    np.testing.assert_allclose(both.x[:70, 1], alone.x[:, 0], rtol=1e-9, atol=1e-12)
    assert not np.any(both.e[70:, 1])


def test_no_other_intensity_is_more_likely_by_much():
    forces, y = data(1200)
    start, lengths = np.diag([0.01, 0.01, 1.0, 1.0]), np.array([1200])
    values = [
        run_filter(system(), filter_gains(system(), NOISE, INTENSITY * s, start), forces, y, lengths).loglik
        for s in (0.1, 1.0, 10.0)
    ]
    assert values[1] > max(values[0], values[2]) + 10  # the true one


def correlations(folder):
    """Return the innovations' largest correlations over lags 1 to 20, in standard deviations of white noise; variances."""
    screen = ScoreTest(prepare(load_case(folder)))
    (group,) = screen.groups
    e = np.einsum("pq,nrq->nrp", group.white, group.smoothed.e)[group.first :]
    e = (e - e.mean(axis=0)).reshape(len(e), -1)
    own = [[np.mean(c[lag:] * c[:-lag]) / np.mean(c**2) for lag in range(1, 21)] for c in e.T]
    return np.abs(own) * np.sqrt(len(e)), e.var(axis=0)


@pytest.mark.slow
def test_innovations_are_white_where_nothing_is_missing_and_are_not_where_something_is(tmp_path, monkeypatch):
    monkeypatch.setattr(rig_oscillator, "SECONDS", 3.0)
    oscillator_case(tmp_path / "null", benign=0.0)
    oscillator_case(tmp_path / "cubic", effect="cubic-stiffness", size=2.0, benign=0.0)
    white, variance = correlations(tmp_path / "null")
    # 180 correlations of white noise: one in ten such tables has one above 3.6 standard deviations
    assert white.max() < 4.5
    assert np.mean(white**2) == pytest.approx(1.0, abs=0.35)
    # The three runs' noise goes with their level, the filter has one for all of them; theirs is read off the spectra.
    assert np.mean(variance) == pytest.approx(1.0, abs=0.4)
    coloured, _ = correlations(tmp_path / "cubic")
    assert np.mean(coloured**2) > 2 * np.mean(white**2)
