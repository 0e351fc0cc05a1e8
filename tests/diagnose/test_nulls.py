"""Nothing is said to be missing from a model that lacks nothing, whatever the noise of its recordings."""

import pytest
from null_rigs import NOISES, RIGS, null_case

from vlab.cases import load_case
from vlab.diagnose.pipeline import diagnose

QUICK = [("carriages", "pink"), ("carriages", "white on the input")]


@pytest.mark.parametrize(("rig", "noise"), QUICK)
def test_coloured_noise_is_not_physics(tmp_path, rig, noise):
    null_case(tmp_path, rig, noise)
    diagnosis = diagnose(load_case(tmp_path / "case.toml")).diagnosis
    assert diagnosis.verdict == "nothing-missing"
    assert not diagnosis.findings


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rig", "noise"), [(rig, noise) for rig in RIGS for noise in NOISES if (rig, noise) not in QUICK]
)
def test_no_noise_is_physics(tmp_path, rig, noise):
    null_case(tmp_path, rig, noise)
    diagnosis = diagnose(load_case(tmp_path / "case.toml")).diagnosis
    assert diagnosis.verdict == "nothing-missing"
    assert not diagnosis.findings
