"""Hum: found where it is, at its size, and not where something else looks like it."""

import numpy as np
import pytest
from scipy import signal
from synthetic import run_of

from vlab.diagnose.data.mains_interference import find_mains_interference, remove_mains_interference

RATE, SECONDS = 1000.0, 20.0
TIME = np.arange(round(RATE * SECONDS)) / RATE


def response(rng, frequency=7.0, zeta=0.01):
    """Return white noise through a resonator, rms 1."""
    w = 2 * np.pi * frequency
    system = signal.cont2discrete(([w**2], [1, 2 * zeta * w, w**2]), 1 / RATE)
    x = signal.lfilter(np.ravel(system[0]), system[1], rng.standard_normal(TIME.size))
    return x / x.std()


def hum(amplitude, frequency, phase):
    return amplitude * np.sin(2 * np.pi * frequency * TIME + phase)


def test_hum_is_found_at_its_frequency_and_size_whatever_its_phase():
    rng = np.random.default_rng(1)
    clean = [response(rng) for _ in range(3)]
    runs = [
        run_of(TIME, {"a": x + hum(0.05, 49.93, 6 * rng.random()) + hum(0.01, 149.79, 6 * rng.random())}) for x in clean
    ]
    (found,) = find_mains_interference(runs)
    assert found.frequency == pytest.approx(
        49.93, abs=0.01
    )  # the window resolves 0.1 Hz in 20 s, its peak a tenth of it
    assert found.harmonics == (1, 3)
    # the response itself has a little power there: some per cent of so small a line
    assert found.rms == pytest.approx(np.hypot(0.05, 0.01) / np.sqrt(2), rel=0.03)
    for run, x in zip(runs, clean, strict=True):
        left = remove_mains_interference(run, [found]).measured["a"] - x
        assert left.std() < 0.1 * found.rms  # what the response itself has in the bins of the window


def test_hum_far_below_slow_motion_is_found():
    """A closed loop at 2.8 Hz moves five hundred times as far: 50 Hz less that is near three times the rate that the band is thinned to."""
    for jitter in (0.0, 2e-4):
        time = TIME + jitter * np.random.default_rng(4).uniform(-1.0, 1.0, TIME.size)
        time -= time[0]
        slow = np.sin(2 * np.pi * 2.8 * time) + 0.3 * np.sin(2 * np.pi * 18.2 * time + 1.0)
        (found,) = find_mains_interference([run_of(time, {"a": slow + 0.002 * np.sin(2 * np.pi * 50.02 * time + 0.3)})])
        assert found.frequency == pytest.approx(50.02, abs=0.01)
        assert found.rms == pytest.approx(0.002 / np.sqrt(2), rel=0.03)


def test_hum_is_found_beside_an_actuator_at_rest():
    rng = np.random.default_rng(3)
    for rest in (0.0, 2.5):
        run = run_of(TIME, {"a": response(rng) + hum(0.1, 50.03, 1.0)}, {"f": np.full(TIME.size, rest)})
        (found,) = find_mains_interference([run])
        assert found.frequency == pytest.approx(50.03, abs=0.01)


def test_the_hum_expected_elsewhere_has_the_size_found_and_the_phase_that_is_there():
    rng = np.random.default_rng(2)
    (found,) = find_mains_interference([run_of(TIME, {"a": response(rng) + hum(0.1, 60.0, 1.0)})])
    other = run_of(TIME, {"a": response(rng) + hum(0.2, 60.0, 2.0)})
    expected = found.expected(other)
    assert np.sqrt(np.mean(expected**2)) == pytest.approx(found.rms)
    assert np.corrcoef(expected, hum(1.0, 60.0, 2.0))[0, 1] > 0.999


def test_what_is_driven_at_the_mains_is_no_hum():
    rng = np.random.default_rng(3)
    force = hum(1.0, 50.0, 0.3) + hum(1.0, 20.0, 0.3)
    assert find_mains_interference([run_of(TIME, {"a": response(rng) + 0.1 * force}, {"f": force})]) == ()


def test_what_is_nonlinear_answers_a_sine_at_its_multiples_and_that_is_no_hum():
    rng = np.random.default_rng(5)
    force = hum(1.0, 20.0, 0.3) + 1e-3 * rng.standard_normal(TIME.size)  # measured, with noise at every frequency
    answer = hum(1.0, 20.0, 0.9) + hum(0.05, 60.0, 0.1) + 1e-3 * rng.standard_normal(TIME.size)
    assert find_mains_interference([run_of(TIME, {"a": answer}, {"f": force})]) == ()
    (found,) = find_mains_interference(
        [run_of(TIME, {"a": answer + hum(0.05, 50.0, 0.1)}, {"f": force})]
    )  # no multiple of 20 Hz
    assert found.frequency == pytest.approx(50.0, abs=0.01)


def test_a_mode_that_rings_at_the_mains_is_no_hum():
    rng = np.random.default_rng(4)
    decay = np.exp(-0.3 * TIME) * np.sin(2 * np.pi * 50.0 * TIME)
    noise = 1e-3 * rng.standard_normal((4, TIME.size))
    assert find_mains_interference([run_of(TIME, {"a": decay + n}) for n in noise[:2]]) == ()
    random = [run_of(TIME, {"a": response(rng, 50.0, 0.001) + n}) for n in noise]
    assert find_mains_interference(random) == ()


def test_noise_alone_has_no_hum():
    rng = np.random.default_rng(5)
    assert find_mains_interference([run_of(TIME, {"a": rng.standard_normal(TIME.size)}) for _ in range(5)]) == ()


def test_irregular_time_stamps_are_taken_as_they_are():
    rng = np.random.default_rng(6)
    time = np.cumsum(rng.uniform(0.5, 1.5, TIME.size)) / RATE
    values = (
        np.sin(2 * np.pi * 3 * time) + 0.05 * np.sin(2 * np.pi * 50.0 * time) + 0.01 * rng.standard_normal(time.size)
    )
    (found,) = find_mains_interference([run_of(time, {"a": values})])
    assert found.rms == pytest.approx(0.05 / np.sqrt(2), rel=0.02)
