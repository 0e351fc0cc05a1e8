"""CSV recordings: strict reader, and vlab's own labelled form.

A file has optional title lines, one header line with names, an optional line of units, and then numbers only. Lines
starting with ``#`` are comments. A column may hold time stamps as text. A name may end with its unit in brackets. Between semicolons or tabs a comma is a
decimal sign if no number has a point.

pyarrow reads an ordinary file fast. A file that pyarrow refuses is read again line by line; the slow reader accepts
complex numbers and locates the fault.
"""

import math
import re
from array import array
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute
import pyarrow.csv
from numpy.typing import NDArray

from vlab import units as known_units
from vlab.errors import BadRecording
from vlab.recordings.files import refuse
from vlab.recordings.formats.cells import cut_line, parse_number
from vlab.recordings.formats.csv_labels import SIGNATURE, read_labels
from vlab.recordings.formats.text_stamps import lines_of, read_stamps
from vlab.recordings.stamps import is_stamp
from vlab.recordings.table import (
    EVERY,
    MAX_COLUMNS,
    Table,
    unknown_column,
)

_LONGEST_PREAMBLE = 2 * MAX_COLUMNS
_MOST_TITLES = 100
BLANK_WORDS = ["", "NaN", "nan", "NAN", "NA", "N/A", "null", "NULL", "None"]
"""BLANK_WORDS: contents of a cell without a reading."""
_BRACKETED = re.compile(r".*\S\s*[\[(]([^\[\]()]+)[\])]")
_DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+([eE][+-]?\d+)?")


@dataclass(frozen=True, kw_only=True)
class _Layout:
    """Start of the numbers and form of the lines."""

    path: Path
    delimiter: str
    names: tuple[str, ...]
    width: int  # cells of a line; one more than names if every line ends with a delimiter
    keep: tuple[int, ...]  # columns to read
    offset: int  # byte offset of the first line of numbers
    line: int  # line number, from 1
    comments: tuple[str, ...]
    units: tuple[str, ...] = ()  # units by column, from a line of their own
    titles: int = 0  # lines before the header
    blank: frozenset[int] = frozenset()  # columns that may have blank cells
    stamps: Mapping[int, str] = field(default_factory=dict)  # columns of time stamps, with the first one

    def fail(self, line: int, what: str, *, fix: str = "") -> BadRecording:
        return refuse(self.path, f"line {line}: {what}", fix=fix)

    def column(self, index: int) -> str:
        return f"column {index + 1} ({self.names[index]!r})" if index < len(self.names) else f"column {index + 1}"


def read(
    data: bytes,
    path: Path,
    *,
    names: Sequence[str] | None = None,
    columns: Sequence[str] | None = None,
    blanks: Collection[str] = frozenset(),
) -> Table:
    """Read a CSV file, see `vlab.recordings.open_table`.

    Parameters
    ----------
    data : bytes
        Bytes of the file.
    path : Path
        Path of the file, for messages.
    names : sequence of str or None
        Column names of a file without names, or in place of its names.
    columns : sequence of str or None
        Columns to read; all by default.
    blanks : collection of str
        Columns that may have blank cells or NaN.

    Returns
    -------
    Table
        Columns, notes and units.

    Raises
    ------
    BadRecording
        The file is damaged, truncated or not numeric.
    """
    if data.startswith((b"\xff\xfe", b"\xfe\xff")) or b"\0" in data[:4096]:
        raise refuse(path, "not a UTF-8 text file", fix="export it as plain CSV text")
    layout = _layout(data, path, names, is_lenient=bool(blanks))
    is_ours = names is None and bool(layout.comments) and layout.comments[0].startswith(SIGNATURE)
    labels = read_labels(layout.comments, layout.names, path) if is_ours else None
    if labels is not None:
        layout = replace(layout, names=("time", *(channel.name for channel in labels.channels)))
        _check_names(layout.names, len(layout.names), path)
    for name in columns or ():
        if name not in layout.names:
            raise unknown_column(name, layout.names, path)
    if columns is not None:
        layout = replace(layout, keep=tuple(i for i in layout.keep if layout.names[i] in columns))
    layout = replace(layout, blank=frozenset(i for i in layout.keep if layout.names[i] in blanks))
    notes: tuple[str, ...] = ()
    if _has_decimal_commas(data, layout):
        body = data[layout.offset :].replace(b",", b".")
        data, notes = data[: layout.offset] + body, ("commas are read as decimal signs",)
    if blanks is EVERY and labels is None:
        return _each(data, layout, notes)
    values = _values(data, layout)
    found = {layout.names[i]: v for i, v in zip(layout.keep, values, strict=True)}
    notes = (*notes, *_on_stamps(layout))
    is_whole = data.endswith((b"\n", b"\r"))
    if labels is None:
        if layout.titles:
            notes = (*notes, f"{layout.titles} line{'s' if layout.titles > 1 else ''} before the header not read")
        if not is_whole:
            notes = (*notes, "the last line has no line end: its last number may be cut short")
        gappy = frozenset(layout.names[i] for i in layout.blank)
        return Table(path=path, columns=found, notes=notes, units=_stated_units(layout), blanks=gappy)
    if not is_whole or labels.samples != str(values[0].size):
        raise refuse(
            path, f"the file is truncated: {values[0].size} of {labels.samples} samples", fix="copy or export it again"
        )
    if any(np.iscomplexobj(column) for column in values):
        raise refuse(path, "a complex number among the samples of a recording", fix="the file was edited or is damaged")
    return Table(
        path=path, columns=found, meta=labels.meta, channels=tuple(c for c in labels.channels if c.name in found)
    )


