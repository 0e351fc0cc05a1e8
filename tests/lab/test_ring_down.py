"""Free decay and effort: fitted exponentials against made ones, releases against the predicted poles."""

import dataclasses
from dataclasses import replace

import numpy as np
import pytest

from vlab.errors import BadRecording
from vlab.hardware import load_hardware
from vlab.lab import Experiment, run_experiment
from vlab.lab.analysis import analytical_response, measured_response
from vlab.lab.excitation import Multisine, Release
from vlab.lab.free_decay import envelope_decay, fit_poles
from vlab.lab.laws import published_law
from vlab.lab.ring_down import LoopPoles, decays, loop_poles
from vlab.lab.run_folder import RunSettings
from vlab.signals import Channel, Recording

RATE = 200.0


def pole(hz, zeta):
    return 2 * np.pi * hz * (-zeta + 1j * np.sqrt(1 - zeta**2))


def vibration(poles, *, seconds=10.0, noise=0.0, channels=3, seed=0) -> Recording:
    """Return decaying exponentials of random size and phase at some sensors."""
    rng, t = np.random.default_rng(seed), np.arange(round(seconds * RATE)) / RATE
    size = rng.uniform(0.5, 1.0, (len(poles), channels)) * np.exp(2j * np.pi * rng.uniform(size=(len(poles), channels)))
    data = np.real(np.exp(np.outer(t, poles)) @ size) + noise * rng.standard_normal((t.size, channels))
    labels = tuple(Channel(name=f"sensor:{i}", kind="velocity", unit="m/s", at=str(i)) for i in range(channels))
    return Recording(time=t, data=data, channels=labels)


def test_poles_of_made_vibrations_are_found_from_a_wrong_start():
    true = np.array([pole(2.0, 0.18), pole(5.0, 0.03), pole(5.4, 0.05)])
    start = np.array([pole(2.1, 0.14), pole(4.95, 0.04), pole(5.5, 0.04)])
    found = fit_poles(vibration(true), start, np.zeros(0, dtype=complex))
    assert found.s == pytest.approx(true, rel=1e-7)  # the tolerance of the search
    assert found.misfit < 1e-6


def test_other_poles_take_part_and_stay():
    # a tone that does not decay and is not looked for: hum
    true, hum = np.array([pole(3.0, 0.05)]), np.array([2j * np.pi * 17.0])
    recording = vibration(np.concatenate([true, hum]))
    with_hum, without = (fit_poles(recording, true * 1.02, others) for others in (hum, np.zeros(0, dtype=complex)))
    assert with_hum.s == pytest.approx(true, rel=1e-7)
    assert without.misfit > 0.3


def test_standard_deviation_is_that_of_repeated_fits():
    true, none = np.array([pole(3.0, 0.05)]), np.zeros(0, dtype=complex)
    rng_free = vibration(true)
    fits = []
    for seed in range(40):
        noisy = rng_free.data + 0.05 * np.random.default_rng(seed).standard_normal(rng_free.data.shape)
        fits.append(fit_poles(dataclasses.replace(rng_free, data=noisy), true, none))
    spread = np.std([fit.s[0].real for fit in fits], ddof=1)
    assert np.mean([fit.sd[0] for fit in fits]) == pytest.approx(spread, rel=0.3)  # 40 fits tell a spread to 11 %


def test_the_envelope_falls_as_the_exponential():
    s = pole(4.0, 0.02)
    rate = envelope_decay(vibration(np.array([s])), "sensor:0", 4.0, 2.0)
    assert rate == pytest.approx(-s.real, rel=2e-3)  # the mirror image at 8 Hz, and the ends
    beating = vibration(np.array([s, pole(4.6, 0.02)]))
    assert envelope_decay(beating, "sensor:0", 4.0, 2.0) is None


def test_an_envelope_that_is_too_short_tells_nothing():
    assert envelope_decay(vibration(np.array([pole(4.0, 0.3)])), "sensor:0", 4.0, 2.0) is None


