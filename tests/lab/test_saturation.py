"""Limit cycles of loops with limited amplifiers: harmonic balance against closed forms and brute force."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from toys import single_mode

from vlab.errors import BadController
from vlab.lab.prediction import SampledLoop
from vlab.lab.saturation import harmonic_balance, saturation_share

LIMIT = 0.3


def driven_mode(laboratory, *, drive=4.0, rate=2000.0) -> SampledLoop:
    """One mode whose 'dashpot' drives it, without delay or filter."""
    return single_mode(laboratory, gain=-drive, rate=rate, delay=0.0, corner=0.0)


def simulated(loop: SampledLoop, limit: float, seconds: float, kick: float = 1e-3) -> np.ndarray:
    """Run the loop sample by sample with clipped commands; return the commands before the limit."""
    A, B, C = loop.plant
    a, b, c, d = loop.law
    z, x, given = np.full(len(A), kick), np.zeros(len(a)), []
    for _ in range(round(seconds * loop.rate)):
        y = C @ z
        u = c @ x + d @ y
        given.append(u)
        x, z = a @ x + b @ y, A @ z + B @ np.clip(u, -limit, limit)
    return np.array(given)


@pytest.mark.parametrize("ratio", [0.5, 1.0, 1.5, 10.0])
def test_the_share_is_the_fundamental_of_a_clipped_sine(ratio):
    fundamental = quad(lambda t: np.clip(ratio * np.sin(t), -1, 1) * np.sin(t), 0, np.pi, limit=200, points=[1.0])[0]
    assert saturation_share(np.array(ratio), 1.0) == pytest.approx(fundamental * 2 / np.pi / ratio, rel=1e-6)


def test_one_driven_mode_swings_where_the_share_leaves_its_own_damping(laboratory):
    # c = 2 zeta omega against drive N(A/L); fast sampling, for half a sample of hold takes a little of the drive's phase
    loop = driven_mode(laboratory, rate=5e4)
    found = harmonic_balance(loop, LIMIT)
    share = 2 * 0.01 * 2 * np.pi * 20.0 / 4.0
    assert saturation_share(found.commands, LIMIT)[0] == pytest.approx(share, rel=1e-5)
    assert found.forces[0] == pytest.approx(share * found.commands[0], rel=1e-5)
    assert found.hz == pytest.approx(20.0, rel=1e-3)
    assert found.samples[0] == pytest.approx(found.commands[0] / 4.0, rel=1e-9)


def test_a_simulated_loop_settles_there(laboratory):
    loop = driven_mode(laboratory)
    found = harmonic_balance(loop, LIMIT)
    u = simulated(loop, LIMIT, 20.0)[-4000:, 0]
    assert np.sqrt(2) * np.std(u) == pytest.approx(found.commands[0], rel=0.01)  # harmonics of a light mode are small


def test_two_amplifiers_of_different_load_settle_together(laboratory):
    # one mode seen by two pairs, the second three times as much: its amplifier is at the limit long before the first
    one = driven_mode(laboratory)
    both = np.array([[1.0], [3.0]])
    law = (np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((2, 0)), np.eye(2))
    loop = replace(one, at_coils=both, at_sensors=both, law=law)
    found = harmonic_balance(loop, LIMIT)
    u = simulated(loop, LIMIT, 20.0)[-4000:]
    assert np.sqrt(2) * np.std(u, axis=0) == pytest.approx(found.commands, rel=0.01)
    assert found.commands[1] / found.commands[0] == pytest.approx(3.0, rel=1e-6)


def test_a_stable_loop_has_no_limit_cycle(laboratory):
    assert harmonic_balance(driven_mode(laboratory, drive=1.0), LIMIT) is None


def test_a_structure_that_grows_by_itself_and_no_limit_are_refused(laboratory):
    loop = driven_mode(laboratory)
    with pytest.raises(BadController, match="grows without control"):
        harmonic_balance(replace(loop, damping=-loop.damping), LIMIT)
    with pytest.raises(BadController, match="no limit"):
        harmonic_balance(loop, 0.0)
