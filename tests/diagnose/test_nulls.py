"""Nothing is said to be missing from a model that lacks nothing, whatever the noise of its recordings."""

import numpy as np
import pytest
from null_rigs import CHAINS, RATE, cases, chain_response, null_case, pendulum_response
from scipy import linalg

from vlab.cases import compare_case, load_case
from vlab.diagnose.pipeline import diagnose

QUICK = [("carriages", "pink"), ("carriages", "white on the input")]


@pytest.mark.slow
@pytest.mark.parametrize(("rig", "noise"), QUICK)
def test_coloured_noise_is_not_physics(tmp_path, rig, noise):
    null_case(tmp_path, rig, noise)
    diagnosis = diagnose(load_case(tmp_path / "case.toml")).diagnosis
    assert diagnosis.verdict == "nothing-missing"
    assert not diagnosis.findings


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rig", "noise", "seed"), [case for case in cases() if case not in [(*quick, 0) for quick in QUICK]]
)
def test_no_noise_and_no_rough_model_is_physics(tmp_path, rig, noise, seed):
    null_case(tmp_path, rig, noise, seed)
    diagnosis = diagnose(load_case(tmp_path / "case.toml")).diagnosis
    assert diagnosis.verdict == "nothing-missing"
    assert not diagnosis.findings


# ---- the rigs themselves ----------------------------------------------------------------------------------------------


def test_there_are_sixty_null_cases():
    assert len(cases()) >= 60
    assert len(set(cases())) == len(cases())


def test_the_second_mode_alone_moves():
    """A chain of two masses rings at its two frequencies; the factor moves the upper one."""
    chain = CHAINS["carriages"]
    kick = np.zeros(20_000)
    kick[0] = 1.0
    peaks = []
    for second in (1.0, 1.05):
        z = chain_response(chain.m, chain.k, 0.02 * chain.c, kick, second=second)[:, 0]
        spectrum, freq = np.abs(np.fft.rfft(z)), np.fft.rfftfreq(len(z), 1 / RATE)
        peaks.append([freq[band][np.argmax(spectrum[band])] for band in (freq < 3.5, freq >= 3.5)])
    below = np.array([[1.0, 0.0], [1.0, 1.0]])
    exact = np.sqrt(linalg.eigh(np.diag(chain.k), below.T @ np.diag(chain.m) @ below, eigvals_only=True)) / (2 * np.pi)
    line = RATE / len(kick)
    assert peaks[0] == pytest.approx(exact, abs=line)
    assert peaks[1] == pytest.approx(exact * [1.0, 1.05], abs=line)


def test_coarse_steps_approach_the_exact_motion_at_second_order():
    chain, time = CHAINS["shaft"], np.arange(500) / RATE
    force = 0.3 * np.sin(2 * np.pi * 2.0 * time)
    exact = chain_response(chain.m, chain.k, chain.c, force)
    error = [np.abs(chain_response(chain.m, chain.k, chain.c, force, steps=n) - exact).max() for n in (8, 16)]
    assert error[0] / error[1] == pytest.approx(4.0, rel=0.1)


def test_a_pendulum_with_coarse_steps_does_so_too():
    time = np.arange(500) / RATE

    def torque(t):  # linear between samples, as the coarse steps have it
        return np.interp(t, time, 0.8 * np.sin(4.0 * time))

    exact = pendulum_response(1.0, 0.1, torque, time)
    error = [np.abs(pendulum_response(1.0, 0.1, torque, time, steps=n) - exact).max() for n in (1, 2)]
    assert error[0] / error[1] == pytest.approx(4.0, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["stochastic force", "wrong second mode", "coarse rig steps", "all at once"])
def test_a_rough_model_is_slightly_wrong(tmp_path, kind):
    """The nominal model follows the recordings to within its stated parameters; the case loads and compares."""
    null_case(tmp_path, "carriages", kind)
    for nrmse in compare_case(tmp_path).nrmse.values():
        assert 0.002 < nrmse < 1.0
