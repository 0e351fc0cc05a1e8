"""Writing time of a long recording for Rerun."""

import tempfile
from pathlib import Path

import numpy as np
import rerun as rr

from vlab.benchmark.comparisons import Row
from vlab.benchmark.stepping import cpu_times
from vlab.signals import Channel, Recording
from vlab.views.rerun.rrd import APPLICATION, blueprint, identity_of, rrd_file
from vlab.views.rerun.traces import log_traces, trace_views

SECONDS, RATE_HZ, CHANNELS = 60.0, 2000.0, 50
RUNS = 3
"""RUNS [1]: files of each way, in turn."""


def rerun_row() -> Row:
    """Time the writing of a long recording."""
    recording = long_recording()
    with tempfile.TemporaryDirectory(prefix="vlab-") as folder:
        path = Path(folder) / "traces.rrd"
        ours, peer, ratio = cpu_times(
            lambda: write_traces(path, recording), lambda: _send_channels(path, recording), RUNS
        )
    return Row(
        work=f"{SECONDS:g} s of {CHANNELS} channels at {RATE_HZ:g} Hz into a Rerun file, CPU seconds per recorded second",
        ours_s=ours / SECONDS,
        peer="rr.send_columns, one call a channel",
        peer_s=peer / SECONDS,
        ratio=ratio,
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


def _send_channels(path: Path, recording: Recording) -> None:
    """Write a recording as the documentation of Rerun shows it."""
    stream = rr.RecordingStream(APPLICATION, send_properties=False)
    stream.save(path)
    times = [rr.TimeColumn("sim_time", duration=recording.time)]
    for i, channel in enumerate(recording.channels):
        stream.send_columns(channel.name, times, rr.Scalars.columns(scalars=recording.data[:, i]))
    stream.disconnect()
