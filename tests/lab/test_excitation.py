"""Excitation signals: level, band, seed, repetition."""

import numpy as np
import pytest

from vlab.errors import BadExperiment, UnknownName
from vlab.lab.excitation import EXCITATIONS, Hammer, Multisine, PseudoRandom, SteppedSine, Sweep, build_excitation

T = (np.arange(40000) + 0.5) / 2000.0


@pytest.mark.parametrize("kind", [Multisine, PseudoRandom])
def test_periodic_signals_have_their_level_and_band(kind):
    signal = kind(level=0.3, low_hz=2.0, high_hz=30.0, period_s=10.0, seed=4)
    x = signal.sample(T)
    assert np.sqrt(np.mean(x**2)) == pytest.approx(0.3, rel=1e-9)  # Parseval over whole periods
    spectrum = np.abs(np.fft.rfft(x[:20000])) / 20000
    freq = np.fft.rfftfreq(20000, 5e-4)
    outside = (freq < 2.0 - 1e-9) | (freq > 30.0 + 1e-9)
    assert spectrum[outside].max() < 1e-12
    assert x[:20000] == pytest.approx(x[20000:], abs=1e-12)


def test_fast_and_direct_synthesis_agree():
    signal = Multisine(level=1.0, low_hz=0.5, high_hz=80.0, period_s=5.0, seed=1, odd=True)
    picked = T[[0, 1, 777, 20001, 39999]]
    direct = np.array([signal.sample(np.array([t]))[0] for t in picked])
    assert signal.sample(T)[[0, 1, 777, 20001, 39999]] == pytest.approx(direct, abs=1e-10)


def test_odd_multisine_leaves_detection_lines():
    signal = Multisine(level=1.0, low_hz=1.0, high_hz=50.0, period_s=10.0, odd=True, seed=2)
    spectrum = np.abs(np.fft.rfft(signal.sample(T[:20000]))) / 20000
    excited = np.flatnonzero(spectrum > 1e-9)
    assert np.all(excited % 2 == 1)
    odd_in_band = np.arange(11, 500, 2)
    assert 0.7 < len(excited) / len(odd_in_band) < 0.8  # one of four left out


@pytest.mark.parametrize("name", list(EXCITATIONS))
def test_same_seed_same_bits(name):
    a, b = (build_excitation(name, level=0.7, seed=None if name == "release" else 9) for _ in range(2))
    assert np.array_equal(a.sample(T), b.sample(T))


def test_other_seed_other_signal():
    assert not np.allclose(Multisine(seed=1).sample(T), Multisine(seed=2).sample(T))


def test_sweep_reaches_both_ends_of_its_band():
    x = Sweep(level=2.0, low_hz=1.0, high_hz=40.0, period_s=20.0).sample(T)
    crossings = T[1:][np.diff(np.sign(x)) != 0]
    rate, middle = 1 / (2 * np.diff(crossings)), (crossings[1:] + crossings[:-1]) / 2
    law = 1.0 + (40.0 - 1.0) * middle / 20.0
    assert rate == pytest.approx(
        law, rel=0.05
    )  # crossings are known to a step of 0.5 ms, 4 % of half a period at 40 Hz
    assert np.abs(x).max() == pytest.approx(2.0, rel=1e-3)


def test_stepped_sine_is_continuous_and_dwells():
    signal = SteppedSine(level=1.0, low_hz=5.0, high_hz=10.0, steps=6, dwell_s=2.0)
    x = signal.sample(T)
    assert np.abs(np.diff(x)).max() < 2 * np.pi * 10.0 * 5e-4 * 1.001  # no jump: slope at most omega times level
    piece = x[4000:8000]
    assert np.fft.rfftfreq(4000, 5e-4)[np.abs(np.fft.rfft(piece)).argmax()] == pytest.approx(6.0)


def test_hammer_blows_are_short_and_repeat():
    x = Hammer(level=5.0, high_hz=60.0, interval_s=4.0, seed=3).sample(T)
    starts = np.flatnonzero((x[1:] > 0) & (x[:-1] == 0))
    assert len(starts) == 6  # from 0.2 s every 3.6 to 4.4 s within 20 s
    assert np.sum(x != 0) / 2000.0 == pytest.approx(6 * 1.5 / 60.0, rel=0.02)  # to a step at either edge
    assert 4.0 <= x.max() <= 6.0


@pytest.mark.parametrize(
    ("name", "settings", "message"),
    [
        ("multisine", {"low_hz": 10.0, "high_hz": 5.0}, "not 0 < low < high"),
        ("multisine", {"period_s": 0.0}, "not a positive number"),
        ("multisine", {"low_hz": 1.01, "high_hz": 1.02, "period_s": 1.0}, "lengthen the period"),
        ("sweep", {"level": float("nan")}, "not a finite number"),
        ("hammer", {"period_s": 3.0}, "has no setting 'period_s'"),
        ("stepped-sine", {"steps": 0}, "make no stepped sine"),
        ("release", {"level": float("inf")}, "not finite"),
    ],
)
def test_settings_that_make_no_signal_are_refused(name, settings, message):
    with pytest.raises(BadExperiment, match=message):
        build_excitation(name, **settings)


def test_unknown_excitation_lists_the_known():
    with pytest.raises(UnknownName, match="did you mean 'multisine'"):
        build_excitation("multisin")
