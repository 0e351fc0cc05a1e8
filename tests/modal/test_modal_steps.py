"""Sines in steps: where they are, which frequency they have, and the responses to them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

from vlab.errors import BadRecording
from vlab.modal.modal_test import ModalTest, run_modal_test
from vlab.modal.recognise import signal_of
from vlab.modal.steps import estimate_stepped_frf, find_steps, tone
from vlab.signals import Channel, Recording

RATE, FREQ, ZETA = 200.0, 5.0, 0.02


def stepped(freq, dwell, *, noise=0.0, rate=RATE, seed=0):
    """A phase-continuous sine in steps."""
    t = np.arange(round(len(freq) * dwell * rate)) / rate
    step = np.minimum((t / dwell).astype(int), len(freq) - 1)
    begun = np.concatenate([[0.0], np.cumsum(np.asarray(freq[:-1]) * dwell)])
    x = np.sin(2 * np.pi * (begun[step] + np.asarray(freq)[step] * (t - step * dwell)))
    return t, x + noise * np.random.default_rng(seed).standard_normal(t.size)


def recording(noise=0.0):
    """One mode, force and displacement, without any note of what excited it."""
    freq = np.concatenate([np.linspace(3.0, 4.6, 9), np.linspace(4.7, 5.3, 13), np.linspace(5.4, 7.0, 9)])
    t, x = stepped(freq, 12.0)
    omega = 2 * np.pi * FREQ
    _, y, _ = signal.lsim(signal.lti([1.0], [1.0, 2 * ZETA * omega, omega**2]), x, t)
    rng = np.random.default_rng(1)
    y = y + noise * y.std() * rng.standard_normal(y.size)
    x = x + 0.1 * noise * rng.standard_normal(x.size)
    labels = (
        Channel(name="f", kind="force", unit="N", is_input=True),
        Channel(name="x", kind="displacement", unit="m"),
    )
    return Recording(time=t, data=np.column_stack([x, y]), channels=labels), freq


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_steps_are_found_where_they_are(noise):
    freq = [2.0, 2.05, 2.1, 3.0, 3.01, 4.0]
    _, x = stepped(freq, 20.0, noise=noise)
    steps = find_steps(x, RATE)
    assert [round(s.hz, 3) for s in steps] == pytest.approx(freq, rel=2e-3)
    edges = np.arange(len(freq)) * 20.0
    # a step begins at most ten cycles late: that is when a change of 0.3 % has become 2 % of a cycle
    assert np.array([s.start for s in steps]) / RATE - edges == pytest.approx(0.0, abs=5.0)


def test_response_at_the_steps_is_the_transfer_function():
    data, freq = recording()
    frf = estimate_stepped_frf(data, signal_of(data, "f", dwell_s=12.0).steps, inputs=["f"], outputs=["x"])
    assert frf.freq == pytest.approx(freq, rel=1e-6)
    s, omega = 2j * np.pi * freq, 2 * np.pi * FREQ
    exact = 1 / (s**2 + 2 * ZETA * omega * s + omega**2)
    # half a step leaves exp(-zeta omega 6 s) = 2 % of a small transient; the held input of the simulation lags nothing
    assert np.abs(frf.H[:, 0, 0] - exact).max() < 0.01 * np.abs(exact).max()


def test_a_sweep_in_steps_from_elsewhere_gives_the_mode():
    data, _ = recording(noise=0.05)
    found = signal_of(data, "f")
    assert (found.kind, found.is_recognised) == ("stepped", True)
    assert 28 <= len(found.steps) <= 31
    result = run_modal_test([data], ModalTest(n_modes=1))
    assert result.poles.freq == pytest.approx([FREQ], rel=1e-3)
    assert result.poles.zeta == pytest.approx([ZETA], rel=0.05)
    assert result.mean.coherence.min() > 0.9


@pytest.mark.slow
def test_a_sliding_sine_and_noise_have_no_steps():
    data, _ = recording()
    t = data.time
    sliding = signal.chirp(t, 1.0, t[-1], 6.0)
    noise = np.random.default_rng(0).standard_normal(t.size)
    for x in (sliding, noise):
        other = replace(data, data=np.column_stack([x, data["x"]]))
        assert signal_of(other, "f").kind == "random"


def test_tone_reads_a_frequency_between_lines():
    t = np.arange(1000) / RATE
    assert tone(np.sin(2 * np.pi * 7.0312 * t + 0.4), 1 / RATE) == pytest.approx(7.0312, rel=1e-7)


def test_steps_too_short_to_settle_are_refused():
    data, _ = recording()
    with pytest.raises(BadRecording, match="dwell longer"):
        estimate_stepped_frf(data, signal_of(data, "f", dwell_s=1.0).steps, inputs=["f"], outputs=["x"])
    with pytest.raises(BadRecording, match="holds no whole step"):
        signal_of(data, "f", dwell_s=1e4)
    with pytest.raises(BadRecording, match="unknown signal 'sines'"):
        signal_of(data, "f", kind="sines")
    with pytest.raises(BadRecording, match="needs its period"):
        signal_of(data, "f", kind="periodic")
