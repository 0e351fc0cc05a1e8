"""Noise of simulated recordings whose noise is known: from one record, from repeats, and as the case states."""

from dataclasses import replace

import numpy as np
import pytest
from null_rigs import CHAINS, RATE, autoregressive, chain_response, low_passed, pink, white
from rig_folder import multisine
from scipy.interpolate import CubicSpline
from synthetic import run_of

from vlab.diagnose.data.free_decay import without_decays
from vlab.diagnose.data.noise import estimate_noise, known_noise, noise_notes
from vlab.diagnose.data.noise_floor import even_floor
from vlab.diagnose.data.repeats import repeat_noise, with_repeats

CHAIN = CHAINS["carriages"]
SECONDS = 24.0
TIME = np.arange(int(SECONDS * RATE)) / RATE
SHARES = [0.001, 0.01]
"""Noise over the rms of the motion."""


def force(seed, high=12.0, period=SECONDS, ramp=0.5):
    sine = multisine(np.random.default_rng(seed), 0.5, high, period, 2.0)
    return sine(TIME) * np.minimum(TIME / ramp, 1.0)


def motion(u, lighter=1.0):
    """Position of the first carriage; damping by a factor."""
    return chain_response(CHAIN.m, CHAIN.k, CHAIN.c * lighter, u)[:, 0]


def through_the_structure(rng):
    """Motion under a force that nobody recorded, rms 1."""
    x = motion(rng.standard_normal(TIME.size))
    return x / np.std(x)


def estimated(u, y, time=TIME, kind="displacement"):
    return estimate_noise(run_of(time, {"x": y}, {"u": u}, kind=kind), "x")


@pytest.mark.parametrize("count", [64, 126, 127, 254, 255, 383, 766, 767, 1022, 1023])
def test_records_of_any_length_have_a_noise_floor(count):
    """Half of these spectra have a multiple of the number of groups of bins."""
    rng = np.random.default_rng(count)
    floor = even_floor(np.cumsum(rng.standard_normal(count)) + 0.01 * rng.standard_normal(count), None)
    assert 0.0 < floor.sigma < 2.0


# ---- one record -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("share", SHARES)
@pytest.mark.parametrize("what", ["white", "hum", "process", "short", "uneven"])
def test_white_noise_of_a_sensor_is_found_beside_anything_else(what, share):
    rng = np.random.default_rng(1)
    u = force(2)
    x = motion(u)
    noise = share * np.std(x)
    y, time = x + noise * rng.standard_normal(TIME.size), TIME
    if what == "hum":
        y = y + 3 * noise * np.sin(2 * np.pi * 50.1 * TIME)
    if what == "process":
        y = y + 2 * noise * through_the_structure(rng)
    if what == "short":
        u, y, time = u[:400], y[:400], time[:400]
    if what == "uneven":
        time = TIME + rng.uniform(-0.3, 0.3, TIME.size) / RATE
        time = time - time[0]
        y, u = CubicSpline(TIME, x)(time) + noise * rng.standard_normal(TIME.size), CubicSpline(TIME, u)(time)
    assert noise / 1.5 < estimated(u, y, time).sigma < 1.5 * noise


@pytest.mark.parametrize("share", SHARES)
@pytest.mark.parametrize("order", [0, 2])
def test_an_excitation_up_to_half_the_sample_rate_is_no_noise(order, share):
    """The response of a position falls towards the top of the spectrum, that of an acceleration does not."""
    u = force(3, high=124.5)
    x = motion(u)
    for _ in range(order):
        x = np.gradient(x, 1 / RATE)
    noise = share * np.std(x)
    y = x + noise * np.random.default_rng(4).standard_normal(TIME.size)
    found = estimated(u, y, kind="acceleration" if order == 2 else "displacement")
    assert noise / 1.5 < found.sigma < 1.5 * noise
    if order == 2:
        assert found.source in ("inputs", "innovations")


