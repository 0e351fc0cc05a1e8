"""Writing time of a long recording for Rerun, beside row-by-row logging."""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import rerun as rr

from vlab.benchmark.comparisons import Row
from vlab.signals import Channel, Recording
from vlab.views.rerun.rrd import APPLICATION, blueprint, identity_of, rrd_file
from vlab.views.rerun.traces import log_traces, trace_views

SECONDS, RATE_HZ, CHANNELS = 60.0, 2000.0, 50
PEER_ROWS = 20_000
"""PEER_ROWS [rows]: rows logged one by one; their time scales to all six million rows."""


def rerun_row() -> Row:
    """Time the writing of a long recording."""
    recording = long_recording()
    with tempfile.TemporaryDirectory(prefix="vlab-") as folder:
        path = Path(folder) / "traces.rrd"
        ours = min(_seconds(lambda: write_traces(path, recording)) for _ in range(3))
        row_s = _seconds(lambda: _log_rows(path, recording)) / PEER_ROWS
    peer = row_s * len(recording) * CHANNELS
    return Row(
        work=f"{SECONDS:g} s of {CHANNELS} channels at {RATE_HZ:g} Hz into a Rerun file, per recorded second",
        ours_s=ours / SECONDS,
        peer=f"rr.log of every sample, from {PEER_ROWS} of them",
        peer_s=peer / SECONDS,
        ratio=peer / ours,
        real_time_factor=SECONDS / ours,
    )


def long_recording() -> Recording:
    """Return noise in five kinds of channel."""
    samples = round(SECONDS * RATE_HZ)
    kinds = (("velocity", "m/s"), ("displacement", "m"), ("force", "N"), ("command", "N"), ("acceleration", "m/s^2"))
    channels = tuple(
        Channel(name=f"{kind}:{k}", kind=kind, unit=unit, at=str(k))
        for kind, unit in kinds
        for k in range(CHANNELS // len(kinds))
    )
    data = np.random.default_rng(0).standard_normal((samples, CHANNELS))
    return Recording(time=np.arange(samples) / RATE_HZ, data=data, channels=channels)


def write_traces(path: Path, recording: Recording) -> None:
    """Write the traces of a recording as a Rerun file."""
    layout = blueprint(trace_views(recording)[0])
    with rrd_file(path, "traces", layout, identity_of(recording.between(0.0, 1.0))) as stream:
        log_traces(stream, recording)


def _log_rows(path: Path, recording: Recording) -> None:
    stream = rr.RecordingStream(APPLICATION, send_properties=False)
    stream.save(path)
    for k in range(PEER_ROWS):
        stream.set_time("sim_time", duration=recording.time[k])
        stream.set_time("step", sequence=k)
        stream.log("trace", rr.Scalars(recording.data[k, 0]))
    stream.disconnect()


def _seconds(work: Callable[[], None]) -> float:
    begun = time.perf_counter()
    work()
    return time.perf_counter() - begun
