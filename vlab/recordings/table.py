"""Guarded opener: any recording file as named columns."""

import difflib
import importlib
import importlib.metadata
import json
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from vlab import units
from vlab.errors import BadRecording, BadUnit, UnknownName, VlabError, unknown_name
from vlab.files.text import one_line
from vlab.recordings.bound import check_bound
from vlab.recordings.files import PathLike, read_guarded, refuse
from vlab.recordings.response_labels import ResponseLabel
from vlab.signals import Channel

READERS = {
    ".csv": "vlab.recordings.formats.csv",
    ".txt": "vlab.recordings.formats.text",
    ".dat": "vlab.recordings.formats.text",
    ".tsv": "vlab.recordings.formats.text",
    ".lvm": "vlab.recordings.formats.lvm",
    ".jsonl": "vlab.recordings.formats.json_lines",
    ".ndjson": "vlab.recordings.formats.json_lines",
    ".json": "vlab.recordings.formats.json_document",
    ".gz": "vlab.recordings.formats.gz",
    ".parquet": "vlab.recordings.formats.parquet",
    ".mat": "vlab.recordings.formats.mat",
    ".npz": "vlab.recordings.formats.npz",
    ".npy": "vlab.recordings.formats.npy",
    ".h5": "vlab.recordings.formats.hdf5",
    ".hdf5": "vlab.recordings.formats.hdf5",
    ".uff": "vlab.recordings.formats.uff",
    ".unv": "vlab.recordings.formats.uff",
    ".tdms": "vlab.recordings.formats.tdms",
    ".xlsx": "vlab.recordings.formats.xlsx",
    ".mcap": "vlab.recordings.formats.mcap",
    ".db3": "vlab.recordings.formats.db3",
}
"""Reader module by suffix.

Each module has ``read(data, path, *, names, columns, blanks) -> Table`` and is imported at first use.
"""


GROUP = "vlab.readers"
"""Entry point group of packages that read further kinds of files; the kinds of `READERS` stay."""


class _Every(frozenset[str]):
    def __contains__(self, name: object) -> bool:
        return True

    def __bool__(self) -> bool:
        return True


EVERY: frozenset[str] = _Every()
"""EVERY: names of all columns, whatever they are."""

MOST_LISTED = 40
"""MOST_LISTED [1]: largest number of columns that a message names."""

MAX_COLUMNS = 10_000
"""MAX_COLUMNS [1]: largest accepted number of columns. A file with more is damaged or hostile."""

_GRAVITY = re.compile(r"\bg\b")  # g beside an acceleration is gravity, not gram

