"""What a run looks like inside: modal amplitudes, short-time spectra, forces before the limit, states of the law."""

from dataclasses import replace

import numpy as np
import pytest
from rerun import chunk

from vlab.controllers import DirectRateFeedback, LinearLaw
from vlab.lab.excitation import Multisine
from vlab.lab.experiment import Experiment, Result, run_experiment
from vlab.signals import Channel, Recording
from vlab.views.rerun import scene
from vlab.views.rerun.control_law import LawScene, LawStates, asked_forces
from vlab.views.rerun.modes import ModalScene
from vlab.views.rerun.spectra import SpectrumScene

PLACES = ("base", "20in")


def swinging(structure, plant, mode, amplitude, *, hz, seconds=4.0, rate=240.0):
    """Return a result in which one mode swings alone; its shape is one at the point that moves most."""
    linear = plant.linearise()
    rows = plant.port_rows([p.name for p in structure.point if p.name in plant.ports])
    shape = linear.eigen[1][:, mode] / np.abs(rows @ linear.eigen[1][:, mode]).max()
    times = np.arange(round(seconds * rate)) / rate
    frames = plant.new_data().qpos + amplitude * np.sin(2 * np.pi * hz * times)[:, None] * shape
    channel = Channel(name="x", kind="displacement", unit="m")
    recording = Recording(time=times, data=np.zeros((times.size, 1)), channels=(channel,))
    return Result(recording=recording, frame_times=times, frames=frames)


@pytest.mark.parametrize("mode", [1, 2, 5])
def test_a_mode_that_swings_alone_is_one_bar_of_its_amplitude(beam, composite, mode):
    modes = ModalScene(beam, composite)
    result = swinging(beam, composite, mode, 1e-4, hz=8.0)
    found = modes.amplitudes(result.frames, result.frame_times)[-1]
    # Eight whole periods lie in the window; modes are orthogonal to rounding, but sums of squares end within a sample.
    assert found == pytest.approx(1e-4 * np.eye(6)[mode], abs=1e-7)


def test_bars_do_not_depend_on_the_parts_they_were_sent_in(beam, composite):
    modes, result = ModalScene(beam, composite), swinging(beam, composite, 1, 1e-4, hz=3.0)

    class Kept:
        def __init__(self):
            self.rows = []

        def log(self, *_, **__):
            pass

        def send_columns(self, _path, _indexes, columns):
            self.rows += columns[0].as_arrow_array().to_pylist()

    whole, parts = Kept(), Kept()
    modes.log(whole, result)
    for since, until in ((0, 100), (100, 511), (511, 512), (512, 960)):
        modes.log(parts, result, since=since, until=until)
    bars = [np.array([row[0]["buffer"] for row in kept.rows], dtype=float) for kept in (whole, parts)]
    assert len(bars[0]) == 160
    assert bars[0] == pytest.approx(bars[1], rel=1e-6)  # sums that begin elsewhere round differently


def test_a_sine_has_its_peak_value_at_its_line():
    time = np.arange(20000) / 2000.0
    values = 3e-3 * np.sin(2 * np.pi * 12.5 * time + 0.3)
    channel = Channel(name="sensor:base", kind="velocity", unit="m/s", at="base")
    recording = Recording(time=time, data=values[:, None], channels=(channel,))
    spectra = SpectrumScene(recording, highest_hz=40.0)
    ends = spectra.ends(len(recording))
    assert ends.tolist() == [1000 * (k + 1) for k in range(20)]
    last = spectra.spectra(values, ends[-1:])[0]
    assert spectra.freq[last.argmax()] == pytest.approx(12.5)
    assert last.max() == pytest.approx(3e-3, rel=1e-9)  # whole periods in the window: no leakage
    assert SpectrumScene(recording).freq[SpectrumScene(recording).lines - 1] == pytest.approx(12.5, abs=2.5)


@pytest.fixture(scope="module")
def limited(modal, laboratory):
    """Return a run whose amplifiers have a limit, with its parts, and what they were asked for."""
    hardware = replace(laboratory, coil=replace(laboratory.coil, limit=0.05))
    law = DirectRateFeedback(20.0 * np.eye(2), sensors=PLACES, actuators=PLACES)
    excitation = Multisine(level=0.05, period_s=1.0, high_hz=30.0)
    experiment = Experiment(
        plant=modal, seconds=1.0, excitation=excitation, excite="base", controller=law, hardware=hardware
    )
    return run_experiment(experiment), hardware, law


def test_what_was_asked_is_what_was_given_up_to_the_limit(modal, limited):
    result, hardware, _ = limited
    asked = asked_forces(modal, result.recording, hardware)
    for place in PLACES:
        given = result.recording[f"force:{place}"]
        assert np.abs(given).max() <= 0.05 * (1 + 1e-12)
        free = np.abs(asked[place]) < 0.045  # where no step inside the sample can have met the limit
        # The excitation is taken as straight between samples: at 30 Hz and 2 kHz off by (omega T)^2/8 = 0.1 %.
        assert asked[place][free] == pytest.approx(given[free], abs=1e-3 * 0.2)
    assert np.abs(asked["base"]).max() > 0.06


def test_the_limit_stands_in_the_plots(modal, limited, tmp_path, beam):
    result, hardware, law = limited
    path = scene.write_run(tmp_path / "l.rrd", beam, modal, result, hardware=hardware, controller=law)
    names = []
    for piece in chunk.RrdReader(path).stream().to_chunks():
        if piece.is_static and piece.entity_path == "/law/0":
            table = piece.to_record_batch()
            names = table.column(next(i for i, n in enumerate(table.schema.names) if n.endswith("names"))).to_pylist()
    assert [n.partition(" [")[0] for n in names[0]] == [
        "asked of the amplifier", "force with excitation", "limit", "-limit", "command of the law",
    ]  # fmt: skip


def test_states_of_a_law_explain_its_commands(modal, laboratory):
    rng = np.random.default_rng(1)
    A, B, C = 0.3 * rng.standard_normal((3, 3)), rng.standard_normal((3, 2)), rng.standard_normal((2, 3))
    law = LinearLaw(A, B, C, np.zeros((2, 2)), sensors=PLACES, actuators=PLACES)
    excitation = Multisine(level=0.05, period_s=1.0, high_hz=30.0)
    experiment = Experiment(plant=modal, seconds=0.5, excitation=excitation, excite="base", controller=law)
    recording = run_experiment(experiment).recording
    inside = LawScene(modal, recording, laboratory, law)
    assert inside.states is not None
    followed = LawStates(law, modal)
    states = np.vstack([followed.follow(recording, 0, 400), followed.follow(recording, 400, len(recording))])
    assert followed.explain(recording, states)
    assert not followed.explain(recording, 1.001 * states)
    assert (
        LawScene(
            modal, recording, laboratory, DirectRateFeedback(np.eye(1), sensors=["base"], actuators=["base"])
        ).states
        is None
    )
