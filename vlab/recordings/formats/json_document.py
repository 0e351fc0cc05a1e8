"""JSON documents: lists of numbers by name, records, or several runs."""

import json
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from vlab.files.text import one_line
from vlab.recordings import files
from vlab.recordings.files import refuse
from vlab.recordings.formats.json_runs import Run, alike, is_rows, runs_in, stacked
from vlab.recordings.formats.records import stamps_of, table_of
from vlab.recordings.formats.variables import Damaged, Skipped, Variables
from vlab.recordings.stamps import FORM, BadStamp, is_stamp, read_stamp, seconds_from
from vlab.recordings.table import Table
from vlab.recordings.workers.rows import DEEPEST, Rows

MOST_BYTES = 2**28
"""MOST_BYTES [bytes]: largest document; its objects take some ten times as much memory."""


def read(
    data: bytes,
    path: Path,
    *,
    names: Sequence[str] | None = None,
    columns: Sequence[str] | None = None,
    blanks: Collection[str] = frozenset(),
) -> Table:
    """Read a JSON document, see `vlab.recordings.open_table`.

    A list of objects gives one row an object. An object gives a column for each list of numbers, and dotted names for
    nested objects. A list of objects in an object gives columns such as ``entries.position``. Several runs follow each
    other, see `vlab.recordings.formats.json_runs`.

    Parameters
    ----------
    data : bytes
        Bytes of the file.
    path : Path
        Path of the file, for messages.
    names : sequence of str or None
        Must be None, because the file has its own names.
    columns : sequence of str or None
        Columns to read; all by default.
    blanks : collection of str
        Columns that may have blank cells or NaN.

    Returns
    -------
    Table
        Columns and refusals.

    Raises
    ------
    BadRecording
        The document is damaged or too large.
    """
    if names is not None:
        raise refuse(path, "a JSON document names its own values", fix="leave out names")
    if len(data) > MOST_BYTES:
        raise refuse(path, f"a JSON document of {len(data)} bytes", fix="write JSON lines (.jsonl), one object a line")
    try:
        content = json.loads(data.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise refuse(path, f"not a JSON document: {error}", fix="name a file with one object a line .jsonl") from error
    limit = files.unpacked_limit(len(data))
    runs = runs_in(content)
    if runs:
        return table_of_runs(runs, path, columns, blanks, limit)
    try:
        if is_rows(content):
            return table_of(_rows(content, limit), path, columns, blanks)
        if not isinstance(content, dict):
            fix = 'write {"name": [values], ...}, a list of objects, or a list of runs'
            raise refuse(path, "the document holds no names", fix=fix)
        found = Variables()
        _collect(found, "", content, limit, 0)
    except (Damaged, ValueError, OverflowError) as error:
        if isinstance(error, files.BadRecording):
            raise
        raise refuse(path, str(error), fix="cut the recording into parts") from error
    pair = alike(content)
    if pair:
        one, other = (one_line(name) for name in pair)
        found.notes.append(
            f"{one!r} and {other!r} have equal columns with times of their own; if they are runs, put them in a list: "
            '{"runs": [...]}'
        )
    return found.table(path, columns, blanks)


def table_of_runs(
    runs: Sequence[Run], path: Path, columns: Sequence[str] | None, blanks: Collection[str], limit: int
) -> Table:
    """Return the table of several runs.

    Parameters
    ----------
    runs : sequence of Run
        Runs.
    path : Path
        Path of the file, for messages.
    columns : sequence of str or None
        Columns to read; all by default.
    blanks : collection of str
        Columns that may have blank cells or NaN.
    limit : int
        Largest size of the columns [bytes].

    Returns
    -------
    Table
        Columns of all runs, one run after the other.

    Raises
    ------
    BadRecording
        No run has a column, or the columns are too large.
    """

    def read_one(content: Any) -> Variables:
        found = Variables()
        if is_rows(content):
            rows = _rows(content, limit)
            times, faults = stamps_of(rows)
            for key, column in (rows.arrays() | times).items():
                found.add(key, column)
            found.refused |= {key: why for key, why in (rows.refused | faults).items() if key not in times}
            found.units |= dict.fromkeys(times, "s")
        else:
            _collect(found, "", content, limit, 0)
        return found

    try:
        found = stacked(runs, read_one)
    except (Damaged, ValueError, OverflowError) as error:
        raise refuse(path, str(error), fix="cut the recording into parts") from error
    return found.table(path, columns, blanks)


def _rows(records: Sequence[Any], limit: int) -> Rows:
    rows = Rows(limit)
    for record in records:
        rows.add(record)
    return rows


def _collect(found: Variables, name: str, value: Any, limit: int, depth: int) -> None:
    """Add a value and the values inside under dotted names."""
    if depth > DEEPEST:
        raise ValueError(f"objects are nested more than {DEEPEST} deep")
    if is_rows(value):
        rows = _rows(value, limit)
        times, faults = stamps_of(rows)
        for key, column in (rows.arrays() | times).items():
            found.add(f"{name}.{key}", column)
        for key, why in (rows.refused | faults).items():
            if key not in times:
                found.refused[f"{name}.{key}"] = why
        found.units |= {f"{name}.{key}": "s" for key in times}
    elif isinstance(value, dict):
        for key, part in value.items():
            _collect(found, f"{name}.{key}" if name else str(key), part, limit, depth + 1)
    elif isinstance(value, list) and value and isinstance(value[0], str) and is_stamp(value[0]):
        texts = [part if isinstance(part, str | None) else str(part) for part in value]
        try:
            found.add(name, seconds_from(read_stamp(value[0]), texts))
            found.units[name] = "s"
        except BadStamp as error:
            found.refused[name] = f"element {error.row + 1} {error.what}; write all stamps of a list as {FORM}"
    elif isinstance(value, list):
        found.add(name, _array(value))
    elif isinstance(value, int | float):
        found.add(name, np.array([float(value)]))
    elif isinstance(value, str):
        found.add(name, value)


def _array(value: list[Any]) -> Any:
    try:
        array = np.array(value, dtype=float)  # null becomes NaN, text raises
    except (ValueError, TypeError, OverflowError):
        return Skipped("a list of other things than numbers, or of unequal lists")
    return array if array.ndim <= 3 else Skipped(f"a list nested {array.ndim} deep")