def _each(data: bytes, layout: _Layout, notes: tuple[str, ...]) -> Table:
    """Return the columns of numbers, and the others' reasons."""
    found: dict[str, NDArray[Any]] = {}
    refused: dict[str, str] = {}
    try:
        values = _values(data, layout)
        found = {layout.names[i]: v for i, v in zip(layout.keep, values, strict=True)}
    except BadRecording:
        for i in layout.keep:
            one = replace(layout, keep=(i,), blank=frozenset({i}))
            try:
                found[layout.names[i]] = _values(data, one)[0]
            except BadRecording as error:
                refused[layout.names[i]] = str(error).removeprefix(f"{layout.path}: ")
    return Table(
        path=layout.path,
        columns=found,
        refused=refused,
        notes=(*notes, *_on_stamps(replace(layout, keep=tuple(i for i in layout.keep if layout.names[i] in found)))),
        units=_stated_units(layout),
        blanks=frozenset(found),
    )


# ---------------------------------------------------------------------------------------------- the shape of a file


def _layout(data: bytes, path: Path, names: Sequence[str] | None, *, is_lenient: bool = False) -> _Layout:
    """Find comments, delimiter, header and first numbers.

    A lenient search takes blank cells beside numbers for numbers.
    """
    comments, content = [], []
    for number, (offset, raw) in enumerate(lines_of(data, path), start=1):
        if number > _LONGEST_PREAMBLE:
            raise refuse(path, f"no numbers in the first {_LONGEST_PREAMBLE} lines", fix="check what was exported")
        try:
            text = raw.decode("utf-8-sig" if number == 1 else "utf-8").strip("\r\n")
        except UnicodeDecodeError as error:
            raise refuse(path, f"line {number} is not UTF-8 text: {error}", fix="export it as UTF-8 text") from error
        if text.lstrip().startswith("#"):
            comments.append(text.strip()[1:].strip())
        elif text.strip(" \t"):
            content.append((number, offset, text))
            if len(content) == _MOST_TITLES or _is_all_numbers(text, is_lenient=is_lenient):
                break
    if not content:
        raise refuse(path, "no numbers in the file", fix="check what was exported")
    titles, units = _above_numbers(content, is_lenient=is_lenient)
    content = content[titles:]
    delimiter = _delimiter(content[min(1, len(content) - 1)][2])
    number, offset, text = content[0]
    cells = cut_line(text, delimiter, path, number)
    width, trailing = len(cells), len(cells) > 1 and not cells[-1]
    cells = cells[:-1] if trailing else cells
    numeric = [_is_number(cell, delimiter) for cell in cells]
    stamps = {i: cell for i, cell in enumerate(cells) if is_stamp(cell)}
    fits = [is_one or i in stamps or (is_lenient and not cells[i]) for i, is_one in enumerate(numeric)]
    if any(numeric) and not all(fits):
        bad = cells[fits.index(False)]
        raise refuse(
            path,
            f"line {number} is neither a header nor numbers: {bad!r} beside numbers",
            fix="give every column a name that is not a number",
        )
    if not any(numeric):
        if len(content) < 2:
            raise refuse(
                path,
                f"a header in line {number} and no numbers after it",
                fix="the file is truncated or the export was empty",
            )
        header = cells
        number, offset, text = content[2 if units else 1]
        stamps = {i: cell for i, cell in enumerate(cut_line(text, delimiter, path, number)) if is_stamp(cell)}
    else:
        header = _commented_names(comments, delimiter, len(cells)) or [f"c{i + 1}" for i in range(len(cells))]
    chosen = tuple(header if names is None else names)
    _check_names(chosen, len(cells), path)
    keep = tuple(range(len(chosen)))
    return _Layout(
        path=path,
        delimiter=delimiter,
        names=chosen,
        width=width,
        keep=keep,
        offset=offset,
        line=number,
        comments=tuple(comments),
        units=units[: len(chosen)],
        titles=titles,
        stamps=stamps,
    )


