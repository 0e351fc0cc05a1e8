"""Faults of text logs that have one usual cause: footers, and separators of thousands."""

import re
from collections.abc import Sequence
from typing import NamedTuple

from vlab.recordings.formats.cells import is_number
from vlab.recordings.stamps import is_stamp

_THOUSANDS = re.compile(r"[+-]?\d{1,3}(?:,\d{3})+(?:\.\d*)?|[+-]?\d{1,3}(?:\.\d{3})+,\d*|[+-]?\d{1,3}(?:\.\d{3}){2,}")
_IN_LINE = re.compile(r"(?<![\d.])\d{1,3}(?:,\d{3})+\.\d")
_POINTED = re.compile(rb"(?<![\d.:,])\d{1,3}(?:\.\d{3})+(?![\d.])")
WITHOUT_THOUSANDS = "export numbers without separators of thousands (1234.5, not 1,234.5 or 1.234,5)"
"""WITHOUT_THOUSANDS: advice on separators of thousands."""


def has_thousands(text: str, delimiter: str) -> bool:
    """Return whether a cell or line of text has separators of thousands.

    Parameters
    ----------
    text : str
        Cell, or line without quotes whose delimiter is a comma.
    delimiter : str
        Delimiter of the line; empty for a cell.

    Returns
    -------
    bool
        True for a cell such as ``1,234.5`` or ``1.234,5``. ``1,234`` alone may have a decimal comma, and is none.
    """
    if delimiter:
        return delimiter == "," and _IN_LINE.search(text) is not None
    return _THOUSANDS.fullmatch(text) is not None and re.fullmatch(r"[+-]?\d+,\d+", text) is None


def pointed_thousands(body: bytes) -> str:
    """Return the first number with points between thousands, beside decimal commas.

    Parameters
    ----------
    body : bytes
        Lines of numbers with decimal commas.

    Returns
    -------
    str
        Number as written; empty if there is none.
    """
    match = _POINTED.search(body)
    return "" if match is None else match[0].decode()


class Footer(NamedTuple):
    """Lines of text after the numbers.

    Parameters
    ----------
    first, last : int
        Numbers of the first and the last line.
    text : str
        First line.
    """

    first: int
    last: int
    text: str

    @property
    def lines(self) -> str:
        """Numbers of the lines as text."""
        return f"{self.first}" if self.first == self.last else f"{self.first} to {self.last}"

    @property
    def is_single(self) -> bool:
        """Whether the footer has one line."""
        return self.first == self.last


def footer(lines: Sequence[tuple[int, str]], delimiter: str) -> Footer | None:
    """Return the lines of text at the end of a file.

    Parameters
    ----------
    lines : sequence of (int, str)
        Number and text of the first row of numbers, and of all lines from the first odd one on.
    delimiter : str
        Delimiter of the cells.

    Returns
    -------
    Footer or None
        None if rows begin with text, if one more row of numbers follows, or if the odd line is a row with a bad cell.
    """
    (start, row), *rest = lines
    there = [(number, text.strip()) for number, text in rest if text.strip()]
    if not there or there[0][0] == start or not _begins_row(row, delimiter):
        return None
    if any(_begins_row(text, delimiter) for _, text in there) or _is_row_like(there[0][1], row, delimiter):
        return None
    return Footer(first=there[0][0], last=there[-1][0], text=there[0][1])


def _is_row_like(text: str, row: str, delimiter: str) -> bool:
    """Return whether a line has as many cells as a row, and a number."""
    cells = text.split(delimiter)
    return len(cells) == len(row.split(delimiter)) and any(is_number(cell.strip(), delimiter) for cell in cells)


def _begins_row(text: str, delimiter: str) -> bool:
    """Return whether the first cell is a number, a stamp or blank."""
    cell = text.split(delimiter)[0].strip(' "\r\n')
    return not cell or is_number(cell, delimiter) or is_stamp(cell)
