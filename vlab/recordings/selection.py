"""Selection of rows of a table by restricted comparisons.

A text such as ``level_V == 0.1 and run != 3`` compares columns with numbers. The text is parsed here and never
evaluated as a program.
"""

import operator
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vlab.errors import BadCase
from vlab.files.text import one_line
from vlab.recordings.files import refuse
from vlab.recordings.table import Table
from vlab.signals import Array

SAME = 1e-6
"""SAME [1]: relative difference of equal numbers, because files hold single precision."""
MOST_CONDITIONS = 20
"""MOST_CONDITIONS [1]: largest number of comparisons."""


def _equal(values: Array, number: float) -> Array:
    return np.abs(values - number) <= SAME * np.maximum(np.abs(values), abs(number))


OPERATORS: dict[str, Callable[[Array, float], Any]] = {
    "==": _equal,
    "!=": lambda values, number: ~_equal(values, number),
    "<=": operator.le,
    ">=": operator.ge,
    "<": operator.lt,
    ">": operator.gt,
}
"""OPERATORS: comparisons of a column with a number."""
_CONDITION = re.compile(r"""\s*(?:"([^"]+)"|'([^']+)'|([^<>=!"']+?))\s*(==|!=|<=|>=|<|>)\s*(\S+)\s*""")
_FORM = "'COLUMN OPERATOR NUMBER', several joined by 'and'; operators: " + ", ".join(OPERATORS)


@dataclass(frozen=True, kw_only=True)
class Condition:
    """Comparison of a column with a number."""

    column: str
    operator: str
    number: float


def parse_where(text: str) -> tuple[Condition, ...]:
    """Return the comparisons of a text.

    Parameters
    ----------
    text : str
        Comparisons joined by ``and``; a name with an operator in it stands in quotes.

    Returns
    -------
    tuple of Condition
        Comparisons, all of which must hold.

    Raises
    ------
    BadCase
        The text has another form.
    """
    out = []
    for part in re.split(r"\s+and\s+", text.strip()):
        match = _CONDITION.fullmatch(part)
        try:
            number = float(match[5]) if match is not None else np.nan
        except ValueError:
            number = np.nan
        if match is None or not np.isfinite(number):
            raise BadCase(f"where = {one_line(text)!r}: {one_line(part)!r} is no comparison; accepted: {_FORM}")
        out.append(Condition(column=match[1] or match[2] or match[3].strip(), operator=match[4], number=number))
    if len(out) > MOST_CONDITIONS:
        raise BadCase(f"where has {len(out)} comparisons; at most {MOST_CONDITIONS} are accepted")
    return tuple(out)


def excludes(one: str, other: str) -> bool:
    """Return whether no row can meet two selections.

    Parameters
    ----------
    one, other : str
        Comparisons of two recordings of one file.

    Returns
    -------
    bool
        True if both demand a different number of one column.
    """
    demanded = {c.column: c.number for c in (parse_where(one) if one else ()) if c.operator == "=="}
    return any(
        c.operator == "==" and c.column in demanded and not _equal(np.array([demanded[c.column]]), c.number)[0]
        for c in (parse_where(other) if other else ())
    )


def select_rows(table: Table, conditions: tuple[Condition, ...]) -> Table:
    """Return the rows of a table that meet all comparisons.

    Parameters
    ----------
    table : Table
        Table with the compared columns.
    conditions : tuple of Condition
        Comparisons.

    Returns
    -------
    Table
        Kept rows; `Table.rows` holds their numbers in the file.

    Raises
    ------
    BadRecording
        Fewer than two rows are kept, or the columns have different lengths.
    UnknownName
        A column is not in the file.
    """
    if not conditions:
        return table
    compared = [table.real(condition.column) for condition in conditions]
    length = len(compared[0])
    other = next((name for name in table.names if len(table[name]) != length), None)
    if other is not None:
        what = f"column {other!r} has {len(table[other])} rows, {conditions[0].column!r} has {length}"
        raise refuse(table.path, what, fix="select rows by a column of the same clock")
    keep = np.ones(length, dtype=bool)
    for condition, values in zip(conditions, compared, strict=True):
        keep &= OPERATORS[condition.operator](values, condition.number)
    said = " and ".join(f"{c.column} {c.operator} {c.number:g}" for c in conditions)
    if keep.sum() < 2:
        known = [f"{v:g}" for v in np.unique(compared[0])[:8]]
        fix = f"values of {conditions[0].column!r}: {', '.join(known)}{' and more' if len(known) == 8 else ''}"
        raise refuse(table.path, f"{keep.sum()} rows meet {said}", fix=fix)
    columns = {name: values[keep] for name, values in table.columns.items()}
    return replace(table, columns=columns, rows=np.flatnonzero(keep))
