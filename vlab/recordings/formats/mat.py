"""MAT recordings of versions 5 to 7.3.

Numeric variables become columns; structs become dotted names. Version 7.3 is HDF5 and read as such. The module parses
the file [1]_ in plain Python and checks every declared size against the available bytes. scipy.io.loadmat crashes the
process (segmentation fault) on damaged files; the tests compare both readers on sound files. No object, function or
class of a file is created.

References
----------
.. [1] MathWorks, MAT-File Format (R2024a), chapter 1, level 5.
"""

import hashlib
import io
import json
import math
import struct
import zlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlab.recordings import files
from vlab.recordings.files import PathLike, refuse, written_whole
from vlab.recordings.formats import hdf5
from vlab.recordings.formats.variables import Damaged, Skipped, Variables, to_float
from vlab.recordings.table import FORMAT_VERSION, Table, check_version, meta_to_json, read_channel, read_meta
from vlab.signals import Recording

_DTYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_ENCODINGS = {1: "latin-1", 2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}
_MATRIX, _COMPRESSED = 14, 15
_CELL, _STRUCT, _OBJECT, _CHAR, _SPARSE, _FUNCTION, _OPAQUE = 1, 2, 3, 4, 5, 16, 17
_KINDS = {_OBJECT: "an object", _SPARSE: "a sparse matrix", _FUNCTION: "a function handle", _OPAQUE: "an object"}
_DEEPEST = 20  # nesting of structs; a recording has two or three levels


