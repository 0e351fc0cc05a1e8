"""Rerun files, read back: every sample, both timelines, the structure where the ports are, nothing half-written."""

import contextlib
import os
from pathlib import Path

import mujoco
import numpy as np
import pytest
from rerun import chunk

from vlab.benchmark import rerun_writing as rerun_timing
from vlab.errors import BadRecording, OutputRefused
from vlab.lab.excitation import Multisine
from vlab.lab.experiment import Experiment, Result, run_experiment
from vlab.plants import Plant
from vlab.signals import Channel, FrequencyResponse, Recording
from vlab.views.figures import ROLES
from vlab.views.rerun import bars, documents, scene, traces
from vlab.views.rerun.frames import Motion
from vlab.views.rerun.traces import axis_unit

HOSTILE = "<script>/../$x ![a](http://b)"


def rows_of(path):
    """Return {entity: rows}, {entity: static components}, and the timelines."""
    rows, static, timelines = {}, set(), set()
    for piece in chunk.RrdReader(path).stream().to_chunks():
        if piece.is_static:
            static.add(piece.entity_path)
        else:
            rows[piece.entity_path] = rows.get(piece.entity_path, 0) + piece.num_rows
            timelines |= set(piece.timeline_names)
    return rows, static, timelines


def column(path, entity, component):
    """Return the values of one component of an entity over all rows."""
    for piece in chunk.RrdReader(path).stream().to_chunks():
        if piece.entity_path == entity and not piece.is_static:
            table = piece.to_record_batch()
            name = next(n for n in table.schema.names if n.endswith(component))
            return table.column(table.schema.names.index(name)).to_pylist()
    raise AssertionError(entity)


def look(path, entity, component):
    """Return the values of a static component of an entity."""
    for piece in chunk.RrdReader(path).stream().to_chunks():
        if piece.entity_path == entity and piece.is_static:
            table = piece.to_record_batch()
            for name in table.schema.names:
                if name.endswith(component):
                    return table.column(table.schema.names.index(name)).to_pylist()[0]
    raise AssertionError(entity)


def packed(colour):
    """Return a colour as Rerun stores it, with full alpha."""
    return int(colour[1:] + "ff", 16)


def traces_of(path):
    return [column(path, entity, "scalars") for entity in rows_of(path)[0] if entity.startswith("/traces/")]


@pytest.fixture(scope="module")
def run(composite: Plant) -> Result:
    excitation = Multisine(level=0.1, period_s=1.0, high_hz=30)
    return run_experiment(Experiment(plant=composite, seconds=1.0, excitation=excitation, excite="base"))


@pytest.fixture(scope="module")
def written(tmp_path_factory, beam, composite, run, laboratory):
    freq = np.linspace(1, 30, 50)
    H = (1 / (1 + 1j * freq))[:, None, None]
    frf = FrequencyResponse(freq=freq, H=H, outputs=("sensor:base",), inputs=("force:base",), unit="m/s/N")
    path = tmp_path_factory.mktemp("scene") / "run.rrd"
    return scene.write_run(path, beam, composite, run, frf=frf, analytical=frf, law="none", hardware=laboratory)


def test_every_sample_of_every_channel_is_written(written, run):
    rows, _, timelines = rows_of(written)
    traces = [entity for entity in rows if entity.startswith("/traces/")]
    assert {rows[entity] for entity in traces} == {len(run.recording)}
    assert timelines == {"sim_time", "step"}
    columns = [np.array(column(written, entity, "scalars")) for entity in traces]
    found = {tuple(values) for block in columns for values in block.T[:, ::97]}
    factors = [axis_unit(channel.unit)[0] for channel in run.recording.channels]
    assert 1e3 in factors
    assert found == {tuple(values) for values in (run.recording.data * factors).T[:, ::97]}


def test_structure_moves_at_the_stored_configurations(written, run, beam):
    rows, static, _ = rows_of(written)
    for bar in beam.bar:
        assert rows[f"/structure/bars/{bar.name}"] == len(run.frames)
        assert f"/structure/undeformed/{bar.name}" in static
    assert {"/structure/points/base", "/structure/cables/cable-upper\\:1", "/structure/forces/base"} <= set(rows)
    assert {"/facts", "/frf/0", "/structure/labels"} <= static


def test_traces_show_their_peaks_when_the_viewer_thins_them(written):
    pieces = [p for p in chunk.RrdReader(written).stream().to_chunks() if p.is_static and "/traces/" in p.entity_path]
    assert pieces
    for piece in pieces:
        table = piece.to_record_batch()
        policy = next(n for n in table.schema.names if n.endswith("aggregation_policy"))
        assert table.column(table.schema.names.index(policy)).to_pylist() == [[scene.PEAKS.value]]


