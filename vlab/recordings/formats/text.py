"""Text files of numbers between blanks or other delimiters.

Runs of blanks become tabs, and lines of comments begin with ``#``. The reader of CSV files does the rest, with the line
numbers of the file. The last comment before the numbers may hold the names, as numpy.savetxt writes them.
"""

import re
from collections.abc import Collection, Sequence
from pathlib import Path

from vlab.recordings.formats import csv
from vlab.recordings.formats.cells import parse_number
from vlab.recordings.stamps import is_stamp
from vlab.recordings.table import Table

_COMMENTS = (b"%", b"#", b"//", b"!")
_LOOKED_AT = 2**16  # bytes that decide on the delimiter
_DATED = re.compile(
    rb"(?<!\d)(\d{4}-\d{2}-\d{2}) (?=\d{1,2}:\d{2}:\d{2})"
)  # a blank inside of a stamp separates no cells
_RUNS = re.compile(rb"[ \t]+")
_ENDS = re.compile(rb"(?m)^[ \t]+|[ \t]+(?=\r?$)")


def read(
    data: bytes,
    path: Path,
    *,
    names: Sequence[str] | None = None,
    columns: Sequence[str] | None = None,
    blanks: Collection[str] = frozenset(),
) -> Table:
    """Read a text file, see `vlab.recordings.open_table`.

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
    data = _DATED.sub(rb"\1T", data)
    first, count = _first_numbers(data)
    head = [_commented(line) for line in data[:first].splitlines(keepends=True)]
    body = data[first:]
    if count:
        head = _separated(head, count)
        body = _RUNS.sub(b"\t", _ENDS.sub(b"", body))
    return csv.read(b"".join(head) + body, path, names=names, columns=columns, blanks=blanks)


def _first_numbers(data: bytes) -> tuple[int, int]:
    """Return the first line of numbers and the separating blanks.

    The count is 0 if a delimiter other than a blank separates, or if no line of numbers is found.
    """
    offset = 0
    for line in data[:_LOOKED_AT].splitlines(keepends=True):
        text = line.decode("utf-8", errors="replace").strip()
        cells = text.split()
        numeric = [_is_number(cell) for cell in cells]
        fits = all(is_one or is_stamp(cell) for is_one, cell in zip(numeric, cells, strict=True))
        is_numbers = any(numeric) and fits and "\t" not in text
        if is_numbers and (len(cells) > 1 or "," not in text):
            return offset, len(cells)
        offset += len(line)
    return 0, 0


def _is_number(cell: str) -> bool:
    return parse_number(cell) is not None or re.fullmatch(r"[+-]?\d+,\d+([eE][+-]?\d+)?", cell) is not None


def _commented(line: bytes) -> bytes:
    text = line.lstrip()
    mark = next((mark for mark in _COMMENTS if text.startswith(mark)), b"")
    return b"#" + text[len(mark) :] if mark else line


def _separated(head: list[bytes], count: int) -> list[bytes]:
    """Return the lines before the numbers, with tabs between names.

    Names with blanks inside have two blanks or more between them.
    """
    out = []
    for line in head:
        end = line[len(line.rstrip(b"\r\n")) :]
        text = line.strip()
        mark, text = (b"#", text[1:].strip()) if text.startswith(b"#") else (b"", text)
        parts = _RUNS.split(text)
        if len(parts) != count:
            parts = [part.strip() for part in re.split(rb"[ \t]{2,}", text)]
        out.append(mark + b"\t".join(parts) + end if len(parts) == count else line)
    return out