@pytest.mark.parametrize("integral", [0.0, 0.05])
@pytest.mark.parametrize("share", [0.003, 0.03])
@pytest.mark.parametrize(("levels", "count"), [(1, 3000), (2, 300), (30, 300)])
def test_a_command_that_answers_the_reading_explains_no_noise(levels, count, share, integral):
    """A speed loop around a first-order drive: the command holds the noise of the reading that it answers."""
    rng = np.random.default_rng(11)
    readings, commands = np.zeros((2, count))
    speed, total = 0.0, 0.0
    for i, wanted in enumerate(np.repeat(rng.uniform(0.5, 1.5, levels), count // levels)):
        readings[i] = speed + share * rng.standard_normal()
        total += integral * (wanted - readings[i])
        commands[i] = 2.0 * (wanted - readings[i]) + total
        speed += 0.05 * (commands[i] - 0.3 * speed)
    assert share / 1.2 < estimated(commands, readings, TIME[:count], kind="velocity").sigma < 1.2 * share


def test_motion_at_the_top_of_the_spectrum_is_no_noise_without_inputs():
    """A free decay sampled five times a period: its spectrum stands above the noise up to half the rate."""
    rng = np.random.default_rng(5)
    t = np.arange(3000)
    x = np.exp(-0.01 * t) * np.sin(0.41 * np.pi * t)
    noise = 1e-3 * np.std(x)
    found = estimate_noise(run_of(t / RATE, {"x": x + noise * rng.standard_normal(t.size)}), "x")
    assert found.sigma == pytest.approx(noise, rel=0.2)


@pytest.mark.parametrize("share", SHARES)
def test_rounding_is_noise_of_a_step_over_root_twelve(share):
    x = motion(force(6))
    step = np.sqrt(12) * share * np.std(x)
    assert estimated(force(6), step * np.round(x / step)).sigma == pytest.approx(share * np.std(x), rel=0.15)


def test_low_passed_noise_has_the_level_of_its_pass_band_and_its_own_rms():
    x = motion(force(7))
    noise = 0.01 * np.std(x)
    rng = np.random.default_rng(8)
    found = estimated(force(7), x + noise * low_passed(rng, TIME.size) + 0.01 * noise * rng.standard_normal(TIME.size))
    assert found.rms == pytest.approx(noise, rel=0.2)
    assert found.sigma == pytest.approx(noise / np.sqrt(0.3), rel=0.2)


@pytest.mark.parametrize("make", [pink, autoregressive])
def test_noise_of_one_record_is_a_lower_bound_for_red_noise(make):
    """Red noise in the band of the motion looks like missing physics in one record; repeats tell it (below)."""
    x = motion(force(9))
    noise = 0.01 * np.std(x)
    found = estimated(force(9), x + noise * make(np.random.default_rng(10), TIME.size))
    assert 0.1 * noise < found.rms < 1.1 * noise


# ---- repeats ----------------------------------------------------------------------------------------------------------

NOISES = {"white": white, "pink": pink, "red": autoregressive, "low-passed": low_passed}


def noise_of(kind, rng):
    return through_the_structure(rng) if kind == "process" else NOISES[kind](rng, TIME.size)


@pytest.mark.parametrize("share", SHARES)
@pytest.mark.parametrize("kind", [*NOISES, "process"])
def test_repeated_recordings_show_noise_of_any_colour(kind, share):
    rng = np.random.default_rng(11)
    u = force(12)
    x = motion(u)
    noise = share * np.std(x)
    runs = with_repeats([run_of(TIME, {"x": x + noise * noise_of(kind, rng)}, {"u": u}) for _ in range(3)])
    found = estimate_noise(runs[1], "x")
    assert (found.source, found.count) == ("recordings", 3)
    # the fit of free decays takes a part of what a mode shapes
    assert noise / (2.0 if kind == "process" else 1.3) < found.rms < 1.3 * noise
    assert found.sigma == found.rms


@pytest.mark.parametrize("lighter", [1.0, 0.1])
@pytest.mark.parametrize("kind", [*NOISES, "process"])
def test_periods_of_one_recording_show_noise_of_any_colour(kind, lighter):
    """The transient of the start is many times the noise in the last periods of a lightly damped chain.

    A mode that decays slower than a period shapes noise that looks like a transient.
    """
    u = force(13, period=SECONDS / 4)
    x = motion(u, lighter)
    noise = 0.002 * np.std(x)
    y = x + noise * noise_of(kind, np.random.default_rng(14))
    found = estimated(u, y)
    assert found.source == "periods"
    assert noise / (5.0 if kind == "process" else 1.5) < found.rms < 1.3 * noise


def test_recordings_of_other_inputs_are_no_repeats():
    runs = with_repeats([run_of(TIME, {"x": motion(force(k))}, {"u": force(k)}) for k in (15, 16)])
    assert not any(run.repeats for run in runs)
    assert repeat_noise(runs[0], "x") is None
    still = with_repeats([run_of(TIME, {"x": motion(force(15))}, {"u": 0.0 * TIME}) for _ in range(2)])
    assert not any(run.repeats for run in still)


@pytest.mark.parametrize(
    ("level", "noise", "same"), [(0.92, 0.0, False), (0.92, 0.02, False), (1.0, 0.02, True), (1.005, 0.02, True)]
)
def test_another_level_of_the_same_input_is_no_repeat(level, noise, same):
    rng = np.random.default_rng(3)
    u = force(15)
    inputs = [factor * u + noise * np.std(u) * rng.standard_normal(u.size) for factor in (1.0, level)]
    runs = with_repeats([run_of(TIME, {"x": motion(w)}, {"u": w}) for w in inputs])
    assert [bool(run.repeats) for run in runs] == [same, same]


def test_a_structure_that_changes_between_repeats_makes_no_noise():
    """A stiffness that drifts by 1 % moves the response by a hundred times the noise, in proportion to the input."""
    rng = np.random.default_rng(17)
    u = force(18)
    motions = [chain_response(CHAIN.m, k * CHAIN.k, CHAIN.c, u)[:, 0] for k in (1.0, 1.01)]
    noise = 1e-3 * np.std(motions[0])
    assert np.std(motions[1] - motions[0]) > 20 * noise
    runs = with_repeats([run_of(TIME, {"x": x + noise * rng.standard_normal(TIME.size)}, {"u": u}) for x in motions])
    found = estimate_noise(runs[0], "x")
    assert found.source not in ("recordings", "periods")
    assert found.rms == pytest.approx(noise, rel=0.2)


def test_the_response_to_a_slight_difference_of_the_inputs_is_no_noise():
    rng = np.random.default_rng(19)
    inputs = [force(20), force(20) + 0.02 * force(21)]
    noise = 1e-3 * np.std(motion(inputs[0]))
    runs = with_repeats(
        [run_of(TIME, {"x": motion(u) + noise * rng.standard_normal(TIME.size)}, {"u": u}) for u in inputs]
    )
    assert runs[0].repeats
    assert estimate_noise(runs[0], "x").rms == pytest.approx(noise, rel=0.2)


def test_samples_before_a_run_may_hold_the_other_periods():
    u = force(22, period=SECONDS / 4)
    x = motion(u)
    noise = 0.01 * np.std(x)
    whole = run_of(TIME, {"x": x + noise * np.random.default_rng(23).standard_normal(TIME.size)}, {"u": u})
    half = TIME.size // 4 * 3
    cut = replace(
        whole, measured=whole.measured.between(TIME[half], np.inf), before=whole.measured.between(-1.0, TIME[half])
    )
    assert estimate_noise(cut, "x").source == "periods"
    assert estimate_noise(cut, "x").rms == pytest.approx(noise, rel=0.2)
    assert not estimate_noise(replace(cut, before=None), "x").is_of_repeats


def test_noise_on_a_thinned_clock_is_that_below_its_half_rate():
    rng = np.random.default_rng(24)
    u = force(25)
    x = motion(u)
    noise = 0.01 * np.std(x)
    runs = with_repeats([run_of(TIME, {"x": x + noise * rng.standard_normal(TIME.size)}, {"u": u}) for _ in range(2)])
    found = known_noise(runs[0], "x", x, thin=4)
    assert found is not None
    assert found.sigma == pytest.approx(noise / 2, rel=0.2)


def test_free_decays_are_removed_to_rounding():
    t = np.arange(2000)
    x = np.exp(-0.002 * t) * np.cos(0.2 * t) + 3 * np.exp(-0.001 * t) * np.sin(0.21 * t)
    rng = np.random.default_rng(26)
    noise = 1e-6 * rng.standard_normal(t.size)
    assert np.std(without_decays(x + noise)) == pytest.approx(1e-6, rel=0.05)
    assert np.std(without_decays(noise)) == pytest.approx(1e-6, rel=0.05)


# ---- as stated --------------------------------------------------------------------------------------------------------


def stated(run, noise):
    return replace(run, compared=tuple(replace(c, noise=noise) for c in run.compared))


def test_stated_noise_counts_and_is_white():
    x = motion(force(27))
    run = stated(run_of(TIME, {"x": x}, {"u": force(27)}), 0.03 * np.std(x))
    found = estimate_noise(run, "x")
    assert (found.sigma, found.rms, found.source) == (0.03 * np.std(x), 0.03 * np.std(x), "stated")
    thinned = known_noise(run, "x", x, thin=9)
    assert thinned is not None
    assert thinned.sigma == pytest.approx(0.01 * np.std(x))


def test_notes_say_how_the_noise_was_got():
    x = motion(force(28))
    run = run_of(TIME, {"x": x}, {"u": force(28)})
    assert noise_notes([stated(run, 0.03 * np.std(x))], ["x"]) == ["noise of x: 3 % of its rms, as the case states"]
    assert noise_notes([run], ["x"]) == ["noise of x: 0.01 % of its rms, assumed, as the recording shows less"]


def test_a_sensor_that_reads_zero_throughout_has_the_least_noise():
    inputs = np.random.default_rng(3).standard_normal((4000, 1))
    for constant in (0.0, 1e-3):
        floor = even_floor(np.full(4000, constant), inputs)
        assert floor.source == "least"
        assert 0.0 < floor.sigma < 1.0
