"""Sensors as real: pick-up, drift, steps of the converter and loaded coils against closed forms."""

import dataclasses

import numpy as np
import pytest

from vlab.errors import BadExperiment, BadStructure, UnknownName
from vlab.hardware import load_hardware
from vlab.hardware.back_emf import brake_model, brake_plant
from vlab.hardware.sensing import Sampling, coil_gain

COILS_AND_PROBE = np.array([True, True, False])
SECONDS = 4


def still(*values: str, seed: int = 0, hz: float = 2000.0) -> tuple[np.ndarray, np.ndarray]:
    """Return times and samples of sensors that do not move."""
    hardware = load_hardware(values=values).at_rate(hz)
    n = round(SECONDS * hz)
    sampling = Sampling.draw(hardware, COILS_AND_PROBE, n, np.random.default_rng(seed))
    return np.arange(n) / hz, sampling.samples(np.zeros((n, 3)), None, slice(None))


def test_the_default_laboratory_adds_nothing():
    _, samples = still()
    assert not samples.any()


def test_mains_shows_at_sixty_hertz_on_coils_alone():
    # 5 mV rms over 5 V s/m: a line of sqrt(2) mm/s at 60 Hz, and nothing else; the probe's lead is not a coil's
    _, samples = still("leads.shielded=false", "leads.radio=0")
    spectrum = np.abs(np.fft.rfft(samples, axis=0)) * 2 / len(samples)
    line = 60 * SECONDS
    assert spectrum[line, :2] == pytest.approx(np.sqrt(2) * 1e-3, rel=1e-9)
    spectrum[line] = 0.0
    assert spectrum.max() < 1e-12
    assert not samples[:, 2].any()


def test_radio_is_folded_to_below_half_the_sample_rate():
    # 1.000137 MHz is 500 x 2 kHz + 137 Hz, and 1000 x 1 kHz + 137 Hz: nothing before the converter filters it
    for rate in (2000.0, 1000.0):
        _, samples = still("leads.shielded=false", "leads.mains=0", hz=rate)
        spectrum = np.abs(np.fft.rfft(samples[:, 0])) * 2 / len(samples)
        assert spectrum.argmax() == 137 * SECONDS
        assert spectrum.max() == pytest.approx(np.sqrt(2) * 2e-3 / 5, rel=1e-6)  # phases reach 2.5e7: 1e-9 of a turn


def test_leads_have_phases_of_their_own_from_the_seed():
    first, again, other = (still("leads.shielded=false", seed=seed)[1] for seed in (3, 3, 4))
    assert np.array_equal(first, again)
    assert not np.allclose(first, other)
    assert not np.allclose(first[:, 0], first[:, 1])


def test_noise_keeps_its_bits_beside_pick_up_and_drift():
    alone = still("velocity_sensor.noise=1mm/s")[1]
    together = still("velocity_sensor.noise=1mm/s", "leads.shielded=false", "leads.radio=0")[1]
    hum = together - alone
    assert np.std(hum[:, 0]) == pytest.approx(1e-3, rel=1e-9)  # 5 mV rms over 5 V s/m


def test_drift_is_a_straight_line_of_the_drawn_rate():
    t, samples = still("velocity_sensor.drift=1um/s^2", "displacement_probe.drift=2um/s", seed=5)
    rates = np.random.default_rng(5).standard_normal(3) * [1e-6, 1e-6, 2e-6]
    assert samples == pytest.approx(np.outer(t, rates), abs=1e-18)


def test_the_converter_rounds_to_its_volts_through_each_sensitivity():
    # 10 mV: 2 mm/s of a coil of 5 V s/m, 0.01 in of a probe of 1 V/in
    hardware = load_hardware(values=["converter.resolution=10mV"])
    sampling = Sampling.draw(hardware, COILS_AND_PROBE, 1, np.random.default_rng(0))
    values = np.random.default_rng(1).uniform(-0.05, 0.05, (1000, 3))
    rounded = sampling.samples(values, None, slice(None))
    step = np.array([2e-3, 2e-3, 0.01 * 0.0254])
    assert rounded / step == pytest.approx(np.round(rounded / step), abs=1e-9)
    error = rounded - values
    assert np.abs(error).max(axis=0) == pytest.approx(step / 2, rel=0.02)  # of a thousand draws
    assert np.std(error, axis=0) == pytest.approx(step / np.sqrt(12), rel=0.05)  # uniform between steps


def test_some_sensors_sample_as_they_do_among_all():
    hardware = load_hardware(values=["leads.shielded=false", "converter.resolution=1mV", "velocity_sensor.noise=1mm/s"])
    sampling = Sampling.draw(hardware, COILS_AND_PROBE, 50, np.random.default_rng(2))
    values, few = np.random.default_rng(3).uniform(-0.05, 0.05, 3), np.array([2, 0])
    for at in (0, 17):
        assert np.array_equal(sampling.only(few).converted(values[few], at), sampling.converted(values, at)[few])


