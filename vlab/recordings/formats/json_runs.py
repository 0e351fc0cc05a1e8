"""Runs of a JSON document: several recordings of equal columns in one file.

A run is an object of equally long lists, or a list of row objects. The runs stand in a list, or under names such as
``run1``. Their rows follow each other in one table, and the column `EPISODE` counts the runs from 0.
"""

import itertools
import re
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from vlab.files.text import one_line
from vlab.recordings.datasets import EPISODE
from vlab.recordings.formats.variables import Variables
from vlab.recordings.overview import kind_of
from vlab.recordings.stamps import is_stamp

MOST_LISTED = 10
"""MOST_LISTED [1]: largest number of runs that a note names."""
LOOKED_AT = 100
"""LOOKED_AT [1]: number of values that tell whether a list holds times."""
_RUN = re.compile(
    r"(?:run|episode|ep|trial|test|rec|recording|exp|experiment|trajectory|traj|take|measurement|log|demo|session|"
    r"sequence|seq|sweep|repeat|repetition|rep)?s?[\s_.-]*\d+",
    re.IGNORECASE,
)


class Run(NamedTuple):
    """A run of a document.

    Parameters
    ----------
    label : str
        Name or number in the document.
    content : dict or list
        Lists by name, or row objects.
    """

    label: str
    content: Any


def runs_in(content: Any) -> list[Run]:
    """Return the runs of a document.

    Parameters
    ----------
    content : object
        Parsed document.

    Returns
    -------
    list of Run
        Runs in the order of the document; empty for a document of one recording.
    """
    if isinstance(content, list):
        return _listed(content)
    if not isinstance(content, dict):
        return []
    parts = {str(key): part for key, part in content.items() if isinstance(part, dict | list)}
    named = {key: part for key, part in parts.items() if _RUN.fullmatch(key) and (_is_run(part) or is_rows(part))}
    if len(named) > 1 and not any(_has_lists(part) for key, part in parts.items() if key not in named):
        return [Run(key, part) for key, part in named.items()]
    lists = {key: found for key, part in parts.items() if isinstance(part, list) and (found := _listed(part))}
    if len(lists) == 1 and not any(_has_lists(part) for key, part in parts.items() if key not in lists):
        return next(iter(lists.values()))
    return []


def is_run(record: Any) -> bool:
    """Return whether an object holds a run, not a row.

    An object with a list of increasing times is a run. An object with one number for the time is a row.

    Parameters
    ----------
    record : object
        Parsed object.

    Returns
    -------
    bool
        False where no entry tells.
    """
    if not isinstance(record, dict):
        return False
    leaves = _leaves(record)
    if any(kind_of(name) == "time" and _increases(value) for name, value in leaves):
        return True
    rows = [value[0] for _, value in leaves if is_rows(value)]
    return not is_row_with_time(record) and any(is_row_with_time(row) for row in rows)


def is_rows(value: Any) -> bool:
    """Return whether a value is a list of objects."""
    return isinstance(value, list) and bool(value) and all(isinstance(part, dict) for part in value)


def is_row_with_time(record: Any) -> bool:
    """Return whether an object holds one number for the time."""
    return any(kind_of(name) == "time" and isinstance(value, int | float | str) for name, value in _leaves(record))


