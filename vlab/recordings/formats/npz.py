"""NPZ recordings: arrays of a numpy archive as columns, never unpickled.

`numpy.load` trusts the sizes in the headers and can run pickles. The module opens the archive with zipfile and checks
each array's header against the available bytes. Anything but plain numbers is named and skipped.
"""

import io
import math
import zipfile
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from vlab.recordings import files
from vlab.recordings.files import refuse
from vlab.recordings.formats.variables import Damaged, Skipped, Variables
from vlab.recordings.table import MAX_COLUMNS, Table

_HEADERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
_LONGEST_HEADER = 10_000  # numpy's own limit, above which its parser is unsafe
_LONGEST_TEXT = 10_000


def read(
    data: bytes,
    path: Path,
    *,
    names: Sequence[str] | None = None,
    columns: Sequence[str] | None = None,
    blanks: Collection[str] = frozenset(),
) -> Table:
    """Read an NPZ file, see `vlab.recordings.open_table`.

    `vlab.recordings.formats.variables.Variables` gives the column names.

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
        Arrays as columns.

    Raises
    ------
    BadRecording
        The file is damaged or too large.
    """
    if names is not None:
        raise refuse(path, "an NPZ file names its own arrays", fix="leave out names")
    try:
        archive = zipfile.ZipFile(io.BytesIO(data))
    except zipfile.BadZipFile as error:
        raise refuse(path, f"not a whole NPZ file: {error}", fix="it is truncated or damaged; copy it again") from error
    found, left = Variables(), files.unpacked_limit(len(data))
    try:
        if len(archive.infolist()) > MAX_COLUMNS:
            raise Damaged(f"more than {MAX_COLUMNS} arrays")
        for info in archive.infolist():
            left -= info.file_size
            if left < 0:
                raise Damaged(f"more than {files.unpacked_limit(len(data))} bytes when unpacked")
            if not info.filename.endswith(".npy"):
                found.notes.append(f"{info.filename}: no array, skipped")
                continue
            found.add(info.filename.removesuffix(".npy"), array_of(_member(archive, info), info.filename))
    except Damaged as error:
        raise refuse(path, str(error), fix="the file is damaged; copy or export it again") from error
    return found.table(path, columns, blanks)


def _member(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> bytes:
    """Return the bytes of one archive member.

    The checksum is verified, and the declared size is the limit.
    """
    if info.flag_bits & 1 or info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise Damaged(f"array {info.filename!r} is encrypted or packed in a way that numpy does not write")
    try:
        with archive.open(info) as stream:
            content = stream.read(info.file_size + 1)
    except Exception as error:  # zipfile and zlib raise a dozen kinds of error on damaged archives
        raise Damaged(f"array {info.filename!r} is damaged: {error}") from error
    if len(content) != info.file_size:
        raise Damaged(f"array {info.filename!r} is truncated: {len(content)} of {info.file_size} bytes")
    return content


def array_of(
    content: bytes, name: str, *, is_structured: bool = False
) -> NDArray[Any] | dict[str, NDArray[Any]] | str | Skipped:
    """Return the array of an NPY file's bytes.

    Parameters
    ----------
    content : bytes
        Bytes of the file.
    name : str
        Name for messages.
    is_structured : bool
        Whether the fields of a structured array are wanted.

    Returns
    -------
    array, dict, str or Skipped
        Array, fields by name, text, or the reason of a refusal.

    Raises
    ------
    Damaged
        The header contradicts the bytes.
    """
    stream = io.BytesIO(content)
    try:
        version = npy.read_magic(stream)
        if version not in _HEADERS:
            return Skipped(f"an array of format version {version}")
        shape, is_fortran, dtype = _HEADERS[version](stream, max_header_size=_LONGEST_HEADER)
    except Exception as error:
        raise Damaged(f"array {name!r} has a damaged header: {error}") from error
    if dtype.hasobject:
        return Skipped("a pickle, which could run a program and is never opened; save numbers only")
    has_fields = bool(dtype.names) and is_structured and len(shape) == 1
    if (dtype.names or dtype.kind == "V") and not has_fields:
        return Skipped(f"a structured array ({dtype}); save its fields one by one")
    declared, there = math.prod(shape) * dtype.itemsize, len(content) - stream.tell()
    if declared != there or any(length < 0 for length in shape):
        raise Damaged(f"array {name!r} declares {shape} of {dtype}, {declared} bytes, and holds {there}")
    if dtype.itemsize == 0 or not there:
        return np.empty(0)
    values = np.frombuffer(content, dtype=dtype, offset=stream.tell())
    if has_fields:
        return {key: np.ascontiguousarray(values[key]) for key in dtype.names or ()}
    if dtype.kind in "US":
        return _text(values)
    return values.reshape(shape, order="F" if is_fortran else "C")


def _text(values: NDArray[Any]) -> str | Skipped:
    if values.size != 1 or values.dtype.itemsize > 4 * _LONGEST_TEXT:
        return Skipped("an array of text")
    text = values[0]
    return text.decode("utf-8", errors="replace") if isinstance(text, bytes) else str(text)
