"""Text recordings: strict reader, and vlab's own labelled form.

A file has optional title lines and comments, one header line with names, an optional line of units, and then numbers only.
Commas, semicolons, tabs, bars or blanks separate the cells. A column may hold time stamps as text. A name may end with its
unit in brackets. Between other delimiters than commas a comma is a decimal sign if no number has a point.

pyarrow reads an ordinary file fast. A file that pyarrow refuses is read again line by line; the slow reader accepts
complex numbers and locates the fault.
"""

import math
import re
from array import array
from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute
import pyarrow.csv
from numpy.typing import NDArray

from vlab.errors import BadRecording
from vlab.files.text import one_line
from vlab.recordings.files import refuse
from vlab.recordings.formats.blanks import tabbed
from vlab.recordings.formats.cells import DECIMAL_COMMA, cut_line, parse_number
from vlab.recordings.formats.csv_head import SAME_COLUMNS, Layout, check_names, is_unit, layout_of, stated_units
from vlab.recordings.formats.csv_labels import SIGNATURE, read_labels
from vlab.recordings.formats.faults import WITHOUT_THOUSANDS, footer, has_thousands, pointed_thousands
from vlab.recordings.formats.list_cells import expanded
from vlab.recordings.formats.text_stamps import lines_of, read_stamps
from vlab.recordings.stamps import FORM, is_stamp, is_timelike
from vlab.recordings.table import (
    EVERY,
    Table,
    unknown_column,
)

BLANK_WORDS = ["", "NaN", "nan", "NAN", "NA", "N/A", "null", "NULL", "None"]
"""BLANK_WORDS: contents of a cell without a reading."""
_LOOKED_AT = 2**16  # bytes that show the line ends
_BRACKETED = re.compile(r".*\S(\s*)[\[(]([^\[\]()]+)[\])]")


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
    data, notes = _plain_text(data, path)
    layout = layout_of(data, path, names, is_lenient=bool(blanks))
    data, repeated = _without_repeats(data, layout)
    notes = (*notes, *layout.notes, *repeated)
    is_ours = names is None and bool(layout.comments) and layout.comments[0].startswith(SIGNATURE)
    labels = read_labels(layout.comments, layout.names, path) if is_ours else None
    if labels is not None:
        layout = replace(layout, names=("time", *(channel.name for channel in labels.channels)))
        check_names(layout.names, path)
    for name in columns or ():
        if name not in layout.names:
            raise unknown_column(name, layout.names, path)
    if columns is not None:
        layout = replace(layout, keep=tuple(i for i in layout.keep if layout.names[i] in columns))
    layout = replace(layout, blank=frozenset(i for i in layout.keep if layout.names[i] in blanks))
    if _has_decimal_commas(data, layout):
        body = data[layout.offset :]
        if pointed := pointed_thousands(body):
            line = layout.line + body[: body.find(pointed.encode())].count(b"\n")
            raise layout.fail(line, f"{pointed!r} has a point beside decimal commas", fix=WITHOUT_THOUSANDS)
        body = body.replace(b",", b".")
        data, notes = data[: layout.offset] + body, (*notes, "commas are read as decimal signs")
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


def _plain_text(data: bytes, path: Path) -> tuple[bytes, tuple[str, ...]]:
    """Return a file as UTF-8 text with tabs in place of blanks, and remarks."""
    notes: tuple[str, ...] = ()
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        try:
            data, notes = data.decode("utf-16").encode(), ("UTF-16 text",)
        except UnicodeDecodeError as error:
            raise refuse(path, f"not UTF-16 text: {error}", fix="export it as UTF-8 text") from error
    if b"\0" in data[:4096]:
        raise refuse(path, "not a UTF-8 text file", fix="export it as plain CSV text")
    if b"\r" in data[:_LOOKED_AT] and b"\n" not in data[:_LOOKED_AT]:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    data, expansions = expanded(data, path)
    return tabbed(data), (*notes, *expansions)


def _without_repeats(data: bytes, layout: Layout) -> tuple[bytes, tuple[str, ...]]:
    """Return the file with comments in place of repeated headers, and remarks."""
    header = {line.encode() for line in layout.header}
    if not any(data.find(b"\n" + line, layout.offset) >= 0 for line in header):
        return data, ()
    out, blank, count, is_header = [data[: layout.offset]], list[bytes](), 0, False
    for _, raw in lines_of(data, layout.path, layout.offset):
        bare = raw.strip()
        if not bare:
            blank.append(raw)
            continue
        was_header, is_header = is_header, bare in header
        out += [b"#\n"] * len(blank) if was_header or is_header else blank
        out.append(b"#\n" if is_header else raw)
        blank, count = [], count + (is_header and not was_header)
    notes = (f"the header is repeated {count} time{'s' if count > 1 else ''} between the numbers",) if count else ()
    return b"".join([*out, *blank]), notes


def _each(data: bytes, layout: Layout, notes: tuple[str, ...]) -> Table:
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


