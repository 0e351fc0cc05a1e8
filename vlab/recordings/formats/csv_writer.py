"""Labelled CSV files of vlab: the writer."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from vlab.errors import BadRecording
from vlab.recordings.files import PathLike, refuse, written_whole
from vlab.recordings.formats.cells import cut_line
from vlab.recordings.formats.csv_labels import SIGNATURE, header_of
from vlab.recordings.table import (
    FORMAT_VERSION,
    meta_to_json,
    read_channel,
)
from vlab.signals import Channel, Recording


def write_csv(recording: Recording, path: PathLike) -> tuple[str, ...]:
    """Write a recording as labelled CSV, see `vlab.recordings.write_recording`.

    Parameters
    ----------
    recording : Recording
        Recording in SI.
    path : str or path
        Path of the file.

    Returns
    -------
    tuple of str
        Empty, because the form is exact.

    Raises
    ------
    BadRecording
        A label cannot be written as CSV text.
    """
    lines = [
        f"# {SIGNATURE} {FORMAT_VERSION}",
        f"# samples: {len(recording)}",
        f"# meta: {meta_to_json(recording.meta, path)}",
    ]
    for channel in recording.channels:
        text = _write_cells(
            [channel.name, channel.kind, channel.unit, channel.at, "input" if channel.is_input else "output"], ";"
        )
        if not _survives(text, channel, path):
            raise refuse(
                path,
                f"the labels of channel {channel.name!r} cannot be written as CSV text",
                fix="rename it, or write .parquet",
            )
        lines.append(f"# channel: {text}")
    lines.append(_write_cells(header_of(recording.channels), ","))
    with written_whole(path) as stream:
        stream.write(("\n".join(lines) + "\n").encode())
        for start in range(0, len(recording), 16384):
            block = np.column_stack([recording.time[start : start + 16384], recording.data[start : start + 16384]])
            stream.write(("\n".join(",".join(map(repr, row)) for row in block.tolist()) + "\n").encode())
    return ()


def _write_cells(cells: Sequence[str], delimiter: str) -> str:
    stream = io.StringIO()
    csv.writer(stream, delimiter=delimiter, lineterminator="").writerow(cells)
    return (
        stream.getvalue().replace(";", "; ") if delimiter == ";" and '"' not in stream.getvalue() else stream.getvalue()
    )


def _survives(text: str, channel: Channel, path: PathLike) -> bool:
    try:
        header = cut_line(_write_cells(header_of([channel]), ","), ",", Path(path), 1)
        label = text.isprintable() and read_channel(cut_line(text, ";", Path(path), 1), path)
    except (BadRecording, UnicodeEncodeError):
        return False
    return label == channel and header == header_of([channel])