def _delimiter(text: str) -> str:
    return next((sign for sign in ";\t," if sign in text), ",")


def _cells(text: str, delimiter: str) -> list[str]:
    """Return the cells of a line of unknown layout.

    A delimiter at the end of the line ends the last cell.
    """
    cells = [cell.strip() for cell in text.split(delimiter)]
    return cells[:-1] if len(cells) > 1 and not cells[-1] else cells


def _is_all_numbers(text: str, *, is_lenient: bool) -> bool:
    delimiter = _delimiter(text)
    cells = _cells(text, delimiter)
    fits = [_is_number(c, delimiter) or is_stamp(c.strip('"')) or (is_lenient and not c) for c in cells]
    return all(fits) and any(_is_number(cell, delimiter) for cell in cells)  # a stamp alone is a title


def _above_numbers(content: list[tuple[int, int, str]], *, is_lenient: bool) -> tuple[int, tuple[str, ...]]:
    """Return the number of title lines and the units.

    The header follows the titles and has as many names as a line has numbers. The units, if any, are on the line after
    the header.
    """
    text = content[-1][2]
    if len(content) < 3 or not _is_all_numbers(text, is_lenient=is_lenient):
        return 0, ()
    delimiter = _delimiter(text)
    count = len(_cells(text, delimiter))
    above = [_cells(line, delimiter) for _, _, line in content[:-1]]
    if is_lenient and len(above[-1]) == text.count(delimiter) + 1:
        count = len(above[-1])  # the last cell is blank, and no delimiter too many
    if len(above[-1]) != count or any(_is_number(cell, delimiter) for cell in above[-1]):
        return 0, ()  # no header fits: the message refers to the first lines
    is_units = len(above[-2]) == count and all(_is_unit(cell) for cell in above[-1])
    return len(above) - (2 if is_units else 1), tuple(above[-1]) if is_units else ()


def _is_unit(cell: str) -> bool:
    bare = cell.strip("[]() ")
    return bare in ("", "-") or known_units.same_dimension(bare, bare)


def _is_number(cell: str, delimiter: str) -> bool:
    return parse_number(cell) is not None or (delimiter != "," and bool(_DECIMAL_COMMA.fullmatch(cell)))


def _stated_units(layout: _Layout) -> dict[str, str]:
    """Return the units in the file, by column.

    The units are on a line of their own, or in brackets behind the names.
    """
    seconds = {layout.names[i]: "s" for i in layout.keep if i in layout.stamps}
    if layout.units:
        return {layout.names[i]: layout.units[i].strip("[]() ") for i in layout.keep} | seconds
    found = {layout.names[i]: _BRACKETED.fullmatch(layout.names[i].strip()) for i in layout.keep}
    return {name: match[1].strip() for name, match in found.items() if match is not None} | seconds


