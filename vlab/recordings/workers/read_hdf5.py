"""Isolated HDF5 and MAT 7.3 reader, without external references.

MAT 7.3 follows MathWorks' conventions. The attribute ``MATLAB_class`` holds the class of a variable, and dimensions are
reversed. Text is stored as 16-bit codes; cells and struct arrays are references into the group ``#refs#``.
"""

import math
from typing import Any

import h5py
import numpy as np
from h5py import h5d, h5g, h5o, h5t
from sandbox import Skip  # type: ignore[import-not-found]

"".encode("utf-16-le")  # loads the codec, which is a file, while files can be opened

_DEEPEST = 20  # nesting of groups; a recording has two or three levels
_MOST = 10_000  # objects in one file
_LONGEST_TEXT = 10_000
_FILTERS = {1, 2, 3, 4, 5, 6, 32000}
"""Filters built into the library: deflate, shuffle, fletcher32, szip, n-bit, scale-offset, lzf."""
_UNITS = ("unit", "units", "Unit", "Units", "unit_str", "UNIT", "UNITS")


def read(data: bytes, options: dict[str, Any]) -> dict[str, Any]:
    """Return the variables of a file in memory.

    `options` has ``matlab`` and ``limit`` [bytes].
    """
    file = h5py.File.in_memory(data)
    walk = _Walk(file, options["limit"], is_matlab=options["matlab"])
    walk.group(file.id, "", 0)
    return {"variables": walk.found, "units": walk.units, "meta": walk.texts(file), "notes": []}


