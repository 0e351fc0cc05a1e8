"""Distributed micro-slip against the closed forms of a power-law density of limits, and against many sliders."""

import numpy as np
import pytest

from vlab.physics.catalogue import EFFECTS
from vlab.physics.effect import Step
from vlab.physics.native import SPRINGS
from vlab.physics.port_memory import SLIDERS, SPANS

LAW = EFFECTS["iwan-slip"]
FORCE, LIMIT = 3.0, 2e-3
EXPONENTS = [0.3, 0.6, 1.0]
"""Of joints: 0.1 to 0.9 (Segalman 2005, table 1, as 1 + chi); 1 is an even density of limits."""


def values(exponent, limit=LIMIT):
    return {"force": FORCE, "limit": limit, "exponent": exponent}


def first_loading(z, exponent, limit=LIMIT):
    """Return the closed form of the resisting force of a first loading."""
    s = np.minimum(np.abs(z) / limit, 1.0)
    return FORCE * ((1.0 + exponent) * s - s ** (1.0 + exponent)) / exponent * np.sign(z)


def resistance(motion, p):
    """Return the resisting force at every point of a motion from rest."""
    memory, out = LAW.memory(()), []
    for z in np.asarray(motion, dtype=float).tolist():
        force, memory = LAW.force(z, 0.0, p, Step(h=1.0), memory)
        out.append(-force)
    return np.array(out)


def loss(amplitude, p, n=100):
    """Return the energy of one settled cycle, by the trapezoid rule."""
    cycle = amplitude * np.concatenate([np.linspace(-1, 1, n), np.linspace(1, -1, n)])
    motion = np.concatenate([np.linspace(0, amplitude, n), np.linspace(amplitude, -amplitude, n), cycle])
    force = resistance(motion, p)[2 * n :]
    return float(np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(cycle)))


@pytest.mark.parametrize("exponent", EXPONENTS)
def test_the_first_loading_is_exact_where_ranges_of_limits_end(exponent):
    z = LIMIT * np.array([*SPANS, 1.5, 4.0])
    np.testing.assert_allclose(resistance(z, values(exponent)), first_loading(z, exponent), rtol=1e-12)


@pytest.mark.parametrize("exponent", EXPONENTS)
def test_the_loss_per_cycle_is_a_power_of_the_amplitude(exponent):
    share = np.geomspace(0.03, 1.0, 13)
    found = np.array([loss(s * LIMIT, values(exponent)) for s in share])
    expected = 4.0 * FORCE * LIMIT * share ** (2.0 + exponent) / (2.0 + exponent)
    slope = np.polyfit(np.log(share), np.log(found), 1)[0]
    assert slope == pytest.approx(2.0 + exponent, abs=0.04)  # ten sliders ripple about the power law
    assert np.sqrt(np.mean((found / expected - 1.0) ** 2)) < 0.08


@pytest.mark.parametrize("exponent", EXPONENTS)
def test_the_secant_stiffness_falls_with_the_amplitude(exponent):
    z = LIMIT * np.array(SPANS)
    expected = FORCE * ((1.0 + exponent) - (z / LIMIT) ** exponent) / (exponent * LIMIT)
    found = resistance(z, values(exponent)) / z
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    assert np.all(np.diff(found) < 0)


@pytest.mark.parametrize("exponent", EXPONENTS)
def test_reversals_follow_masings_rule(exponent):
    """A branch is the first loading at twice the scale, from wherever the motion turned."""
    top = 0.7 * LIMIT
    first = np.linspace(0.0, top, 50)[1:]
    down = np.linspace(top, -top, 99)[1:]
    force = resistance(np.concatenate([first, down]), values(exponent))
    own = resistance((top - down) / 2.0, values(exponent))
    np.testing.assert_allclose(force[len(first) :], force[len(first) - 1] - 2.0 * own, atol=1e-12 * FORCE)


def test_a_closed_inner_loop_leaves_no_trace():
    p, outer = values(0.6), np.array([0.8, -0.5, 0.4])
    inner = np.array([0.8, -0.5, 0.1, -0.2, 0.1, 0.4])
    assert resistance(LIMIT * inner, p)[-1] == pytest.approx(resistance(LIMIT * outer, p)[-1], rel=1e-12)


def test_the_whole_contact_slips_at_the_full_force():
    far = resistance(LIMIT * np.array([0.5, 1.0, 3.0, 2.9, 0.9, -5.0]), values(0.6))
    np.testing.assert_allclose(far[[1, 2, 5]], [FORCE, FORCE, -FORCE], rtol=1e-12)
    np.testing.assert_allclose(far[4], -FORCE, rtol=1e-12)  # 2 limits back from a turn the slip is whole again


@pytest.mark.parametrize("exponent", EXPONENTS)
def test_random_motion_gives_the_force_of_many_sliders(exponent):
    """Two thousand sliders with evenly spaced limits and the density itself, summed without a closed form."""
    motion = np.cumsum(np.random.default_rng(5).standard_normal(1500))
    motion *= 0.8 * LIMIT / np.abs(motion).max()
    limits = (np.arange(2000) + 0.5) / 2000 * LIMIT
    density = (1.0 + exponent) * FORCE / LIMIT * (limits / LIMIT) ** (exponent - 1.0) / 2000
    stretch, many = np.zeros(2000), []
    for step in np.diff(motion, prepend=0.0):
        stretch = np.clip(stretch + step, -limits, limits)
        many.append(stretch @ density)
    few = resistance(motion, values(exponent))
    assert np.std(few - np.array(many)) < 0.04 * np.std(many)  # what ten sliders leave of the density


def test_the_force_depends_on_the_way_not_on_the_speed():
    motion = LIMIT * np.cumsum(np.random.default_rng(2).standard_normal(200)) * 0.2
    between = np.interp(np.arange(0, 199.001, 0.25), np.arange(200), motion)
    np.testing.assert_allclose(
        resistance(between, values(0.6))[::4], resistance(motion, values(0.6)), atol=1e-12 * FORCE
    )


def test_a_large_exponent_is_one_slider():
    """All limits are then nearly the largest one: the law of a spring with one dry slider."""
    place, one = 0.0, []
    motion = LIMIT * np.array([0.5, 0.9, -0.5, 1.5, -2.0])
    for z in motion:
        stretch = np.clip(z - place, -LIMIT, LIMIT)
        place = z - stretch
        one.append(FORCE / LIMIT * stretch)
    np.testing.assert_allclose(resistance(motion, values(60.0)), one, atol=0.06 * FORCE)


def test_a_start_in_the_middle_of_a_motion_is_on_the_first_loading():
    """The screening and the fits begin in the middle of decays, where the past is unknown."""
    start = LIMIT * SPANS[-2]
    np.testing.assert_allclose(resistance([start], values(0.6)), first_loading(start, 0.6), rtol=1e-12)


def test_springs_of_mujoco_have_the_force_and_the_stiffness_of_the_law():
    springs = SPRINGS["iwan-slip"](values(0.6))
    assert len(springs) == SLIDERS
    assert sum(s.stiffness for s in springs) == pytest.approx(FORCE / LIMIT * 1.6 / 0.6)
    assert sum(s.stiffness * s.springyield for s in springs) == pytest.approx(FORCE)