def _on_stamps(layout: _Layout) -> list[str]:
    """Return remarks on columns of time stamps."""
    read = [i for i in layout.keep if i in layout.stamps]
    return [f"{layout.names[i]}: time stamps from {layout.stamps[i]} on are read in seconds" for i in read]


def _has_decimal_commas(data: bytes, layout: _Layout) -> bool:
    """Return whether numbers use decimal commas.

    The first line of numbers must contain commas, no point, and another delimiter.
    """
    if layout.delimiter == ",":
        return False
    end = data.find(b"\n", layout.offset)
    text = data[layout.offset : end if end >= 0 else len(data)].decode("utf-8", errors="replace")
    cells = [cell.strip() for cell in text.split(layout.delimiter)]
    cells = [cell for cell in cells if not is_stamp(cell.strip('"'))]
    return "." not in "".join(cells) and any(_DECIMAL_COMMA.fullmatch(cell) for cell in cells)


def _commented_names(comments: list[str], delimiter: str, n_columns: int) -> list[str]:
    """Return the names in the last comment before the numbers.

    numpy.savetxt writes names in such a comment.
    """
    cells = [cell.strip() for cell in comments[-1].split(delimiter)] if comments else []
    fits = (
        1 < len(cells) == n_columns == len(set(cells))
        and all(cells)
        and all(parse_number(cell) is None for cell in cells)
    )
    return cells if fits else []


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


# ------------------------------------------------------------------------------------------------------ the numbers


def _values(data: bytes, layout: _Layout) -> list[NDArray[Any]]:
    """Return the columns to read; time stamps in seconds."""
    plain = replace(layout, keep=tuple(i for i in layout.keep if i not in layout.stamps))
    numbers = _fast(data, plain) or _slow(data, plain) if plain.keep else []
    found = dict(zip(plain.keep, numbers, strict=True))
    for is_blank in (False, True):
        some = {i: layout.column(i) for i in layout.stamps if i in layout.keep and (i in layout.blank) == is_blank}
        if some:
            first, blanks = (layout.offset, layout.line), BLANK_WORDS if is_blank else []
            found |= read_stamps(data, layout.path, first, layout.delimiter, some, starts=layout.stamps, blanks=blanks)
    return [found[i] for i in layout.keep]


def _fast(data: bytes, layout: _Layout) -> list[NDArray[Any]] | None:
    """Read real numbers with pyarrow.

    None leaves the decision to the slow reader.
    """
    body = memoryview(data)[layout.offset :]
    has_signs = any(data.find(sign, layout.offset) >= 0 for sign in (b"#", b'"'))
    has_lone_returns = data.count(b"\r") != data.count(b"\r\n")
    if has_signs or has_lone_returns:
        return None
    end = len(body)
    while end and body[end - 1] in b" \t\r\n":
        end -= 1
    labels = [str(i) for i in range(layout.width)]
    keep = [labels[i] for i in layout.keep]
    unnamed = labels[len(layout.names) :]  # of delimiters at the ends of the lines
    try:
        table = pa.csv.read_csv(
            pa.BufferReader(pa.py_buffer(body[:end])),
            read_options=pa.csv.ReadOptions(column_names=labels, use_threads=False),
            parse_options=pa.csv.ParseOptions(delimiter=layout.delimiter, quote_char=False, ignore_empty_lines=False),
            convert_options=pa.csv.ConvertOptions(
                column_types={**{k: pa.float64() for k in keep}, **{k: pa.string() for k in unnamed}},
                include_columns=[*keep, *unnamed],
                null_values=BLANK_WORDS if layout.blank else [],
            ),
        )
    except (pa.ArrowException, ValueError):  # the slow reader locates the fault
        return None
    if any(pa.compute.any(pa.compute.not_equal(table.column(name), "")).as_py() for name in unnamed):
        return None
    values = [table.column(name).to_numpy() for name in keep]
    fine = [~np.isinf(v) if i in layout.blank else np.isfinite(v) for i, v in zip(layout.keep, values, strict=True)]
    return values if all(f.all() for f in fine) else None


