"""Durations and levels that follow from the plant, against closed forms of its modes."""

import numpy as np
import pytest

from vlab.hardware import load_hardware
from vlab.lab.plant_modes import plant_modes
from vlab.lab.run_folder import RunSettings
from vlab.lab.suited import DECAYED, SETTLED, SHARE, suited


def settings(**changes) -> RunSettings:
    return RunSettings(structure="beam", plant="modal", **changes)


@pytest.fixture(scope="module")
def tau(modal) -> float:
    """Time constant of the slowest mode of the beam from 0.5 to 60 Hz [s]."""
    modes = plant_modes(modal, [tap.name for tap in modal.sensors], low_hz=0.5, high_hz=60.0)
    return float((1 / (2 * np.pi * modes.freq * modes.zeta)).max())


def test_half_of_the_periods_outlast_the_transient(tau):
    found = suited(settings(excite="multisine"))
    assert found.tau_s == pytest.approx(tau)
    assert np.exp(-found.settings.seconds / 2 / tau) <= SETTLED
    assert found.settings.seconds == 4 * found.settings.period_s
    stated = suited(settings(excite="multisine", period_s=10.0)).settings
    assert stated.period_s == 10.0
    assert stated.seconds % 20.0 == 0.0
    assert np.exp(-stated.seconds / 2 / tau) <= SETTLED


def test_blows_and_bursts_leave_time_to_decay(tau):
    blows = suited(settings(excite="hammer")).settings
    interval = float(blows.excite.partition("interval_s=")[2])
    assert np.exp(-interval / tau) <= DECAYED
    bursts = suited(settings(excite="burst-random:share=0.5")).settings
    block = float(bursts.excite.partition("block_s=")[2])
    assert np.exp(-0.5 * block / tau) <= DECAYED
    assert bursts.seconds == 4 * block


def test_a_release_moves_a_coil_by_its_share_of_the_linear_range(modal):
    level = suited(settings(excite="release")).settings.level
    linear = modal.linearise()
    rows = modal.port_rows([tap.at for tap in modal.actuators])
    base = next(i for i, tap in enumerate(modal.actuators) if tap.at == "base")
    travel = np.abs(rows @ np.linalg.solve(linear.K, rows[base])).max() * level
    assert travel == pytest.approx(SHARE * load_hardware().velocity_sensor.linear_range, rel=0.05)  # two digits


def test_what_is_stated_stays():
    assert suited(settings(excite="multisine", law="mfdrf")).settings == settings(excite="multisine", law="mfdrf")
    assert suited(settings(excite="multisine", level=0.2)).settings.level == 0.2
    assert suited(settings(excite="hammer:level=2,interval_s=9")).settings.seconds == 36.0
    assert suited(settings(excite="dwell:hz=1.85")).words == ""