def _stated_units(layout: Layout) -> dict[str, str]:
    """Return the units in the file, by column.

    The units are on a line of their own, or in brackets behind the names.
    """
    seconds = {layout.names[i]: "s" for i in layout.keep if i in layout.stamps}
    if layout.units:
        return stated_units(layout, {i: layout.names[i] for i in layout.keep}) | seconds
    found = {layout.names[i]: _BRACKETED.fullmatch(layout.names[i].strip()) for i in layout.keep}
    stated = {name: (match[1], match[2].strip()) for name, match in found.items() if match is not None}
    # q[0] and position[elbow] are elements
    return {n: u for n, (gap, u) in stated.items() if is_unit(u) or (gap and not u.isdecimal())} | seconds


def _on_stamps(layout: Layout) -> list[str]:
    """Return remarks on columns of time stamps."""
    read = [i for i in layout.keep if i in layout.stamps]
    return [f"{layout.names[i]}: time stamps from {layout.stamps[i]} on are read in seconds" for i in read]


def _has_decimal_commas(data: bytes, layout: Layout) -> bool:
    """Return whether numbers use decimal commas.

    The first line of numbers must contain commas, no point, and another delimiter.
    """
    if layout.delimiter == ",":
        return False
    end = data.find(b"\n", layout.offset)
    text = data[layout.offset : end if end >= 0 else len(data)].decode("utf-8", errors="replace")
    cells = [cell.strip() for cell in text.split(layout.delimiter)]
    cells = [cell for cell in cells if not is_stamp(cell.strip('"'))]
    cells = [cell for cell in cells if not has_thousands(cell, "")]
    return "." not in "".join(cells) and any(DECIMAL_COMMA.fullmatch(cell) for cell in cells)


# ------------------------------------------------------------------------------------------------------ the numbers


def _values(data: bytes, layout: Layout) -> list[NDArray[Any]]:
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


def _fast(data: bytes, layout: Layout) -> list[NDArray[Any]] | None:
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


def _slow(data: bytes, layout: Layout) -> list[NDArray[Any]]:
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
        is_last = offset + len(raw) == len(data) and not raw.endswith(b"\n")
        try:
            if blank:
                what = "an empty line between the numbers"
                raise layout.fail(blank, what, fix="the file is damaged or was written twice")
            numbers = _row(layout, number, text, is_last=is_last)
        except BadRecording as error:
            at_end = _footer_fault(data, layout, (offset, number))
            if at_end is not None:
                raise at_end from error
            raise
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


def _row(layout: Layout, line: int, text: str, *, is_last: bool) -> list[complex]:
    """Return the numbers of a line, or raise with its fault."""
    cells = cut_line(text, layout.delimiter, layout.path, line)
    if len(cells) != layout.width:
        raise _ragged(layout, line, text, len(cells), is_last=is_last)
    if layout.width > len(layout.names) and cells[-1]:
        raise layout.fail(line, f"{layout.width} cells for {len(layout.names)} names")
    return [_cell(layout, line, i, cells[i], is_last) for i in layout.keep]


def _footer_fault(data: bytes, layout: Layout, at: tuple[int, int]) -> BadRecording | None:
    """Return the error for text after the numbers, or None.

    Parameters
    ----------
    data : bytes
        Bytes of the file.
    layout : Layout
        Head of the file.
    at : tuple of (int, int)
        Offset and number of the first odd line.
    """
    rest = enumerate(lines_of(data, layout.path, at[0]), start=at[1])
    first = next(lines_of(data, layout.path, layout.offset))[1]
    lines = [(layout.line, first), *((number, raw) for number, (_, raw) in rest)]
    found = footer([(number, raw.decode("utf-8", errors="replace")) for number, raw in lines], layout.delimiter)
    if found is None:
        return None
    what = f"text after the numbers: {one_line(found.text, longest=60)!r}"
    return layout.fail(found.first, what, fix=f"delete line{'' if found.is_single else 's'} {found.lines}")


def _plain_row(raw: bytes, delimiter: bytes, layout: Layout) -> list[float]:
    """Return the row of an ordinary line, or nothing."""
    try:
        row = [float(cell) for cell in raw.split(delimiter)]
    except ValueError:
        return []
    fits = len(row) == layout.width == len(layout.keep) and b"_" not in raw and math.isfinite(sum(row))
    return row if fits else []


def _cell(layout: Layout, line: int, index: int, cell: str, is_last: bool) -> complex:
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
        elif is_timelike(cell):
            fix = f"write times in seconds, or as {FORM}"
        elif has_thousands(cell, ""):
            fix = WITHOUT_THOUSANDS
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


def _ragged(layout: Layout, line: int, text: str, cells: int, *, is_last: bool) -> BadRecording:
    if is_last and cells < layout.width:
        return layout.fail(
            line,
            f"the file is truncated: {cells} of {layout.width} cells and no line end",
            fix="copy or export it again",
        )
    return layout.fail(
        line,
        f"{cells} cells where {layout.width} are expected",
        fix=WITHOUT_THOUSANDS if cells > layout.width and has_thousands(text, layout.delimiter) else SAME_COLUMNS,
    )
