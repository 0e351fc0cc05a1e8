"""Noise and distortion told apart: on static nonlinearities behind a filter the answer is known."""

import numpy as np
import pytest

from vlab.errors import BadRecording
from vlab.lab.excitation import Multisine
from vlab.modal.distortion import separate_distortion
from vlab.signals import Channel, Recording

RATE, PERIOD, PERIODS = 200.0, 10.0, 6


def record(law, *, seed, noise=0.0, odd=True):
    t = np.arange(round(RATE * PERIOD * PERIODS)) / RATE
    x = Multisine(level=1.0, low_hz=1.0, high_hz=20.0, period_s=PERIOD, odd=odd, seed=seed).sample(t)
    y = law(x) + noise * np.random.default_rng(100 + seed).standard_normal(t.size)
    labels = (
        Channel(name="f", kind="force", unit="N", is_input=True),
        Channel(name="x", kind="displacement", unit="m"),
    )
    return Recording(time=t, data=np.column_stack([x, y]), channels=labels)


def separate(law, *, realisations=6, noise=0.0, odd=True):
    records = [record(law, seed=k, noise=noise, odd=odd) for k in range(realisations)]
    return separate_distortion(records, input="f", outputs=["x"], period_s=PERIOD)


def test_a_linear_system_has_noise_only():
    part = separate(lambda x: 2 * x, noise=0.1)
    # closed form: noise of variance s^2 on N samples gives a line amplitude 2/N sum of variance 4 s^2 / N (real and
    # imaginary part together); one period has N = 2000, the mean of 6 periods and 6 realisations a 36th of it
    amplitude = part.amplitude[0]
    expected = np.sqrt(4 * 0.1**2 / (RATE * PERIOD) / 36) / amplitude
    assert np.sqrt(np.mean(part.noise_sd**2)) == pytest.approx(
        expected, rel=0.05
    )  # 143 lines x 30 degrees of freedom: 1.5 %
    assert np.sqrt(np.mean(part.total_sd**2)) == pytest.approx(expected, rel=0.1)  # 143 lines x 5: 4 %
    assert np.abs(part.G - 2).max() < 5 * expected
    (level,) = part.levels()
    assert level["even_db"] < level["noise_db"] + 10 * np.log10(0.3)  # noise is taken off the detection lines
    assert level["odd_db"] < level["noise_db"] + 10 * np.log10(0.3)


def test_a_quadratic_law_shows_at_even_lines_only():
    (level,) = separate(lambda x: x + 0.1 * x**2).levels()
    # the excited lines are odd: products of two are even. 2 (0.1)^2 of the power of x^2 is spread over 0 to 40 Hz
    assert -30 < level["even_db"] < -15
    assert level["odd_db"] < -200  # rounding
    assert level["nonlinear_db"] < -200


def test_a_cubic_law_shows_at_odd_lines_and_between_realisations():
    b = 0.1
    part = separate(lambda x: x + b * x**3)
    (level,) = part.levels()
    assert level["even_db"] < -200
    assert -35 < level["odd_db"] < -12
    # what differs between realisations has the size of what comes out at the odd lines that are left out
    assert level["nonlinear_db"] == pytest.approx(level["odd_db"], abs=2.5)
    # Bussgang: a Gaussian input of variance 1 sees the gain 1 + 3 b in a cubic law
    assert np.mean(part.G.real) == pytest.approx(1 + 3 * b, rel=0.02)


def test_one_realisation_tells_noise_but_not_distortion():
    part = separate(lambda x: x + 0.1 * x**3, realisations=1, noise=0.05, odd=False)
    assert part.total_sd is None
    assert part.distortion_sd is None
    (level,) = part.levels()
    assert level["nonlinear_db"] is None
    assert level["even_db"] is None  # every line is excited
    assert level["odd_db"] is None


def test_realisations_that_do_not_go_together_are_refused():
    a = record(lambda x: x, seed=0)
    t = np.arange(round(2 * RATE * PERIOD * PERIODS)) / (2 * RATE)
    other = Recording(time=t, data=np.resize(a.data, (t.size, 2)), channels=a.channels)
    with pytest.raises(BadRecording, match="different sample rates"):
        separate_distortion([a, other], input="f", outputs=["x"], period_s=PERIOD)
