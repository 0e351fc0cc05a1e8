"""Poles that stand on a misfit of the model alone."""

import numpy as np
import pytest

from vlab.demo.story import BAND, identify_loop, perform_loop_test
from vlab.lab.run_folder import RunSettings


def test_no_pole_confirms_itself():
    """The chart weighted by a doubtful narrow pole repeats the pole at every order."""
    settings = RunSettings(
        structure="beam", level=0.1, low_hz=BAND[0], high_hz=BAND[1], period_s=20.0, seconds=60.0, seed=1, law="mfdrf"
    )
    test = identify_loop(perform_loop_test("MFDRF", settings.prepare()))
    assert test.poles.freq == pytest.approx(test.predicted_freq, rel=0.005)
    assert test.poles.zeta == pytest.approx(test.predicted_zeta, rel=0.03)  # the bench is damped as the loop predicts
    assert np.all(test.poles.confidence > 0.9)