def stacked(runs: Sequence[Run], read: Callable[[Any], Variables]) -> Variables:
    """Return the columns of all runs, one run after the other.

    A number of a run becomes a constant column. A run without a column has blank cells there.

    Parameters
    ----------
    runs : sequence of Run
        Runs.
    read : callable
        Reader of one run.

    Returns
    -------
    Variables
        Columns with the number of the run in `EPISODE`, where the runs have no such column.
    """
    found = Variables()
    tables: list[dict[str, Any]] = []
    counts: list[int] = []
    for run in runs:
        own = read(run.content)
        columns = own.columns | own.gappy
        count = _length(columns)
        for name in [name for name, values in columns.items() if len(values) not in (1, count)]:
            why = f"in run {one_line(run.label)!r} it has {len(columns[name])} rows, and its other columns {count}"
            found.refused[name] = why
        tables.append({name: v if len(v) == count else np.full(count, v[0]) for name, v in columns.items()})
        counts.append(count)
        found.units |= own.units
        found.refused |= {name: why for name, why in own.refused.items() if name not in own.gappy}
    names = dict.fromkeys(name for table in tables for name in table if name not in found.refused)
    for name in names:
        parts = [table.get(name, np.full(count, np.nan)) for table, count in zip(tables, counts, strict=True)]
        found.add(name, np.concatenate(parts))
    if EPISODE not in names and any(counts):
        found.add(EPISODE, np.repeat(np.arange(float(len(runs))), counts))
    if len(runs) > 1:
        labels = [one_line(run.label) for run in runs[:MOST_LISTED]]
        rest = f" and {len(runs) - MOST_LISTED} more" if len(runs) > MOST_LISTED else ""
        found.notes.append(f"{len(runs)} runs ({', '.join(labels)}{rest}), counted from 0 in {EPISODE}")
    return found


def alike(content: Any) -> tuple[str, ...]:
    """Return names of entries with equal columns, which may be runs.

    Parameters
    ----------
    content : object
        Parsed document without runs.

    Returns
    -------
    tuple of str
        Names of the first two entries with a time and equal columns; empty without such entries.
    """
    if not isinstance(content, dict):
        return ()
    names = [str(key) for key, part in content.items() if _is_run(part)]
    for i, one in enumerate(names):
        for other in names[i + 1 :]:
            if _columns(content[one]) == _columns(content[other]):
                return (one, other)
    return ()


def _listed(parts: list[Any]) -> list[Run]:
    """Return the runs of a list; none for a list of rows or numbers."""
    if parts and all(is_rows(part) for part in parts):
        return [Run(str(i), part) for i, part in enumerate(parts)]
    if not is_rows(parts):
        return []
    if all(is_run(part) for part in parts) or all(_is_long(part, len(parts)) for part in parts):
        return [Run(_label(part, i), part) for i, part in enumerate(parts)]
    return []


def _is_run(part: Any) -> bool:
    return is_run(part) or (isinstance(part, dict) and not is_row_with_time(part) and _is_long(part, 1))


def _is_long(record: Any, count: int) -> bool:
    """Return whether lists without times are longer than `count`."""
    if is_row_with_time(record):
        return False
    lengths = {len(value) for _, value in _leaves(record) if isinstance(value, list)}
    return len(lengths) == 1 and lengths.pop() > max(count, 1)


def _increases(value: Any) -> bool:
    """Return whether a value is a list of increasing times or time stamps."""
    if not isinstance(value, list) or len(value) < 2:
        return False
    first = value[:LOOKED_AT]
    if all(isinstance(part, str) and is_stamp(part) for part in first):
        return True
    is_number = all(isinstance(part, int | float) for part in first)
    return is_number and all(one < other for one, other in itertools.pairwise(first))


def _has_lists(part: Any) -> bool:
    """Return whether a part holds samples of its own."""
    return isinstance(part, list) or any(isinstance(value, list) for _, value in _leaves(part))


def _columns(part: Any) -> frozenset[str]:
    return frozenset(name for name, value in _leaves(part) if isinstance(value, list))


def _label(part: dict[str, Any], number: int) -> str:
    named = next((part[key] for key in ("name", "id", "run", "episode", "label", "title") if key in part), number)
    return str(named) if isinstance(named, str | int) else str(number)


def _length(columns: dict[str, Any]) -> int:
    """Return the number of rows of most columns."""
    lengths = [len(values) for values in columns.values() if len(values) > 1]
    return max(lengths, key=lengths.count) if lengths else int(bool(columns))


def _leaves(value: Any, name: str = "", depth: int = 0) -> list[tuple[str, Any]]:
    """Return the entries of nested objects, with whole lists."""
    if not isinstance(value, dict) or depth > 4:
        return [(name, value)]
    return [leaf for key, part in value.items() for leaf in _leaves(part, str(key), depth + 1)]