def test_vibrations_that_cannot_be_fitted_are_refused():
    none, start = np.zeros(0, dtype=complex), np.array([pole(3.0, 0.05)])
    recording = vibration(start)
    with pytest.raises(BadRecording, match="grows"):
        fit_poles(recording, np.array([pole(3.0, -0.3)]), none)
    with pytest.raises(BadRecording, match="record longer"):
        fit_poles(recording.between(0.0, 0.05), start, none)
    with pytest.raises(BadRecording, match="zero throughout"):
        fit_poles(dataclasses.replace(recording, data=np.zeros_like(recording.data)), start, none)
    force = dataclasses.replace(recording.channels[0], kind="force")
    forces = dataclasses.replace(recording, data=recording.data[:, :1], channels=(force,))
    with pytest.raises(BadRecording, match="no velocity or displacement"):
        fit_poles(forces, start, none)


def test_a_mode_that_noise_hides_is_not_told():
    recording = vibration(np.array([pole(3.0, 0.05)]), noise=1e-3)
    absent = LoopPoles(s=np.array([pole(3.0, 0.05), pole(8.0, 0.4)]), others=np.zeros(0, dtype=complex))
    seen, hidden = decays(recording, absent)
    assert seen.zeta == pytest.approx(0.05, rel=0.01)
    assert hidden.zeta is None


@pytest.mark.parametrize(
    ("law", "seconds", "tolerance"), [("", 10.0, 2e-3), ("mfdrf", 6.0, 0.02), ("lqdrf", 6.0, 0.02)]
)
def test_a_release_shows_the_predicted_damping(modal, fe, beam, law, seconds, tolerance):
    # the modal plant has the FE model's own modes; its step of half a millisecond shifts damping by less than this
    controller, hardware = published_law(beam, law) if law else None, load_hardware()
    experiment = Experiment(
        plant=modal, seconds=seconds, excitation=Release(level=0.1), excite="base", controller=controller
    )
    poles = loop_poles(fe, controller, hardware)
    found = decays(run_experiment(experiment).recording, poles)
    assert [mode.mode for mode in found] == [1, 2, 3, 4, 5, 6]
    told = [mode for mode in found if mode.zeta is not None]
    assert len(told) >= 5
    for mode in told:
        assert mode.zeta == pytest.approx(mode.predicted_zeta, rel=tolerance)
        assert mode.hz == pytest.approx(mode.predicted_hz, rel=2e-3)
        if mode.zeta_envelope is not None:
            assert mode.zeta_envelope == pytest.approx(mode.predicted_zeta, rel=0.05)
    if not law:
        assert sum(mode.zeta_envelope is not None for mode in found) >= 4  # light and well apart, but for modes 3 and 4


def test_a_missing_buffer_shows_in_the_release(modal, fe, beam):
    # section 5.1: back EMF adds a dissipative force; the modal damping of the closed form, seen in the decay
    hardware = load_hardware(values=["velocity_sensor.buffered=false"])
    experiment = Experiment(plant=modal, seconds=8.0, excitation=Release(level=0.1), excite="base", hardware=hardware)
    omega, shapes = fe.linear.eigen
    motion = fe.deflections([sensor.at for sensor in beam.sensor]) @ shapes[:, :6]
    expected = fe.linear.zeta[:6] + 25.0 / 608.0 * np.sum(motion**2, axis=0) / (2 * omega[:6])
    found = decays(run_experiment(experiment).recording, loop_poles(fe, None, hardware))
    assert min(expected / fe.linear.zeta[:6]) > 1.05  # visible in every mode, a third more in the first
    assert [mode.zeta for mode in found] == pytest.approx(expected, rel=0.01)


def test_a_loaded_coil_gives_less_inside_its_travel(modal, beam):
    # damping is small in the first milliseconds: the samples are R_load/(R + R_load) of the buffered ones
    law = published_law(beam, "mfdrf")
    runs = [
        run_experiment(
            Experiment(
                plant=modal,
                seconds=0.05,
                excitation=Multisine(level=0.1, period_s=1.0),
                excite="base",
                controller=law,
                hardware=load_hardware(values=values),
            )
        ).recording["sensor:base"]
        for values in ((), ("velocity_sensor.buffered=false", "velocity_sensor.sensitivity=0.001V s/m"))
    ]
    share = 600.0 / 608.0  # braking by 1e-6/608 is nothing: only the share is left, fed back as well
    assert runs[1] == pytest.approx(share * runs[0], rel=0.02, abs=0.01 * np.abs(runs[0]).max())
    assert np.abs(runs[1][1:20]).max() == pytest.approx(share * np.abs(runs[0][1:20]).max(), rel=1e-3)


