"""Tests without a recorded input against closed forms: sums of decaying sines, and a chain under white forces."""

import numpy as np
import pytest
from scipy import signal

from vlab.errors import BadRecording
from vlab.modal.modal_test import ModalTest, read_signals, run_modal_test
from vlab.signals import Channel, Recording

RATE = 200.0
FREQ, ZETA = np.array([4.0, 11.0]), np.array([0.01, 0.02])
SHAPES = np.array([[1.0, -0.8], [0.6, 1.0]])
OMEGA = 2 * np.pi * FREQ
POLES = OMEGA * (-ZETA + 1j * np.sqrt(1 - ZETA**2))


def recording(y: np.ndarray, kinds=("velocity", "velocity")) -> Recording:
    units = {"velocity": "m/s", "displacement": "m", "acceleration": "m/s^2"}
    channels = tuple(Channel(name=f"y{i}", kind=kind, unit=units[kind]) for i, kind in enumerate(kinds))
    return Recording(time=np.arange(len(y)) / RATE, data=y, channels=channels)


def decay(seconds: float, orders=(1, 1), noise: float = 0.0) -> np.ndarray:
    """Return displacements sum Re(phi a exp(s t)), differentiated to the orders of the sensors."""
    t = np.arange(round(seconds * RATE)) / RATE
    waves = np.array([0.9, 0.7j])[:, None] * np.exp(POLES[:, None] * t) / OMEGA[:, None]
    parts = [(SHAPES[i][:, None] * POLES[:, None] ** order * waves).sum(axis=0).real for i, order in enumerate(orders)]
    return np.stack(parts, axis=1) + noise * np.random.default_rng(1).standard_normal((len(t), 2))


@pytest.mark.parametrize("seconds", [20.0, 5.0])  # exp(-zeta omega 5 s) is 0.28: the window must end the record
def test_a_free_decay_gives_poles_and_shapes(seconds):
    result = run_modal_test([recording(decay(seconds, noise=1e-4))], ModalTest())
    assert [s.kind for s in result.signals] == ["free"]
    assert result.poles.freq == pytest.approx(FREQ, rel=5e-4)
    assert result.poles.zeta == pytest.approx(ZETA, rel=0.02)
    assert result.poles.real_shapes() == pytest.approx(SHAPES, abs=0.01)


def test_sensors_of_several_kinds_have_one_shape():
    y = decay(20.0, orders=(0, 2))
    result = run_modal_test([recording(y, ("displacement", "acceleration"))], ModalTest())
    assert result.poles.freq == pytest.approx(FREQ, rel=5e-4)
    assert result.poles.zeta == pytest.approx(ZETA, rel=0.02)
    assert result.poles.real_shapes() == pytest.approx(SHAPES, abs=0.03)


def test_vibration_under_white_forces_gives_the_poles():
    # exact discrete model of both modes, each under white noise of its own
    rng, seconds = np.random.default_rng(4), 1500.0
    modes = []
    for pole in POLES:
        z = np.exp(pole / RATE)
        modes.append(signal.lfilter([1.0], [1.0, -2 * z.real, abs(z) ** 2], rng.standard_normal(round(seconds * RATE))))
    y = np.stack(modes, axis=1) / np.std(modes, axis=1) @ SHAPES.T
    y += 0.05 * rng.standard_normal(y.shape)
    result = run_modal_test([recording(y)], ModalTest(segment_s=15.0))
    assert [s.kind for s in result.signals] == ["ambient"]
    # sd of a frequency sqrt(zeta / (4 pi f T)) f is 0.04 %, of a damping ratio sqrt(1 / (pi f T zeta)) is 7 %
    found = result.poles
    assert found.freq == pytest.approx(FREQ, rel=2e-3)
    assert found.zeta == pytest.approx(ZETA, rel=0.25)
    assert found.real_shapes() == pytest.approx(SHAPES, abs=0.1)


def test_a_kind_that_needs_an_input_is_refused():
    still = recording(np.zeros((1000, 2)))
    with pytest.raises(BadRecording, match="a test by random excitation needs an input"):
        read_signals([recording(decay(5.0))], ModalTest(signal="random"))
    with pytest.raises(BadRecording, match="do not move"):
        run_modal_test([still], ModalTest(signal="free"))
    with pytest.raises(BadRecording, match="accepted: at least 64"):
        run_modal_test([recording(decay(5.0))], ModalTest(segment_s=0.1))
