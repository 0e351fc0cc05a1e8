"""Named variables of MAT, NPZ, HDF5 and TDMS files as columns.

Structs and matrices are split by name.
"""

import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlab.files.text import one_line
from vlab.recordings.files import refuse
from vlab.recordings.table import MAX_COLUMNS, Table, not_finite

_WIDEST = 1000  # columns of one matrix; a wider one is an image or a map
_WHOLE = 2**53  # largest integer exact in a double


class Damaged(Exception):
    """File content that contradicts its headers."""


@dataclass(frozen=True)
class Skipped:
    """Reason why an entry is neither number nor text."""

    what: str


def to_float(values: NDArray[Any]) -> NDArray[Any] | str:
    """Return numbers as float64 or complex128 without loss.

    Parameters
    ----------
    values : array
        Array of any type.

    Returns
    -------
    array or str
        Numbers, or the reason of refusal.
    """
    kind, size = values.dtype.kind, values.dtype.itemsize
    if kind not in "biufc":
        return f"it holds {values.dtype}, not numbers; a time must be in seconds"
    if kind in "iu" and size == 8 and values.size and (int(values.max()) > _WHOLE or int(values.min()) < -_WHOLE):
        return "it has numbers beyond the precision of a float; subtract the start of a clock"
    with np.errstate(all="ignore"):  # the comparison finds values that do not fit
        wide = values.astype(complex if kind == "c" else float)
    if size > wide.dtype.itemsize and not np.array_equal(wide.astype(values.dtype), values, equal_nan=True):
        return f"it has numbers of {8 * size} bits beyond the precision of a float; save it as double"
    return wide


_PART = re.compile(r"(.*\S)\s*\[([\s\d:,-]+)\]")


def part_of(name: str, arrays: Mapping[str, NDArray[Any]]) -> NDArray[Any] | None:
    """Return the part of an array that a name with indices means.

    ``y[:, 2]`` is a column, counted from zero. ``y[:, :, 0]`` strings the second axis together: samples of an array
    (samples, periods, realisations) then run through all periods of the first realisation.

    Parameters
    ----------
    name : str
        Name of an array with one index or ``:`` for each axis.
    arrays : mapping of str to array
        Arrays of the file.

    Returns
    -------
    (n,) array or None
        Samples along the first ``:``, then along each later one; None if the name means no part.
    """
    match = _PART.fullmatch(name.strip())
    array = None if match is None else arrays.get(match[1])
    if match is None or array is None:
        return None
    words = [word.strip() for word in match[2].split(",")]
    if len(words) != array.ndim or ":" not in words:
        return None
    index: list[Any] = []
    for word, length in zip(words, array.shape, strict=True):
        if word == ":":
            index.append(slice(None))
        elif re.fullmatch(r"-?\d{1,9}", word) and -length <= int(word) < length:
            index.append(int(word))
        else:
            return None
    return np.ascontiguousarray(np.ravel(array[tuple(index)], order="F"))


@dataclass
class Variables:
    """Collected columns and refusals of a file.

    A vector is a column. The samples of a matrix run along its longest axis, the first of equal axes. The remaining
    axes number the columns: ``y_1``, ``y_2`` or, for three axes, ``H_1_2``. A struct array is numbered likewise:
    ``run_2.y``.
    """

    columns: dict[str, NDArray[Any]] = field(default_factory=dict)
    refused: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    meta: dict[str, Any] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    gappy: dict[str, NDArray[Any]] = field(default_factory=dict)
    arrays: dict[str, NDArray[Any]] = field(default_factory=dict)
    aliases: dict[str, str] = field(default_factory=dict)

    @classmethod
    def of_answer(cls, answer: Mapping[str, Any], path: Path) -> "Variables":
        """Return the variables that an isolated reader found.

        Parameters
        ----------
        answer : mapping
            Answer of `vlab.recordings.isolated.read_isolated`: variables, notes and units.
        path : Path
            Path of the file, for messages.

        Returns
        -------
        Variables
            Columns and refusals, without the metadata of the file.

        Raises
        ------
        BadRecording
            The file has too many variables.
        """
        found = cls(notes=list(answer["notes"]), units=dict(answer["units"]))
        try:
            for name, value in answer["variables"]:
                found.add(one_line(name), value)
        except Damaged as error:
            raise refuse(path, str(error), fix="the file is damaged; copy or export it again") from error
        return found

    def add(self, name: str, value: Any) -> None:
        """Add a value under its name.

        The value is an array, a text, a dict of fields, a list of cells or `Skipped`.

        Parameters
        ----------
        name : str
            Name of the variable.
        value : object
            Value of the variable.

        Raises
        ------
        Damaged
            The file has too many variables.
        """
        if len(self.columns) + len(self.refused) > MAX_COLUMNS:
            raise Damaged(f"more than {MAX_COLUMNS} variables")
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
        elif isinstance(value, Skipped):
            self.refused[name] = f"it is {value.what}"
            self.notes.append(f"{name}: {value.what} skipped")
        else:
            self._array(name, value)

    def table(self, path: Path, columns: Sequence[str] | None, blanks: Collection[str] = frozenset()) -> Table:
        """Return the table of requested columns.

        Parameters
        ----------
        path : Path
            Path of the file, for messages.
        columns : sequence of str or None
            Columns to keep; all if none matches. ``y[:, 0]`` names a part of an array, see `part_of`.
        blanks : collection of str
            Columns that may hold NaN.

        Returns
        -------
        Table
            Table.
        """
        for name in columns or ():
            if (
                name not in self.columns
                and name not in self.refused
                and (found := part_of(name, self.arrays)) is not None
            ):
                self._array(name, found)
        other = {self.aliases.get(name, name) for name in blanks}
        for name in [name for name in self.gappy if name in blanks or name in other]:
            self.columns[name] = self.gappy[name]
            del self.refused[name]
        wanted = None if columns is None else {self.aliases.get(name, name) for name in columns}
        chosen = self.columns if wanted is None else {k: v for k, v in self.columns.items() if k in wanted}
        kept = chosen or self.columns
        return Table(
            path=path,
            columns=kept,
            refused=self.refused,
            notes=tuple(self.notes),
            meta=self.meta,
            units={name: unit for name, unit in self.units.items() if name in kept},
            blanks=frozenset(name for name in kept if name in self.gappy),
            aliases=self.aliases,
        )

    def _group(self, name: str, what: str, parts: dict[str, Any]) -> None:
        self.refused[name] = (
            f"it is {what}; name what is in it, such as {next(iter(parts))!r}"
            if parts
            else f"it is {what} with nothing in it"
        )
        for key, part in parts.items():
            if name in self.units:
                self.units[key] = self.units[name]
            self.add(key, part)

    def _array(self, name: str, raw: NDArray[Any]) -> None:
        value = to_float(raw if raw.ndim else raw.reshape(1))
        if isinstance(value, str):
            self.refused[name] = value
            return
        if value.ndim > 1:
            self.arrays[name] = value
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
                if not np.isinf(value).any():
                    self.gappy[name] = np.ascontiguousarray(table.reshape(-1))
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
