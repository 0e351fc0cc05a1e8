"""Dates and clock times of Arrow columns, in seconds."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

PER_SECOND = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}
"""PER_SECOND [1/s]: ticks of an Arrow unit of time."""
DAY_S = 86_400
"""DAY_S [s]: length of a day, after which a clock time begins again."""


def is_time(kind: Any) -> bool:
    """Return whether values of an Arrow type are times."""
    return bool(pa.types.is_timestamp(kind) or pa.types.is_time(kind))


def time_fields(schema: Any) -> list[str]:
    """Return the columns of times that stand once in an Arrow schema."""
    return [field.name for field in schema if is_time(field.type) and schema.names.count(field.name) == 1]


def first_times(file: Any, names: Sequence[str]) -> dict[str, int]:
    """Return the zero of each column of times, in nanoseconds.

    Columns of one kind count from the earliest of their first values, so that their times fit together.

    Parameters
    ----------
    file : ParquetFile
        File.
    names : sequence of str
        All columns of times.

    Returns
    -------
    dict of str to int
        Zero by column.
    """
    fields = [file.schema_arrow.field(name) for name in names]
    row = next(file.iter_batches(batch_size=1, columns=list(names)), None) if names else None
    if row is None:
        return {}
    first: dict[str, int | None] = {}
    for field in fields:
        tick = _ticks(row.column(field.name))[0].as_py()
        first[field.name] = None if tick is None else tick * (10**9 // PER_SECOND[field.type.unit])
    out = {}
    for field in fields:
        same = [first[other.name] for other in fields if _kind(other.type) == _kind(field.type)]
        out[field.name] = min((value for value in same if value is not None), default=0)
    return out


def to_seconds(column: Any, zero: int) -> Any:
    """Return a column of times in seconds.

    A clock time that goes back by more than half a day has passed midnight.

    Parameters
    ----------
    column : ChunkedArray
        Dates with time, or clock times.
    zero : int
        Time of zero [ns].

    Returns
    -------
    ChunkedArray
        Times [s], null where the column is.
    """
    per_second = PER_SECOND[column.type.unit]
    ticks = pc.subtract(_ticks(column), zero // (10**9 // per_second))
    there = ticks.is_valid().to_numpy()
    values = pc.fill_null(ticks, 0).to_numpy().copy()
    if pa.types.is_time(column.type) and there.any():
        day = DAY_S * per_second
        values[there] += day * np.cumsum(np.diff(values[there], prepend=values[there][0]) < -(day // 2))
    return pa.chunked_array([pa.array(values / per_second, mask=~there)])


def _ticks(column: Any) -> Any:
    width = pa.int32() if pa.types.is_time32(column.type) else pa.int64()
    return column.cast(width).cast(pa.int64())


def _kind(kind: Any) -> tuple[bool, bool]:
    is_date = bool(pa.types.is_timestamp(kind))
    return is_date, is_date and kind.tz is not None
