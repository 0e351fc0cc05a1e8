"""Time stamps in two columns: whole seconds, and the rest in nanoseconds or microseconds.

ROS writes a stamp as ``stamp.sec`` and ``stamp.nanosec``, POSIX as ``tv_sec`` and ``tv_usec``. Their sum is a column named
``stamp.sec + stamp.nanosec``. A double holds no nanoseconds since 1970, so the sum counts from a round origin.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from vlab.recordings.table import Table
from vlab.signals import Array

_WHOLE = re.compile(r"(|.*[^A-Za-z0-9])(?:secs?|seconds)", re.IGNORECASE)
_REST = re.compile(r"(|.*[^A-Za-z0-9])(?:(nano|n)|(?:micro|u))(?:secs?|seconds)", re.IGNORECASE)
_SIGN = " + "
ORIGIN = 1e6
"""ORIGIN [s]: zeros of the sums are multiples of this time, the last but one before the first stamp. Such a zero keeps
fractions of a nanosecond. All columns share it, and the times still count as far from zero."""


def parts_of(name: str) -> tuple[str, str] | None:
    """Return the two columns behind the name of a sum.

    Parameters
    ----------
    name : str
        Name of a column, such as ``stamp.sec + stamp.nanosec``.

    Returns
    -------
    tuple of (str, str) or None
        Columns of seconds and rest; None if the name is no sum.
    """
    whole, sign, rest = name.partition(_SIGN)
    return (whole, rest) if sign and _rest_scale(whole, rest) is not None else None


def split_names(names: Iterable[str]) -> list[str]:
    """Return the columns of a file behind names of columns and sums.

    Parameters
    ----------
    names : iterable of str
        Names, each once.

    Returns
    -------
    list of str
        Names without sums, each once.
    """
    return list(dict.fromkeys(part for name in names for part in parts_of(name) or (name,)))


def with_sums(table: Table, wanted: Sequence[str] | None) -> Table:
    """Return a table with the sums of its pairs.

    Parameters
    ----------
    table : Table
        Columns of a file.
    wanted : sequence of str or None
        Names of columns and sums; None for every pair of the file.

    Returns
    -------
    Table
        The table, with a column [s] a pair in addition.
    """
    pairs = _pairs(table.columns) if wanted is None else [pair for name in wanted if (pair := parts_of(name))]
    scales = {pair: scale for pair in pairs if (scale := _fitting_scale(table, *pair)) is not None}
    firsts = [float(np.nanmin(table[whole])) for whole, _ in scales]
    origin = ORIGIN * max(0.0, np.floor(min(firsts, default=0.0) / ORIGIN) - 1.0)
    sums = {f"{w}{_SIGN}{r}": (table[w] - origin) + scale * table[r] for (w, r), scale in scales.items()}
    if not sums:
        return table
    blanks = {name for name, values in sums.items() if np.isnan(values).any()}
    return replace(
        table,
        columns={**table.columns, **sums},
        units={**table.units, **dict.fromkeys(sums, "s")},
        blanks=frozenset({*blanks, *(name for name in table.names if name in table.blanks)}),
        notes=(*table.notes, *(f"{name}: times count from {origin:.0f} s" for name in sums if origin)),
    )


def _pairs(names: Iterable[str]) -> list[tuple[str, str]]:
    """Return the pairs among names of columns."""
    known = list(names)
    return [(w, r) for w in known if _WHOLE.fullmatch(w) for r in known if _rest_scale(w, r) is not None]


def _rest_scale(whole: str, rest: str) -> float | None:
    """Return the unit of the rest [s], or None if two names are no pair."""
    first, second = _WHOLE.fullmatch(whole), _REST.fullmatch(rest)
    if first is None or second is None or first[1] != second[1]:
        return None
    return 1e-9 if second[2] else 1e-6


def _fitting_scale(table: Table, whole: str, rest: str) -> float | None:
    """Return the unit of the rest [s], or None where the numbers are no pair."""
    scale = _rest_scale(whole, rest)
    if scale is None or whole not in table.columns or rest not in table.columns:
        return None
    seconds, rests = table[whole], table[rest]
    if np.iscomplexobj(seconds) or np.iscomplexobj(rests) or len(seconds) != len(rests) or not _are_whole(seconds):
        return None
    there = rests[np.isfinite(rests)]
    return scale if there.size and np.all(there >= 0.0) and np.all(scale * there < 1.0) else None


def _are_whole(values: Array) -> bool:
    there = values[np.isfinite(values)]
    return bool(there.size and np.all(there == np.rint(there)))
