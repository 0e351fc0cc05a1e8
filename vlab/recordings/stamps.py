"""Time stamps as text, in seconds from a first stamp.

Stamps are ISO 8601 dates with time, dates such as 2025/03/01 or 01.03.2025 with time, or clock times.
`datetime.datetime.fromisoformat` parses the whole seconds. Decimals count as integer nanoseconds, so no stamp is rounded
before the first one is subtracted.
"""

import datetime
import re
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from vlab.recordings.workers.rows import LONGEST_STAMP
from vlab.signals import Array

_STAMP = re.compile(
    r"(?:(\d{4}[-/]\d{1,2}[-/]\d{1,2}|\d{1,2}\.\d{1,2}\.\d{4}|\d{8}(?=T))[T ])?"
    r"(\d{1,2}:\d{2}:\d{2}|(?<=T)\d{6})(?:[.,](\d{1,12})|:(\d{3}|\d{6}))?(?: ?([AaPp][Mm]))?\s?(Z|[+-]\d{2}:?\d{2})?",
    re.ASCII,
)
_TIMELIKE = re.compile(r"[\d./-]*[T ]?\d{1,2}:\d{2}(?::\d{2})?[\d.,:]*(?: ?[AaPp][Mm])?|\d{4}-\d{2}-\d{2}", re.ASCII)
_SECOND = 10**9
_DAY = 86_400 * _SECOND
FORM = "ISO 8601 (2025-03-01T10:00:00.250) or clock time (10:00:00.250)"
"""FORM: accepted stamps, for messages."""


class Stamp(NamedTuple):
    """A time stamp.

    Parameters
    ----------
    nanoseconds : int
        Time since a fixed instant [ns].
    has_date, has_offset : bool
        Whether the stamp states a date, and an offset to UTC.
    """

    nanoseconds: int
    has_date: bool
    has_offset: bool

    @property
    def form(self) -> str:
        """Form of the stamp in words, common to a column."""
        kind = "a date with time" if self.has_date else "a clock time"
        return f"{kind} with an offset to UTC" if self.has_offset else kind


class BadStamp(ValueError):
    """Text that is no stamp of the form of its column.

    Parameters
    ----------
    row : int
        Row of the text, from 0.
    what : str
        Fault, with the text.
    """

    def __init__(self, row: int, what: str) -> None:
        super().__init__(what)
        self.row, self.what = row, what


def is_stamp(text: str) -> bool:
    """Return whether a text has the form of a time stamp."""
    return text[:1].isdigit() and len(text) <= LONGEST_STAMP and _STAMP.fullmatch(text) is not None


def is_timelike(text: str) -> bool:
    """Return whether a text looks like a time that is no accepted stamp.

    A date of month and day in any order is ambiguous, and minutes with seconds are, too.

    Parameters
    ----------
    text : str
        Text without blanks around.
    """
    return len(text) <= LONGEST_STAMP and not is_stamp(text) and _TIMELIKE.fullmatch(text) is not None


def read_stamp(text: str) -> Stamp | None:
    """Return a text as a time stamp.

    Parameters
    ----------
    text : str
        Text without blanks around.

    Returns
    -------
    Stamp or None
        None if the text is no stamp, or states a time that does not exist.
    """
    match = _STAMP.fullmatch(text) if len(text) <= LONGEST_STAMP else None
    if match is None:
        return None
    date, clock, decimals, millis, half, offset = match.groups()
    decimals = decimals or millis
    if ":" not in clock:
        clock = f"{clock[:2]}:{clock[2:4]}:{clock[4:]}"
    hour, _, rest = clock.partition(":")
    if half:
        if not 1 <= int(hour) <= 12:
            return None
        hour = str(int(hour) % 12 + (12 if half.lower() == "pm" else 0))
    try:
        whole = datetime.datetime.fromisoformat(f"{_iso_date(date)}T{hour.zfill(2)}:{rest}{offset or ''}")
    except ValueError:
        return None
    start = datetime.datetime(2000, 1, 1, tzinfo=datetime.UTC if offset else None)
    seconds = (whole - start) // datetime.timedelta(seconds=1)
    return Stamp(seconds * _SECOND + int(f"{decimals or '':0<9}"[:9]), date is not None, offset is not None)


def _iso_date(date: str | None) -> str:
    """Return a date as year, month and day between hyphens."""
    if date is None:
        return "2000-01-01"
    if date.isdecimal():
        return f"{date[:4]}-{date[4:6]}-{date[6:]}"
    parts = re.split(r"[-/.]", date)
    year, month, day = reversed(parts) if "." in date else parts
    return f"{year}-{month.zfill(2)}-{day.zfill(2)}"


def first_stamp(texts: Iterable[str | None], like: str) -> Stamp | None:
    """Return the earliest stamp of one form.

    Columns of one file count from the same stamp, so that their times fit together.

    Parameters
    ----------
    texts : iterable of str or None
        First stamps of the columns of a file.
    like : str
        Stamp with the wanted form.

    Returns
    -------
    Stamp or None
        None if `like` is no stamp.
    """
    own = read_stamp(like)
    every = [stamp for text in texts if text and (stamp := read_stamp(text)) is not None]
    return min((stamp for stamp in every if own is not None and stamp.form == own.form), default=own)


def seconds_from(first: Stamp | None, texts: Sequence[str | None]) -> Array:
    """Return the times of stamps [s] from a first one.

    A clock time that goes back by more than half a day has passed midnight.

    Parameters
    ----------
    first : Stamp or None
        Stamp of zero time.
    texts : sequence of str or None
        Stamps; None for a blank cell.

    Returns
    -------
    (n,) array
        Times [s]; NaN for a blank cell.

    Raises
    ------
    BadStamp
        A text is no stamp, or has another form than the first stamp.
    """
    out = np.full(len(texts), np.nan)
    days, before = 0, None if first is None else first.nanoseconds
    for row, text in enumerate(texts):
        if text is None:
            continue
        stamp = read_stamp(text)
        if stamp is None or first is None or before is None:
            raise BadStamp(row, f"is {text[:60]!r}, not a time stamp")
        if stamp.form != first.form:
            raise BadStamp(row, f"is {text!r}, {stamp.form}; the first stamp is {first.form}")
        if not stamp.has_date and before - stamp.nanoseconds > _DAY // 2:
            days += 1
        before = stamp.nanoseconds
        out[row] = (stamp.nanoseconds - first.nanoseconds + days * _DAY) / _SECOND
    return out
