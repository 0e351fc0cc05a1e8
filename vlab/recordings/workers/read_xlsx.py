"""Isolated reader of Excel workbooks: one sheet as text with tabs."""

import csv
import datetime
import io
import math
import zipfile
from typing import Any

import openpyxl
import openpyxl.worksheet._reader  # loaded while files can be opened

_MOST_COLUMNS = 10_000
_MOST_SHEETS = 100

# one small workbook through the library loads every module that reading needs
_made = io.BytesIO()
_book = openpyxl.Workbook()
_book.active.append(["a", 1.5])
_book.save(_made)
for _row in openpyxl.load_workbook(_made, read_only=True, data_only=True).active.iter_rows(values_only=True):
    pass


def read(data: bytes, options: dict[str, Any]) -> dict[str, Any]:
    """Return the first sheet with numbers as text.

    Parameters
    ----------
    data : bytes
        Bytes of the file.
    options : dict of str to object
        ``limit`` [bytes].

    Returns
    -------
    dict of str to object
        ``text`` with one line a row and tabs between cells, and ``notes``.

    Raises
    ------
    ValueError
        The file is no workbook, or too large.
    """
    try:
        unpacked = sum(info.file_size for info in zipfile.ZipFile(io.BytesIO(data)).infolist())
    except zipfile.BadZipFile as error:
        raise ValueError(f"not a whole workbook: {error}") from error
    if unpacked > options["limit"]:
        raise ValueError(f"{unpacked} bytes when unpacked; at most {options['limit']} are read")
    book = openpyxl.load_workbook(io.BytesIO(data), read_only=True, data_only=True, keep_links=False)
    sheets = book.worksheets[:_MOST_SHEETS]
    for i, sheet in enumerate(sheets):
        text = _text(sheet)
        if text:
            others = [other.title for k, other in enumerate(sheets) if k != i]
            said = f"sheet {sheet.title!r} is read" + (f", not {', '.join(map(repr, others))}" if others else "")
            return {"variables": [], "units": {}, "meta": {}, "notes": [said], "text": text}
    return {"variables": [], "units": {}, "meta": {}, "notes": [], "text": ""}


def _text(sheet: Any) -> str:
    """Return the rows of a sheet as text; empty without numbers."""
    sheet.reset_dimensions()  # the stated size may be wrong
    rows: list[list[str]] = []
    has_numbers = False
    for row in sheet.iter_rows(values_only=True):
        if len(row) > _MOST_COLUMNS:
            raise ValueError(f"a row of {len(row)} cells; at most {_MOST_COLUMNS} are read")
        has_numbers |= any(isinstance(cell, int | float) for cell in row)
        rows.append([_cell(cell) for cell in row])
    if not has_numbers:
        return ""
    while rows and not any(rows[-1]):
        rows.pop()
    used = [i for i in range(max(map(len, rows))) if any(i < len(row) and row[i] for row in rows)]
    stream = io.StringIO()
    writer = csv.writer(stream, delimiter="\t", lineterminator="\n")
    for row in rows:
        writer.writerow([row[i] if i < len(row) else "" for i in used])
    return stream.getvalue()


def _cell(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(int(value))
    if isinstance(value, float):
        return repr(value) if math.isfinite(value) else ""
    if isinstance(value, datetime.datetime | datetime.date | datetime.time):
        return value.isoformat()
    return " ".join(str(value).split())