@dataclass
class _Walk:
    """Parser of one file's elements.

    A limit bounds the unpacked bytes.
    """

    order: str  # "<" or ">"
    limit: int
    spent: int = 0

    def spend(self, n_bytes: int) -> None:
        self.spent += n_bytes
        if self.spent > self.limit:
            raise Damaged(f"more than {self.limit} bytes when unpacked")

    def element(self, view: memoryview, offset: int) -> tuple[int, memoryview, int]:
        """Return type, content and end of an element."""
        if offset + 8 > len(view):
            raise Damaged("truncated: it ends where a variable is expected")
        kind, size = struct.unpack_from(self.order + "II", view, offset)
        if kind >> 16:  # small form: size, type and up to four bytes of content in eight bytes
            kind, size = kind & 0xFFFF, kind >> 16
            if size > 4:
                raise Damaged(f"a short element declares {size} bytes")
            return kind, view[offset + 4 : offset + 4 + size], offset + 8
        if size > len(view) - offset - 8:
            raise Damaged(f"truncated: {size} bytes are declared where {len(view) - offset - 8} are left")
        end = offset + 8 + size
        return kind, view[offset + 8 : end], end if kind == _COMPRESSED else min(end + -end % 8, len(view))

    def inflate(self, packed: memoryview) -> memoryview:
        """Return the matrix of a compressed element.

        The checksum is verified.
        """
        stream = zlib.decompressobj()
        try:
            tag = stream.decompress(packed, 8)
            if len(tag) < 8:
                raise Damaged("a compressed variable is truncated")
            kind, size = struct.unpack(self.order + "II", tag)
            if kind != _MATRIX or not size:
                raise Damaged("a compressed element holds no variable")
            self.spend(size)
            content = stream.decompress(stream.unconsumed_tail, size)
            stream.decompress(stream.unconsumed_tail, 64)  # reads padding and the checksum at the end of the stream
        except zlib.error as error:
            raise Damaged(f"a compressed variable is damaged ({error})") from error
        if len(content) < size or not stream.eof:
            raise Damaged("a compressed variable is truncated")
        return memoryview(content)

    def variables(self, view: memoryview) -> Iterator[tuple[str, Any]]:
        """Yield name and value of each variable."""
        offset = 128
        while offset < len(view):
            kind, content, offset = self.element(view, offset)
            if kind == _COMPRESSED:
                yield self.matrix(self.inflate(content))
            elif kind == _MATRIX:
                yield self.matrix(content)
            else:
                raise Damaged(f"an element of type {kind} where a variable is expected")

    def matrix(self, view: memoryview, depth: int = 0) -> tuple[str, Any]:
        """Return the name and value of a matrix.

        The value is an array, text, a dict of struct fields, a list of cells, or `Skipped`.
        """
        if not len(view):
            return "", np.empty((0, 0))
        if depth > _DEEPEST:
            raise Damaged(f"structs nested more than {_DEEPEST} deep")
        kind, flags, offset = self.element(view, 0)
        if kind != 6 or len(flags) != 8:
            raise Damaged("a variable has no array flags")
        (flag,) = struct.unpack_from(self.order + "I", flags)
        array_class, is_complex = flag & 0xFF, bool(flag & 0x0800)
        if array_class == _OPAQUE:  # an opaque element has name and class in place of dimensions
            return self._name(view, offset)[0], Skipped(_KINDS[_OPAQUE])
        kind, content, offset = self.element(view, offset)
        if kind != 5 or len(content) % 4:
            raise Damaged("a variable has no dimensions")
        shape = struct.unpack(f"{self.order}{len(content) // 4}i", content)
        name, offset = self._name(view, offset)
        if len(shape) < 2 or len(shape) > 32 or min(shape) < 0:
            raise Damaged(f"variable {name!r} has the dimensions {shape}")
        if array_class in _KINDS:
            return name, Skipped(_KINDS[array_class])
        if array_class == _CELL:
            return name, self._many(view, offset, shape, depth)[0]
        if array_class == _STRUCT:
            return name, self._struct(view, offset, shape, depth)
        if array_class == _CHAR:
            return name, self._text(view, offset, shape)
        if not 6 <= array_class <= 15:
            raise Damaged(f"variable {name!r} is of the unknown class {array_class}")
        values, offset = self._numbers(view, offset, shape)
        if is_complex:
            imaginary, offset = self._numbers(view, offset, shape)
            return name, _complex(values, imaginary)
        return name, values

    def _name(self, view: memoryview, offset: int) -> tuple[str, int]:
        _, content, offset = self.element(view, offset)
        name = bytes(content[:256]).decode("latin-1").rstrip("\0")
        if not name.isprintable():
            raise Damaged("the name of a variable is not text")
        return name, offset

    def _numbers(self, view: memoryview, offset: int, shape: tuple[int, ...]) -> tuple[NDArray[Any], int]:
        kind, content, offset = self.element(view, offset)
        if kind not in _DTYPES:
            raise Damaged(f"numbers of the unknown type {kind}")
        dtype = np.dtype(self.order + _DTYPES[kind])
        if math.prod(shape) * dtype.itemsize != len(content):
            raise Damaged(f"{len(content)} bytes of numbers where {shape} declares {math.prod(shape) * dtype.itemsize}")
        self.spend(8 * math.prod(shape))
        return np.frombuffer(content, dtype=dtype).reshape(shape, order="F"), offset

    def _text(self, view: memoryview, offset: int, shape: tuple[int, ...]) -> Any:
        if not math.prod(shape):
            return ""
        kind, content, _ = self.element(view, offset)
        if kind not in _ENCODINGS or len(shape) > 2 or shape[0] != 1:
            return Skipped("a block of text")
        encoding = _ENCODINGS[kind] + ("" if kind in (1, 2, 16) else "-le" if self.order == "<" else "-be")
        self.spend(4 * len(content))
        return bytes(content).decode(encoding, errors="replace")

    def _many(self, view: memoryview, offset: int, shape: tuple[int, ...], depth: int) -> tuple[list[Any], int]:
        """Read as many matrices as the shape declares.

        Each matrix takes at least eight bytes.
        """
        if math.prod(shape) * 8 > len(view) - offset:
            raise Damaged(f"truncated: {shape} cells are declared in {len(view) - offset} bytes")
        self.spend(64 * math.prod(shape))
        cells = []
        for _ in range(math.prod(shape)):
            kind, content, offset = self.element(view, offset)
            if kind != _MATRIX:
                raise Damaged(f"an element of type {kind} in a cell or a struct")
            cells.append(self.matrix(content, depth + 1)[1])
        return cells, offset

    def _struct(self, view: memoryview, offset: int, shape: tuple[int, ...], depth: int) -> Any:
        _, content, offset = self.element(view, offset)
        length = int.from_bytes(content, "little" if self.order == "<" else "big", signed=True)
        _, content, offset = self.element(view, offset)
        if length < 1 or len(content) % length:
            raise Damaged("the names of the fields of a struct are damaged")
        raw = [
            bytes(content[i : i + length]).partition(b"\0")[0].decode("latin-1") for i in range(0, len(content), length)
        ]
        if len(set(raw)) != len(raw) or not all(name.isprintable() and name for name in raw):
            raise Damaged("the names of the fields of a struct are damaged")
        if not raw:
            return {}
        values, _ = self._many(view, offset, (*shape, len(raw)), depth)
        items = [dict(zip(raw, values[i : i + len(raw)], strict=True)) for i in range(0, len(values), len(raw))]
        return items[0] if len(items) == 1 else items


def _complex(real: NDArray[Any], imaginary: NDArray[Any]) -> NDArray[Any] | Skipped:
    parts = [to_float(real), to_float(imaginary)]
    for part in parts:
        if isinstance(part, str):
            return Skipped(f"complex, and {part}")
    both = np.empty(real.shape, dtype=complex)
    both.real, both.imag = parts
    return both


