"""Misfit measures against closed forms."""

import json

import numpy as np
import pytest

from vlab.cases.misfit import misfit
from vlab.errors import BadRecording
from vlab.signals import Channel, Recording

TIME = np.arange(4000) / 200.0
SINE = np.sin(2 * np.pi * 5 * TIME)  # 100 whole periods


def recording(values, time=TIME):
    return Recording(time=time, data=values[:, None], channels=(Channel(name="x", kind="displacement", unit="m"),))


@pytest.mark.parametrize(
    ("gain", "phase", "offset"), [(1.0, 0.0, 0.0), (1.3, 0.0, 0.0), (1.0, 0.4, 0.0), (0.8, -0.3, 0.5)]
)
def test_nrmse_of_a_sine_is_the_distance_of_two_phasors(gain, phase, offset):
    m = misfit(recording(SINE), recording(gain * np.sin(2 * np.pi * 5 * TIME + phase) + offset), "x")
    distance = abs(gain * np.exp(1j * phase) - 1)
    # whole periods: sums over samples equal the integrals, so only rounding is left
    assert m.nrmse == pytest.approx(np.sqrt(distance**2 + 2 * offset**2), abs=1e-12)
    assert m.vaf == pytest.approx(1 - distance**2, abs=1e-12)
    assert m.mean_error == pytest.approx(offset, abs=1e-12)


def test_a_model_that_gives_the_mean_has_nrmse_one_and_accounts_for_nothing():
    m = misfit(recording(SINE + 3), recording(np.full_like(SINE, 3.0)), "x")
    assert (m.nrmse, m.vaf) == (pytest.approx(1.0, abs=1e-12), pytest.approx(0.0, abs=1e-12))


def test_the_error_is_found_in_its_bands():
    error = np.sin(2 * np.pi * 5 * TIME) + 2 * np.sin(2 * np.pi * 40 * TIME)
    m = misfit(recording(SINE), recording(SINE + error), "x", band_edges_hz=[1, 20, 60, 100])
    # powers 1 : 4; Hann's side lobes fall with the third power of distance, here 20 lines away and more: below 1e-6
    np.testing.assert_allclose(m.band_share, [0.2, 0.8, 0.0], atol=1e-5)
    assert m.band_nrmse[0] == pytest.approx(1.0, abs=1e-5)
    assert misfit(recording(SINE), recording(SINE + error), "x").band_share.sum() == pytest.approx(1.0, abs=1e-12)


def test_the_error_is_found_in_its_windows():
    late = np.where(TIME >= 10, 0.5, 0.0) * SINE
    m = misfit(recording(SINE), recording(SINE + late), "x", windows=9)  # windows of 4 s every 2 s
    np.testing.assert_allclose(m.window_time_s, np.arange(1, 10) * (TIME[-1] / 10))
    assert np.all(m.window_nrmse[:4] < 1e-12)
    # windows hold whole periods but for one sample of 800
    np.testing.assert_allclose(m.window_nrmse[5:], 0.5, rtol=2e-3)


def test_a_perfect_model_has_no_misfit_anywhere():
    m = misfit(recording(SINE), recording(SINE), "x")
    assert m.nrmse == m.rms_error == 0.0
    assert m.vaf == 1.0
    assert not m.band_share.any()
    assert not m.window_nrmse.any()


def test_irregular_times_give_the_same_measures():
    rng = np.random.default_rng(3)
    time = TIME + rng.uniform(-0.002, 0.002, TIME.size)
    y, error = np.sin(2 * np.pi * 5 * time), 0.1 * np.sin(2 * np.pi * 2 * time)
    m = misfit(recording(y, time), recording(y + error, time), "x", band_edges_hz=[0.5, 3, 100])
    assert m.nrmse == pytest.approx(0.1, rel=0.02)  # sums over jittered samples: 1/sqrt(4000)
    assert m.band_share[0] > 0.999  # linear interpolation: errors of (omega dt)^2/8 = 5e-4


def test_a_misfit_is_plain_json():
    document = json.loads(json.dumps(misfit(recording(SINE), recording(0.9 * SINE), "x").to_json(), allow_nan=False))
    assert document["unit"] == "m"
    assert document["nrmse"] == pytest.approx(0.1)
    assert {"time_s", "nrmse", "recording_rms"} == set(document["windows"][0])
    assert {"low_hz", "high_hz", "error_share", "nrmse"} == set(document["bands"][0])


@pytest.mark.parametrize(
    ("simulated", "match"),
    [(recording(SINE[:-1], TIME[:-1]), "different time stamps"), (recording(SINE, TIME + 1), "different time stamps")],
)
def test_other_time_stamps_are_refused(simulated, match):
    with pytest.raises(BadRecording, match=match):
        misfit(recording(SINE), simulated, "x")


def test_what_does_not_move_or_makes_no_bands_is_refused():
    with pytest.raises(BadRecording, match="constant"):
        misfit(recording(np.ones_like(SINE)), recording(SINE), "x")
    with pytest.raises(BadRecording, match="band edges"):
        misfit(recording(SINE), recording(SINE), "x", band_edges_hz=[3, 2])
