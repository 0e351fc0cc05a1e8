"""Hammer tests: blows are found, doubles left out, and the window's damping is taken out again."""

import numpy as np
import pytest
from scipy import signal

from vlab.errors import BadRecording
from vlab.modal.impact import END_LEVEL, estimate_impact_frf, find_blows
from vlab.modal.modal_test import ModalTest, run_modal_test
from vlab.signals import Channel, Recording

RATE = 500.0
FREQ, ZETA = np.array([6.0, 17.0]), np.array([0.004, 0.006])
SHAPES = np.array([[1.0, 1.0], [0.6, -0.9]])


def state_space():
    """Two modes, the force at the first point; displacement at the first, velocity at the second."""
    omega = 2 * np.pi * FREQ
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.diag(omega**2), -np.diag(2 * ZETA * omega)]])
    B = np.concatenate([np.zeros(2), SHAPES[0]])[:, None]
    C = np.array([[*SHAPES[0], 0, 0], [0, 0, *SHAPES[1]]])
    return A, B, C, np.zeros((2, 1))


def struck(at=(0.5, 20.5, 40.5, 60.5), *, seconds=80.0, noise=0.0, double=None):
    t = np.arange(round(seconds * RATE)) / RATE
    force, width = np.zeros_like(t), 0.016
    for k, begin in enumerate(at):
        for start, size in ((begin, 1.0 + 0.1 * k), *([(begin + 0.2, 0.5)] if k == double else [])):
            inside = (t >= start) & (t < start + width)
            force[inside] += size * np.sin(np.pi * (t[inside] - start) / width)
    _, y, _ = signal.lsim(signal.StateSpace(*state_space()), force, t)
    rng = np.random.default_rng(3)
    y = y + noise * y.std(axis=0) * rng.standard_normal(y.shape)
    force = force + noise * 0.01 * rng.standard_normal(force.shape)
    labels = (
        Channel(name="hammer", kind="force", unit="N", is_input=True),
        Channel(name="x", kind="displacement", unit="m"),
        Channel(name="v", kind="velocity", unit="m/s"),
    )
    return Recording(time=t, data=np.column_stack([force, y]), channels=labels)


@pytest.mark.slow
def test_added_damping_is_taken_out_exactly():
    recording = struck()
    result = run_modal_test([recording], ModalTest(band_hz=(2.0, 25.0)))
    assert result.signals[0].kind == "impact"  # told from the samples: the recording says nothing
    assert result.signals[0].is_recognised
    # the window adds 0.15 1/s: at 6 Hz a damping ratio of .004 where .004 is the mode's own; the fit must see .008
    window = result.mean.added_decay / (2 * np.pi * FREQ[0])
    assert window > 0.9 * ZETA[0]
    assert result.poles.freq == pytest.approx(FREQ, rel=1e-4)
    # one block ends at 5 % of the window times what the mode has left: leakage of that order times 1 / lines in a peak
    assert result.poles.zeta == pytest.approx(ZETA, rel=0.01)
    shapes = result.poles.real_shapes()
    assert shapes[1] / shapes[0] == pytest.approx(SHAPES[1] / SHAPES[0], rel=0.01)  # velocity integrated at s + decay


def test_without_the_correction_the_damping_would_be_wrong():
    frf = estimate_impact_frf(struck(), inputs=["hammer"], outputs=["x"])
    assert frf.added_decay == pytest.approx(-np.log(END_LEVEL) / 20.0, rel=1e-3)
    s = frf.added_decay + 2j * np.pi * frf.freq
    A, B, C, _ = state_space()
    exact = np.array([(C[:1] @ np.linalg.solve(k * np.eye(4) - A, B))[0, 0] for k in s])
    near = (frf.freq > 4) & (frf.freq < 20)
    # H at s = decay + j omega; what differs is the blow before, of which exp(-zeta omega 20 s) = 5 % goes on ringing
    assert np.abs(frf.H[near, 0, 0] - exact[near]).max() < 0.05 * np.abs(exact[near]).max()
    plain = np.array([(C[:1] @ np.linalg.solve(k * np.eye(4) - A, B))[0, 0] for k in 2j * np.pi * frf.freq])
    assert np.abs(frf.H[near, 0, 0] - plain[near]).max() > 0.3 * np.abs(plain[near]).max()


def test_noise_and_a_doubled_blow():
    recording = struck(noise=0.02, double=2)
    blows = find_blows(recording["hammer"], RATE, block_s=19.0)
    assert [blow.count for blow in blows] == [1, 1, 2, 1]
    frf = estimate_impact_frf(recording, inputs=["hammer"], outputs=["x", "v"], block_s=19.0)
    assert frf.n_averages == 3  # the doubled one is left out
    result = run_modal_test([recording], ModalTest(band_hz=(2.0, 25.0), segment_s=19.0, n_modes=2))
    assert result.poles.freq == pytest.approx(FREQ, rel=1e-3)
    assert result.poles.zeta == pytest.approx(ZETA, rel=0.05)


def test_what_cannot_be_a_hammer_test_says_so():
    with pytest.raises(BadRecording, match="doubled"):
        estimate_impact_frf(struck(at=(0.5,), double=0, seconds=30), inputs=["hammer"], outputs=["x"], block_s=20.0)
    with pytest.raises(BadRecording, match="holds no free response"):
        estimate_impact_frf(struck(), inputs=["hammer"], outputs=["x"], block_s=0.05)
    with pytest.raises(BadRecording, match="accepted: above 0 up to 1"):
        estimate_impact_frf(struck(), inputs=["hammer"], outputs=["x"], end_level=0.0)
    with pytest.raises(BadRecording, match="one input, not 2"):
        estimate_impact_frf(struck(), inputs=["hammer", "x"], outputs=["v"])