def test_roll_off_takes_the_share_of_the_closed_form_from_a_large_motion(laboratory):
    # a travel of twice the linear one swings to an excess of half the range: gain 1/2 at the ends, 1 inside
    travel, phase = laboratory.velocity_sensor.linear_range, 2 * np.pi * np.arange(4000) / 4000
    place, velocity = travel * np.sin(phase), np.cos(phase)
    sampling = Sampling.draw(laboratory, np.array([True]), 1, np.random.default_rng(0))
    seen = sampling.samples(velocity[:, None], place[:, None], slice(None))[:, 0]
    inside = np.abs(place) <= travel / 2
    assert np.array_equal(seen[inside], velocity[inside])
    excess = 2 * np.abs(np.sin(phase)) - 1
    exact = np.where(excess > 0, velocity / (1 + excess**2), velocity)
    assert seen == pytest.approx(exact, rel=1e-12)
    assert coil_gain(np.array([travel]), travel) == pytest.approx(0.5)


def test_a_missing_buffer_brakes_by_bl_squared_over_r_and_takes_its_share():
    coil = load_hardware(values=["velocity_sensor.buffered=false"]).velocity_sensor
    assert coil.back_emf_damping == pytest.approx(5.0**2 / (8.0 + 600.0))
    assert coil.signal_share == pytest.approx(600.0 / 608.0)
    shorted = dataclasses.replace(coil, unbuffered_load=1e-9)
    assert shorted.back_emf_damping == pytest.approx(25.0 / 8.0)  # Bl^2/R of the coil alone
    assert load_hardware().velocity_sensor.back_emf_damping == 0.0
    assert load_hardware().velocity_sensor.signal_share == 1.0


@pytest.mark.parametrize("plant_name", ["modal", "composite"])
def test_braking_adds_the_modal_damping_of_the_coils(request, beam, fe, plant_name):
    # 2 zeta omega grows by Bl^2/R sum(phi_i^2); Phi^T C Phi of plant and model alike
    hardware, plant = load_hardware(values=["velocity_sensor.buffered=false"]), request.getfixturevalue(plant_name)
    assert brake_plant(plant, load_hardware()) is plant
    omega, shapes = fe.linear.eigen
    motion = fe.deflections([sensor.at for sensor in beam.sensor]) @ shapes[:, :6]
    added = 25.0 / 608.0 * np.sum(motion**2, axis=0) / (2 * omega[:6])
    braked = brake_plant(plant, hardware)
    # the composite's shapes are its own: 0.2 % of frequency, 1 % of a squared deflection
    rel = 1e-6 if plant_name == "modal" else 0.02
    assert braked.linearise().zeta[:6] - plant.linearise().zeta[:6] == pytest.approx(added, rel=rel)
    model = brake_model(fe, hardware)
    assert model.linear.zeta[:6] - fe.linear.zeta[:6] == pytest.approx(added, rel=1e-9)
    assert brake_model(fe, load_hardware()) is fe


def test_force_coils_without_current_control_brake_the_model_too(beam, fe):
    hardware = load_hardware(values=["coil.current_controlled=false"])
    omega, shapes = fe.linear.eigen
    added = 25.0 / 8.0 * np.sum((fe.coils.T @ shapes[:, :6]) ** 2, axis=0) / (2 * omega[:6])
    assert brake_model(fe, hardware).linear.zeta[:6] - fe.linear.zeta[:6] == pytest.approx(added, rel=1e-9)


def test_values_given_with_a_run_take_units_and_switches(laboratory):
    hardware = load_hardware(
        values=["coil.limit=0.2lbf", "converter.rate=1 kHz", "array.states=8", "leads.shielded = false"]
    )
    assert hardware.coil.limit == pytest.approx(0.2 * 4.4482216)
    assert hardware.converter.rate == 1000.0
    assert hardware.array.states == 8
    assert hardware.leads.carriers != ()
    assert laboratory.leads.carriers == ()


@pytest.mark.parametrize(
    ("text", "error", "words"),
    [
        ("noise=3", BadExperiment, "TABLE.KEY=VALUE"),
        ("coil.limit=much", BadExperiment, "TABLE.KEY=VALUE"),
        ("coils.limit=3", UnknownName, "did you mean 'coil'"),
        ("coil.limits=3", UnknownName, "did you mean 'limit'"),
        ("coil.limit=3 m", BadStructure, "cannot be converted"),
        ("coil.limit=-3", BadStructure, "must be at least 0"),
        ("coil.limit=1e999", BadStructure, "must be finite"),
        ("coil.current_controlled=1", BadStructure, "bool was expected"),
        ("converter.rate=5000", BadStructure, "outside the converter's"),
    ],
)
def test_bad_values_are_refused_in_one_line(text, error, words):
    with pytest.raises(error, match=words):
        load_hardware(values=[text])