class _Walk:
    """Traversal of one file's objects.

    Limits bound bytes and objects; a group is never entered from within itself.
    """

    def __init__(self, file: Any, limit: int, *, is_matlab: bool) -> None:
        self.file, self.limit, self.is_matlab = file, limit, is_matlab
        self.left, self.objects = limit, 0
        self.inside: list[Any] = []  # open groups
        self.found: list[tuple[str, Any]] = []
        self.units: dict[str, str] = {}

    def count(self, depth: int) -> None:
        self.objects += 1
        if self.objects > _MOST or depth > _DEEPEST:
            raise ValueError(f"more than {_MOST} objects, or groups nested more than {_DEEPEST} deep")

    def members(self, gid: Any) -> list[tuple[str, Any]]:
        """Return the members of a group.

        A link to anything but the file's own objects is a `Skip`.
        """
        found: list[tuple[str, Any]] = []
        for raw in gid:
            self.count(0)
            name = raw.decode("utf-8", errors="replace")
            kind = gid.links.get_info(raw).type
            if kind == h5py.h5l.TYPE_EXTERNAL:
                other = gid.links.get_val(raw)[0].decode("utf-8", errors="replace")
                found.append((name, Skip(f"a link to another file ({other}), which is never opened")))
            elif kind != h5py.h5l.TYPE_HARD or b"/" in raw or raw == b".":
                found.append((name, Skip("a soft link; name its target")))
            else:
                found.append((name, h5o.open(gid, raw)))
        return found

    def enter(self, gid: Any) -> list[tuple[str, Any]]:
        """Return the members of a group and mark it open.

        An open group has no members.
        """
        info = h5o.get_info(gid)
        key = (info.fileno, repr(info.addr))
        members = [] if key in self.inside else self.members(gid)
        self.inside.append(key)
        return members

    def group(self, gid: Any, prefix: str, depth: int) -> None:
        """Read a group and its subgroups by path."""
        self.count(depth)
        for name, member in self.enter(gid):
            if self.is_matlab and name in ("#refs#", "#subsystem#"):
                continue
            full = prefix + name
            if isinstance(member, h5g.GroupID) and not self.is_matlab:
                self.group(member, full + "/", depth + 1)
                continue
            self.found.append((full, self.value(member, depth + 1)))
            if isinstance(member, h5d.DatasetID):
                self.note_unit(full, member)
        self.inside.pop()

    def note_unit(self, name: str, did: Any) -> None:
        attributes = h5py.Dataset(did).attrs
        for key in _UNITS:
            text = self.text_of(attributes, key)
            if text:
                self.units[name] = text
                return

    def texts(self, item: Any) -> dict[str, str]:
        """Return the single-text attributes of an object."""
        keys = list(item.attrs)[:100]
        found = {key: self.text_of(item.attrs, key) for key in keys if isinstance(key, str)}  # bytes are damaged text
        return {key: text for key, text in found.items() if text is not None}

    def text_of(self, attributes: Any, key: str) -> str | None:
        if key not in attributes:
            return None
        aid = attributes.get_id(key)
        if not isinstance(aid.get_type(), h5t.TypeStringID) or math.prod(aid.shape) != 1:
            return None
        value = np.ravel(attributes[key])[0]
        text = value.decode("utf-8", errors="replace") if isinstance(value, bytes) else str(value)
        return text[:_LONGEST_TEXT]

    def value(self, oid: Any, depth: int) -> Any:
        """Return the value of an object."""
        self.count(depth)
        if isinstance(oid, Skip):
            return oid
        if isinstance(oid, h5g.GroupID):  # in a MAT file: a struct, or the parts of a sparse matrix
            if "MATLAB_sparse" in h5py.Group(oid).attrs:
                return Skip("a sparse matrix")
            fields = {name: self.value(member, depth + 1) for name, member in self.enter(oid)}
            self.inside.pop()
            return fields
        if not isinstance(oid, h5d.DatasetID):
            return Skip("no data set")
        why = self.refusal(oid)
        return why if why is not None else self.samples(h5py.Dataset(oid), depth)

    def refusal(self, did: Any) -> Skip | None:
        """Return the reason to refuse a data set.

        Causes: samples stored elsewhere, missing, or packed by a plug-in.
        """
        properties = did.get_create_plist()
        if properties.get_layout() == h5d.VIRTUAL:
            return Skip("a view of other files or data sets, which are never opened; copy the samples into this file")
        if properties.get_external_count():
            return Skip("stored in another file, which is never opened; copy the samples into this file")
        codes = [properties.get_filter(i)[0] for i in range(properties.get_nfilters())]
        if not set(codes) <= _FILTERS:
            return Skip(f"packed by a plug-in (filters {codes}), and plug-ins are never loaded; save it with gzip")
        if did.shape is None or not math.prod(did.shape):
            return None
        size = math.prod(did.shape) * did.get_type().get_size()
        self.left -= size
        if self.left < 0:
            raise ValueError(f"the file declares more than {self.limit} bytes when unpacked")
        if properties.get_layout() == h5d.CHUNKED:
            chunk = properties.get_chunk()
            if math.prod(chunk) * did.get_type().get_size() > self.limit:
                raise ValueError(f"the file declares blocks of {chunk} samples")
            there, all_of_them = did.get_num_chunks(), math.prod(map(_blocks, did.shape, chunk))
            if there != all_of_them:
                return Skip(f"not whole: {there} of {all_of_them} blocks of samples were written")
        elif did.get_storage_size() < size:
            return Skip(f"not whole: {did.get_storage_size()} of {size} bytes of samples were written")
        return None

    def samples(self, dataset: Any, depth: int) -> Any:
        tid = dataset.id.get_type()
        mat_class = self.text_of(dataset.attrs, "MATLAB_class") if self.is_matlab else None
        if "MATLAB_empty" in dataset.attrs or dataset.shape is None or not dataset.size:
            return "" if mat_class == "char" else np.empty(0)
        if isinstance(tid, h5t.TypeReferenceID):
            return self.references(dataset, depth) if self.is_matlab else Skip("a list of references")
        if mat_class in ("function_handle",) or "MATLAB_object_decode" in dataset.attrs:
            return Skip("a function handle" if mat_class == "function_handle" else "an object")
        if isinstance(tid, h5t.TypeStringID):
            return _text(dataset)
        if isinstance(tid, h5t.TypeCompoundID) and tid.get_nmembers() != 2:
            return Skip("a table of several fields; save each as a data set of its own")
        if (
            not isinstance(tid, h5t.TypeIntegerID | h5t.TypeFloatID | h5t.TypeEnumID | h5t.TypeCompoundID)
            and dataset.dtype.kind != "c"
        ):
            return Skip(f"of type {dataset.dtype}, not numbers")
        values = np.asarray(dataset[()])
        if values.dtype.names is not None:
            if values.dtype.names not in (("real", "imag"), ("r", "i")):
                return Skip(
                    f"a table of the fields {', '.join(values.dtype.names)}; save each as a data set of its own"
                )
            first, second = (values[name] for name in values.dtype.names)
            if first.dtype.kind != "f" or second.dtype.kind != "f":
                return Skip("complex numbers of integers")
            values = first + 1j * second
        if mat_class == "char":
            return _codes(values)
        return np.ascontiguousarray(values).T if self.is_matlab else np.ascontiguousarray(values)

    def references(self, dataset: Any, depth: int) -> list[Any]:
        """Return the cells of an array in MATLAB's order."""
        if dataset.size > _MOST:
            raise ValueError(f"a cell array of {dataset.size} cells")
        cells: list[Any] = []
        for reference in np.ravel(dataset[()]):
            member = self.file[reference] if reference else None
            cells.append(np.empty(0) if member is None else self.value(member.id, depth + 1))
        return cells


def _blocks(length: int, block: int) -> int:
    return -(-length // block)


def _text(dataset: Any) -> Any:
    if dataset.size != 1 or dataset.dtype.itemsize > _LONGEST_TEXT:
        return Skip("a list of text")
    return str(np.ravel(dataset.asstr(errors="replace")[()])[0])[:_LONGEST_TEXT]


def _codes(values: Any) -> Any:
    if values.dtype.kind != "u" or values.dtype.itemsize > 2 or values.ndim != 2 or values.shape[1] != 1:
        return Skip("a block of text")
    return values.astype("<u2").tobytes().decode("utf-16-le", errors="replace")
