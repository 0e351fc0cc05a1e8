"""Columns of time stamps in lines of text."""

import io
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from vlab.recordings.files import refuse
from vlab.recordings.formats.cells import cut_line
from vlab.recordings.stamps import FORM, BadStamp, first_stamp, seconds_from
from vlab.signals import Array

LONGEST_LINE = 2**20
"""LONGEST_LINE [bytes]: longest accepted line: ten thousand columns of a hundred characters."""


def lines_of(data: bytes, path: Path, offset: int = 0) -> Iterator[tuple[int, bytes]]:
    """Yield the offset and the bytes of each line.

    Parameters
    ----------
    data : bytes
        Bytes of the file.
    path : Path
        Path of the file, for messages.
    offset : int
        Offset of the first line.

    Yields
    ------
    tuple of (int, bytes)
        Offset and line.

    Raises
    ------
    BadRecording
        A line is too long.
    """
    stream = io.BytesIO(data)
    stream.seek(offset)
    while line := stream.readline(LONGEST_LINE + 1):
        if len(line) > LONGEST_LINE:
            raise refuse(
                path,
                f"a line of more than {LONGEST_LINE} bytes",
                fix="not a text file of numbers, or its line ends are missing",
            )
        yield offset, line
        offset += len(line)


def read_stamps(
    data: bytes,
    path: Path,
    first: tuple[int, int],
    delimiter: str,
    columns: Mapping[int, str],
    *,
    starts: Mapping[int, str],
    blanks: Sequence[str],
) -> dict[int, Array]:
    """Return columns of time stamps as seconds.

    Parameters
    ----------
    data : bytes
        Bytes of the file.
    path : Path
        Path of the file, for messages.
    first : tuple of (int, int)
        Offset and number of the first line of numbers.
    delimiter : str
        Delimiter of the cells.
    columns : mapping of int to str
        Columns to read, with their name in messages.
    starts : mapping of int to str
        Stamps in the first line, of all columns of the file.
    blanks : sequence of str
        Contents of cells without a stamp; empty where each cell needs a stamp.

    Returns
    -------
    dict of int to array
        Times [s] from the earliest stamp of the first line; NaN for a blank cell.

    Raises
    ------
    BadRecording
        A cell holds no stamp, or a stamp of another form.
    """
    texts: dict[int, list[str | None]] = {i: [] for i in columns}
    numbers = []
    for number, (_, raw) in enumerate(lines_of(data, path, first[0]), start=first[1]):
        line = raw.decode("utf-8", errors="replace").strip("\r\n")
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        cells = cut_line(line, delimiter, path, number)
        numbers.append(number)
        for i, column in texts.items():
            cell = cells[i] if i < len(cells) else ""
            column.append(None if cell in blanks else cell)
    out = {}
    for i, column in texts.items():
        try:
            out[i] = seconds_from(first_stamp(starts.values(), starts[i]), column)
        except BadStamp as error:
            fix = f"write all stamps of a column as {FORM}"
            raise refuse(path, f"line {numbers[error.row]}: {columns[i]} {error.what}", fix=fix) from error
    return out
