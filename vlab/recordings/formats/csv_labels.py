"""Labels of vlab's own CSV form, in comment lines."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vlab.recordings.files import refuse
from vlab.recordings.formats.cells import cut_line
from vlab.recordings.table import check_version, read_channel, read_meta
from vlab.signals import Channel

SIGNATURE = "vlab-recording"
"""SIGNATURE: beginning of the first comment."""


def header_of(channels: Sequence[Channel]) -> list[str]:
    """Return the header line of some channels."""
    return ["time [s]", *(f"{channel.name} [{channel.unit}]" for channel in channels)]


@dataclass(frozen=True, kw_only=True)
class Labels:
    """Contents of a vlab file's comment lines."""

    channels: tuple[Channel, ...]
    samples: str
    meta: dict[str, Any]


def read_labels(comments: Sequence[str], names: Sequence[str], path: Path) -> Labels:
    """Return the labels of a vlab file.

    Parameters
    ----------
    comments : sequence of str
        Comment lines without their sign.
    names : sequence of str
        Names in the header line, which must agree with the labels.
    path : Path
        Path of the file, for messages.

    Returns
    -------
    Labels
        Channels, number of samples and notes.

    Raises
    ------
    BadRecording
        The labels are damaged, or contradict the header.
    """
    check_version(comments[0].removeprefix(SIGNATURE).strip(), path)
    entries = [comment.partition(":")[::2] for comment in comments[1:]]
    channels = tuple(read_channel(cut_line(text, ";", path, 1), path) for key, text in entries if key == "channel")
    if tuple(names) != tuple(header_of(channels)):
        raise refuse(path, "the header and the channel labels do not agree", fix="the file was edited or is damaged")
    single = {key: text.strip() for key, text in entries if key != "channel"}
    return Labels(
        channels=channels,
        samples=single.get("samples", "an unknown number of"),
        meta=read_meta(single.get("meta", "{}"), path),
    )
