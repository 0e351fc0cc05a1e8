"""Topics of a robot log as columns, a clock each.

An isolated process decodes the messages, see `vlab.recordings.workers.messages`. Elements of a joint state are also
known by the joint: ``/joint_states/position[elbow]``.
"""

from collections.abc import Collection, Sequence
from pathlib import Path

from vlab.files.text import one_line
from vlab.recordings.formats.variables import Variables
from vlab.recordings.isolated import read_isolated
from vlab.recordings.table import Table

BYTES_PER_SECOND = 1e6
"""BYTES_PER_SECOND [bytes/s]: slowest accepted reading of a log."""
INSTALL = "'vlab-vibration[ros]' (mcap, mcap-ros2-support)"
"""INSTALL: packages that decode robot logs."""


def read_topics(reader: str, data: bytes, path: Path, columns: Sequence[str] | None, blanks: Collection[str]) -> Table:
    """Read the topics of a log in an isolated process.

    Parameters
    ----------
    reader : str
        Module of `vlab.recordings.workers`.
    data : bytes
        Bytes of the file.
    path : Path
        Path of the file, for messages.
    columns : sequence of str or None
        Columns to read; all by default.
    blanks : collection of str
        Columns that may hold NaN.

    Returns
    -------
    Table
        Columns of all topics.

    Raises
    ------
    BadRecording
        The library is missing, or the file is damaged.
    """
    answer = read_isolated(reader, data, path, library="mcap_ros2", install=INSTALL, bytes_per_second=BYTES_PER_SECOND)
    found = Variables.of_answer(answer, path)
    aliases = {}
    for topic, joints in answer["names"].items():
        for i, joint in enumerate(joints):
            for name in ("position", "velocity", "effort"):
                known = f"{topic}/{name}[{i}]"
                if known in found.columns or known in found.gappy:
                    aliases[f"{topic}/{name}[{one_line(joint)}]"] = known
    found.aliases = aliases
    return found.table(path, columns, blanks)
