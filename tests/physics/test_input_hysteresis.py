"""Prandtl-Ishlinskii hysteresis between command and force: closed forms, wiping out, gain and lag by level."""

import numpy as np
import pytest

from vlab.physics.actuator_memory import THRESHOLDS, WEIGHTS, play
from vlab.physics.catalogue import EFFECTS
from vlab.physics.small_signal import is_linear

LAW = EFFECTS["actuator-hysteresis"]
GROWTH, LIMIT = 0.04, 5.0
VALUES = {"growth": GROWTH, "limit": LIMIT}
H = 1e-3


def force(u, values=VALUES, h=H):
    return LAW.actuate(np.asarray(u, dtype=float), values, h)


def settled(amplitude, samples=4000):
    """Return the command and force of one settled cycle of a cosine."""
    u = amplitude * np.cos(2 * np.pi * np.arange(3 * samples) / samples)
    return u[2 * samples :], force(u)[2 * samples :]


def described(amplitude, samples=4000):
    """Return the complex gain of the first harmonic."""
    u, y = settled(amplitude, samples)
    turn = np.exp(-2j * np.pi * np.arange(samples) / samples)
    return (y @ turn) / (u @ turn)


def test_a_play_operator_follows_behind_its_width():
    u = np.array([0.3, 1.0, 2.0, 1.5, 0.5, -0.4, -3.0, 0.0])
    np.testing.assert_allclose(play(u, np.array([0.5]))[:, 0], [0.0, 0.5, 1.5, 1.5, 1.0, 0.1, -2.5, -0.5])
    assert play(np.zeros((1, 3)), np.array([0.5, 1.0])).shape == (1, 3, 2)


def test_a_signal_gives_the_play_of_sample_after_sample():
    u = np.cumsum(np.random.default_rng(1).standard_normal((777, 2)), axis=0)
    r = np.array([0.2, 1.0, 6.0, 1e3])
    now, one_by_one = np.zeros((2, 4)), []
    for x in u:
        now = np.minimum(np.maximum(now, x[:, None] - r), x[:, None] + r)
        one_by_one.append(now)
    np.testing.assert_array_equal(play(u, r), one_by_one)


def test_the_operators_share_all_thresholds():
    assert sum(WEIGHTS) == pytest.approx(1.0)
    assert np.dot(WEIGHTS, THRESHOLDS) == pytest.approx(0.5)  # the mean of an even density


def test_a_first_rise_is_rayleighs_parabola():
    """At ends of the operators' ranges the sum is exact; beyond the limit the slope is 1 + 2 g L."""
    ends = LIMIT * np.cumsum(WEIGHTS)
    for u in ends:
        assert force([u])[0] == pytest.approx(u + GROWTH * u * u, rel=1e-12)
    far = force([2 * LIMIT, 3 * LIMIT])
    assert np.diff(far)[0] == pytest.approx(LIMIT * (1.0 + 2.0 * GROWTH * LIMIT), rel=1e-12)


@pytest.mark.parametrize(("amplitude", "within"), [(0.5, 0.1), (1.25, 0.05), (2.5, 0.03), (5.0, 0.015)])
def test_the_loop_of_a_sinusoid_has_rayleighs_area(amplitude, within):
    """The area is 4/3 g A^3; the operators resolve fewer thresholds at low levels."""
    u, y = settled(amplitude)
    area = abs(0.5 * np.sum(u * np.roll(y, -1) - np.roll(u, -1) * y))
    assert area == pytest.approx(4.0 / 3.0 * GROWTH * amplitude**3, rel=within)


@pytest.mark.parametrize("amplitude", [1.25, 2.5, 5.0])
def test_gain_and_lag_are_those_of_rayleighs_law(amplitude):
    """The first harmonic has the gain 1 + g A in phase and 4 g A/(3 pi) behind."""
    gain = described(amplitude)
    assert gain.real == pytest.approx(1.0 + GROWTH * amplitude, rel=2e-3)
    assert -gain.imag == pytest.approx(4.0 * GROWTH * amplitude / (3.0 * np.pi), rel=0.05)


def test_gain_and_lag_grow_with_the_level_and_not_with_frequency():
    levels = [described(a) for a in (0.3, 1.0, 3.0)]
    assert np.all(np.diff(np.abs(levels)) > 0)
    assert np.all(np.diff(np.angle(levels)) < 0)
    assert described(3.0, 400) == pytest.approx(described(3.0, 4000), abs=1e-4)  # ten times the frequency


def test_the_law_is_rate_independent():
    way = np.cumsum(np.random.default_rng(3).standard_normal(300))
    y = force(way)
    np.testing.assert_array_equal(force(np.repeat(way, 3))[2::3], y)  # held three times as long
    between = np.interp(np.arange(0, 299.001, 0.25), np.arange(300), way)  # four times as slow
    np.testing.assert_allclose(force(between)[::4], y, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(force(way, h=17.0), y)


def test_a_larger_swing_wipes_out_smaller_ones():
    """Only the extremes that no later extreme exceeds are remembered (Madelung's rule)."""
    history = [1.0, -0.5, 0.7, -0.2, 0.4, 0.1]
    swept = [*history, 4.0, -3.0, 2.0]
    assert force(swept)[-1] == pytest.approx(force([4.0, -3.0, 2.0])[-1], rel=1e-12)
    loop = [4.0, -3.0, 1.0, -1.0, 1.0, 2.0]  # the inner loop closes and is forgotten
    assert force(loop)[-1] == pytest.approx(force([4.0, -3.0, 2.0])[-1], rel=1e-12)


def test_inner_loops_at_equal_levels_are_congruent():
    """An inner loop between two commands has one shape, whatever the past: the class of Prandtl and Ishlinskii."""
    low, high = -1.0, 1.0
    after_high = force([5.0, low, high, low])
    after_low = force([-5.0, high, low, high, low])
    assert after_high[2] - after_high[3] == pytest.approx(after_low[3] - after_low[4], rel=1e-12)
    assert after_high[3] != pytest.approx(after_low[4], rel=1e-3)


def test_small_commands_see_the_models_gain():
    assert described(1e-4 * LIMIT) == pytest.approx(1.0, abs=1e-12)
    assert not is_linear(LAW)
