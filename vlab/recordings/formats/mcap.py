"""MCAP recordings: messages of topics as columns, see `vlab.recordings.formats.topics`."""

from collections.abc import Collection, Sequence
from pathlib import Path

from vlab.recordings.files import refuse
from vlab.recordings.formats.topics import read_topics
from vlab.recordings.table import Table


def read(
    data: bytes,
    path: Path,
    *,
    names: Sequence[str] | None = None,
    columns: Sequence[str] | None = None,
    blanks: Collection[str] = frozenset(),
) -> Table:
    """Read an MCAP log, see `vlab.recordings.open_table`."""
    if names is not None:
        raise refuse(path, "an MCAP log names its own topics", fix="leave out names")
    return read_topics("read_mcap", data, path, columns, blanks)
