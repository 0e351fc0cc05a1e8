"""One noisy test of the beam's modal plant: its six modes come back, and sdypy-EMA (LSCF poles, LSFD shapes) finds the same."""

import numpy as np
import pytest

from vlab.lab.experiment import run_experiment
from vlab.lab.plant_modes import compare_with_plant, plant_modes
from vlab.lab.run_folder import RunSettings
from vlab.modal.mac import mac
from vlab.modal.modal_test import ModalTest, run_modal_test

BAND = (1.0, 28.0)
SCALE = 100.0
"""The package looks for stable poles in windows of 2 to 25 Hz; time is told a hundred times faster, which changes no ratio."""


@pytest.fixture(scope="module")
def tested():
    settings = RunSettings(
        structure="beam", plant="modal", excite="multisine", low_hz=0.8, high_hz=30.0, level=0.05, period_s=30.0, seconds=150.0, noise=4e-4
    )  # fmt: skip
    prepared = settings.prepare()
    result = run_modal_test([run_experiment(prepared.experiment).recording], ModalTest(band_hz=BAND))
    return result, plant_modes(prepared.plant, result.mean.outputs, low_hz=BAND[0], high_hz=BAND[1])


def theirs(result):
    EMA = pytest.importorskip("sdypy.EMA", reason="sdypy-EMA is not installed (pip install 'vlab-vibration[test]')")
    frf = result.mean.between(*BAND)
    # the package wants lines from 0 Hz on: those below the band are filled with the first
    spacing = np.median(np.diff(frf.freq))
    grid = np.arange(0, round(frf.freq[-1] / spacing) + 1) * spacing
    at = np.searchsorted(frf.freq, grid - 0.5 * spacing).clip(0, frf.freq.size - 1)
    model = EMA.Model(
        frf.H[at, :, 0].T, SCALE * grid, lower=SCALE * BAND[0], upper=SCALE * grid[-2], pol_order_high=40, frf_form="receptance"
    )  # fmt: skip
    model.get_poles(method="lscf", show_progress=False)
    model.select_closest_poles(list(SCALE * result.poles.freq))
    model.get_constants(f_upper=SCALE * grid[-4])
    return model


def test_the_modal_plant_of_the_beam_gives_its_six_modes_back(tested):
    result, true = tested
    found = compare_with_plant(true, result.poles.to_modal_model())
    assert len(found) == 6
    assert all(m.ok for m in found)
    assert result.poles.freq.size == 6  # and nothing else


def test_both_find_the_same_poles_and_shapes(tested):
    result, true = tested
    model = theirs(result)
    freq, zeta = np.asarray(model.nat_freq) / SCALE, np.asarray(model.nat_xi)
    assert freq == pytest.approx(result.poles.freq, rel=2e-4)
    # LSCF without weights is biased by noise: the package's damping is good to some per cent here, and ours is nearer
    assert zeta == pytest.approx(result.poles.zeta, rel=0.08)
    alike = np.diag(mac(np.asarray(model.A), result.poles.shapes))
    assert alike.min() > 0.98
    ours = np.abs(result.poles.zeta / true.zeta - 1)
    assert ours.max() <= max(np.abs(zeta / true.zeta - 1).max(), 0.01)
