"""Hardware of concealed cases: converters, delays, coils in the loop, excitations."""

import numpy as np
import pytest

from vlab.proof.generator.excite import CLASSES, REST_S, excite
from vlab.proof.generator.hardware import Output, late, low_passed
from vlab.proof.generator.integration import Feedback, _Way, integrate
from vlab.proof.generator.law import Static
from vlab.proof.generator.rigs import shaft


def test_the_converter_delays_and_filters_as_theory_says():
    rate, sub, f = 2000.0, 20, 41.0
    samples = np.sin(2 * np.pi * f * np.arange(4000) / rate)[:, None, None]
    out = Output(delay_s=1.35 / rate, corner_hz=677.0).forces(samples, 1 / (rate * sub), sub)[:, 0, 0]
    time = (np.arange(out.size) + 0.5) / (rate * sub)
    late_part = time > 0.5
    basis = np.exp(-2j * np.pi * f * time[late_part])
    found = 2j * np.mean(out[late_part] * basis)
    expected = (
        np.exp(-2j * np.pi * f * 1.35 / rate) * np.sinc(f / rate) * np.exp(-1j * np.pi * f / rate) / (1 + 1j * f / 677)
    )
    # 61.5 cycles are averaged; images of the staircase at 2 kHz leave 1e-3.
    assert found == pytest.approx(expected, abs=3e-3)


@pytest.mark.parametrize(("delay", "corner"), [(0.0, 0.0), (1.35, 677.0), (0.4, 100.0), (2.0, 0.0)])
def test_the_loop_s_way_is_the_converter_s_one_step_at_a_time(delay, corner):
    rate, sub = 2000.0, 10
    output = Output(delay_s=delay / rate, corner_hz=corner)
    samples = np.random.default_rng(1).standard_normal((60, 1, 2))
    whole = output.forces(samples, 1 / (rate * sub), sub)
    way, single = _Way(output, 1 / (rate * sub), sub, (1, 2)), []
    for k in range(len(whole)):
        if k % sub == 0:
            way.say(samples[k // sub])
        single.append(way.force(k))
    assert np.array(single) == pytest.approx(whole, abs=1e-12)


def test_a_coil_in_the_loop_weakens_what_the_law_asks_for():
    """A coil without any force left, u (1 - 1): the loop is open, whatever its gain."""
    bench = shaft().build({}, {})
    n, kick = 400, np.zeros((8000, 2, 1))
    kick[:20] = 1.0
    kick[:, 0] = 0.0  # pushed elsewhere
    loop = Feedback(actuators=(0,), sensors=(0,), gains=np.array([[0.05]]), noise=np.zeros((n, 1, 1)))
    dead = Static(lambda z, v, t, u: -u)
    y = integrate(bench, kick, [("joint:rotor", dead)], step=1e-4, substeps=20, feedback=loop)
    opened = integrate(bench, kick, [], step=1e-4, substeps=20)
    closed = integrate(bench, kick, [], step=1e-4, substeps=20, feedback=loop)
    assert np.abs(y - opened).max() < 1e-9 * np.abs(opened).max()
    assert np.abs(closed - opened).max() > 1e-2 * np.abs(opened).max()


def test_delays_and_filters_keep_the_impulse():
    pulse = np.zeros((200, 1, 1))
    pulse[10] = 1.0
    for out in (late(pulse, 3.7), low_passed(pulse, 300.0, 1e-3)):
        assert out.sum() == pytest.approx(1.0, rel=1e-12)
    assert late(pulse, 3.7)[13:15, 0, 0] == pytest.approx([0.3, 0.7])


@pytest.mark.parametrize("kind", CLASSES)
def test_excitations_have_unit_size_and_begin_in_silence(kind):
    time = np.arange(6000) / 500.0
    u = excite(kind, np.random.default_rng(1), time, (0.8, 24.0))
    assert np.sqrt(np.mean(u**2)) == pytest.approx(1.0)
    assert not u[time < REST_S].any()
    spectrum = np.abs(np.fft.rfft(u)) ** 2
    assert spectrum[np.fft.rfftfreq(6000, 1 / 500.0) > 60.0].sum() < 0.01 * spectrum.sum()
