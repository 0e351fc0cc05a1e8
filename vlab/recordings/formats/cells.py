"""Cells of a text line: separation and parsing of numbers."""

import csv
import math
import re
from pathlib import Path

from vlab.recordings.files import refuse

_NUMBER = r"(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_COMPLEX = re.compile(rf"(?:([+-]?{_NUMBER})\s*(\+-|[+-])\s*({_NUMBER})|([+-]?{_NUMBER}))\s*\*?\s*[ijIJ]", re.ASCII)
DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+([eE][+-]?\d+)?")
"""DECIMAL_COMMA: number with a decimal comma."""
_LONGEST_CELL = 100  # a double has at most 24 characters, a complex number of two doubles 50


def cut_line(text: str, delimiter: str, path: Path, line: int) -> list[str]:
    """Split a line at its delimiters and strip the cells.

    Delimiters inside quotes do not split.

    Parameters
    ----------
    text : str
        Line of text.
    delimiter : str
        Delimiter of the cells.
    path : Path
        File, for messages.
    line : int
        Line number, for messages.

    Returns
    -------
    list of str
        Cells.

    Raises
    ------
    BadRecording
        A quote is open.
    """
    if '"' not in text:
        return [cell.strip() for cell in text.split(delimiter)]
    try:
        return [
            cell.strip() for cell in next(csv.reader([text], delimiter=delimiter, strict=True, skipinitialspace=True))
        ]
    except (csv.Error, StopIteration) as error:
        raise refuse(path, f"line {line}: the quotes do not close", fix="the file is damaged") from error


def parse_number(cell: str) -> complex | None:
    """Return the real or complex number in a cell.

    Parameters
    ----------
    cell : str
        Stripped text of a cell.

    Returns
    -------
    complex or None
        None if the cell is no number.
    """
    if len(cell) > _LONGEST_CELL or "_" in cell or not cell.isascii():
        return None
    try:
        return float(cell)
    except ValueError:
        pass
    bare = cell[1:-1].strip() if cell.startswith("(") and cell.endswith(")") else cell
    match = _COMPLEX.fullmatch(bare)
    if match is None:
        return complex(math.nan) if re.fullmatch(r"[+-]?nan\s*[+-]\s*nan\s*[ij]", bare, re.IGNORECASE) else None
    real, sign, imaginary, only = match.groups()
    return (
        complex(0.0, float(only)) if only else complex(float(real), float(imaginary) * (-1.0 if "-" in sign else 1.0))
    )


def is_number(cell: str, delimiter: str) -> bool:
    """Return whether a cell holds a number.

    Parameters
    ----------
    cell : str
        Stripped text of a cell.
    delimiter : str
        Delimiter of the line; a decimal comma stands between other delimiters only.

    Returns
    -------
    bool
        True for a real or complex number.
    """
    return parse_number(cell) is not None or (delimiter != "," and DECIMAL_COMMA.fullmatch(cell) is not None)
