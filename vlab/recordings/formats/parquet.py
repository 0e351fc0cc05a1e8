"""Parquet recordings: vlab's native form, and columns of foreign files.

A run has a ``time`` column [s] and one float64 column a channel. The metadata of each field hold kind, unit, place and
direction; those of the file hold the format version and the notes. Page checksums do not cover page headers, and a
flipped bit there can change the samples. The columns therefore have checksums of their own.
"""

import hashlib
import json
import zlib
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from vlab.recordings import files
from vlab.recordings.files import PathLike, refuse, written_whole
from vlab.recordings.formats import vectors
from vlab.recordings.formats.parquet_times import first_times, is_time, time_fields, to_seconds
from vlab.recordings.isolated import read_isolated
from vlab.recordings.table import (
    FORMAT_VERSION,
    MAX_COLUMNS,
    Table,
    check_version,
    meta_to_json,
    not_finite,
    read_channel,
    read_meta,
    unknown_column,
)
from vlab.signals import Channel, Recording


def write_parquet(recording: Recording, path: PathLike) -> tuple[str, ...]:
    """Write a recording as Parquet, see `vlab.recordings.write_recording`.

    Parameters
    ----------
    recording : Recording
        Recording in SI.
    path : str or path
        Path of the file.

    Returns
    -------
    tuple of str
        Empty, because the form is exact.

    Raises
    ------
    BadRecording
        A channel is named ``time``, or a label cannot be written.
    """
    if "time" in recording.names:
        raise refuse(path, "a channel is named 'time', which is the name of the time stamps", fix="rename the channel")
    time = {"unit": "s", "crc32": _checksum(recording.time)}
    fields = [pa.field("time", pa.float64(), nullable=False, metadata=time)]
    for i, channel in enumerate(recording.channels):
        labels = {
            "kind": channel.kind,
            "unit": channel.unit,
            "at": channel.at,
            "input": "input" if channel.is_input else "output",
            "crc32": _checksum(recording.data[:, i]),
        }
        fields.append(pa.field(channel.name, pa.float64(), nullable=False, metadata=labels))
    notes = {"vlab-recording": str(FORMAT_VERSION), "meta": meta_to_json(recording.meta, path)}
    notes["sha256"] = _digest(recording.channels, notes["meta"], len(recording))
    try:
        schema = pa.schema(fields, metadata=notes)
    except UnicodeEncodeError as error:
        raise refuse(path, f"a label cannot be written: {error}", fix="rename the channel") from error
    columns = [recording.time, *(np.ascontiguousarray(recording.data[:, i]) for i in range(len(recording.channels)))]
    with written_whole(path) as stream:
        table = pa.Table.from_arrays([pa.array(values) for values in columns], schema=schema)
        pq.write_table(table, stream, compression="zstd", use_dictionary=False, write_page_checksum=True)
    return ()


def _checksum(values: Any) -> str:
    return f"{zlib.crc32(np.ascontiguousarray(values, dtype='<f8').data):08x}"


def _digest(channels: Sequence[Channel], meta: str, rows: int) -> str:
    """Return a checksum of the labels.

    The samples have checksums of their own.
    """
    labels = [[c.name, c.kind, c.unit, c.at, c.is_input] for c in channels]
    return hashlib.sha256(json.dumps([labels, meta, rows]).encode()).hexdigest()


def read(
    data: bytes,
    path: Path,
    *,
    names: Sequence[str] | None = None,
    columns: Sequence[str] | None = None,
    blanks: Collection[str] = frozenset(),
) -> Table:
    """Read a Parquet file, see `vlab.recordings.open_table`.

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
        Numeric columns; labels for vlab's own files.

    Raises
    ------
    BadRecording
        The file is damaged or was edited.
    """
    if names is not None:
        raise refuse(path, "a Parquet file names its own columns", fix="leave out names")
    file = pq.ParquetFile(pa.BufferReader(data), page_checksum_verification=True)
    schema, rows = file.schema_arrow, file.metadata.num_rows
    if len(schema.names) > MAX_COLUMNS:
        raise refuse(path, f"the file declares {len(schema.names)} columns, at most {MAX_COLUMNS} are read")
    refused, wanted = _choose(schema, columns)
    times = time_fields(schema) if set(wanted) & set(time_fields(schema)) else []
    declared, limit = (
        8 * _values(data, path, file, list(dict.fromkeys([*wanted, *times]))),
        files.unpacked_limit(len(data)),
    )
    if rows < 1 or declared > limit:
        raise refuse(path, f"the file declares {rows} rows, {declared} bytes unpacked; 1 to {limit} bytes are read")
    table = file.read(columns=wanted, use_threads=False)
    zeros = first_times(file, times)
    found = _numeric_columns(table, wanted, zeros, refused, columns, blanks)
    missing = next((name for name in columns or () if name not in found and name not in refused), None)
    if missing is not None:
        raise unknown_column(missing, vectors.all_names(file), path, others=_choose(schema, None)[0])
    metadata = {
        key.decode(): value.decode(errors="replace")
        for key, value in (schema.metadata or {}).items()
        if key != b"ARROW:schema"
    }
    if "vlab-recording" not in metadata:
        gappy = frozenset(name for name in found if name in blanks)
        seconds = {name: "s" for name in zeros if name in found}
        return Table(path=path, columns=found, refused=refused, meta=metadata, blanks=gappy, units=seconds)
    check_version(metadata["vlab-recording"], path)
    if refused:
        raise refuse(
            path, "; ".join(f"column {name!r}: {why}" for name, why in refused.items()), fix="the file is damaged"
        )
    if columns is None and "time" not in found:
        raise refuse(path, "the column 'time' is missing", fix="the file is damaged")
    return _checked(path, found, schema, metadata, rows)