FORMAT_VERSION = 1
"""FORMAT_VERSION [1]: version of vlab's own files. A reader refuses a newer version."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Table:
    """Numeric columns of one file, unconverted and unrepaired.

    Parameters
    ----------
    path : Path
        The file.
    columns : mapping of str to (n,) array
        Real or complex, finite, read-only columns; lengths may differ. A column in `blanks` is NaN where a cell is blank.
    refused : mapping of str to str
        Reason of refusal by name, for entries that cannot be columns. Access raises the reason.
    notes : tuple of str
        Remarks on the file (objects skipped, no line end at the end).
    meta : mapping
        Text and notes of the file.
    channels : tuple of Channel or None
        Labels of vlab's own file, else None.
    units : mapping of str to str
        Units as stated in the file, unchecked.
    blanks : collection of str
        Columns that may have blank cells.
    aliases : mapping of str to str
        Column by its other name.
    rows : (n,) array of int or None
        Row of the file for each sample, after a selection of rows; None for all rows.
    responses : tuple of ResponseLabel or None
        Columns that the file states to be frequency responses; None for a file that states no kinds of columns.

    Raises
    ------
    BadRecording
        No column, or a column that is not one-dimensional, numeric and finite.
    """

    path: Path
    columns: Mapping[str, NDArray[Any]]
    refused: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    meta: Mapping[str, Any] = field(default_factory=dict)
    channels: tuple[Channel, ...] | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    blanks: Collection[str] = frozenset()
    aliases: Mapping[str, str] = field(default_factory=dict)
    rows: NDArray[Any] | None = None
    responses: tuple[ResponseLabel, ...] | None = None

    def __post_init__(self) -> None:
        columns = {}
        for name, values in self.columns.items():
            array = np.asarray(values, dtype=complex if np.iscomplexobj(values) else float).view()
            if array.ndim != 1 or not array.size:
                raise refuse(
                    self.path, f"column {name!r} has the shape {array.shape}", fix="a column is a list of numbers"
                )
            if not np.isfinite(array).all() and (name not in self.blanks or bool(np.isinf(array).any())):
                raise refuse(self.path, f"column {name!r}: {not_finite(array)}")
            array.setflags(write=False)
            columns[name] = array
        if not columns:
            reasons = "; ".join(f"{name}: {why}" for name, why in list(self.refused.items())[:3])
            if len(self.refused) > 1 and len(set(self.refused.values())) == 1:  # a fault of the file, not of a column
                raise refuse(self.path, next(iter(self.refused.values())))
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
        """Column names in file order."""
        return tuple(self.columns)

    def __getitem__(self, name: str) -> NDArray[Any]:
        name = name if name in self.columns else self.aliases.get(name, name)
        if name in self.columns:
            return self.columns[name]
        if name in self.refused:
            raise refuse(self.path, f"{name!r} cannot be a column: {self.refused[name]}")
        raise unknown_column(name, [*self.names, *self.aliases], self.path)

    def real(self, name: str) -> NDArray[Any]:
        """Return a real column.

        Parameters
        ----------
        name : str
            Name of the column.

        Returns
        -------
        array
            Samples, (n,).

        Raises
        ------
        BadRecording
            The column is complex.
        UnknownName
            No such column.
        """
        values = self[name]
        if np.iscomplexobj(values):
            fix = "a frequency response is described in [[frf]], not as a recording"
            raise refuse(self.path, f"column {name!r} is complex", fix=fix)
        return values

    def check_unit(self, name: str, unit: str, si: str) -> None:
        """Check a given unit against the file's statement.

        A file without a known unit passes.

        Parameters
        ----------
        name : str
            Name of the column.
        unit : str
            Given unit.
        si : str
            SI unit inside vlab.

        Raises
        ------
        BadUnit
            The units differ in dimension or by a factor.
        """
        stated = self.units.get(name, "").translate(units.SIGNS)
        if "m/s^2" in si:
            stated = _GRAVITY.sub("g_0", stated)
        try:
            units.factor(stated, stated)
        except BadUnit:
            return  # counts, volts per division and the like: the given unit decides
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
    blanks: Collection[str] = frozenset(),
) -> Table:
    """Open a recording file as named columns.

    No content of the file is executed.

    Parameters
    ----------
    path : str or path
        File with a suffix in `READERS`.
    folder : str or path, optional
        Folder that must contain the file (after absolute paths, ``..`` and links); `path` is then relative.
    names : sequence of str, optional
        Column names of a CSV file without names, or in place of its names.
    columns : sequence of str, optional
        Columns to read; a CSV file may then have gaps and text in every other column.
    blanks : collection of str
        Columns in which blank cells and NaN are read as NaN, and not refused.

    Returns
    -------
    Table
        Columns, refusals and notes.

    Raises
    ------
    BadRecording
        The file is missing, outside the folder, too large, of unknown suffix, damaged, truncated or not numeric. Or the
        manifest of a run folder states another hash.
    UnknownName
        A name in `columns` is not in the file.
    """
    suffix = Path(path).suffix.lower()
    installed = None if suffix in READERS else _installed_reader(suffix)
    if suffix not in READERS and installed is None:
        if not (Path(path) if folder is None else Path(folder) / path).exists():
            raise refuse(path, "there is no such file", fix="check the name and the folder")
        raise refuse(path, f"files of kind {suffix!r} are not read", fix=f"accepted: {', '.join(READERS)}")
    data = read_guarded(path, folder=folder)
    check_bound(data, Path(path) if folder is None else Path(folder) / path)
    read = importlib.import_module(READERS[suffix]).read if installed is None else installed
    pairs = importlib.import_module("vlab.recordings.stamp_pairs")  # builds tables itself
    parts = None if columns is None else pairs.split_names(columns)
    blanks = EVERY if blanks is EVERY else frozenset(pairs.split_names(blanks))
    try:
        table = cast(Table, read(data, Path(path), names=names, columns=parts, blanks=blanks))
    except VlabError:
        raise
    except MemoryError as error:
        raise refuse(
            path, "reading it needs more memory than there is", fix="the file is damaged, or cut it into parts"
        ) from error
    except Exception as error:
        # format libraries raise a dozen kinds of error on damaged files, with one meaning here
        what = f"not a readable {suffix[1:]} file: {error}"
        raise refuse(path, what, fix="the file is damaged; export or copy it again") from error
    if table.channels is None:
        table = pairs.with_sums(table, columns)
    for name in columns or ():
        table[name]
    return table


def _installed_reader(suffix: str) -> Any:
    """Return the reader of an installed package for a suffix, or None.

    The entry point has the name of the suffix without its dot, and is a function like ``read`` in `READERS`.
    """
    chosen = [point for point in importlib.metadata.entry_points(group=GROUP) if f".{point.name}" == suffix]
    if not chosen:
        return None
    if len(chosen) > 1:
        offered = ", ".join(point.value for point in chosen)
        raise BadRecording(f"{len(chosen)} installed packages read files of kind {suffix!r} ({offered}); keep one")
    try:
        return chosen[0].load()
    except Exception as error:
        raise BadRecording(
            f"the reader {chosen[0].value!r} of files of kind {suffix!r} fails when it is loaded: {one_line(error)}"
        ) from error


def unknown_column(
    name: str, names: Sequence[str], path: PathLike, *, others: Mapping[str, str] = MappingProxyType({})
) -> UnknownName:
    """Return the error for a column that a file does not have.

    Parameters
    ----------
    name : str
        Name as given.
    names : sequence of str
        Columns of the file.
    path : str or path
        File, for the message.
    others : mapping of str to str
        Entries of the file that are no columns, with the reason.

    Returns
    -------
    UnknownName
        Error with the nearest columns; parts of a name such as ``action[0]`` count.
    """
    known = names if len(names) <= MOST_LISTED else difflib.get_close_matches(name, names, n=MOST_LISTED, cutoff=0.0)
    known = known or names[:MOST_LISTED]
    parts = [n for n in names if name and (f"[{name}]" in n or n.rpartition("/")[2] == name)]
    error = unknown_name("column", name, map(one_line, known), where=one_line(path))
    if others:
        listed = "; ".join(f"{one_line(n)}: {one_line(why, longest=80)}" for n, why in list(others.items())[:8])
        error = UnknownName(f"{error}; not readable: {listed}")
    if not parts or ("did you mean" in str(error) and len(parts) < 2):
        return error
    hint = " or ".join(repr(one_line(n)) for n in parts[:4])
    return UnknownName(f"{one_line(path)}: unknown column {one_line(name)!r}; did you mean {hint}?")


def not_finite(array: NDArray[Any]) -> str:
    """Return a message on the first nonfinite sample."""
    bad = int(np.argmin(np.isfinite(array)))
    count = f"{int(np.sum(~np.isfinite(array)))} of {array.size} samples are not finite"
    return f"{'NaN' if np.isnan(array[bad]) else 'infinite'} at sample {bad} ({count})"


def meta_to_json(meta: Mapping[str, Any], path: PathLike) -> str:
    """Return the notes of a recording as JSON.

    Arrays become lists.

    Parameters
    ----------
    meta : mapping of str to object
        Notes by name.
    path : str or path
        File, for messages.

    Returns
    -------
    str
        JSON text.

    Raises
    ------
    BadRecording
        A value has no JSON form.
    """
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
    """Refuse a file of a newer vlab version."""
    if not text.isdecimal() or not 1 <= int(text) <= FORMAT_VERSION:
        raise refuse(
            path,
            f"the file is vlab recording version {text[:20]!r}, this vlab reads up to {FORMAT_VERSION}",
            fix="update vlab",
        )


def read_meta(text: str, path: PathLike) -> dict[str, Any]:
    """Return the notes of a vlab file.

    Parameters
    ----------
    text : str
        JSON text.
    path : str or path
        File, for messages.

    Returns
    -------
    dict of str to object
        Notes by name.

    Raises
    ------
    BadRecording
        The notes are damaged.
    """
    try:
        meta = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise refuse(path, f"the notes (meta) are damaged: {error}") from error
    if not isinstance(meta, dict):
        raise refuse(path, "the notes (meta) are damaged: not a JSON table")
    return meta


def read_channel(labels: Sequence[str], path: PathLike) -> Channel:
    """Return the channel described by a vlab file's labels.

    Parameters
    ----------
    labels : sequence of str
        Name, kind, unit, place and ``input`` or ``output``.
    path : str or path
        File, for messages.

    Returns
    -------
    Channel
        Channel.

    Raises
    ------
    BadRecording
        The labels are damaged.
    """
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
