"""LabVIEW measurement files (.lvm): text under a header.

Each segment has a header that ends with ``***End_of_Header***``, a line of names and lines of numbers. Segments of the
same channels follow each other. Source: NI, Specification for the LabVIEW Measurement File (.lvm).
"""

import re
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from vlab.recordings.files import refuse
from vlab.recordings.formats import csv, text
from vlab.recordings.table import Table

SIGNATURE = b"LabVIEW Measurement"
"""SIGNATURE: beginning of the first line."""
END = "***End_of_Header***"
X, COMMENT = "X_Value", "Comment"


@dataclass(frozen=True, kw_only=True)
class _Segment:
    """Names and clock of one segment."""

    names: tuple[str, ...]
    has_time: bool
    start: float
    step: float


def read(
    data: bytes,
    path: Path,
    *,
    names: Sequence[str] | None = None,
    columns: Sequence[str] | None = None,
    blanks: Collection[str] = frozenset(),
) -> Table:
    """Read a LabVIEW measurement file, see `vlab.recordings.open_table`.

    The column ``X_Value`` is the time [s], from the file or from its header. Comments are not read.

    Parameters
    ----------
    data : bytes
        Bytes of the file.
    path : Path
        Path of the file, for messages.
    names : sequence of str or None
        Must be None, because the file has its own names.
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
        The file is damaged, or its segments have different channels.
    """
    if not data.lstrip(b"\xef\xbb\xbf").startswith(SIGNATURE):
        return text.read(data, path, names=names, columns=columns, blanks=blanks)
    if names is not None:
        raise refuse(path, "a LabVIEW measurement file names its own channels", fix="leave out names")
    lines, segment, notes = _numbers(data.decode("utf-8-sig", errors="replace").splitlines(), path)
    wanted = None if columns is None else [name for name in columns if segment.has_time or name != X]
    plain = "\n".join(lines).encode() + b"\n"
    table = csv.read(plain, path, columns=wanted or None, blanks=blanks)
    found, units = dict(table.columns), dict(table.units)
    if not segment.has_time:
        found[X] = segment.start + segment.step * np.arange(len(next(iter(found.values()))))
    if X in found:
        units[X] = "s"
    return replace(table, columns=found, units=units, notes=(*notes, *table.notes))


def _numbers(lines: Sequence[str], path: Path) -> tuple[list[str], _Segment, list[str]]:
    """Return lines of names and numbers, with headers as comments."""
    keys: dict[str, str] = {}
    out: list[str] = []
    segment: _Segment | None = None
    notes: list[str] = []
    is_special, ended, count, delimiter = False, 0, 0, "\t"
    stated, there = 0, 0
    for number, line in enumerate(lines, start=1):
        bare = line.strip()
        is_special = (is_special or bare.startswith("***Start_Special***")) and not bare.startswith("***End_Special***")
        words = re.split(r"[\t,;]", line)
        is_names = ended >= 2 and words[0].strip() == X
        if is_names:
            found = _segment(words, keys, path)
            if segment is not None and found.names != segment.names:
                raise refuse(path, "the segments of the file have different channels", fix="export one segment a file")
            out.append(delimiter.join(found.names) if segment is None else "#")
            segment, count = segment or found, count + 1
            samples = keys.get("Samples", "")
            stated += int(samples) if samples.isdecimal() and len(samples) < 12 else 0
        elif bare == END:
            ended += 1
            out.append("#")
        elif segment is None or is_special or not bare or not _begins_with_number(bare):
            if len(words) > 1:
                keys[words[0].strip()] = words[1].strip()
            if words[0].strip() == "Separator":
                delimiter = "," if "comma" in line.lower() else "\t"
            out.append("#")
        else:
            row = _row(line, delimiter, segment)
            if len(row) < len(segment.names):
                what = f"line {number}: {len(row)} numbers where {len(segment.names)} are expected"
                raise refuse(path, what, fix="the file is cut short or damaged; copy or export it again")
            out.append(delimiter.join(row))
            there += 1
    if segment is None:
        raise refuse(path, f"no line of names that begins with {X}", fix="export it again with a header")
    if there < stated:  # a header may count the first of several blocks only, so more is no fault
        raise refuse(path, f"the header states {stated} samples, the file has {there}", fix="copy or export it again")
    if count > 1:
        notes.append(f"{count} segments are strung together")
    return out, segment, notes


def _begins_with_number(line: str) -> bool:
    return line[0] in "0123456789+-.,;\t"


def _segment(words: Sequence[str], keys: dict[str, str], path: Path) -> _Segment:
    given = [word.strip() for word in words]
    given = given[: given.index(COMMENT)] if COMMENT in given else given
    has_time = keys.get("X_Columns", "One").lower() != "no"
    seen: Counter[str] = Counter()
    names = []
    for name in given if has_time else given[1:]:
        seen[name] += 1
        names.append(name if seen[name] == 1 else f"{name} {seen[name] - 1}")
    try:
        start, step = (float(keys.get(key, "0").replace(",", ".")) for key in ("X0", "Delta_X"))
    except ValueError as error:
        raise refuse(path, f"X0 or Delta_X of the header is no number: {error}", fix="export it again") from error
    if not names or not (has_time or step > 0):
        raise refuse(path, "the header states neither channels nor a step of time", fix="export it again")
    return _Segment(names=tuple(names), has_time=has_time, start=start, step=step)


def _row(line: str, delimiter: str, segment: _Segment) -> list[str]:
    """Return the numbers of a line, without its comment."""
    cells = line.split(delimiter)
    cells = cells if segment.has_time or cells[0].strip() else cells[1:]
    return cells[: len(segment.names)]
