"""Any recording file as named columns, through the one guarded opener."""

import difflib
import importlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from vlab import units
from vlab.errors import BadRecording, BadUnit, VlabError, unknown_name
from vlab.files.text import one_line
from vlab.recordings.bound import check_bound
from vlab.recordings.files import PathLike, read_guarded, refuse
from vlab.signals import Channel

READERS = {
    ".csv": "vlab.recordings.formats.csv",
    ".parquet": "vlab.recordings.formats.parquet",
    ".mat": "vlab.recordings.formats.mat",
    ".npz": "vlab.recordings.formats.npz",
    ".h5": "vlab.recordings.formats.hdf5",
    ".hdf5": "vlab.recordings.formats.hdf5",
    ".uff": "vlab.recordings.formats.uff",
    ".unv": "vlab.recordings.formats.uff",
    ".tdms": "vlab.recordings.formats.tdms",
}
"""Suffix -> module with ``read(data, path, *, names, columns) -> Table``, imported when first needed."""

MAX_COLUMNS = 10_000
"""More columns than any recording has; a file that declares more is damaged or hostile."""

_GRAVITY = re.compile(r"\bg\b")  # beside an acceleration, not a gram

FORMAT_VERSION = 1
"""Version of vlab's own files; a reader refuses files that are newer than itself."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Table:
    """The numeric columns of one file, as they stand in it: no units converted, nothing repaired.

    Parameters
    ----------
    path : Path
        The file.
    columns : mapping of str to (n,) array
        Real or complex, finite, read-only; lengths may differ between columns.
    refused : mapping of str to str
        What stands in the file but cannot be a column, and why; asking for one raises that reason.
    notes : tuple of str
        What a reader of the file should know (objects skipped, no line end at the end, ...).
    meta : mapping
        Text and notes of the file itself.
    channels : tuple of Channel or None
        The labels, where the file is vlab's own.
    units : mapping of str to str
        The units of columns as the file itself states them, not checked.

    Raises
    ------
    BadRecording
        No column, or one that is not one-dimensional, numeric and finite.
    """

    path: Path
    columns: Mapping[str, NDArray[Any]]
    refused: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    meta: Mapping[str, Any] = field(default_factory=dict)
    channels: tuple[Channel, ...] | None = None
    units: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        columns = {}
        for name, values in self.columns.items():
            array = np.asarray(values, dtype=complex if np.iscomplexobj(values) else float).view()
            if array.ndim != 1 or not array.size:
                raise refuse(
                    self.path, f"column {name!r} has the shape {array.shape}", fix="a column is a list of numbers"
                )
            if not np.isfinite(array).all():
                raise refuse(self.path, f"column {name!r}: {not_finite(array)}")
            array.setflags(write=False)
            columns[name] = array
        if not columns:
            reasons = "; ".join(f"{name}: {why}" for name, why in list(self.refused.items())[:3])
            raise refuse(
                self.path,
                f"no numeric column in the file{f' ({reasons})' if reasons else ''}",
                fix="check what was exported",
            )
        object.__setattr__(self, "columns", MappingProxyType(columns))
        object.__setattr__(self, "refused", MappingProxyType(dict(self.refused)))
        object.__setattr__(self, "meta", MappingProxyType(dict(self.meta)))
        object.__setattr__(self, "units", MappingProxyType(dict(self.units)))

    @property
    def names(self) -> tuple[str, ...]:
        """The column names in file order."""
        return tuple(self.columns)

    def __getitem__(self, name: str) -> NDArray[Any]:
        if name in self.columns:
            return self.columns[name]
        if name in self.refused:
            raise refuse(self.path, f"{name!r} cannot be a column: {self.refused[name]}")
        known = self.names if len(self.columns) <= 40 else difflib.get_close_matches(name, self.names, n=40, cutoff=0.0)
        raise unknown_name("column", name, map(one_line, known), where=one_line(self.path))

    def real(self, name: str) -> NDArray[Any]:
        """Return a column where only real numbers make sense.

        Raises
        ------
        BadRecording
            The column is complex.
        UnknownName
            There is no such column.
        """
        values = self[name]
        if np.iscomplexobj(values):
            fix = "a frequency response is described in [[frf]], not as a recording"
            raise refuse(self.path, f"column {name!r} is complex", fix=fix)
        return values

    def check_unit(self, name: str, unit: str, si: str) -> None:
        """Hold a given unit against the one that the file itself states for a column, where it states a known one.

        Raises
        ------
        BadUnit
            They differ, in dimension or by a factor.
        """
        stated = self.units.get(name, "").translate(units.SIGNS)
        if "m/s^2" in si:
            stated = _GRAVITY.sub("g_0", stated)
        try:
            units.factor(stated, stated)
        except BadUnit:
            return  # counts, volts per division and the like: only the given unit says what they are
        if not stated or "EU" in stated:  # engineering units: any
            return
        given = units.factor(unit, si)
        other = units.factor(stated, si) if units.same_dimension(stated, si) else None
        if other is None or abs(given / other - 1) > 1e-6:
            ratio = "another dimension" if other is None else f"a factor of {given / other:.6g}"
            raise BadUnit(
                f"the file states {one_line(self.units[name])!r} and the description {unit!r}, {ratio} between them; "
                "correct the description, or give a scale where the file is wrong"
            )


def open_table(
    path: PathLike,
    *,
    folder: PathLike | None = None,
    names: Sequence[str] | None = None,
    columns: Sequence[str] | None = None,
) -> Table:
    """Open a recording file as named columns; nothing in the file is ever executed.

    Parameters
    ----------
    path : str or path
        A file with one of the suffixes in `READERS`.
    folder : str or path, optional
        Refuse a file outside this folder (absolute, ``..`` or through links); `path` is then relative to it.
    names : sequence of str, optional
        Names of the columns of a CSV file that has none, or in place of those it has.
    columns : sequence of str, optional
        Read these only; a CSV file may then have gaps and text in its other columns.

    Returns
    -------
    Table
        Finite columns and what else was found.

    Raises
    ------
    BadRecording
        The file is missing, outside the folder, too large, of unknown suffix, damaged, truncated or not numeric; or it is the
        recording of a run folder whose manifest states another hash.
    UnknownName
        One of `columns` is not in the file.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in READERS:
        if not (Path(path) if folder is None else Path(folder) / path).exists():
            raise refuse(path, "there is no such file", fix="check the name and the folder")
        raise refuse(path, f"files of kind {suffix!r} are not read", fix=f"accepted: {', '.join(READERS)}")
    data = read_guarded(path, folder=folder)
    check_bound(data, Path(path) if folder is None else Path(folder) / path)
    reader = importlib.import_module(READERS[suffix])
    try:
        table = cast(Table, reader.read(data, Path(path), names=names, columns=columns))
    except VlabError:
        raise
    except MemoryError as error:
        raise refuse(
            path, "reading it needs more memory than there is", fix="the file is damaged, or cut it into parts"
        ) from error
    except Exception as error:
        # The format libraries raise a dozen kinds on damaged files; all of them mean the same here.
        what = f"not a readable {suffix[1:]} file: {error}"
        raise refuse(path, what, fix="the file is damaged; export or copy it again") from error
    for name in columns or ():
        table[name]
    return table


