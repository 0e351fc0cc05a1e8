"""Parquet: vlab's native run format, and the numeric columns of anyone else's files.

A run is a ``time`` column [s] and one float64 column a channel; kind, unit, place and direction stand in the metadata of
each field, the format version and the notes in that of the file. Pages carry checksums, so that a flipped bit is found.
"""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from vlab.recordings import files
from vlab.recordings.files import PathLike, refuse, written_whole
from vlab.recordings.table import (
    FORMAT_VERSION,
    MAX_COLUMNS,
    Table,
    check_version,
    meta_to_json,
    not_finite,
    read_channel,
    read_meta,
)
from vlab.signals import Channel, Recording


def write_parquet(recording: Recording, path: PathLike) -> None:
    """Write a recording as Parquet; see `vlab.recordings.write_recording`."""
    if "time" in recording.names:
        raise refuse(path, "a channel is named 'time', which is the name of the time stamps", fix="rename the channel")
    fields = [pa.field("time", pa.float64(), nullable=False, metadata={"unit": "s"})]
    for channel in recording.channels:
        labels = {
            "kind": channel.kind,
            "unit": channel.unit,
            "at": channel.at,
            "input": "input" if channel.is_input else "output",
        }
        fields.append(pa.field(channel.name, pa.float64(), nullable=False, metadata=labels))
    notes = {"vlab-recording": str(FORMAT_VERSION), "meta": meta_to_json(recording.meta, path)}
    try:
        schema = pa.schema(fields, metadata=notes)
    except UnicodeEncodeError as error:
        raise refuse(path, f"a label cannot be written: {error}", fix="rename the channel") from error
    columns = [recording.time, *(np.ascontiguousarray(recording.data[:, i]) for i in range(len(recording.channels)))]
    with written_whole(path) as stream:
        table = pa.Table.from_arrays([pa.array(values) for values in columns], schema=schema)
        pq.write_table(table, stream, compression="zstd", use_dictionary=False, write_page_checksum=True)


def read(data: bytes, path: Path, *, names: Sequence[str] | None = None, columns: Sequence[str] | None = None) -> Table:
    """Read the numeric columns of a Parquet file; see `vlab.recordings.open_table`."""
    if names is not None:
        raise refuse(path, "a Parquet file names its own columns", fix="leave out names")
    file = pq.ParquetFile(pa.BufferReader(data), page_checksum_verification=True)
    schema, rows = file.schema_arrow, file.metadata.num_rows
    if len(schema.names) > MAX_COLUMNS:
        raise refuse(path, f"the file declares {len(schema.names)} columns, at most {MAX_COLUMNS} are read")
    refused, wanted = _choose(schema, columns)
    declared = rows * 8 * len(wanted)
    if rows < 1 or declared > files.MAX_BYTES:
        raise refuse(
            path, f"the file declares {rows} rows, {declared} bytes unpacked; 1 to {files.MAX_BYTES} bytes are read"
        )
    table = file.read(columns=wanted, use_threads=False)
    found: dict[str, Any] = {}
    for name in wanted:
        values = _numbers(table.column(name))
        if isinstance(values, str):
            refused[name] = values
        else:
            found[name] = values
    metadata = {
        key.decode(): value.decode(errors="replace")
        for key, value in (schema.metadata or {}).items()
        if key != b"ARROW:schema"
    }
    if "vlab-recording" not in metadata:
        return Table(path=path, columns=found, refused=refused, meta=metadata)
    check_version(metadata["vlab-recording"], path)
    if refused:
        raise refuse(
            path, "; ".join(f"column {name!r}: {why}" for name, why in refused.items()), fix="the file is damaged"
        )
    if columns is None and "time" not in found:
        raise refuse(path, "the column 'time' is missing", fix="the file is damaged")
    channels = tuple(_channel(schema.field(name), path) for name in found if name != "time")
    return Table(path=path, columns=found, meta=read_meta(metadata.get("meta", ""), path), channels=channels)


def _choose(schema: Any, columns: Sequence[str] | None) -> tuple[dict[str, str], list[str]]:
    """Return the fields that cannot be read as numbers, with the reason, and those that can."""
    refused, wanted, times = {}, [], Counter(schema.names)
    for field in schema:
        if columns is not None and field.name not in columns:
            continue
        if times[field.name] > 1:
            refused[field.name] = "the name stands more than once in the file"
        elif pa.types.is_integer(field.type) or pa.types.is_floating(field.type) or pa.types.is_boolean(field.type):
            wanted.append(field.name)
        else:
            refused[field.name] = f"it holds {field.type}, not numbers; a time must be in seconds"
    return refused, wanted


def _numbers(column: Any) -> Any:
    """Return a column as float64, or the reason why it is none."""
    if column.null_count:
        first = int(np.argmax(column.is_null().to_numpy()))
        return f"empty at sample {first} ({column.null_count} of {len(column)} samples are empty)"
    try:
        values = column.cast(pa.float64()).to_numpy()
    except pa.ArrowInvalid as error:
        return f"it has numbers beyond the precision of a float ({error}); subtract the start of a clock"
    return values if np.isfinite(values).all() else not_finite(values)


def _channel(field: Any, path: Path) -> Channel:
    labels = {key.decode(): value.decode() for key, value in (field.metadata or {}).items()}
    return read_channel([field.name, *(labels.get(key, "?") for key in ("kind", "unit", "at", "input"))], path)
