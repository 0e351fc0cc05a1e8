"""Cells with lists of numbers, as one column for each element.

Exports of robot data sets hold the joints of a sample in one cell: ``"[0.1, 0.2]"``, ``[0.1 0.2]`` as numpy prints, or
``0.1;0.2``. The elements are parsed as numbers and never evaluated as a program.
"""

import csv
import io
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from vlab.recordings.files import refuse
from vlab.recordings.formats.cells import is_number, parse_number
from vlab.recordings.table import MAX_COLUMNS

LOOKED_AT = 2**18
"""LOOKED_AT [bytes]: head of the file that shows lists."""
MOST_TITLES = 100
"""MOST_TITLES [1]: largest number of lines above the first list."""
BLANK = ("", "nan", "none", "null")
"""BLANK: contents of a cell without a list, in lower case."""
_BRACKETED = re.compile(r"(?:(?:np\.)?array\()?\s*(\[[^\[\]]*\]|\([^()]*\))\s*(?:,\s*dtype=\w+\s*)?\)?")
_BETWEEN = re.compile(r"\s*[,;]\s*|\s+")
_UNQUOTED = re.compile(r'(?<!")\[[^\[\]"\n]*\](?!")')


class _Found(NamedTuple):
    """Delimiter, names, number of lines above the names, and length of each list by column."""

    delimiter: str
    names: list[str]
    above: int
    lengths: Mapping[int, int]


def expanded(data: bytes, path: Path) -> tuple[bytes, tuple[str, ...]]:
    """Return a text with a column for each element of its lists.

    Parameters
    ----------
    data : bytes
        Bytes of the file, UTF-8.
    path : Path
        Path of the file, for messages.

    Returns
    -------
    tuple of (bytes, tuple of str)
        Text with names such as ``action[0]``, and remarks; the text itself without lists.

    Raises
    ------
    BadRecording
        The lists of a column have different lengths, or a cell holds no list.
    """
    head = data[:LOOKED_AT]
    if not any(sign in head for sign in (b"[", b"(", b";")):
        return data, ()
    found = _lists_below_names(head.decode("utf-8-sig", errors="replace"))
    if found is None:
        return data, ()
    _, names, above, lengths = found
    if sum(lengths.values()) + len(names) > MAX_COLUMNS:
        what = f"{sum(lengths.values())} numbers in the lists of a line"
        raise refuse(path, what, fix=f"at most {MAX_COLUMNS} columns are read")
    rows = _reader(data.decode("utf-8-sig", errors="replace"), found.delimiter)
    out = io.StringIO()
    write = csv.writer(out, delimiter=found.delimiter, lineterminator="\n")
    has_lists = False
    try:
        for count, row in enumerate(rows):
            cells = [cell.strip() for cell in row]
            if count < above:
                out.write(f"{found.delimiter.join(row)}\n" if row and row[0].lstrip().startswith("#") else "#\n")
                continue
            if len(cells) <= max(lengths) or (row and row[0].lstrip().startswith("#")):
                out.write(found.delimiter.join(row) + "\n")  # the reader of numbers says what is wrong
                continue
            parts = {i: list_in(cells[i], found.delimiter) for i in lengths}
            has_lists = has_lists or any(part is not None for part in parts.values())
            for i, part in parts.items():
                if cells == names:
                    parts[i] = [f"{names[i]}[{k}]" for k in range(lengths[i])]
                elif not has_lists or (part is None and cells[i].lower() in BLANK):
                    parts[i] = [cells[i]] * lengths[i]  # a unit, or no reading
                elif part is None or len(part) != lengths[i]:
                    is_text = f"{cells[i][:40]!r}" if part is None else f"a list of {len(part)} numbers"
                    raise refuse(
                        path,
                        f"line {rows.line_num}: column {i + 1} ({names[i]!r}) is {is_text}, and a list of {lengths[i]} numbers "
                        "above",
                        fix="all lists of a column must have one length; export each joint as a column",
                    )
            write.writerow([cell for i, one in enumerate(cells) for cell in (parts.get(i) or [one])])
    except csv.Error as error:
        raise refuse(path, f"line {rows.line_num}: {error}", fix="the file is damaged; export it again") from error
    listed = ", ".join(f"{names[i]} ({count})" for i, count in list(lengths.items())[:8])
    return out.getvalue().encode(), (f"lists in cells become columns: {listed}",)


def list_in(cell: str, delimiter: str) -> list[str] | None:
    """Return the elements of a list of numbers in a cell.

    Parameters
    ----------
    cell : str
        Stripped text of a cell.
    delimiter : str
        Delimiter of the line.

    Returns
    -------
    list of str or None
        Numbers as text; None for a cell without a list.
    """
    if parse_number(cell) is not None:
        return None
    match = _BRACKETED.fullmatch(cell)
    if match is not None:
        inner, fewest = match[1][1:-1].strip(), 1 if match[1].startswith("[") else 2
        parts = _BETWEEN.split(inner)
    elif delimiter != ";" and ";" in cell:
        parts, fewest = [part.strip() for part in cell.split(";")], 2
    else:
        return None
    parts = parts[:-1] if len(parts) > 1 and not parts[-1] else parts
    is_list = len(parts) >= fewest and all(isinstance(parse_number(part), float) for part in parts)
    return parts if is_list else None


def _reader(text: str, delimiter: str) -> Any:
    if delimiter == ",":
        text = _UNQUOTED.sub(lambda match: match[0].replace(",", " "), text)
    return csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, skipinitialspace=True)


def _lists_below_names(head: str) -> _Found | None:
    """Return the names above the first line with lists."""
    for delimiter in "\t,;|":
        if delimiter not in head:
            continue
        above: list[list[str]] = []
        try:
            for row in _reader(head, delimiter):
                cells = [cell.strip() for cell in row]
                lists = {i: len(p) for i, cell in enumerate(cells) if (p := list_in(cell, delimiter)) is not None}
                if _is_plain(row, delimiter):
                    break
                if lists:
                    named = _names(above, len(cells), delimiter)
                    if named is not None:
                        return _Found(delimiter, above[named], named, lists)
                    break
                above.append(cells)
                if len(above) > MOST_TITLES:
                    break
        except csv.Error:
            continue
    return None


def _is_plain(row: Sequence[str], delimiter: str) -> bool:
    """Return whether semicolons separate plain numbers."""
    cells = delimiter.join(row).split(";")
    return len(cells) > 1 and all(is_number(cell.strip(), ";") for cell in cells)


def _names(above: Sequence[Sequence[str]], width: int, delimiter: str) -> int | None:
    """Return the first of the lines of names and units right above a line."""
    at = len(above)
    while at and len(above[at - 1]) == width and not any(is_number(cell, delimiter) for cell in above[at - 1]):
        at -= 1
    return at if at < len(above) else None
