"""MAT 5 to 7: numeric variables as columns, structs flattened to dotted names.

The file is walked here in plain Python, every declared size checked against the bytes that are there, because
scipy.io.loadmat ends the whole process (segmentation fault) on damaged files; the tests compare the two on sound ones.
Format: MathWorks, "MAT-File Format" (R2024a), chapter 1, level 5. No object, function or class in a file is ever made.
"""

import math
import struct
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlab.recordings import files
from vlab.recordings.files import refuse
from vlab.recordings.table import MAX_COLUMNS, Table, not_finite

_DTYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_ENCODINGS = {1: "latin-1", 2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}
_MATRIX, _COMPRESSED = 14, 15
_CELL, _STRUCT, _OBJECT, _CHAR, _SPARSE, _FUNCTION, _OPAQUE = 1, 2, 3, 4, 5, 16, 17
_KINDS = {_OBJECT: "an object", _SPARSE: "a sparse matrix", _FUNCTION: "a function handle", _OPAQUE: "an object"}
_DEEPEST = 20  # structs in structs; a recording has two or three
_WIDEST = 1000  # columns of one matrix; more is an image or a map


class _Damaged(Exception):
    """The bytes are not what their headers declare."""


@dataclass(frozen=True)
class _Skipped:
    """Something in the file that is no number and no text."""

    what: str


