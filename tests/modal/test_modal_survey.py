"""A modal test from recordings: which estimator, which shapes, what goes together."""

from dataclasses import replace

import numpy as np
import pytest

from vlab.errors import BadRecording
from vlab.modal.modal_test import ModalTest, estimate_responses, run_modal_test
from vlab.signals import Channel, Recording
from vlab.views.reports.modal_test import doubts

RATE, PERIOD = 200.0, 20.0
FREQ, ZETA = np.array([4.0, 9.0]), np.array([0.02, 0.01])
SHAPES = np.array([[1.0, 1.0], [0.5, -1.0]])


def recording(*, periods: int = 3, noise: float = 0.0, seed: int = 0, meta: dict | None = None) -> Recording:
    """Two modes under a steady multisine, made in the frequency domain: one velocity, one displacement, no transient."""
    rng = np.random.default_rng(seed)
    n = round(RATE * PERIOD)
    freq = np.fft.rfftfreq(n, 1 / RATE)
    force = np.where((freq >= 1) & (freq <= 20), np.exp(2j * np.pi * rng.uniform(size=len(freq))), 0) * n / 50
    omega, s = 2 * np.pi * FREQ, 2j * np.pi * freq
    modal = SHAPES[0] / (s[:, None] ** 2 + 2 * ZETA * omega * s[:, None] + omega**2)
    motion = modal @ SHAPES.T
    signals = [force, motion[:, 0] * s * force, motion[:, 1] * force]
    data = np.tile(np.column_stack([np.fft.irfft(x, n) for x in signals]), (periods, 1))
    data[:, 1:] += noise * rng.standard_normal((len(data), 2)) * data[:, 1:].std(axis=0)
    channels = (
        Channel(name="f", kind="force", unit="N", is_input=True),
        Channel(name="v", kind="velocity", unit="m/s"),
        Channel(name="x", kind="displacement", unit="m"),
    )
    return Recording(
        time=np.arange(len(data)) / RATE,
        data=data,
        channels=channels,
        meta={"period_s": PERIOD} if meta is None else meta,
    )


def test_velocity_and_displacement_sensors_give_one_shape():
    result = run_modal_test([recording()], ModalTest(n_modes=2, band_hz=(2.0, 15.0)))
    assert result.poles.freq == pytest.approx(FREQ, rel=1e-6)  # noise-free and periodic: no leakage
    assert result.poles.zeta == pytest.approx(ZETA, rel=1e-4)
    shapes = result.poles.real_shapes()
    assert shapes[1] / shapes[0] == pytest.approx(SHAPES[1] / SHAPES[0], rel=1e-4)  # integrated, not mixed units


def test_averaging_recordings_lowers_the_noise():
    test = ModalTest(n_modes=2, band_hz=(2.0, 15.0))
    many = [recording(noise=0.3, seed=k) for k in range(4)]
    errors = [
        np.abs(run_modal_test(runs, test).mean.H - run_modal_test([recording()], test).mean.H).mean()
        for runs in (many[:1], many)
    ]
    assert errors[1] < 0.75 * errors[0]  # half, for four independent recordings


def test_a_record_shorter_than_two_periods_is_averaged_over_segments():
    (response,) = estimate_responses([recording(periods=1)], ModalTest())
    assert len(response.freq) < 400  # segments of an eighth, not the lines of the period
    with pytest.raises(BadRecording, match="coherence would be 1"):
        estimate_responses([recording(periods=1)], ModalTest(period_s=PERIOD))  # asked for by name: refused


def test_recordings_that_do_not_go_together_are_refused():
    other = recording(meta={})
    with pytest.raises(BadRecording, match="test them one by one"):
        run_modal_test([recording(), other], ModalTest())
    with pytest.raises(BadRecording, match="no recording"):
        run_modal_test([], ModalTest())


def test_a_recording_without_sensor_says_so():
    whole = recording()
    with pytest.raises(BadRecording, match="no sensor"):
        run_modal_test([whole.select(["f"])], ModalTest())


def test_a_transient_that_is_still_there_is_said():
    test = ModalTest(n_modes=2, band_hz=(2.0, 15.0))
    result = run_modal_test([recording(periods=4)], test)
    # the first half of 80 s is left out; exp(-0.02 * 2 pi 4 * 40) = 2e-9
    assert result.skipped_s == (40.0,)
    assert result.still_ringing() == pytest.approx(np.exp(-ZETA * 2 * np.pi * FREQ * 40.0), rel=1e-3)
    assert doubts(result) == []
    early = replace(result, skipped_s=(5.0,))
    (said,) = doubts(early)
    # ln(1/.03) / .503 1/s = 7 s have to be left out, of twice as many
    assert "Mode 1 still rang" in said
    assert "at 8.1 % of it" in said
    assert "at least 14 s" in said
    assert early.as_dict()["modes"][0]["transient_left"] == pytest.approx(0.081, abs=1e-3)


def test_where_the_misfit_lies_is_said():
    result = run_modal_test([recording()], ModalTest(n_modes=2, band_hz=(2.0, 15.0)))
    H = result.mean.H.copy()
    spoilt = (result.mean.freq >= 12.0) & (result.mean.freq <= 13.0)
    H[spoilt] += 0.1 * np.abs(H).max()
    poles = replace(result.poles, residual=0.5)
    worse = replace(result, mean=replace(result.mean, H=H), poles=poles)
    low, high = worse.misfit_band()
    assert 12.0 <= low < high <= 13.0
    assert any("--band" in said for said in doubts(worse))
