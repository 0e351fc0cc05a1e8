"""Aligned text tables that fit the terminal.

Columns of text are wrapped where a table is wider than the terminal. A pipe or a file gets whole lines.
"""

import re
import shutil
import sys
import textwrap
from collections.abc import Sequence
from typing import Any

from vlab.files.text import in_line

GAP = "  "
"""GAP: blanks between two columns."""
LONGEST_WORDS = (24, 16, 12)
"""LONGEST_WORDS [characters]: longest word of a cell that stays whole, tried in this order until the table fits."""
_PIECES = re.compile(r"[^\s/_:.,-]*[/_:.,-]|[^\s/_:.,-]+|\s+")


def text_table(headers: Sequence[str], rows: Sequence[Sequence[Any]], *, width: int | None = None) -> str:
    """Return an aligned plain-text table, with numbers flush right.

    Parameters
    ----------
    headers : sequence of str
        Headings of the columns.
    rows : sequence of sequence of object
        Cells of each row.
    width : int or None
        Width to fit [characters]; by default that of the terminal, and unlimited for a pipe or file.

    Returns
    -------
    str
        Lines of the table.
    """
    heads = [in_line(h) for h in headers]
    cells = [[_show(cell) for cell in row] for row in rows]
    is_text = [any(isinstance(row[i], str) for row in rows) for i in range(len(heads))]
    columns = [[head, *(row[i] for row in cells)] for i, head in enumerate(heads)]
    room = terminal_width() if width is None else width
    natural = [max(map(len, column)) for column in columns]
    tried = (_fitted(natural, [_least(column, longest) for column in columns], room) for longest in LONGEST_WORDS)
    widths = min(tried, key=lambda found: max(_total(found) - room, 0) if room is not None else 0)

    def lines(parts: Sequence[str]) -> list[str]:
        wrapped = [_wrapped(part, w) for part, w in zip(parts, widths, strict=True)]
        return [
            GAP.join(
                (w[k] if k < len(w) else "").ljust(size) if text else (w[k] if k < len(w) else "").rjust(size)
                for w, size, text in zip(wrapped, widths, is_text, strict=True)
            ).rstrip()
            for k in range(max(map(len, wrapped)))
        ]

    body = [line for row in cells for line in lines(row)]
    return "\n".join([*lines(heads), GAP.join("-" * w for w in widths), *body])


def terminal_width() -> int | None:
    """Return the width of the terminal [characters], if there is one."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else None


def _total(widths: Sequence[int]) -> int:
    """Return the width of a table."""
    return sum(widths) + len(GAP) * (len(widths) - 1)


def _fitted(natural: Sequence[int], least: Sequence[int], room: int | None) -> list[int]:
    """Return widths that fit the room; the widest columns shrink."""
    widths = list(natural)
    for cap in range(max(natural) - 1, 0, -1):
        if room is None or _total(widths) <= room:
            break
        widths = [max(low, min(size, cap)) for size, low in zip(natural, least, strict=True)]
    return widths


def _least(column: Sequence[str], longest: int) -> int:
    """Return the smallest width of a column without broken words."""
    return max((min(len(word), longest) for cell in column for word in cell.split()), default=1)


def _wrapped(cell: str, width: int) -> list[str]:
    """Return the lines of a cell."""
    if len(cell) <= width:
        return [cell]
    lines = [""]
    for piece in (p for word in _words(cell, width) for p in word):
        if len(lines[-1]) + len(piece.rstrip()) <= width:
            lines[-1] += piece
        else:
            lines.append(piece.lstrip())
    return [part for line in lines for part in textwrap.wrap(line, width) or [""]]


def _words(cell: str, width: int) -> list[list[str]]:
    """Return the words of a cell, too long ones in pieces."""
    words = re.findall(r"\S+\s*", cell)
    return [[word] if len(word.rstrip()) <= width else _PIECES.findall(word) for word in words]


def _show(cell: Any) -> str:
    if cell is None:
        return "-"
    if isinstance(cell, bool):
        return "yes" if cell else "no"
    if isinstance(cell, float):
        cell += 0.0  # no minus before a zero
        return f"{cell:.4g}" if abs(cell) < 1e-3 or abs(cell) >= 1e4 else f"{cell:.4f}".rstrip("0").rstrip(".")
    return in_line(cell)
