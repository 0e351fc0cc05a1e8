"""Growth of errors along a motion beside closed forms, and diagnoses of links that cannot stand by themselves."""

from types import SimpleNamespace

import numpy as np
import pytest
from rig_upright import GROWTH, PLACE, SECONDS, standing_link
from scipy.linalg import expm

from vlab.cases import load_case
from vlab.diagnose.inference.trajectory_score_test import TrajectoryScoreTest
from vlab.diagnose.pipeline import diagnose
from vlab.diagnose.predictors.error_growth import error_growth, parts_within_growth
from vlab.diagnose.predictors.trajectory_problem import prepare_trajectory
from vlab.diagnose.settings import ERROR_GROWTH
from vlab.diagnose.validation.horizon import length_of_parts, parts_within
from vlab.signals import Channel, Recording

H, N = 0.005, 1600


def system(*squares):
    """Return independent coordinates z'' = s z over N steps of H."""
    nv = len(squares)
    step = expm(H * np.block([[np.zeros((nv, nv)), np.eye(nv)], [np.diag(squares), np.zeros((nv, nv))]]))
    motion = SimpleNamespace(v=np.sin(np.arange(N) * 0.01)[:, None] * np.arange(1, nv + 1))
    return SimpleNamespace(A=np.repeat(step[None], N, axis=0), M=np.zeros((N, nv, nv)), motion=motion)


@pytest.mark.parametrize("count", [1, 4, 16])
def test_errors_about_an_unstable_equilibrium_grow_as_a_hyperbolic_cosine(count):
    rate = 4.0
    assert error_growth(system(rate**2), count) == pytest.approx(np.cosh(rate * N * H / count), rel=1e-9)


def test_errors_of_oscillations_and_free_masses_do_not_grow():
    assert error_growth(system(-900.0, 0.0), 1) == pytest.approx(1.0)
    assert parts_within_growth(system(-900.0, 0.0)) == 1


def test_slow_growth_leaves_a_recording_whole():
    assert parts_within_growth(system(0.7**2)) == 1  # cosh(5.6) = 135 stays below 1/0.002


@pytest.mark.slow
def test_parts_are_the_longest_within_two_e_foldings():
    count = parts_within_growth(system(4.0**2, -100.0))
    assert np.cosh(4.0 * N * H / count) <= ERROR_GROWTH.most < np.cosh(4.0 * N * H / (count - 1))


@pytest.mark.slow
def test_parts_stay_long_enough_for_a_state_of_their_own():
    assert parts_within_growth(system(40.0**2)) == N // 100


def test_a_recording_is_cut_at_its_horizon():
    channel = Channel(name="angle", kind="angle", unit="rad")
    recorded = Recording(time=np.arange(801) * 0.01, data=np.zeros((801, 1)), channels=(channel,))
    run = SimpleNamespace(measured=recorded)
    assert [parts_within(run, s) for s in (np.inf, 8.0, 3.0, 1.0, 0.01)] == [1, 1, 3, 8, 8]
    assert length_of_parts(run, 4) == pytest.approx(2.0)
    assert length_of_parts(run, 1) == np.inf


@pytest.mark.slow
def test_a_standing_link_is_predicted_in_parts(tmp_path):
    standing_link(tmp_path)
    screen = TrajectoryScoreTest(*prepare_trajectory(load_case(tmp_path)))
    horizon = screen.problem.horizon_s
    assert 1.0 < GROWTH * horizon < 4.0
    assert max(screen.part_counts) == round(SECONDS / horizon)


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.0, 0.15])
def test_torques_of_a_standing_link_show_its_friction_and_nothing_else(tmp_path, friction):
    standing_link(tmp_path, friction)
    got = diagnose(load_case(tmp_path)).diagnosis
    if not friction:
        assert got.verdict == "nothing-missing"
        return
    assert [f.place for f in got.findings] == [PLACE]
    assert got.findings[0].family == "friction"
    assert got.findings[0].parameters["force"]["value"] == pytest.approx(friction, rel=0.05)
    assert all(c.after < 0.3 * c.start for c in got.checked)