def test_points_stand_where_the_ports_are(written, run, beam, composite):
    points = column(written, "/structure/points/base", "positions")
    drawn = np.array([p[0] for p in points])
    truth = scene.port_deflections(composite, run.frames, ["base"])[:, 0]
    size = float(np.hypot(*np.ptp([beam.position(p.name) for p in beam.point], axis=0)))
    everything = scene.port_deflections(composite, run.frames, [p.name for p in beam.point])
    factor = scene.sensible_exaggeration(float(np.abs(everything).max()), size)
    assert factor > 1
    assert drawn[:, 1] == pytest.approx(factor * truth, rel=1e-5, abs=1e-7)
    assert np.ptp(drawn[:, [0, 2]], axis=0) == pytest.approx([0, 0])


def test_motion_is_read_back_as_it_was(written, run, beam, composite, tmp_path):
    found, truth = Motion.read(written), Motion.of(beam, composite, run)
    assert found.names == truth.names
    assert np.array_equal(found.deflections, truth.deflections)
    assert np.array_equal(found.steps, truth.steps)
    assert found.times == pytest.approx(truth.times, abs=1e-9)  # Rerun keeps whole nanoseconds
    (tmp_path / "no.rrd").write_bytes(b"nothing")
    for damaged in (tmp_path / "no.rrd", tmp_path / "missing.rrd"):
        with pytest.raises(BadRecording, match="no motion of a structure"):
            Motion.read(damaged)


def test_the_file_opens_arranged(written):
    reader = chunk.RrdReader(written)
    assert len(reader.recordings()) == 1
    assert len(reader.blueprints()) == 1


def test_the_same_run_gets_the_same_identity_and_no_wall_clock(tmp_path, beam, composite, run):
    paths = [scene.write_run(tmp_path / f"{k}.rrd", beam, composite, run) for k in range(2)]
    ids = [chunk.RrdReader(path).recordings()[0].recording_id for path in paths]
    assert ids[0] == ids[1]
    assert all("log_time" not in rows_of(path)[2] for path in paths)
    assert b"start_time" not in paths[0].read_bytes()


@pytest.mark.parametrize(
    ("largest", "factor"), [(0.0, 1.0), (0.001, 200.0), (0.0021, 50.0), (0.01, 20.0), (0.2, 1.0), (10.0, 1.0)]
)
def test_exaggeration_is_a_round_number_of_at_least_one(largest, factor):
    assert scene.sensible_exaggeration(largest, 1.0) == pytest.approx(factor)


def test_hostile_channel_names_are_only_names(tmp_path, beam, composite, run):
    channels = list(run.recording.channels)
    channels[-1] = Channel(name=HOSTILE, kind="other", unit="V")
    recording = Recording(time=run.recording.time, data=run.recording.data, channels=tuple(channels))
    result = Result(recording=recording, frame_times=run.frame_times, frames=run.frames)
    path = scene.write_run(tmp_path / "h.rrd", beam, composite, result, law=HOSTILE)
    kinds = {(c.kind, c.unit) for c in channels}
    assert sum(entity.startswith("/traces/") for entity in rows_of(path)[0]) == len(kinds)
    assert sum(len(block[0]) for block in traces_of(path)) == len(channels)
    assert documents.cell("![a](http://b) <i>|\n") == r"\!\[a\]\(http://b\) \<i\>\| "


def test_comparison_overlays_and_subtracts(tmp_path):
    time = np.arange(2000) / 1000
    channel = Channel(name="sensor:base", kind="velocity", unit="m/s", at="base")
    measured = Recording(time=time, data=np.sin(9 * time)[:, None], channels=(channel,))
    shifted = time[:-1] + 0.0005
    simulated = Recording(time=shifted, data=0.5 * np.sin(9 * shifted)[:, None], channels=(channel,))
    path = scene.write_comparison(tmp_path / "c.rrd", measured, simulated)
    rows, _, timelines = rows_of(path)
    assert set(rows) == {f"/comparison/0/{what}" for what in ("measured", "nominal", "residual")}
    assert set(rows.values()) == {1998}  # the samples that lie within the simulation
    assert timelines == {"sim_time", "step"}
    rest = np.array(column(path, "/comparison/0/residual", "scalars")).ravel()
    assert rest == pytest.approx(500.0 * np.sin(9 * time[1:-1]), abs=0.1)  # mm/s
    for what in ("measured", "nominal", "residual"):
        assert look(path, f"/comparison/0/{what}", "colors") == [packed(ROLES[what]["color"])]