@dataclass
class _Walk:
    """Reads the elements of one file, within a budget of unpacked bytes."""

    order: str  # "<" or ">"
    budget: int = field(default_factory=lambda: files.MAX_BYTES)

    def spend(self, n_bytes: int) -> None:
        self.budget -= n_bytes
        if self.budget < 0:
            raise _Damaged(f"more than {files.MAX_BYTES} bytes when unpacked")

    def element(self, view: memoryview, offset: int) -> tuple[int, memoryview, int]:
        """Return type and content of the element at an offset, and the offset of the next."""
        if offset + 8 > len(view):
            raise _Damaged("truncated: it ends where a variable is expected")
        kind, size = struct.unpack_from(self.order + "II", view, offset)
        if kind >> 16:  # the small form: size, type and up to four bytes of content in eight
            kind, size = kind & 0xFFFF, kind >> 16
            if size > 4:
                raise _Damaged(f"a short element declares {size} bytes")
            return kind, view[offset + 4 : offset + 4 + size], offset + 8
        if size > len(view) - offset - 8:
            raise _Damaged(f"truncated: {size} bytes are declared where {len(view) - offset - 8} are left")
        end = offset + 8 + size
        return kind, view[offset + 8 : end], end if kind == _COMPRESSED else min(end + -end % 8, len(view))

    def inflate(self, packed: memoryview) -> memoryview:
        """Return the content of the one matrix in a compressed element, its checksum verified."""
        stream = zlib.decompressobj()
        try:
            tag = stream.decompress(packed, 8)
            if len(tag) < 8:
                raise _Damaged("a compressed variable is truncated")
            kind, size = struct.unpack(self.order + "II", tag)
            if kind != _MATRIX or not size:
                raise _Damaged("a compressed element holds no variable")
            self.spend(size)
            content = stream.decompress(stream.unconsumed_tail, size)
            stream.decompress(stream.unconsumed_tail, 64)  # padding, and the checksum at the end of the stream
        except zlib.error as error:
            raise _Damaged(f"a compressed variable is damaged ({error})") from error
        if len(content) < size or not stream.eof:
            raise _Damaged("a compressed variable is truncated")
        return memoryview(content)

    def variables(self, view: memoryview) -> Iterator[tuple[str, Any]]:
        """Yield name and value of the variables of a file."""
        offset = 128
        while offset < len(view):
            kind, content, offset = self.element(view, offset)
            if kind == _COMPRESSED:
                yield self.matrix(self.inflate(content))
            elif kind == _MATRIX:
                yield self.matrix(content)
            else:
                raise _Damaged(f"an element of type {kind} where a variable is expected")

    def matrix(self, view: memoryview, depth: int = 0) -> tuple[str, Any]:
        """Return name and value: an array, text, a dict of struct fields, a list of cells, or `_Skipped`."""
        if not len(view):
            return "", np.empty((0, 0))
        if depth > _DEEPEST:
            raise _Damaged(f"structs nested more than {_DEEPEST} deep")
        kind, flags, offset = self.element(view, 0)
        if kind != 6 or len(flags) != 8:
            raise _Damaged("a variable has no array flags")
        (flag,) = struct.unpack_from(self.order + "I", flags)
        array_class, is_complex = flag & 0xFF, bool(flag & 0x0800)
        if array_class == _OPAQUE:  # name and class follow instead of dimensions
            return self._name(view, offset)[0], _Skipped(_KINDS[_OPAQUE])
        kind, content, offset = self.element(view, offset)
        if kind != 5 or len(content) % 4:
            raise _Damaged("a variable has no dimensions")
        shape = struct.unpack(f"{self.order}{len(content) // 4}i", content)
        name, offset = self._name(view, offset)
        if len(shape) < 2 or len(shape) > 32 or min(shape) < 0:
            raise _Damaged(f"variable {name!r} has the dimensions {shape}")
        if array_class in _KINDS:
            return name, _Skipped(_KINDS[array_class])
        if array_class == _CELL:
            return name, self._many(view, offset, shape, depth)[0]
        if array_class == _STRUCT:
            return name, self._struct(view, offset, shape, depth)
        if array_class == _CHAR:
            return name, self._text(view, offset, shape)
        if not 6 <= array_class <= 15:
            raise _Damaged(f"variable {name!r} is of the unknown class {array_class}")
        values, offset = self._numbers(view, offset, shape)
        if is_complex:
            imaginary, offset = self._numbers(view, offset, shape)
            both = np.empty(shape, dtype=complex)
            both.real, both.imag = values, imaginary
            values = both
        return name, values

    def _name(self, view: memoryview, offset: int) -> tuple[str, int]:
        _, content, offset = self.element(view, offset)
        name = bytes(content[:256]).decode("latin-1").rstrip("\0")
        if not name.isprintable():
            raise _Damaged("the name of a variable is not text")
        return name, offset

    def _numbers(self, view: memoryview, offset: int, shape: tuple[int, ...]) -> tuple[NDArray[Any], int]:
        kind, content, offset = self.element(view, offset)
        if kind not in _DTYPES:
            raise _Damaged(f"numbers of the unknown type {kind}")
        dtype = np.dtype(self.order + _DTYPES[kind])
        if math.prod(shape) * dtype.itemsize != len(content):
            raise _Damaged(
                f"{len(content)} bytes of numbers where {shape} declares {math.prod(shape) * dtype.itemsize}"
            )
        self.spend(8 * math.prod(shape))
        return np.frombuffer(content, dtype=dtype).astype(float).reshape(shape, order="F"), offset

    def _text(self, view: memoryview, offset: int, shape: tuple[int, ...]) -> Any:
        if not math.prod(shape):
            return ""
        kind, content, _ = self.element(view, offset)
        if kind not in _ENCODINGS or len(shape) > 2 or shape[0] != 1:
            return _Skipped("a block of text")
        encoding = _ENCODINGS[kind] + ("" if kind in (1, 2, 16) else "-le" if self.order == "<" else "-be")
        self.spend(4 * len(content))
        return bytes(content).decode(encoding, errors="replace")

    def _many(self, view: memoryview, offset: int, shape: tuple[int, ...], depth: int) -> tuple[list[Any], int]:
        """Read as many matrices as the shape declares; each takes at least eight bytes."""
        if math.prod(shape) * 8 > len(view) - offset:
            raise _Damaged(f"truncated: {shape} cells are declared in {len(view) - offset} bytes")
        self.spend(64 * math.prod(shape))
        cells = []
        for _ in range(math.prod(shape)):
            kind, content, offset = self.element(view, offset)
            if kind != _MATRIX:
                raise _Damaged(f"an element of type {kind} in a cell or a struct")
            cells.append(self.matrix(content, depth + 1)[1])
        return cells, offset

    def _struct(self, view: memoryview, offset: int, shape: tuple[int, ...], depth: int) -> Any:
        _, content, offset = self.element(view, offset)
        length = int.from_bytes(content, "little" if self.order == "<" else "big", signed=True)
        _, content, offset = self.element(view, offset)
        if length < 1 or len(content) % length:
            raise _Damaged("the names of the fields of a struct are damaged")
        raw = [
            bytes(content[i : i + length]).partition(b"\0")[0].decode("latin-1") for i in range(0, len(content), length)
        ]
        if len(set(raw)) != len(raw) or not all(name.isprintable() and name for name in raw):
            raise _Damaged("the names of the fields of a struct are damaged")
        if not raw:
            return {}
        values, _ = self._many(view, offset, (*shape, len(raw)), depth)
        items = [dict(zip(raw, values[i : i + len(raw)], strict=True)) for i in range(0, len(values), len(raw))]
        return items[0] if len(items) == 1 else items


