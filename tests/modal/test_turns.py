"""Coils one after another in one record, against records of each coil."""

import numpy as np
import pytest

from vlab.errors import BadExperiment
from vlab.lab.excitation import InTurn, SteppedSine, build_excitation
from vlab.lab.plant_modes import plant_modes
from vlab.lab.run_folder import RunSettings, simulate_run
from vlab.lab.suited import BANDWIDTHS, DECAYED, SEEN, suited
from vlab.modal.modal_test import ModalTest, estimate_responses
from vlab.modal.poles import PER_POLE, TOP_POLES, count_resonances, estimate_poles
from vlab.modal.turns import in_turns
from vlab.signals import FrequencyResponse


def test_a_turn_is_the_record_of_its_coil_alone():
    settings = RunSettings(structure="beam", plant="linear", seconds=12.0, period_s=1.0, at="base,40in")
    whole = simulate_run(settings.prepare()).recording
    first, second = in_turns([whole])
    assert (first.inputs, second.inputs) == (("excitation:base",), ("excitation:40in",))
    assert len(first) == len(second) == len(whole) / 2
    assert not np.any(whole["excitation:40in"][: len(first)])
    alone = simulate_run(RunSettings(**{**settings.__dict__, "seconds": 6.0, "at": "base"}).prepare()).recording
    np.testing.assert_allclose(first["sensor:base"], alone["sensor:base"], rtol=0, atol=1e-12)
    frf = estimate_responses([whole], ModalTest())
    assert [f.inputs for f in frf] == [first.inputs, second.inputs]
    np.testing.assert_allclose(frf[0].H, estimate_responses([alone], ModalTest())[0].H, rtol=1e-9)


def test_each_actuator_has_the_signal_in_its_turn():
    signal = build_excitation("multisine", period_s=2.0)
    turns = InTurn(signal=signal, actuators=3, turn_s=4.0)
    t = np.arange(1200) / 100.0
    found = turns.sample(t)
    for i in range(3):
        np.testing.assert_allclose(found[400 * i : 400 * (i + 1), i], signal.sample(t[:400]))
    assert np.count_nonzero(found, axis=1).max() == 1
    assert turns.facts["turn_s"] == 4.0


def test_coils_are_added_until_every_mode_of_the_grid_is_excited():
    prepared = RunSettings(structure="grid", plant="modal").prepare()
    chosen = suited(RunSettings(structure="grid", plant="modal")).settings.at.split(",")
    linear, plant = prepared.plant.linearise(), prepared.plant
    hz, shapes = linear.freq, linear.eigen[1]
    rows = np.abs(plant.actuator_forces().T @ shapes[:, (hz >= 0.5) & (hz <= 60.0)])
    used = rows[[plant.actuator_index(at) for at in chosen]].max(axis=0)
    assert chosen[0] == prepared.structure.exciter
    is_driven = rows.max(axis=0) > 1e-2 * rows.max()
    assert np.all(used[is_driven] >= SEEN * rows.max(axis=0)[is_driven])
    beam = suited(RunSettings(structure="beam", plant="modal"))
    assert beam.settings.at == ""  # its exciter sees all of its modes
    assert not beam.in_turn


def test_a_stepped_sine_has_fine_steps_about_every_mode():
    found = suited(RunSettings(structure="beam", plant="modal", excite="stepped-sine")).settings
    signal = build_excitation(found.excite)
    plant = RunSettings(structure="beam", plant="modal").prepare().plant
    modes = plant_modes(plant, [tap.name for tap in plant.sensors], low_hz=0.5, high_hz=60.0)
    for hz, zeta in zip(modes.freq[:6], modes.zeta[:6], strict=True):
        tau = 1 / (2 * np.pi * hz * zeta)
        near = np.abs(signal.freq / hz - 1) <= 2 * BANDWIDTHS * zeta * 1.001
        assert near.sum() >= 7
        assert np.exp(-signal.duration[near].max() / 2 / tau) <= DECAYED * 1.001
    assert found.seconds == np.ceil(signal.seconds)


def test_zooms_of_their_own_need_one_number_each():
    own = SteppedSine(steps=2, zoom_hz=(2.0, 5.0), zoom_widths=(0.1, 0.01), zoom_dwells_s=(9.0, 4.0), zoom_steps=3)
    near = np.abs(own.freq - 5.0) < 0.051
    assert own.freq[near].tolist() == pytest.approx([4.95, 5.0, 5.05])
    assert own.duration[near].tolist() == [4.0, 4.0, 4.0]
    with pytest.raises(BadExperiment, match="zoom_widths has 1 numbers for 2 zooms"):
        SteppedSine(zoom_hz=(2.0, 5.0), zoom_widths=(0.1,))
    with pytest.raises(BadExperiment, match="between 0 and 0.5"):
        SteppedSine(zoom_hz=(2.0,), zoom_widths=(0.7,))


def test_data_with_many_modes_get_a_higher_order():
    """Twenty-four modes at two inputs, in closed form: more than the first chart can carry."""
    rng, freq = np.random.default_rng(2), np.linspace(0.5, 30.0, 3000)
    hz, zeta = np.linspace(2.0, 28.0, 24) + 0.2 * rng.standard_normal(24), 0.004
    shapes, forces = rng.standard_normal((6, 24)), rng.standard_normal((2, 24))
    assert PER_POLE * 24 > TOP_POLES
    s, pole = 2j * np.pi * freq[:, None], 2 * np.pi * hz * (-zeta + 1j * np.sqrt(1 - zeta**2))
    each = 1 / ((s - pole) * (s - pole.conj()))
    H = np.einsum("fk,ok,ik->foi", each, shapes, forces)
    H += 1e-4 * np.abs(H).mean() * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape))
    outputs, inputs = tuple(f"y{i}" for i in range(6)), ("a", "b")
    found = estimate_poles(FrequencyResponse(freq=freq, H=H, outputs=outputs, inputs=inputs, unit="m/N"))
    assert found.freq == pytest.approx(np.sort(hz), rel=1e-3)
    assert found.zeta == pytest.approx(np.full(24, zeta), rel=0.05)


def test_resonances_are_counted_over_all_singular_values():
    """Six modes in closed form, two of them within a hundredth of a hertz of each other."""
    freq = np.linspace(0.5, 12.0, 4000)
    hz = np.array([2.0, 3.5, 5.0, 5.01, 8.0, 10.0])
    rng = np.random.default_rng(4)
    shapes, forces = rng.standard_normal((5, 6)), np.linalg.qr(rng.standard_normal((6, 6)))[0][:2]
    s, pole = 2j * np.pi * freq[:, None], 2 * np.pi * hz * (-0.004 + 1j)
    H = np.einsum("fk,ok,ik->foi", 1 / ((s - pole) * (s - pole.conj())), shapes, forces)
    outputs = tuple(f"y{i}" for i in range(5))
    frf = FrequencyResponse(freq=freq, H=H, outputs=outputs, inputs=("a", "b"), unit="m/N")
    assert count_resonances(frf) == pytest.approx(6, abs=1)
