"""Text files of numbers between blanks or other delimiters, see `vlab.recordings.formats.csv`."""

from collections.abc import Collection, Sequence
from pathlib import Path

from vlab.recordings.formats import csv
from vlab.recordings.table import Table


def read(
    data: bytes,
    path: Path,
    *,
    names: Sequence[str] | None = None,
    columns: Sequence[str] | None = None,
    blanks: Collection[str] = frozenset(),
) -> Table:
    """Read a text file, see `vlab.recordings.open_table`.

    Parameters
    ----------
    data : bytes
        Bytes of the file.
    path : Path
        Path of the file, for messages.
    names : sequence of str or None
        Column names of a file without names, or in place of its names.
    columns : sequence of str or None
        Columns to read; all by default.
    blanks : collection of str
        Columns that may have blank cells or NaN.

    Returns
    -------
    Table
        Columns, notes and units.

    Raises
    ------
    BadRecording
        The file is damaged, truncated or not numeric.
    """
    return csv.read(data, path, names=names, columns=columns, blanks=blanks)
