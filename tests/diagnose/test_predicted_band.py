"""Recordings with faster motion than the fitted ones are compared in the band that these tell of."""

from dataclasses import replace

import numpy as np
import pytest
from rig_stop import stop_case

from vlab.cases import load_case
from vlab.diagnose.data.band import below
from vlab.diagnose.settings import RUNS
from vlab.diagnose.validation.simulation import ExtendedModel, check

H = 1e-3


@pytest.mark.parametrize("hz", [2.0, 20.0, 30.0, 60.0, 200.0])
def test_the_low_pass_has_the_amplitude_of_two_butterworth_filters_and_no_phase(hz):
    time = H * np.arange(20000)
    tone = np.sin(2 * np.pi * hz * time)
    # the bilinear transform maps frequencies to tan(pi f h)
    ratio = np.tan(np.pi * hz * H) / np.tan(np.pi * 30.0 * H)
    middle = slice(4000, -4000)
    np.testing.assert_allclose(
        below(tone, H, 30.0)[middle], tone[middle] / (1.0 + ratio ** (2 * RUNS.band_order)), atol=1e-9
    )


@pytest.mark.parametrize("band_hz", [0.5 / H, 1e9, np.inf])
def test_a_band_beyond_the_samples_changes_nothing(band_hz):
    values = np.random.default_rng(1).normal(size=(50, 3))
    assert below(values, H, band_hz) is values


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """A case whose model has everything, and its runs."""
    case = load_case(stop_case(tmp_path_factory.mktemp("band") / "rig").folder)
    return ExtendedModel(plant=case.plant), list(case.runs(("fit", "holdout")))


def with_tone(model, run, hz, share):
    """Return a run as the model simulates it, with a tone added to every compared channel."""
    simulated = model.simulated(run)
    data = simulated.data.copy()
    for c in run.compared:
        column = simulated.index(c.channel)
        data[:, column] += share * np.std(data[:, column]) * np.sin(2 * np.pi * hz * simulated.time)
    return replace(run, measured=replace(run.measured, data=data))


def test_motion_above_the_band_is_left_out(rig):
    model, runs = rig
    rate = 1 / runs[1].measured.sample_period
    fast = with_tone(model, runs[1], 0.3 * rate, 0.2)
    (whole,), (banded,) = (check([fast], model, None, band_hz=band) for band in (np.inf, 0.05 * rate))
    assert whole.before == pytest.approx(0.2 / np.sqrt(2), rel=0.05)
    assert whole.notes == ()
    assert banded.before < 0.05 * whole.before  # the filter rings at both ends
    assert banded.noise <= whole.noise
    assert banded.band_hz == 0.05 * rate
    assert "compared below" in banded.notes[0]


def test_an_error_within_the_band_stays(rig):
    model, runs = rig
    rate = 1 / runs[1].measured.sample_period
    slow, fast = (with_tone(model, runs[1], share * rate, 0.2) for share in (0.01, 0.3))
    still = with_tone(model, runs[1], 0.0, 0.0)
    data = slow.measured.data + fast.measured.data - still.measured.data
    both = replace(fast, measured=replace(fast.measured, data=data))
    (banded,) = check([both], model, None, band_hz=0.05 * rate)
    assert np.isfinite(banded.band_hz)
    assert banded.before == pytest.approx(0.2 / np.sqrt(2), rel=0.1)


def test_a_recording_without_faster_motion_is_compared_whole(rig):
    model, runs = rig
    rate = 1 / runs[1].measured.sample_period
    (whole,), (banded,) = (check([runs[1]], model, None, band_hz=band) for band in (np.inf, 0.45 * rate))
    assert np.isinf(banded.band_hz)
    assert (banded.before, banded.after, banded.noise) == (whole.before, whole.after, whole.noise)