def read(data: bytes, path: Path, *, names: Sequence[str] | None = None, columns: Sequence[str] | None = None) -> Table:
    """Read the variables of a MAT file; see `vlab.recordings.open_table`.

    A vector is a column. The samples of a matrix run along its longest axis, the first among equals; its other axes
    number the columns: ``y_1``, ``y_2`` or, of three axes, ``H_1_2``. A struct array is numbered likewise: ``run_2.y``.
    """
    if names is not None:
        raise refuse(path, "a MAT file names its own variables", fix="leave out names")
    _check_header(data, path)
    found = _Found()
    try:
        for name, value in _Walk("<" if data[126:128] == b"IM" else ">").variables(memoryview(data)):
            if name:
                found.add(name, value)
            else:
                found.notes.append("unnamed data for objects skipped")
            if len(found.columns) + len(found.refused) > MAX_COLUMNS:
                raise _Damaged(f"more than {MAX_COLUMNS} variables")
    except _Damaged as error:
        raise refuse(path, str(error), fix="the file is damaged; copy or export it again") from error
    chosen = found.columns if columns is None else {k: v for k, v in found.columns.items() if k in columns}
    return Table(
        path=path, columns=chosen or found.columns, refused=found.refused, notes=tuple(found.notes), meta=found.meta
    )


def _check_header(data: bytes, path: Path) -> None:
    if data[:10] == b"MATLAB 7.3" or data[:4] == b"\x89HDF" or data[512:516] == b"\x89HDF":
        raise refuse(path, "MAT 7.3 (HDF5) is not readable yet", fix="save as -v7: save('name.mat', ..., '-v7')")
    if len(data) < 136 or data[126:128] not in (b"IM", b"MI") or data[124:126] not in (b"\0\1", b"\1\0"):
        raise refuse(path, "not a MAT file of version 5 to 7", fix="save as -v7: save('name.mat', ..., '-v7')")


@dataclass
class _Found:
    """The columns so far, and what cannot be one."""

    columns: dict[str, NDArray[Any]] = field(default_factory=dict)
    refused: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    meta: dict[str, Any] = field(default_factory=dict)

    def add(self, name: str, value: Any) -> None:
        """File a value under its name, structs and cells field by field."""
        if name in self.columns or name in self.refused or name in self.meta:
            self.columns.pop(name, None)
            self.meta.pop(name, None)
            self.refused[name] = "two things in the file have this name"
        elif isinstance(value, dict):
            self._group(name, "a struct", {f"{name}.{key}": part for key, part in value.items()})
        elif isinstance(value, list):
            self._group(name, "a struct or cell array", {f"{name}_{i}": part for i, part in enumerate(value, start=1)})
        elif isinstance(value, str):
            self.meta[name] = value
        elif isinstance(value, _Skipped):
            self.refused[name] = f"it is {value.what}"
            self.notes.append(f"{name}: {value.what} skipped")
        else:
            self._array(name, value)

    def _group(self, name: str, what: str, parts: dict[str, Any]) -> None:
        self.refused[name] = (
            f"it is {what}; name what is in it, such as {next(iter(parts))!r}"
            if parts
            else f"it is {what} with nothing in it"
        )
        for key, part in parts.items():
            self.add(key, part)

    def _array(self, name: str, value: NDArray[Any]) -> None:
        size, shape = value.size, " x ".join(map(str, value.shape))
        if not size:
            self.refused[name] = f"it is empty ({shape})"
            return
        longest = int(np.argmax(value.shape))
        table = np.moveaxis(value, longest, 0)
        others = table.shape[1:]
        if math.prod(others) == 1:
            if np.isfinite(value).all():
                self.columns[name] = np.ascontiguousarray(table.reshape(-1))
            else:
                self.refused[name] = not_finite(table.reshape(-1))
            return
        if math.prod(others) > _WIDEST:
            self.refused[name] = f"it is a matrix of {shape}; more than {_WIDEST} columns are not read"
            return
        used = [axis for axis, length in enumerate(others) if length > 1]
        parts = {}
        for index in np.ndindex(others):
            parts["_".join([name, *(str(index[axis] + 1) for axis in used)])] = np.ascontiguousarray(
                table[(slice(None), *index)]
            )
        if longest:
            self.notes.append(f"{name}: {shape} matrix, its samples are taken along axis {longest + 1}")
        self._group(name, f"a {shape} matrix", parts)