def test_hum_on_unshielded_leads_reaches_the_law(modal, beam):
    seen = []

    class Listener:
        sensors, actuators = ("base",), ("base",)

        def reset(self):
            seen.clear()

        def step(self, y):
            seen.append(float(y[0]))
            return np.zeros(1)

    hardware = load_hardware(values=["leads.shielded=false", "leads.radio=0", "converter.resolution=0.1mV"])
    run = run_experiment(Experiment(plant=modal, seconds=1.0, controller=Listener(), hardware=hardware))
    assert np.array_equal(seen, run.recording["sensor:base"])
    spectrum = np.abs(np.fft.rfft(seen)) * 2 / len(seen)
    assert spectrum.argmax() == 60
    assert spectrum[60] == pytest.approx(np.sqrt(2) * 1e-3, rel=0.01)  # steps of 0.02 mm/s


def test_effort_counts_what_the_limit_cut(modal, beam, laboratory):
    # a force of 0.1 N peak through a limit of its half is beyond it for two thirds of the time: |sin| > 1/2
    limited = dataclasses.replace(laboratory, coil=dataclasses.replace(laboratory.coil, limit=0.05))
    sine = Multisine(level=0.1 / np.sqrt(2), period_s=1.0, low_hz=9.9, high_hz=10.1)
    run = run_experiment(Experiment(plant=modal, seconds=2.0, excitation=sine, excite="base", hardware=limited))
    base = next(part for part in run.effort if part.at == "base")
    assert base.saturated_share == pytest.approx(2 / 3, abs=0.005)  # edges fall on one of 200 steps a cycle
    assert base.force_peak == 0.05
    mean_square = 0.05**2 * 2 / 3 + 0.1**2 * (1 / 6 - np.sin(np.pi / 3) / (2 * np.pi))  # cut, and the sine below
    assert base.force_rms == pytest.approx(np.sqrt(mean_square), rel=0.01)
    assert base.command_rms == 0.0
    others = [part for part in run.effort if part.at != "base"]
    assert [part.force_rms for part in others] == [0.0, 0.0]


def test_effort_of_a_law_is_that_of_its_commands(modal, beam):
    law = published_law(beam, "mfdrf")
    run = run_experiment(
        Experiment(plant=modal, seconds=2.0, excitation=Release(level=0.2), excite="base", controller=law)
    )
    for part in run.effort:
        command = run.recording[f"command:{part.at}"]
        assert part.command_rms == pytest.approx(np.sqrt(np.mean(command**2)))
        assert part.command_peak == np.abs(command).max()
        assert part.saturated_share == 0.0


def test_a_run_keeps_its_hardware_values():
    settings = RunSettings(structure="beam", plant="modal", hardware_values=("leads.shielded=false",))
    assert not settings.prepare().hardware.leads.shielded
    assert 'hardware_values = ["leads.shielded=false"]' in settings.to_toml()


@pytest.mark.slow
@pytest.mark.parametrize("law", ["", "mfdrf"])
def test_theory_of_a_bench_without_buffers_is_what_it_measures(law):
    # the loaded coils brake the structure and give less: both are in the analytical response
    values = ("velocity_sensor.buffered=false", "velocity_sensor.unbuffered_load=20 ohm")
    settings = RunSettings(
        structure="beam",
        plant="modal",
        law=law,
        low_hz=1.0,
        high_hz=30.0,
        period_s=5.0,
        seconds=20.0 if law else 40.0,  # the law damps what the start leaves
        hardware_values=values,
    )
    prepared = settings.prepare()
    recording = run_experiment(prepared.experiment).recording
    measured = measured_response(recording)
    expected = analytical_response(prepared, recording, measured.freq)
    # in the first 20 s the slowest transient falls to exp(-7); the step lowers 22.7 Hz by 0.1 %, a fifth of its half width
    assert np.abs(measured.H - expected.H).max() < 0.03 * np.abs(expected.H).max()
    buffered = replace(settings, hardware_values=()).prepare()
    without = analytical_response(buffered, recording, measured.freq)
    assert np.abs(measured.H - without.H).max() > 0.2 * np.abs(expected.H).max()
