"""Table from records, with blank cells where a record lacks a value."""

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from vlab.recordings.stamps import FORM, BadStamp, first_stamp, is_stamp, seconds_from
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
    times, faults = stamps_of(rows)
    found, refused = rows.arrays() | times, rows.refused | faults
    refused = {name: why for name, why in refused.items() if name not in times}
    for name in columns or ():
        if name not in found and name not in refused:
            raise unknown_column(name, list(found), path, others=refused)
    kept = {name: values for name, values in found.items() if columns is None or name in columns}
    for name in [n for n, values in kept.items() if not np.isfinite(values).all() and n not in blanks]:
        refused[name] = not_finite(kept.pop(name))
    return Table(
        path=path,
        columns=kept,
        refused=refused,
        notes=tuple(notes),
        units={name: "s" for name in times if name in kept},
        blanks=frozenset(n for n in kept if n in blanks),
    )


def stamps_of(rows: Rows) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the columns of time stamps in seconds, and reasons of refusal.

    Parameters
    ----------
    rows : Rows
        Records.

    Returns
    -------
    tuple of (dict of str to (n,) array, dict of str to str)
        Times [s] from the earliest first stamp; faults of columns that begin with a stamp.
    """
    found, refused = {}, {}
    firsts = {name: next(text for text in texts if text is not None) for name, texts in rows.texts.items()}
    for name, texts in rows.texts.items():
        if not is_stamp(firsts[name]):
            continue
        if name in rows.columns:
            refused[name] = "it holds time stamps and numbers"
            continue
        every = [*texts, *[None] * (rows.count - len(texts))]
        try:
            found[name] = seconds_from(first_stamp(firsts.values(), firsts[name]), every)
        except BadStamp as error:
            refused[name] = f"record {error.row + 1} {error.what}; write all stamps of a column as {FORM}"
    return found, refused
