"""Force appropriation: the forces that hold one mode, and a dwell that does."""

import numpy as np
import pytest

from vlab.errors import BadRecording
from vlab.lab.excitation import Dwell
from vlab.modal.appropriation import appropriate, mode_indicator
from vlab.modal.modal_test import ModalTest, run_dwell_test
from vlab.signals import Channel, FrequencyResponse, Recording

PHI = np.array([[1.0, 1.0], [0.8, -0.7], [0.3, 0.9]])
"""Two mass-normalised modes at three points; forces act at the first two."""
FREQ, ZETA = np.array([5.0, 5.1]), np.array([0.01, 0.012])
OMEGA = 2 * np.pi * FREQ


def receptance(freq):
    s = 2j * np.pi * np.asarray(freq)[:, None]
    modal = 1 / (s**2 + 2 * ZETA * OMEGA * s + OMEGA**2)
    H = np.einsum("fk,ok,ik->foi", modal, PHI, PHI[:2])
    return FrequencyResponse(freq=freq, H=H, outputs=("a", "b", "c"), inputs=("f1", "f2"), unit="m/N")


def test_forces_are_orthogonal_to_the_other_mode():
    # closed form: with as many forces as modes the forces that excite mode j alone satisfy phi_k^T f = 0 for k != j
    freq = np.linspace(4.5, 5.6, 2201)
    for j, other in ((0, 1), (1, 0)):
        found = appropriate(receptance(freq), FREQ[j], 0.04)
        exact = np.array([PHI[1, other], -PHI[0, other]])
        exact = exact / exact[np.argmax(np.abs(exact))]
        assert found.hz == pytest.approx(FREQ[j], abs=5e-4)  # a line
        assert found.forces == pytest.approx(exact, abs=2e-3)
        assert found.indicator < 1e-4


def test_indicator_is_small_at_modes_only():
    frf = receptance(np.linspace(4.0, 6.0, 401))
    values, forces = mode_indicator(frf)
    assert np.all(np.diff(values, axis=1) >= 0)
    assert values.min() >= 0
    assert values.max() <= 1
    dips = np.flatnonzero((values[1:-1, 0] < values[:-2, 0]) & (values[1:-1, 0] < values[2:, 0])) + 1
    assert frf.freq[dips[values[dips, 0] < 0.1]] == pytest.approx(FREQ, abs=0.006)
    assert forces.shape == (401, 2, 2)
    with pytest.raises(BadRecording, match="widen the search"):
        appropriate(frf, 9.0, 0.1)


def held(forces, hz, *, noise=0.0, drive_s=150.0, seconds=180.0, rate=100.0):
    """Simulate velocities under a dwell, exactly between samples of a finely held force."""
    t = np.arange(round(seconds * rate * 4)) / (rate * 4)
    excitation = Dwell(level=1.0, hz=hz, forces=tuple(forces), drive_s=drive_s)
    f = excitation.sample(t)
    from scipy import signal

    velocity = np.zeros((t.size, 3))
    for k in range(2):
        system = signal.lti([1.0, 0.0], [1.0, 2 * ZETA[k] * OMEGA[k], OMEGA[k] ** 2])
        velocity += np.outer(signal.lsim(system, f @ PHI[:2, k], t)[1], PHI[:, k])
    velocity, f, t = velocity[::4], f[::4], t[::4]
    velocity = velocity + noise * velocity.std(axis=0) * np.random.default_rng(0).standard_normal(velocity.shape)
    labels = [Channel(name=f"f{i + 1}", kind="force", unit="N", is_input=True) for i in range(2)]
    labels += [Channel(name=name, kind="velocity", unit="m/s") for name in "abc"]
    return Recording(time=t, data=np.hstack([f, velocity]), channels=tuple(labels), meta=excitation.facts)


@pytest.mark.parametrize("j", [0, 1])
def test_a_dwell_holds_one_of_two_close_modes(j):
    forces = np.array([PHI[1, 1 - j], -PHI[0, 1 - j]])
    result = run_dwell_test(held(forces, FREQ[j], noise=0.01), ModalTest())
    assert result.indicator < 0.02
    shape = PHI[:, j] / PHI[np.argmax(np.abs(PHI[:, j])), j]
    assert result.shape == pytest.approx(shape, abs=0.01)
    assert result.decay_hz == pytest.approx(FREQ[j], rel=1e-4)  # undamped natural frequency
    assert result.decay_zeta == pytest.approx(ZETA[j], rel=0.01)
    assert result.forces == pytest.approx(
        forces / np.abs(forces).max() * np.sign(result.forces[0] * forces[0]), rel=1e-3
    )


def test_one_force_does_not_hold_it():
    result = run_dwell_test(held([1.0, 0.0001], FREQ[0]), ModalTest())
    assert result.indicator > 0.2  # the neighbour 2 % away moves, too


@pytest.mark.slow
def test_what_is_no_dwell_says_so():
    with pytest.raises(BadRecording, match="fewer than 4 cycles"):
        run_dwell_test(held([1.0, 0.5], 5.0, seconds=150.5), ModalTest())
    with pytest.raises(BadRecording, match="not a dwell"):
        run_dwell_test(held([1.0, 0.5], 5.0), ModalTest(period_s=10.0))
