"""Coarse readings: found with their steps, and not where there are none."""

import numpy as np
import pytest
from synthetic import run_of

from vlab.diagnose.data.quantisation import sensor_steps

TIME = np.arange(6000) / 500.0


def motion(seed=0, noise=2e-3):
    rng = np.random.default_rng(seed)
    return sum(np.sin(2 * np.pi * f * TIME + p) for f, p in zip((0.7, 2.3, 5.1), rng.uniform(0, 6, 3), strict=True)) + (
        noise * rng.standard_normal(TIME.size)
    )


def rounded(y, step):
    return step * np.round(y / step)


@pytest.mark.parametrize("step", [0.03, 0.11, 0.5, 1.4])
def test_the_step_of_rounded_readings_is_found(step):
    runs = [run_of(TIME, {"a": rounded(motion(i), step), "b": motion(i)}, name=str(i)) for i in range(3)]
    (found,) = sensor_steps(runs)
    assert found.channel == "a"
    # values reach over 12 steps at least, and the peak of their characteristic function is a part of 1/12 wide
    assert found.step == pytest.approx(step, rel=2e-3)
    assert abs(found.step - step) < 4 * found.sd


def test_a_finer_converter_behind_the_coarse_one_is_in_the_interval():
    step, fine = 1.4, 0.011
    runs = [run_of(TIME, {"a": rounded(rounded(motion(i), step), fine)}, name=str(i)) for i in range(3)]
    (found,) = sensor_steps(runs)
    assert abs(fine * round(step / fine) - step) > 5e-4  # no number of finer steps is a coarse one
    assert abs(found.step - step) < 2 * found.sd < 0.01


def test_steps_are_found_beneath_noise_that_came_after_them():
    rng = np.random.default_rng(5)
    y = rounded(motion(), 0.2) + 0.03 * rng.standard_normal(TIME.size)
    (found,) = sensor_steps([run_of(TIME, {"a": rounded(y, 0.01)})])
    assert found.step == pytest.approx(0.2, rel=5e-3)


@pytest.mark.parametrize("seed", [0, 2, 3, 8, 9])
def test_a_drive_of_limited_speed_between_two_ends_is_not_quantised(seed):
    """The drive moves by about a fifth of the way in a sample, and stands at the ends most of the time."""
    rng, x, at = np.random.default_rng(seed), [], 0.0
    for end in (5.0, 0.0) * 4:
        x += [at] * 20
        while abs(end - at) > 1.2:
            at += np.sign(end - at) * rng.normal(0.96, 0.15)
            x.append(at)
        at = end
    x = np.array(x) + 0.02 * rng.standard_normal(len(x))
    assert sensor_steps([run_of(np.arange(len(x)) / 100.0, {"a": rounded(x, 0.01)})]) == ()


@pytest.mark.parametrize("step", [0.07, 0.3])
def test_a_joint_that_dwells_at_taught_positions_is_not_quantised(step):
    """A servo moves a joint from one multiple of an angle to the next, and stays there most of the time."""
    rng = np.random.default_rng(4)
    angle = np.zeros(TIME.size)
    for at in range(300, TIME.size, 300):
        behind = TIME[at:] - TIME[at]
        angle[at:] += step * rng.integers(-2, 3) * (1 - np.exp(-behind / 0.01) * (1 + behind / 0.01))
    assert sensor_steps([run_of(TIME, {"a": angle + 1e-3 * step * rng.standard_normal(TIME.size)})]) == ()
    (found,) = sensor_steps([run_of(TIME, {"a": rounded(motion(), step)})])
    assert found.step == pytest.approx(step, rel=5e-3)


def test_steps_are_found_beneath_hum():
    y = rounded(motion(), 0.2) + 0.02 * np.sin(2 * np.pi * 50.0 * TIME)
    (found,) = sensor_steps([run_of(TIME, {"a": y})])
    assert found.step == pytest.approx(0.2, rel=5e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    "y",
    [
        motion(),
        rounded(motion(), 1e-3),  # fine steps are what every converter has
        rounded(motion(noise=0.1), 0.05),  # noise over several steps
        np.where(motion() > 0, 1.0, -1.0),  # a switch
        np.where(TIME < 9.0, 0.0, motion()),  # still most of the time
        np.zeros_like(TIME),
        np.sin(2 * np.pi * 3.0 * TIME),
        np.exp(-0.3 * TIME) * np.sin(2 * np.pi * 3.0 * TIME),
        np.exp(-1.5 * TIME[:250]) * np.sin(2 * np.pi * 7.0 * TIME[:250]),
        np.exp(-3.0 * TIME) * np.sin(2 * np.pi * 7.0 * TIME) + 1e-3 * np.sin(20 * TIME),
        rounded(6.0 * np.cumsum(np.abs(TIME % 2.0 - 1.0) < 0.05) / 50.0, 3e-4),  # an axis driven from stop to stop
    ],
    ids=["smooth", "fine", "noisy", "switch", "still", "dead", "sine", "decay", "short decay", "decayed", "dwells"],
)
def test_readings_without_coarse_steps_have_none(y):
    assert sensor_steps([run_of(TIME[: len(y)], {"a": y})]) == ()
