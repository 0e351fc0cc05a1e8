"""Blanks between the numbers of a text file, as tabs."""

import re

from vlab.recordings.formats.cells import is_number
from vlab.recordings.stamps import is_stamp

COMMENTS = (b"%", b"#", b"//", b"!")
"""COMMENTS: beginnings of a line of comment above the numbers."""
_LOOKED_AT = 2**16  # bytes that decide on the delimiter
_DATED = re.compile(
    rb"(?<!\d)(\d{4}-\d{2}-\d{2}) (?=\d{1,2}:\d{2}:\d{2})"
)  # a blank inside of a stamp separates no cells
_RUNS = re.compile(rb"[ \t]+")
_ENDS = re.compile(rb"(?m)^[ \t]+|[ \t]+(?=\r?$)")


def tabbed(data: bytes) -> bytes:
    """Return a text whose numbers stand between blanks with tabs between them.

    Parameters
    ----------
    data : bytes
        Bytes of the file.

    Returns
    -------
    bytes
        Text of equal lines; the text itself where another delimiter separates the numbers.
    """
    first, count = _first_numbers(_DATED.sub(rb"\1T", data[:_LOOKED_AT]))
    if count < 2:
        return data
    data = _DATED.sub(rb"\1T", data)
    head = [_commented(line) for line in data[:first].splitlines(keepends=True)]
    return b"".join(_separated(head, count)) + _RUNS.sub(b"\t", _ENDS.sub(b"", data[first:]))


def _first_numbers(data: bytes) -> tuple[int, int]:
    """Return the first line of numbers and the separating blanks.

    The count is 0 if a delimiter other than a blank separates, or if no line of numbers is found.
    """
    offset = 0
    for line in data.splitlines(keepends=True):
        text = line.decode("utf-8", errors="replace").strip()
        cells = text.split()
        numeric = [is_number(cell, "\t") for cell in cells]
        fits = all(is_one or is_stamp(cell) for is_one, cell in zip(numeric, cells, strict=True))
        is_numbers = any(numeric) and fits and "\t" not in text
        if is_numbers and (len(cells) > 1 or "," not in text):
            return offset, len(cells)
        offset += len(line)
    return 0, 0


def _commented(line: bytes) -> bytes:
    text = line.lstrip()
    mark = next((mark for mark in COMMENTS if text.startswith(mark)), b"")
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