def _slow(data: bytes, layout: _Layout) -> list[NDArray[Any]]:
    """Read line by line and locate the first fault."""
    real, imaginary = array("d"), array("d")
    delimiter, blank = layout.delimiter.encode(), 0
    for number, (offset, raw) in enumerate(lines_of(data, layout.path, layout.offset), start=layout.line):
        row = [] if blank or imaginary else _plain_row(raw, delimiter, layout)
        if row:
            real.extend(row)
            continue
        text = raw.decode("utf-8", errors="replace").strip("\r\n")
        if not text.strip():
            blank = blank or number
            continue
        if text.lstrip().startswith("#"):
            continue
        if blank:
            raise layout.fail(
                blank, "an empty line between the numbers", fix="the file is damaged or was written twice"
            )
        is_last = offset + len(raw) == len(data) and not raw.endswith(b"\n")
        cells = cut_line(text, layout.delimiter, layout.path, number)
        if len(cells) != layout.width:
            raise _ragged(layout, number, len(cells), is_last)
        if layout.width > len(layout.names) and cells[-1]:
            raise layout.fail(number, f"{layout.width} cells for {len(layout.names)} names")
        numbers = [_cell(layout, number, i, cells[i], is_last) for i in layout.keep]
        if not imaginary and any(isinstance(value, complex) for value in numbers):
            imaginary = array("d", bytes(8 * len(real)))
        real.extend(value.real for value in numbers)
        if imaginary or any(isinstance(value, complex) for value in numbers):
            imaginary.extend(value.imag for value in numbers)
    table = np.frombuffer(real, dtype=float).reshape(-1, len(layout.keep))
    if not imaginary:
        return list(table.T.copy())
    both = np.empty(table.shape, dtype=complex)
    both.real, both.imag = table, np.frombuffer(imaginary, dtype=float).reshape(table.shape)
    return [column.copy() if column.imag.any() else column.real.copy() for column in both.T]


def _plain_row(raw: bytes, delimiter: bytes, layout: _Layout) -> list[float]:
    """Return the row of an ordinary line, or nothing."""
    try:
        row = [float(cell) for cell in raw.split(delimiter)]
    except ValueError:
        return []
    fits = len(row) == layout.width == len(layout.keep) and b"_" not in raw and math.isfinite(sum(row))
    return row if fits else []


def _cell(layout: _Layout, line: int, index: int, cell: str, is_last: bool) -> complex:
    """Return the number in a cell, or raise with its fault."""
    value = parse_number(cell)
    where = layout.column(index)
    if index in layout.blank and (cell in BLANK_WORDS or (value is not None and math.isnan(value.real))):
        return math.nan
    if value is None and is_last and index == layout.width - 1:
        raise layout.fail(
            line, f"the file is truncated: {where} is {cell!r} and the line does not end", fix="copy or export it again"
        )
    if value is None and not cell:
        raise layout.fail(
            line,
            f"{where} is empty",
            fix="cut the gap, or name another column; columns that no channel names are not read",
        )
    if value is None:
        fix = "lines after the header hold numbers only"
        if is_stamp(cell):
            fix = "write time stamps in every line, or numbers"
        elif re.fullmatch(r"[+-]?\d+,\d+", cell):
            fix = "use a point as the decimal sign"
        elif len(cell.split()) > 1:
            fix = "separate the columns by comma, semicolon or tab"
        raise layout.fail(line, f"{where} is {cell[:60]!r}, not a number", fix=fix)
    if not (math.isfinite(value.real) and math.isfinite(value.imag)):
        raise layout.fail(
            line,
            f"{where} is {'NaN' if 'nan' in cell.lower() else 'infinite'} ({cell!r})",
            fix="cut the gap out of the recording",
        )
    return value


def _ragged(layout: _Layout, line: int, cells: int, is_last: bool) -> BadRecording:
    if is_last and cells < layout.width:
        return layout.fail(
            line,
            f"the file is truncated: {cells} of {layout.width} cells and no line end",
            fix="copy or export it again",
        )
    return layout.fail(
        line,
        f"{cells} cells where {layout.width} are expected",
        fix="every line needs the same columns; check the delimiter",
    )
