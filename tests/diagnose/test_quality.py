"""Damage to recordings: what is lost, what stands at a limit, what is dead or a copy."""

import numpy as np
import pytest
from synthetic import run_of

from vlab.diagnose.data.mains_interference import find_mains_interference, remove_mains_interference
from vlab.diagnose.data.quality import assess_quality, is_informative, on_clock, sensor_limits
from vlab.diagnose.settings import DATA_FINDINGS
from vlab.recordings.quality import cut_off

TIME = np.arange(4000) / 500.0


def motion(seed=0):
    rng = np.random.default_rng(seed)
    return np.sin(2 * np.pi * 1.3 * TIME) + 0.3 * np.sin(2 * np.pi * 4.1 * TIME) + 1e-3 * rng.standard_normal(TIME.size)


def test_sound_recordings_have_no_damage():
    run = run_of(TIME, {"a": motion(), "b": motion(1)})
    assert assess_quality([run]).lines == ()
    assert is_informative(run, run.compared).all()
    assert sensor_limits([run]) == ()


def test_samples_at_a_sensors_limit_say_nothing_of_the_structure():
    a = np.clip(motion(), -1.0, 1.0)
    run = run_of(TIME, {"a": a, "b": motion(1)})
    valid = is_informative(run, run.compared)
    np.testing.assert_array_equal(valid[:, 0], np.abs(a) < 1.0)
    assert valid[:, 1].all()
    (stop,) = sensor_limits([run])
    assert stop.channel == "a"
    assert stop.limit == 1.0
    assert stop.share == pytest.approx(np.mean(np.abs(a) == 1.0))
    assert assess_quality([run]).fatal == ()


def test_a_coarse_reading_that_stands_still_at_the_top_of_a_small_motion_is_no_other_limit():
    loud = run_of(TIME, {"a": np.clip(motion(), -1.0, 1.0)}, name="loud")
    quiet = 0.3 * motion(1)
    top = int(np.argmax(quiet))
    quiet[top - 1 : top + 2] = quiet.max()
    (stop,) = sensor_limits([loud, run_of(TIME, {"a": quiet}, name="quiet")])
    assert stop.limit == 1.0


def test_a_range_that_is_reached_seldom_is_told_by_ends_that_agree():
    both = np.clip(motion(), -1.25, 1.25)  # a few samples at each end
    (stop,) = sensor_limits([run_of(TIME, {"a": both})])
    assert stop.tops == 2
    one = np.clip(motion() + 0.2, -2.0, 1.25)
    (stop,) = sensor_limits([run_of(TIME, {"a": one})])
    assert stop.tops == 1
    assert stop.beyond > DATA_FINDINGS.beyond  # but no smooth top is as long between ends as fast


def test_a_pause_at_the_farthest_pose_is_no_limit_where_a_holdout_goes_farther():
    paused = run_of(TIME, {"a": np.clip(motion() + 0.4, -2.0, 1.0)})
    assert [stop.limit for stop in sensor_limits([paused])] == [1.0]
    farther, nearer = (run_of(TIME, {"a": scale * motion(1), "b": motion(2)}, name="holdout") for scale in (1.0, 0.5))
    assert sensor_limits([paused], [farther]) == ()
    assert [stop.limit for stop in sensor_limits([paused], [nearer])] == [1.0]


def test_a_coarse_reading_of_a_smooth_top_would_have_gone_no_further():
    smooth = np.sin(2 * np.pi * 0.4 * TIME)
    coarse = 0.05 * np.round(smooth / 0.05)
    assert np.count_nonzero(coarse == coarse.max()) > 100
    assert cut_off(coarse, coarse == coarse.max()) < DATA_FINDINGS.beyond


def test_two_limits_that_differ_are_no_range():
    runs = [run_of(TIME, {"a": np.clip(motion(), -limit, limit)}, name=str(limit)) for limit in (0.8, 1.0)]
    assert sensor_limits(runs) == ()


def test_blocks_that_repeat_a_value_are_left_out():
    a = motion()
    a[1050:1170] = a[1049]
    run = run_of(TIME, {"a": a})
    valid = is_informative(run, run.compared)[:, 0]
    assert not valid[1050:1170].any()
    assert valid[:1050].all()
    assert valid[1170:].all()
    assert any("repeat the last value" in line for line in assess_quality([run]).warnings)


def test_a_recording_that_is_mostly_lost_says_nothing():
    a = motion()
    for first in range(100, 3900, 100):
        a[first : first + 40] = a[first]
    damage = assess_quality([run_of(TIME, {"a": a})])
    assert any("lost" in line for line in damage.fatal)


def test_a_clock_has_no_samples_in_a_gap():
    keep = (TIME < 3.0) | (TIME > 3.5)
    run = run_of(TIME[keep], {"a": motion()[keep]})
    grid = np.arange(1000) / 125.0
    valid = on_clock(run, is_informative(run, run.compared), grid)[:, 0]
    inside = (grid > 3.0) & (grid < 3.5)
    assert not valid[inside].any()
    assert valid[(grid < 2.98) | (grid > 3.52)].all()


def test_a_gap_may_explain_what_follows_it_alone():
    keep = (TIME < 3.0) | (TIME > 3.5)
    gap, sound = run_of(TIME[keep], {"a": motion()[keep]}, name="gap"), run_of(TIME, {"a": motion()}, name="sound")
    damage = assess_quality([gap, sound])
    assert any("gap" in line for line in damage.warnings)
    assert damage.since == {"gap": pytest.approx(3.0, abs=0.01)}


def test_dead_and_copied_sensors_are_fatal():
    still = run_of(TIME, {"a": motion(), "b": np.full(TIME.size, 0.2)})
    assert [line for line in assess_quality([still]).fatal if "b stands still" in line]
    twice = run_of(TIME, {"a": motion(), "b": motion()})
    assert [line for line in assess_quality([twice]).fatal if "same samples" in line]
    both = [still, run_of(TIME, {"a": motion(2), "b": motion(3)}, name="other")]
    assert not assess_quality(both).fatal  # it moves elsewhere


def test_hum_taken_off_hides_no_limit():
    buzz = 0.02 * np.sin(2 * np.pi * 50.0 * TIME)
    run = run_of(TIME, {"a": np.clip(motion() + buzz, -1.0, 1.0), "b": motion(1) + buzz})
    clean = remove_mains_interference(run, find_mains_interference([run]))
    assert not np.array_equal(clean.measured["a"], run.measured["a"])
    valid = is_informative(clean, run.compared)
    np.testing.assert_array_equal(valid, is_informative(run, run.compared))
    assert not valid[:, 0].all()
    np.testing.assert_array_equal(is_informative(clean, run.compared[1:]), valid[:, 1:])