def not_finite(array: NDArray[Any]) -> str:
    """Say which is the first sample that is not finite."""
    bad = int(np.argmin(np.isfinite(array)))
    count = f"{int(np.sum(~np.isfinite(array)))} of {array.size} samples are not finite"
    return f"{'NaN' if np.isnan(array[bad]) else 'infinite'} at sample {bad} ({count})"


def meta_to_json(meta: Mapping[str, Any], path: PathLike) -> str:
    """Return the notes of a recording as JSON; arrays become lists, anything else that JSON lacks is refused."""
    try:
        return json.dumps(dict(meta), default=_plain)
    except (TypeError, ValueError) as error:
        raise refuse(
            path,
            f"the notes (meta) cannot be written as JSON: {error}",
            fix="keep numbers, text, lists and tables in meta",
        ) from error


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} is not a JSON value")


def check_version(text: str, path: PathLike) -> None:
    """Refuse a vlab file that a newer vlab wrote."""
    if not text.isdecimal() or not 1 <= int(text) <= FORMAT_VERSION:
        raise refuse(
            path,
            f"the file is vlab recording version {text[:20]!r}, this vlab reads up to {FORMAT_VERSION}",
            fix="update vlab",
        )


def read_meta(text: str, path: PathLike) -> dict[str, Any]:
    """Return the notes of a vlab file."""
    try:
        meta = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise refuse(path, f"the notes (meta) are damaged: {error}") from error
    if not isinstance(meta, dict):
        raise refuse(path, "the notes (meta) are damaged: not a JSON table")
    return meta


def read_channel(labels: Sequence[str], path: PathLike) -> Channel:
    """Return the channel of the labels name, kind, unit, at, input|output of a vlab file."""
    if len(labels) != 5 or labels[4] not in ("input", "output"):
        raise refuse(
            path,
            f"the channel labels {list(labels)} are damaged",
            fix="they are: name; kind; unit; at; input or output",
        )
    try:
        return Channel(name=labels[0], kind=labels[1], unit=labels[2], at=labels[3], is_input=labels[4] == "input")
    except BadRecording as error:
        raise refuse(path, str(error)) from error
