"""Head of a text file: titles, comments, names and units above the numbers."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from vlab import units as known_units
from vlab.errors import BadRecording
from vlab.recordings.files import refuse
from vlab.recordings.formats.cells import cut_line, is_number, parse_number
from vlab.recordings.formats.faults import WITHOUT_THOUSANDS, has_thousands
from vlab.recordings.formats.text_stamps import lines_of
from vlab.recordings.stamps import is_stamp
from vlab.recordings.table import MAX_COLUMNS

COMMENTS = ("#", "%", "//", "!")
"""COMMENTS: beginnings of a line of comment above the numbers; below, only the first begins a comment."""
DELIMITERS = ";\t,|"
"""DELIMITERS: accepted delimiters, in the order in which a line of numbers is tried."""
LONGEST_PREAMBLE = 2 * MAX_COLUMNS
"""LONGEST_PREAMBLE [1]: largest number of lines above the numbers."""
SAME_COLUMNS = "every line needs the same columns; check the delimiter"
"""SAME_COLUMNS: advice on lines of unequal length."""
_MOST_TITLES = 100
_READINGS = {"counts", "count", "ticks", "tick", "raw", "lsb", "steps", "pulses"}  # units of converters and encoders
_NO_UNITS = {"none", "n/a", "na", "a.u.", "au"}
_LETTERS = set("smgNVAWJKCh%°-")  # any other single letter is more often a name than a unit
_TYPES = {"double", "single", "float", "int", "bool", "boolean", "datetime", "duration", "string", "number"}
_TYPES |= {"float16", "float32", "float64", "uint8", "uint16", "uint32", "uint64", "int8", "int16", "int32", "int64"}


@dataclass(frozen=True, kw_only=True)
class Layout:
    """Start of the numbers and form of the lines.

    Parameters
    ----------
    path : Path
        File.
    delimiter : str
        Delimiter of the cells.
    names : tuple of str
        Names of the columns.
    width : int
        Cells of a line; one more than names if every line ends with a delimiter.
    keep : tuple of int
        Columns to read.
    offset, line : int
        Offset [bytes] and number of the first line of numbers, from 1.
    comments : tuple of str
        Comments without their signs.
    units : tuple of str
        Units by column, from a line of their own; empty without such a line.
    titles : int
        Lines that are neither names, units nor numbers.
    header : tuple of str
        Lines of names and units.
    blank : frozenset of int
        Columns that may have blank cells.
    stamps : mapping of int to str
        First time stamp of each column of time stamps.
    notes : tuple of str
        Remarks on the head.
    """

    path: Path
    delimiter: str
    names: tuple[str, ...]
    width: int
    keep: tuple[int, ...]
    offset: int
    line: int
    comments: tuple[str, ...]
    units: tuple[str, ...] = ()
    titles: int = 0
    header: tuple[str, ...] = ()
    blank: frozenset[int] = frozenset()
    stamps: Mapping[int, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def fail(self, line: int, what: str, *, fix: str = "") -> BadRecording:
        """Return the error of a line."""
        return refuse(self.path, f"line {line}: {what}", fix=fix)

    def column(self, index: int) -> str:
        """Return number and name of a column for messages."""
        return f"column {index + 1} ({self.names[index]!r})" if index < len(self.names) else f"column {index + 1}"


class _Line(NamedTuple):
    """Line of text above or at the first numbers."""

    number: int
    offset: int
    text: str


class _Head(NamedTuple):
    """Lines of the head: content, and comments with the number of content lines before each."""

    content: list[_Line]
    comments: list[tuple[int, str]]
    notes: tuple[str, ...]


def layout_of(data: bytes, path: Path, names: Sequence[str] | None, *, is_lenient: bool = False) -> Layout:
    """Find comments, delimiter, names, units and first numbers.

    Parameters
    ----------
    data : bytes
        Bytes of the file.
    path : Path
        Path of the file, for messages.
    names : sequence of str or None
        Names in place of the file's own.
    is_lenient : bool
        Whether blank cells beside numbers count as numbers.

    Returns
    -------
    Layout
        All columns.

    Raises
    ------
    BadRecording
        No numbers, or names that do not fit the numbers.
    """
    head = _head(data, path, is_lenient=is_lenient)
    content = head.content
    if not content:
        raise refuse(path, "no numbers in the file", fix="check what was exported")
    at = _first_numbers(content, path, is_lenient=is_lenient)
    number, offset, text = content[at]
    delimiter = delimiter_of(text, is_lenient=is_lenient)
    cells = cut_line(text, delimiter, path, number)
    counts = {len(cells), len(_stripped(cells))}
    rows = [_fitted(cut_line(line.text, delimiter, path, line.number), counts) for line in content[:at]]
    block = at
    while block and len(rows[block - 1]) in counts and not any(is_number(c, delimiter) for c in rows[block - 1]):
        block -= 1
    comments = [text for _, text in head.comments]
    titles = at
    if block < at:
        named, units = _names_and_units(rows[block:at])
        header, titles = rows[block + named], at - (2 if units else 1)
        below = [text for k, text in head.comments if k > block + named]
        units = units or _commented_units(below, delimiter, len(header))
    elif at and not (header := _commented(comments, delimiter, len(_stripped(cells)))[0]):
        last = content[at - 1]
        if any(is_number(cell, delimiter) for cell in rows[-1]):
            bad = next((cell for cell in rows[-1] if not is_number(cell, delimiter)), "")
            raise refuse(
                path,
                f"line {last.number} is neither a header nor numbers: {bad!r} beside numbers",
                fix="give every column a name that is not a number",
            )
        what = f"line {number}: {len(cells)} cells where {len(rows[-1])} are expected"
        is_cut = len(cells) > len(rows[-1]) and has_thousands(text, delimiter)
        raise refuse(path, what, fix=WITHOUT_THOUSANDS if is_cut else SAME_COLUMNS)
    else:
        count = len(_stripped(cells))
        header, units = _commented(comments, delimiter, count)
        header = header or [f"c{i + 1}" for i in range(count)]
    if header and not header[0]:
        header = ["c1", *header[1:]]  # the numbers of the rows, as data frames write them
    chosen = tuple(header if names is None else names)
    _check_names(chosen, len(header), path)
    return Layout(
        path=path,
        delimiter=delimiter,
        names=chosen,
        width=len(cells),
        keep=tuple(range(len(chosen))),
        offset=offset,
        line=number,
        comments=tuple(comments),
        units=units[: len(chosen)],
        titles=titles,
        header=tuple(line.text.strip() for line in content[block:at]),
        stamps={i: cell for i, cell in enumerate(cells) if is_stamp(cell)},
        notes=head.notes,
    )


def delimiter_of(text: str, *, is_lenient: bool = False) -> str:
    """Return the delimiter of a line of numbers.

    Parameters
    ----------
    text : str
        Line.
    is_lenient : bool
        Whether blank cells count as numbers.

    Returns
    -------
    str
        First of `DELIMITERS` between numbers, or else the first in the line.
    """
    there = [sign for sign in DELIMITERS if sign in text]
    fits = (sign for sign in there if _are_numbers(_cells(text, sign), sign, is_lenient=is_lenient))
    return next(fits, there[0] if there else ",")


def _head(data: bytes, path: Path, *, is_lenient: bool) -> _Head:
    """Return the lines down to the first line of numbers."""
    content: list[_Line] = []
    comments: list[tuple[int, str]] = []
    notes: tuple[str, ...] = ()
    for number, (offset, raw) in enumerate(lines_of(data, path), start=1):
        if number > LONGEST_PREAMBLE:
            raise refuse(path, f"no numbers in the first {LONGEST_PREAMBLE} lines", fix="check what was exported")
        try:
            text = raw.decode("utf-8-sig" if number == 1 else "utf-8").strip("\r\n")
        except UnicodeDecodeError as error:
            try:
                text = raw.decode("cp1252").strip("\r\n")
            except UnicodeDecodeError:
                what = f"line {number} is not UTF-8 text: {error}"
                raise refuse(path, what, fix="export it as UTF-8 text") from error
            notes = ("the head is not UTF-8 and is read as Windows-1252 text",)
        bare = text.lstrip()
        mark = next((mark for mark in COMMENTS if bare.startswith(mark)), "")
        if mark:
            comments.append((len(content), bare[len(mark) :].strip()))
        elif text.strip(f" {DELIMITERS}"):
            content.append(_Line(number, offset, text))
            delimiter = delimiter_of(text, is_lenient=is_lenient)
            is_numbers = _are_numbers(_cells(text, delimiter), delimiter, is_lenient=is_lenient)
            if len(content) == _MOST_TITLES or is_numbers:
                break
    return _Head(content, comments, notes)


def _first_numbers(content: Sequence[_Line], path: Path, *, is_lenient: bool) -> int:
    """Return the index of the first line of numbers."""
    last = content[-1].text
    delimiter = delimiter_of(last, is_lenient=is_lenient)
    if _are_numbers(_cells(last, delimiter), delimiter, is_lenient=is_lenient):
        return _below_names(content, delimiter)
    for at in range(1, len(content)):
        delimiter = delimiter_of(content[at].text)
        cells = _cells(content[at].text, delimiter)
        above = _fitted([cell.strip() for cell in content[at - 1].text.split(delimiter)], {len(cells)})
        is_named = len(above) == len(cells) and not any(is_number(cell, delimiter) for cell in above)
        if is_named and any(is_number(cell, delimiter) or is_stamp(cell) for cell in cells):
            return at
    delimiter = delimiter_of(content[0].text)
    cells = _cells(content[0].text, delimiter)
    if any(is_number(cell, delimiter) for cell in cells):
        bad = next(cell for cell in cells if not is_number(cell, delimiter))
        raise refuse(
            path,
            f"line {content[0].number} is neither a header nor numbers: {bad!r} beside numbers",
            fix="give every column a name that is not a number",
        )
    if len(content) < 2:
        what = f"a header in line {content[0].number} and no numbers after it"
        raise refuse(path, what, fix="the file is truncated or the export was empty")
    return 1


def _below_names(content: Sequence[_Line], delimiter: str) -> int:
    """Return the index of the first line below the names, or the last.

    Lines with words for blank cells may stand between the names and the first line of numbers only.
    """
    rows = [_cells(line.text, delimiter) for line in content]
    at = len(rows) - 1
    while at and len(rows[at - 1]) == len(rows[-1]) and any(is_number(cell, delimiter) for cell in rows[at - 1]):
        at -= 1
    return at if at and len(rows[at - 1]) == len(rows[at]) else len(rows) - 1


def _cells(text: str, delimiter: str) -> list[str]:
    """Return the cells of a line without quotes.

    A delimiter at the end of the line ends the last cell.
    """
    return _stripped([cell.strip().strip('"').strip() for cell in text.split(delimiter)])


def _stripped(cells: list[str]) -> list[str]:
    return cells[:-1] if len(cells) > 1 and not cells[-1] else cells


def _fitted(cells: list[str], counts: set[int]) -> list[str]:
    """Return the cells of a line, the last one blank if counted."""
    short = _stripped(cells)
    return cells if len(short) not in counts and len(cells) in counts else short


def _are_numbers(cells: Sequence[str], delimiter: str, *, is_lenient: bool) -> bool:
    fits = [is_number(c, delimiter) or is_stamp(c) or (is_lenient and not c) for c in cells]
    return all(fits) and any(is_number(cell, delimiter) for cell in cells)  # a stamp alone is a title


def _names_and_units(block: Sequence[Sequence[str]]) -> tuple[int, tuple[str, ...]]:
    """Return the row of names and the units in the lines right above the numbers.

    A row of units stands below the names, or above. A row of types or of equal words is no row of names.
    """
    for row in range(len(block) - 1, 0, -1):
        if _are_units(block[row]):
            return row - 1, tuple(block[row])
    if len(block) > 1 and _are_units(block[0]) and any(block[0]):
        return 1, tuple(block[0])
    named = [
        row
        for row, cells in enumerate(block)
        if len(set(cells)) == len(cells) and not all(cell.lower() in _TYPES for cell in cells)
    ]
    return (named[-1] if named else len(block) - 1), ()


def _are_units(cells: Sequence[str]) -> bool:
    return all(is_unit(cell) for cell in cells)


def is_unit(cell: str) -> bool:
    """Return whether a text is blank, a unit, or a word for readings without one."""
    bare = cell.strip("[]() ")
    if len(bare) < 2:
        return not bare or bare in _LETTERS
    return bare.lower() in _READINGS | _NO_UNITS or known_units.same_dimension(bare, bare)


def _commented(comments: Sequence[str], delimiter: str, count: int) -> tuple[list[str], tuple[str, ...]]:
    """Return names and units in the last comments before the numbers.

    numpy.savetxt writes names in such a comment.
    """
    units = _commented_units(comments, delimiter, count) if len(comments) > 1 else ()
    names = _commented_names(comments[:-1], delimiter, count) if units else []
    return (names, units) if names else (_commented_names(comments, delimiter, count), ())


def _commented_names(comments: Sequence[str], delimiter: str, count: int) -> list[str]:
    cells = [cell.strip().strip('"') for cell in comments[-1].split(delimiter)] if comments else []
    fits = (
        1 < len(cells) == count == len(set(cells)) and all(cells) and all(parse_number(cell) is None for cell in cells)
    )
    return cells if fits else []


def _commented_units(comments: Sequence[str], delimiter: str, count: int) -> tuple[str, ...]:
    cells = [cell.strip().strip('"') for cell in comments[-1].split(delimiter)] if comments else []
    return tuple(cells) if 1 < len(cells) == count and any(cells) and _are_units(cells) else ()


def stated_units(layout: Layout, names: Mapping[int, str]) -> dict[str, str]:
    """Return the units on a line of their own.

    Parameters
    ----------
    layout : Layout
        Head of the file.
    names : mapping of int to str
        Names of the columns.

    Returns
    -------
    dict of str to str
        Units by name; empty where the line says that there is none.
    """
    bare = {name: layout.units[i].strip("[]() ") for i, name in names.items()}
    return {name: "" if unit.lower() in _NO_UNITS else unit for name, unit in bare.items()}


def _check_names(names: tuple[str, ...], n_columns: int, path: Path) -> None:
    if len(names) != n_columns:
        raise refuse(path, f"{len(names)} names were given for {n_columns} columns")
    if n_columns > MAX_COLUMNS:
        raise refuse(
            path, f"{n_columns} columns; at most {MAX_COLUMNS} are read", fix="check the delimiter and the line ends"
        )
    for name, count in Counter(names).items():
        if not name or count > 1:
            what = f"the column name {name!r} stands {count} times" if name else "a column of the header has no name"
            raise refuse(path, what, fix="name each column once, in the file or with names")


def check_names(names: tuple[str, ...], path: Path) -> None:
    """Refuse names that repeat, are empty, or are too many.

    Parameters
    ----------
    names : tuple of str
        Names of the columns.
    path : Path
        Path of the file, for messages.

    Raises
    ------
    BadRecording
        A name is empty or repeats.
    """
    _check_names(names, len(names), path)
