"""A run that is streamed while it goes: everything arrives, in time, on this machine only, and a closed viewer is no harm."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from command import run
from rerun import chunk

from vlab.errors import BadExperiment, OutputRefused
from vlab.lab.run_folder import RunSettings, perform
from vlab.recordings import read_recording
from vlab.views.rerun import live, viewer
from vlab.views.rerun.traces import axis_unit

QUICK = RunSettings(structure="beam", plant="modal", seconds=0.6, period_s=0.6, low_hz=10.0, high_hz=30.0, law="mfdrf")
WORDS = "--plant modal --seconds 0.6 --period 0.6 --band 10 30 --law mfdrf"


def free_port():
    with socket.socket() as probe:
        probe.bind((viewer.HERE, 0))
        return probe.getsockname()[1]


@pytest.fixture
def saver(tmp_path):
    """Start Rerun without a window: it saves what arrives."""
    port, path = free_port(), tmp_path / "arrived.rrd"
    command = [sys.executable, "-m", "rerun", "--bind", viewer.HERE, "--port", str(port), "--save", str(path)]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    process = subprocess.Popen(command, env={**os.environ, "CI": "1"}, start_new_session=True, **quiet)
    try:
        end = time.monotonic() + 60
        while not viewer.listening(port):
            assert process.poll() is None
            assert time.monotonic() < end
            time.sleep(0.05)
        yield port, path, process
    finally:
        stop(process, signal.SIGKILL)


def stop(process, how):
    """End a viewer and the process that Rerun's command starts it in."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, how)
    process.wait(30)


def arrived(path, process):
    """Let the viewer write its file to the end and return the chunks."""
    stop(process, signal.SIGINT)
    return chunk.RrdReader(path).stream().to_chunks()


def listeners(port):
    """Return the addresses that something listens at a port on, as the kernel writes them."""
    table = Path("/proc/net/tcp")
    if not table.is_file():
        pytest.skip("no /proc here")
    lines = [line.split() for line in table.read_text().splitlines()[1:]]
    return [
        line[1].partition(":")[0] for line in lines if line[3] == "0A" and int(line[1].partition(":")[2], 16) == port
    ]


@pytest.mark.filterwarnings("ignore:RRD file has no footer")  # a file that was saved from a stream has none
def test_every_sample_of_a_live_run_arrives(saver, tmp_path, capsys):
    port, path, process = saver
    words = [*WORDS.split(), "--live", str(port), "--pace", "inf", "--out", str(tmp_path / "run")]
    status, _, _ = run(capsys, "experiment", "beam", *words)
    assert status == 0
    assert listeners(port) == ["0100007F"]  # 127.0.0.1
    recording = read_recording(tmp_path / "run" / "recording.parquet")
    rows, values = {}, {}
    for piece in arrived(path, process):
        if not piece.is_static:
            table = piece.to_record_batch()
            rows[piece.entity_path] = rows.get(piece.entity_path, 0) + piece.num_rows
            if piece.entity_path.startswith("/traces/"):
                name = next(n for n in table.schema.names if n.endswith("scalars"))
                steps = table.column("step").to_numpy()
                block = np.array(table.column(name).to_pylist())
                values.setdefault(piece.entity_path, {}).update(dict(zip(steps.tolist(), block, strict=True)))
    assert {rows[entity] for entity in values} == {len(recording)}
    found = {tuple(c) for block in values.values() for c in np.array([block[k] for k in sorted(block)]).T[:, ::41]}
    factors = [axis_unit(channel.unit)[0] for channel in recording.channels]
    assert found == {tuple(c) for c in (recording.data * factors).T[:, ::41]}
    assert (
        rows["/structure/bars/beam"] == rows["/structure/forces/base"] == 37
    )  # pictures: one every 33 samples of 1200
    assert {"/modes", "/spectra/0", "/law/0"} <= set(rows)


def test_a_viewer_that_is_closed_does_no_harm(saver, tmp_path):
    port, _, process = saver
    view = live.LiveView(QUICK.prepare(), connect=lambda: viewer.viewer_at(port), pace=float("inf"))

    def watch(done_s, so_far):
        view.watch(done_s, so_far)
        if process.poll() is None:
            stop(process, signal.SIGKILL)
            end = time.monotonic() + 60  # the viewer is a child of what was waited for
            while viewer.listening(port):
                assert time.monotonic() < end
                time.sleep(0.05)

    done = perform(QUICK.prepare(), tmp_path, watch=watch)
    view.finish(done.result)
    assert (tmp_path / "recording.parquet").is_file()


def test_a_paced_run_waits_and_sends_in_small_parts(monkeypatch):
    now, sent = [0.0], []
    monkeypatch.setattr(live.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(live.time, "sleep", lambda seconds: now.__setitem__(0, now[0] + seconds))
    view = live.LiveView(QUICK.prepare(), connect=lambda: "", pace=0.5)
    monkeypatch.setattr(view, "_send", lambda result, until_s: sent.append(until_s))
    view.watch(0.25, lambda: None)
    assert now[0] == pytest.approx(0.5, abs=1 / live.PICTURES_HZ)  # half as fast as the clock
    assert np.diff(sent).max() <= 0.5 / live.PICTURES_HZ + 1e-12
    assert sent[-1] == 0.25


@pytest.mark.parametrize("pace", [0.0, -1.0, float("nan")])
def test_a_pace_that_is_none_is_refused(pace):
    with pytest.raises(BadExperiment, match="pace"):
        live.LiveView(QUICK.prepare(), connect=lambda: "", pace=pace)


def test_without_a_display_nothing_is_started(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(viewer.sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(viewer.subprocess, "Popen", lambda *_, **__: pytest.fail("a viewer was started"))
    monkeypatch.chdir(tmp_path)
    for words, said in (
        (["--live", str(free_port())], "no display"),
        (["--live", "70000"], "accepted: 1 to 65535"),
        (["--pace", "2"], "--pace is for --live"),
    ):
        status, out, err = run(capsys, "experiment", "beam", *WORDS.split(), *words)
        assert (status, out, err.count("\n")) == (2, "", 1)
        assert said in err
        assert list(tmp_path.iterdir()) == []


def test_a_viewer_that_ends_at_once_is_said(monkeypatch):
    monkeypatch.setenv("DISPLAY", ":nowhere")
    ends = [sys.executable, "-c", "raise SystemExit(3)"]
    monkeypatch.setattr(viewer, "start_viewer", lambda **_: subprocess.Popen(ends))
    with pytest.raises(OutputRefused, match=r"ended at once \(status 3\)"):
        viewer.viewer_at(free_port())