def _numeric_columns(
    table: Any,
    wanted: Sequence[str],
    zeros: Mapping[str, Any],
    refused: dict[str, str],
    columns: Sequence[str] | None,
    blanks: Collection[str],
) -> dict[str, Any]:
    """Return the columns of numbers; reasons for the others go to `refused`."""
    found: dict[str, Any] = {}
    for field_name in wanted:
        column = table.column(field_name)
        column = to_seconds(column, zeros[field_name]) if field_name in zeros else column
        for name, values in vectors.elements(field_name, column, refused):
            if columns is not None and name not in columns:
                continue
            numbers = _numbers(values, may_be_blank=name in blanks)
            if isinstance(numbers, str):
                refused[name] = numbers
            else:
                found[name] = numbers
    return found


def _checked(path: Path, found: dict[str, Any], schema: Any, metadata: Mapping[str, str], rows: int) -> Table:
    """Return a file of vlab with its labels and checked samples."""
    channels = tuple(_channel(schema.field(name), path) for name in found if name != "time")
    if any(schema.field(name).type != pa.float64() for name in found):
        raise refuse(path, "a column of a vlab recording is not of doubles", fix="the file was edited or is damaged")
    for name, values in found.items():
        checksum = (schema.field(name).metadata or {}).get(b"crc32", b"").decode(errors="replace")
        if checksum not in ("", _checksum(values)):
            raise refuse(path, f"the samples of {name!r} are not those that were written", fix="the file is damaged")
    is_whole = len(found) == len(schema.names)
    if is_whole and metadata.get("sha256", "") not in ("", _digest(channels, metadata.get("meta", ""), rows)):
        raise refuse(path, "the labels are not those that were written", fix="the file was edited or is damaged")
    return Table(path=path, columns=found, meta=read_meta(metadata.get("meta", ""), path), channels=channels)


def _values(data: bytes, path: Path, file: Any, wanted: Sequence[str]) -> int:
    """Return the number of values that the file declares for some fields.

    A column of numbers has one value per row. The values of nested columns stand in the description of the column's chunks,
    and the library aborts the process where that description is damaged: an isolated process counts.
    """
    flat = file.metadata.num_rows * len(wanted)
    if not any(vectors.is_vector(file.schema_arrow.field(name).type) for name in wanted):
        return int(flat)
    counted = read_isolated(
        "count_parquet", data, path, library="pyarrow", install="pyarrow", options={"fields": list(wanted)}
    )
    return max(int(counted["meta"]["values"]), flat)


def _choose(schema: Any, columns: Sequence[str] | None) -> tuple[dict[str, str], list[str]]:
    """Return refused fields with reasons, and wanted fields."""
    refused, wanted, times = {}, [], Counter(schema.names)
    fields = None if columns is None else {*columns, *(vectors.field_of(name, schema.names) for name in columns)}
    for field in schema:
        if fields is not None and field.name not in fields:
            continue
        if times[field.name] > 1:
            refused[field.name] = "the name stands more than once in the file"
        elif vectors.is_numeric(field.type) or vectors.is_vector(field.type) or is_time(field.type):
            wanted.append(field.name)
        else:
            refused[field.name] = f"it holds {field.type}, not numbers; a time must be in seconds"
    return refused, wanted


def _numbers(column: Any, *, may_be_blank: bool) -> Any:
    """Return a column as float64, or the reason of refusal."""
    if column.null_count and not may_be_blank:
        first = int(np.argmax(column.is_null().to_numpy()))
        return f"empty at sample {first} ({column.null_count} of {len(column)} samples are empty)"
    try:
        values = column.cast(pa.float64()).to_numpy()
    except pa.ArrowInvalid as error:
        return f"it has numbers beyond the precision of a float ({error}); subtract the start of a clock"
    is_fine = not np.isinf(values).any() if may_be_blank else np.isfinite(values).all()
    return values if is_fine else not_finite(values)


def _channel(field: Any, path: Path) -> Channel:
    labels = {key.decode(): value.decode() for key, value in (field.metadata or {}).items()}
    return read_channel([field.name, *(labels.get(key, "?") for key in ("kind", "unit", "at", "input"))], path)
