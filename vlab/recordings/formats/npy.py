"""NPY recordings: one array of numpy, never unpickled.

A matrix has the columns ``col0``, ``col1`` and so on. A structured array has its fields. ``data[:, 2]`` names a part of
the array, see `vlab.recordings.formats.variables.part_of`.
"""

from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np

from vlab.recordings.files import refuse
from vlab.recordings.formats.npz import array_of
from vlab.recordings.formats.variables import Damaged, Skipped, Variables
from vlab.recordings.table import MAX_COLUMNS, Table

NAME = "data"
"""NAME: name of the whole array."""


def read(
    data: bytes,
    path: Path,
    *,
    names: Sequence[str] | None = None,
    columns: Sequence[str] | None = None,
    blanks: Collection[str] = frozenset(),
) -> Table:
    """Read an NPY file, see `vlab.recordings.open_table`.

    Parameters
    ----------
    data : bytes
        Bytes of the file.
    path : Path
        Path of the file, for messages.
    names : sequence of str or None
        Names in place of ``col0``, ``col1`` and so on.
    columns : sequence of str or None
        Columns to read; all by default.
    blanks : collection of str
        Columns that may have blank cells or NaN.

    Returns
    -------
    Table
        Columns of the array.

    Raises
    ------
    BadRecording
        The file is damaged, or holds no array of numbers.
    """
    found = Variables()
    try:
        value = array_of(data, path.name, is_structured=True)
        if isinstance(value, Skipped | str):
            what = value.what if isinstance(value, Skipped) else "text"
            raise refuse(path, f"the file holds {what}", fix="save an array of numbers")
        if isinstance(value, dict):
            for name, column in value.items():
                found.add(name, column)
            return found.table(path, columns, blanks)
        if value.ndim > 2:
            found.add(NAME, value)
            return found.table(path, columns, blanks)
        table = value.reshape(len(value), -1) if value.ndim else value.reshape(1, 1)
        if table.shape[1] > len(table):
            table = table.T
            found.notes.append(f"array of {value.shape}: its samples are taken along axis 2")
        if table.shape[1] > MAX_COLUMNS:
            raise refuse(path, f"{table.shape[1]} columns; at most {MAX_COLUMNS} are read")
        if names is not None and len(names) != table.shape[1]:
            raise refuse(path, f"{len(names)} names were given for {table.shape[1]} columns")
        for i in range(table.shape[1]):
            found.add(names[i] if names is not None else f"col{i}", np.ascontiguousarray(table[:, i]))
        found.arrays[NAME] = value
    except Damaged as error:
        raise refuse(path, str(error), fix="the file is damaged; copy or export it again") from error
    return found.table(path, columns, blanks)
