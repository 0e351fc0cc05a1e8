"""Table from records, with blank cells where a record lacks a value."""

from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np

from vlab.recordings.table import Table, not_finite, unknown_column
from vlab.recordings.workers.rows import Rows


def table_of(
    rows: Rows, path: Path, columns: Sequence[str] | None, blanks: Collection[str], notes: Sequence[str] = ()
) -> Table:
    """Return the table of some records.

    Parameters
    ----------
    rows : Rows
        Records.
    path : Path
        Path of the file, for messages.
    columns : sequence of str or None
        Columns to read; all by default.
    blanks : collection of str
        Columns that may hold NaN.
    notes : sequence of str
        Remarks on the file.

    Returns
    -------
    Table
        Columns and refusals.

    Raises
    ------
    UnknownName
        A column is not in the file.
    """
    found, refused = rows.arrays(), dict(rows.refused)
    for name in columns or ():
        if name not in found and name not in refused:
            raise unknown_column(name, list(found), path, others=refused)
    kept = {name: values for name, values in found.items() if columns is None or name in columns}
    for name in [n for n, values in kept.items() if not np.isfinite(values).all() and n not in blanks]:
        refused[name] = not_finite(kept.pop(name))
    return Table(
        path=path, columns=kept, refused=refused, notes=tuple(notes), blanks=frozenset(n for n in kept if n in blanks)
    )