def test_plots_have_the_white_paper_that_black_curves_need():
    """Rerun draws plots on a dark ground, where the black of measured curves is invisible."""
    for view in (traces.plot_view("velocity", "/traces/0"), bars.bar_view("spectrum", "/spectra/0")):
        ground = view.properties["PlotBackground"]
        assert ground.color.as_arrow_array().to_pylist() == [packed("#ffffff")]


def test_bodies_of_any_model_are_drawn_within_the_model(tmp_path):
    xml = """<mujoco><worldbody><geom type="plane" size="9 9 1"/><body name="arm" pos="0 0 1"><joint axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 0 0 -.5" size=".02"/><site name="end" pos="0 0 -.5"/></body></worldbody></mujoco>"""
    spec = mujoco.MjSpec.from_string(xml)
    plant = Plant(name="mjcf", model=spec.compile(), spec=spec, actuators=(), sensors=())
    angles = np.linspace(0, 1, 30)[:, None]
    channel = Channel(name="angle", kind="angle", unit="rad")
    recording = Recording(time=np.arange(300) / 300, data=np.zeros((300, 1)), channels=(channel,))
    result = Result(recording=recording, frame_times=recording.time[::10], frames=angles)
    path = scene.write_bodies(tmp_path / "b.rrd", plant, result)
    assert rows_of(path)[0]["/bodies/geoms"] == 30
    rods = np.array(column(path, "/bodies/geoms", "strips"))
    assert rods.shape == (30, 1, 2, 3)  # the endless floor is not a rod
    assert np.linalg.norm(rods[:, 0, 1] - rods[:, 0, 0], axis=1) == pytest.approx(np.full(30, 0.5), rel=1e-5)


def test_configurations_of_another_plant_are_refused(tmp_path, beam, composite, run):
    result = Result(recording=run.recording, frame_times=run.frame_times, frames=run.frames[:, :-1])
    with pytest.raises(BadRecording, match="configurations"):
        scene.write_run(tmp_path / "x.rrd", beam, composite, result)
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_cannot_be_written_is_refused_in_one_line(tmp_path, beam, composite, run):
    (tmp_path / "taken").mkdir()
    with pytest.raises(OutputRefused) as caught:
        scene.write_run(tmp_path / "taken", beam, composite, run)
    assert "\n" not in str(caught.value)
    assert [p.name for p in tmp_path.iterdir()] == ["taken"]


def test_nothing_is_printed_and_no_connection_stays(tmp_path, beam, composite, run, capfd):
    before = open_sockets()
    scene.write_run(tmp_path / "quiet.rrd", beam, composite, run)
    assert capfd.readouterr() == ("", "")
    assert open_sockets() == before


def open_sockets():
    folder = Path("/proc/self/fd")
    if not folder.is_dir():
        pytest.skip("no /proc here")
    links = []
    for entry in list(folder.iterdir()):
        with contextlib.suppress(OSError):
            links.append(os.readlink(entry))
    return sorted(link for link in links if link.startswith("socket:"))


def test_a_folder_that_is_missing_is_refused(tmp_path, beam, composite, run):
    with pytest.raises(OutputRefused, match="cannot be written"):
        scene.write_run(tmp_path / "missing" / "run.rrd", beam, composite, run)
    assert list(tmp_path.iterdir()) == []


def test_a_failure_on_the_way_leaves_nothing(tmp_path, beam, composite, run, monkeypatch):
    def fail(*_args):
        raise KeyError("inside")

    monkeypatch.setattr(scene, "log_document", fail)
    with pytest.raises(KeyError):
        scene.write_run(tmp_path / "run.rrd", beam, composite, run)
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_fills_up_leaves_no_half_file(tmp_path, beam, composite, run):
    resource = pytest.importorskip("resource")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, hard))
    try:
        with pytest.raises(OutputRefused, match="incomplete"):
            scene.write_run(tmp_path / "run.rrd", beam, composite, run)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_long_recording_of_many_channels_is_written_whole(tmp_path):
    recording = rerun_timing.long_recording()  # what `vlab bench` times: 60 s of 50 channels at 2 kHz
    rerun_timing.write_traces(tmp_path / "long.rrd", recording)
    rows, static, _ = rows_of(tmp_path / "long.rrd")
    assert rows == {f"/traces/{k}": 120_000 for k in range(5)}
    assert set(rows) <= static  # names and units of all curves