def read(
    data: bytes,
    path: Path,
    *,
    names: Sequence[str] | None = None,
    columns: Sequence[str] | None = None,
    blanks: Collection[str] = frozenset(),
) -> Table:
    """Read a MAT file, see `vlab.recordings.open_table`.

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
        Variables as columns.

    Raises
    ------
    BadRecording
        The file is damaged or of another version.
    """
    if names is not None:
        raise refuse(path, "a MAT file names its own variables", fix="leave out names")
    if data[:10] == b"MATLAB 7.3" or data[:4] == b"\x89HDF" or data[512:516] == b"\x89HDF":
        return hdf5.read_matlab(data, path, columns=columns, blanks=blanks)
    if len(data) < 136 or data[126:128] not in (b"IM", b"MI") or data[124:126] not in (b"\0\1", b"\1\0"):
        raise refuse(path, "not a MAT file of version 5 to 7.3", fix="save as -v7: save('name.mat', ..., '-v7')")
    found, own = Variables(), {}
    try:
        walk = _Walk("<" if data[126:128] == b"IM" else ">", files.unpacked_limit(len(data)))
        for name, value in walk.variables(memoryview(data)):
            if not name:
                found.notes.append("unnamed data for objects skipped")
                continue
            found.add(name, value)
            own[name] = value
    except Damaged as error:
        raise refuse(path, str(error), fix="the file is damaged; copy or export it again") from error
    return _own_table(own, path, columns) if _OWN in found.meta else found.table(path, columns, blanks)


# ------------------------------------------------------------------------------------------------- vlab's own form

_OWN = "vlab_recording"
"""Variable name of the labels. The value is JSON text for jsondecode; the variables time (n x 1) and data (n x
channels) accompany it."""


_HEADER_TEXT = 116  # bytes of free text, in which scipy writes the time of day


def write_mat(recording: Recording, path: PathLike) -> tuple[str, ...]:
    """Write a recording as MAT 5, see `vlab.recordings.write_recording`.

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
        A channel is named ``time``.
    """
    if "time" in recording.names:
        raise refuse(path, "a channel is named 'time', which is the name of the time stamps", fix="rename the channel")
    from scipy.io import savemat  # deferred, because reading does not need scipy

    time, samples = recording.time[:, None], recording.data
    labels = {
        "version": FORMAT_VERSION,
        "channels": [[c.name, c.kind, c.unit, c.at, "input" if c.is_input else "output"] for c in recording.channels],
        "meta": json.loads(meta_to_json(recording.meta, path)),
    }
    labels["sha256"] = _digest(labels, time, samples)
    stream = io.BytesIO()
    savemat(stream, {"time": time, "data": samples, _OWN: json.dumps(labels)}, format="5")
    stream.getbuffer()[:_HEADER_TEXT] = b"MATLAB 5.0 MAT-file, a vlab recording".ljust(_HEADER_TEXT)  # no date
    with written_whole(path) as target:
        target.write(stream.getbuffer())
    return ()


def _digest(labels: Mapping[str, Any], time: NDArray[Any], samples: NDArray[Any]) -> str:
    """Return a checksum of labels and samples.

    The format has a checksum only for packed elements.
    """
    text = json.dumps({key: value for key, value in labels.items() if key != "sha256"}, sort_keys=True)
    digest = hashlib.sha256(text.encode())
    digest.update(np.ascontiguousarray(time, dtype="<f8").tobytes())
    digest.update(np.asfortranarray(samples, dtype="<f8").tobytes(order="F"))
    return digest.hexdigest()


def _own_table(variables: Mapping[str, Any], path: Path, columns: Sequence[str] | None) -> Table:
    labels = read_meta(variables[_OWN], path)
    check_version(str(labels.get("version")), path)
    time, samples = variables.get("time", ""), variables.get("data", "")
    entries, meta = labels.get("channels"), labels.get("meta")
    has_samples = isinstance(time, np.ndarray) and isinstance(samples, np.ndarray)
    if not has_samples or not isinstance(entries, list) or not isinstance(meta, dict):
        raise refuse(path, "time, data or the labels of a vlab recording are missing", fix="the file is damaged")
    channels = [read_channel([str(part) for part in entry], path) for entry in entries if isinstance(entry, list)]
    if samples.shape != (time.size, len(entries)) or len(channels) != len(entries) or not channels:
        what = f"{samples.shape} samples do not fit {time.size} times and {len(entries)} channels"
        raise refuse(path, what, fix="the file was edited or is damaged")
    if labels.get("sha256") != _digest(labels, time, samples):
        raise refuse(
            path, "the samples or labels are not those that were written", fix="the file was edited or is damaged"
        )
    found = {"time": time.reshape(-1)} | {c.name: samples[:, i] for i, c in enumerate(channels)}
    if len(found) != len(channels) + 1:
        raise refuse(path, "two channels have one name", fix="the file was edited or is damaged")
    if columns is not None:
        found = {name: values for name, values in found.items() if name in columns} or found
    return Table(path=path, columns=found, meta=meta, channels=tuple(c for c in channels if c.name in found))
