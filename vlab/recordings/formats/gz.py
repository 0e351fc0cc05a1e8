"""Files packed by gzip, read by the inner suffix."""

import importlib
import zlib
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import cast

from vlab.recordings import files, table
from vlab.recordings.files import refuse
from vlab.recordings.table import Table

INNER = (".csv", ".txt", ".dat", ".tsv", ".lvm", ".jsonl", ".ndjson", ".json", ".npy")
"""INNER: suffixes that a packed file may have before ``.gz``."""


def read(
    data: bytes,
    path: Path,
    *,
    names: Sequence[str] | None = None,
    columns: Sequence[str] | None = None,
    blanks: Collection[str] = frozenset(),
) -> Table:
    """Read a packed file, see `vlab.recordings.open_table`.

    Parameters
    ----------
    data : bytes
        Bytes of the file.
    path : Path
        Path of the file, such as ``run.csv.gz``.
    names : sequence of str or None
        Column names of an inner file without names.
    columns : sequence of str or None
        Columns to read; all by default.
    blanks : collection of str
        Columns that may have blank cells or NaN.

    Returns
    -------
    Table
        Columns of the inner file.

    Raises
    ------
    BadRecording
        The file is damaged, unpacks to too much, or its inner suffix is unknown.
    """
    suffix = Path(path.stem).suffix.lower()
    if suffix not in INNER:
        raise refuse(
            path, f"a packed file of kind {suffix!r} is not read", fix=f"accepted before .gz: {', '.join(INNER)}"
        )
    reader = importlib.import_module(table.READERS[suffix])
    return cast(Table, reader.read(_unpacked(data, path), path, names=names, columns=columns, blanks=blanks))


def _unpacked(data: bytes, path: Path) -> bytes:
    """Return the content of all members of a file."""
    limit, parts, size, rest = files.unpacked_limit(len(data)), [], 0, data
    while rest:
        stream = zlib.decompressobj(wbits=31)
        try:
            part = stream.decompress(rest, limit + 1 - size)
        except zlib.error as error:
            raise refuse(path, f"not a whole gzip file: {error}", fix="it is damaged; copy it again") from error
        size += len(part)
        if size > limit:
            raise refuse(path, f"more than {limit} bytes when unpacked", fix="unpack it, or cut it into parts")
        if not stream.eof:
            raise refuse(path, "the gzip file is cut short", fix="copy it again")
        parts.append(part)
        rest = stream.unused_data.lstrip(b"\0")
    if not size:
        raise refuse(path, "nothing in the packed file", fix="export or copy it again")
    return b"".join(parts)
