"""Excitation signals: level, band, seed, repetition."""

import numpy as np
import pytest

from vlab.errors import BadExperiment, UnknownName
from vlab.lab.excitation import (
    EXCITATIONS,
    BurstRandom,
    Dwell,
    Hammer,
    Multisine,
    PseudoRandom,
    SteppedSine,
    Sweep,
    build_excitation,
    forces_at,
)

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
    a, b = (build_excitation(name, level=0.7, seed=9) for _ in range(2))
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
        ("stepped-sine", {"zoom_hz": (70.0,)}, "a zoom of 70 Hz cannot be made"),
        ("burst-random", {"share": 0.0}, "takes a share"),
        ("burst-random", {"block_s": 0.001}, "lengthen the period"),
        ("dwell", {"forces": (0.0, 0.0)}, "without any force"),
        ("dwell", {"hz": -1.0}, "cannot be driven"),
        ("dwell", {"low_hz": 1.0}, "has no setting 'low_hz'"),
        ("release", {"level": float("inf")}, "not finite"),
    ],
)
def test_settings_that_make_no_signal_are_refused(name, settings, message):
    with pytest.raises(BadExperiment, match=message):
        build_excitation(name, **settings)


def test_unknown_excitation_lists_the_known():
    with pytest.raises(UnknownName, match="did you mean 'multisine'"):
        build_excitation("multisin")


def test_realisations_share_their_detection_lines():
    spectra = [
        np.abs(
            np.fft.rfft(
                Multisine(level=1.0, low_hz=1.0, high_hz=50.0, period_s=10.0, odd=True, seed=k).sample(T[:20000])
            )
        )
        for k in (1, 2)
    ]
    assert np.array_equal(
        spectra[0] > 1e-6, spectra[1] > 1e-6
    )  # the robust method needs one set of lines, other phases
    groups = np.flatnonzero(spectra[0][:500] > 1e-6) // 8  # four odd lines are eight lines
    assert np.bincount(groups)[2:60].max() <= 4


def test_a_burst_is_on_for_its_share_and_new_in_every_block():
    signal = BurstRandom(level=0.3, low_hz=2.0, high_hz=40.0, block_s=4.0, share=0.25, seed=3)
    x = signal.sample(T)  # five blocks of 8000 samples
    blocks = x.reshape(5, 8000)
    on = blocks[:, :2000]
    assert np.all(blocks[:, 2001:] == 0)
    # rms of 1 s of noise of 38 Hz: 76 degrees of freedom a block, 380 in all, 4 %; the ramps take 6 % of the power
    assert np.sqrt(np.mean(on**2)) == pytest.approx(0.3 * np.sqrt(1 - 10 / 8 * 0.05), rel=0.15)
    alike = np.corrcoef(on)
    assert np.abs(alike[~np.eye(5, dtype=bool)]).max() < 0.5  # 76 degrees of freedom: 4 standard deviations of .11
    outside = np.fft.rfftfreq(8000, 5e-4) > 46.0  # 20 cycles a ramp: what leaks is far from the band
    power = np.sum(np.abs(np.fft.rfft(blocks)) ** 2, axis=0)
    assert power[outside].sum() < 1e-3 * power.sum()


def test_stepped_sine_zooms_around_modes_and_dwells_long_enough():
    signal = SteppedSine(
        level=1.0, low_hz=1.0, high_hz=11.0, steps=11, dwell_s=2.0, zoom_hz=(5.0,), zoom_width=0.02, zoom_steps=5, zoom_dwell_s=8.0
    )  # fmt: skip
    assert signal.freq == pytest.approx([1, 2, 3, 4, 4.9, 4.95, 5, 5.05, 5.1, 6, 7, 8, 9, 10, 11])
    assert signal.duration == pytest.approx(
        [10, 5, 10 / 3, 2.5, 8, 8, 8, 8, 8, 2, 2, 2, 2, 2, 2]
    )  # ten cycles at least
    assert signal.facts["step_hz"] == signal.freq.tolist()
    t = np.arange(round(signal.seconds * 500)) / 500
    x = signal.sample(t)
    assert np.abs(np.diff(x)).max() < 2 * np.pi * 11.0 / 500 * 1.001  # phase-continuous through the zoom
    begin = signal.duration[:6].sum()
    inside = (t >= begin) & (t < begin + 8)
    assert np.fft.rfftfreq(4000, 1 / 500)[np.abs(np.fft.rfft(x[inside])).argmax()] == pytest.approx(5.0)


def test_a_dwell_drives_several_actuators_and_stops_at_a_full_cycle():
    signal = Dwell(level=0.5, hz=3.0, forces=(1.0, -2.0), drive_s=4.1)
    f = forces_at(signal, T, 2)
    assert f[:, 0] == pytest.approx(-0.5 * f[:, 1])
    assert np.abs(f).max() == pytest.approx(0.5, rel=1e-5)  # the largest of the forces has the level
    assert signal.stop_s == pytest.approx(13 / 3)  # the end of the thirteenth cycle
    assert np.all(f[signal.stop_s < T] == 0)
    with pytest.raises(BadExperiment, match="2 forces cannot drive 3 actuators"):
        forces_at(signal, T, 3)
    with pytest.raises(BadExperiment, match="1 force cannot drive 2 actuators"):
        forces_at(Multisine(), T, 2)


def test_settings_are_read_as_written():
    assert build_excitation("dwell:hz=3.31,forces=1/-0.4", level=0.2) == Dwell(hz=3.31, forces=(1.0, -0.4), level=0.2)
    assert build_excitation("multisine:odd=yes,period_s=5") == Multisine(odd=True, period_s=5.0)
    assert build_excitation("stepped-sine:steps=5,zoom_hz=2", low_hz=1.0, high_hz=3.0).zoom_hz == (2.0,)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("dwell:hz", "has not the form NAME:setting=value"),
        ("dwell:hz=1,hz=2", "each setting once"),
        ("dwell:hz=fast", "hz=fast is not a number"),
        ("dwell:forces=1;2", "is not numbers with slashes"),
        ("stepped-sine:steps=2.5", "is not a whole number"),
        ("multisine:odd=maybe", "is not yes or no"),
        ("multisine:odds=yes", "has no setting 'odds'"),
        ("multisine:level=1", "level is given twice"),
    ],
)
def test_settings_that_cannot_be_read_are_refused(text, message):
    with pytest.raises(BadExperiment, match=message):
        build_excitation(text, level=0.2)
