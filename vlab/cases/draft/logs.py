"""Logs of a draft: columns, clock and roles."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from vlab import units
from vlab.cases.channel_map import FAR_S
from vlab.errors import BadCase, BadRecording, unknown_name
from vlab.files.text import one_line
from vlab.recordings.datasets import EPISODE, episodes_of, open_any, read_dataset
from vlab.recordings.overview import REPEATED, ColumnOverview, kind_of, overview
from vlab.recordings.selection import parse_where, select_rows
from vlab.recordings.table import MOST_LISTED, READERS, Table

EVEN = 0.2
"""EVEN [1]: largest spread of the steps of a column without a name of time, over their median, in a clock."""
PERIODS, RATES = ("dt", "ts", "sample_time", "period_s"), ("fs", "rate_hz", "sample_rate", "samplerate", "fps")
"""PERIODS, RATES: names of a column with the sample period [s] or the sample rate [Hz]."""
FEWEST = 20
"""FEWEST [1]: fewest samples of a log, of which the last third is held out; fewer do not show the slowest motion."""
HELD_OUT = 3
"""HELD_OUT [1]: one recording in so many is held out, and the last such share of a single one."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Log:
    """One recording file or data set.

    Parameters
    ----------
    path : Path
        File or folder.
    table : Table
        Columns; of the first episode in a data set.
    columns : tuple of ColumnOverview
        Probable meaning of the columns.
    labels : mapping of str to str
        Name for the case by name in the table, where both differ.
    episodes : tuple of int
        Episodes of a data set; empty for a plain file.
    """

    path: Path
    table: Table
    columns: tuple[ColumnOverview, ...]
    labels: Mapping[str, str] = field(default_factory=dict)
    episodes: tuple[int, ...] = ()

    def label(self, column: str) -> str:
        """Return the name of a column for the case."""
        return self.labels.get(column, column)


@dataclass(frozen=True, kw_only=True)
class LogClock:
    """Clock of the logs.

    Parameters
    ----------
    time : str or None
        Time column.
    unit : str
        Unit of the time column.
    rate_hz : float or None
        Sample rate [Hz] without a time column.
    why : str
        Reason of the choice.
    is_sure : bool
        Whether name or file state unit and meaning.
    """

    time: str | None
    unit: str = "s"
    rate_hz: float | None = None
    why: str
    is_sure: bool = True


@dataclass(frozen=True, kw_only=True)
class Part:
    """Recordings of one table of the case.

    Parameters
    ----------
    paths : tuple of Path
        Files.
    role : str
        ``"fit"`` or ``"holdout"``.
    episodes : tuple of int
        Episodes of a data set.
    start_s, stop_s : float or None
        Part of a single file [s].
    name : str
        Name of the part of a single file.
    """

    paths: tuple[Path, ...]
    role: str
    episodes: tuple[int, ...] = ()
    start_s: float | None = None
    stop_s: float | None = None
    name: str = ""


def open_log(path: Path) -> Log:
    """Open a log for a draft.

    Parameters
    ----------
    path : Path
        Recording file, LeRobot data set or bag.

    Returns
    -------
    Log
        Columns with their probable meaning.

    Raises
    ------
    BadCase
        The path is a model or a case.
    BadRecording
        The file is missing or damaged.
    """
    if path.suffix.lower() in (".xml", ".toml") or (path.is_file() and path.suffix.lower() not in READERS):
        raise BadCase(
            f"{path}: a recording was expected after the model (accepted: {', '.join(READERS)}, or the folder of a "
            "data set); give the model first, then its logs"
        )
    table, labels = open_any(path)
    data = read_dataset(path) if path.is_dir() else None
    numbers: Sequence[int] = range(data.episodes) if data is not None else episodes_of(table)
    if EPISODE in table.names and len(numbers) > 0:
        table = select_rows(table, parse_where(f"{EPISODE} == {numbers[0]}"))
    return Log(path=path, table=table, columns=overview(table), labels=labels, episodes=tuple(numbers))


def choose_clock(log: Log, *, time: str | None = None, rate_hz: float | None = None) -> LogClock:
    """Choose the time column of a log.

    Parameters
    ----------
    log : Log
        Log.
    time : str, optional
        Time column that the user names.
    rate_hz : float, optional
        Sample rate that the user states [Hz].

    Returns
    -------
    LogClock
        Clock with its reason.

    Raises
    ------
    BadCase
        No column counts the time, or the times start again.
    BadRecording
        A column named for a time holds text other than time stamps.
    """
    if rate_hz is not None:
        return LogClock(time=None, rate_hz=rate_hz, why="the rate as stated")
    where = one_line(log.path)
    if time is not None:
        found = next((c for c in log.columns if time in (c.name, log.label(c.name))), None)
        if found is None and time in log.table.refused:
            log.table.real(time)  # raises the reason
        if found is None:
            raise unknown_name("time column", time, [c.name for c in log.columns][:MOST_LISTED], where=where)
        return _clock(log, found, "as stated")
    named = [c for c in log.columns if c.kind == "time" and c.rate_hz]
    if named:
        best = max(named, key=lambda c: (bool(c.unit), c.blank == 0))
        return _clock(log, best, "its name, and its values increase")
    unread = [name for name in log.table.refused if kind_of(name) == "time"]
    for name in (name for name in unread if "time stamp" in log.table.refused[name]):
        log.table.real(name)  # raises the reason, as a column that grows evenly may be no time
    repeated = next((c for c in log.columns if c.kind == REPEATED), None)
    if repeated is not None:
        raise _repeated_times(log, repeated)
    again = next((c for c in log.columns if c.kind.startswith("time, starts again")), None)
    if again is not None:
        raise BadCase(
            f"{where}: the times in column {one_line(again.name)!r} start again; split the file into one file a run, or "
            "name another time column with --time"
        )
    stated = _stated_rate(log)
    if stated is not None:
        return stated
    steady = [c for c in log.columns if not c.kind and _is_steady(log.table[c.name])]
    if steady:
        return _clock(log, steady[0], "its values increase evenly", is_sure=False)
    for name in unread:
        log.table.real(name)  # raises the reason
    listed = ", ".join(one_line(c.name) for c in log.columns[:MOST_LISTED])
    raise BadCase(
        f"{where}: no column counts the time (columns: {listed}); state the sample rate with --rate-hz, or the column with "
        "--time"
    )


def _repeated_times(log: Log, column: ColumnOverview) -> BadCase:
    """Return the error for a time column with equal neighbours."""
    steps = np.diff(log.table.real(column.name))
    count = int(np.sum(steps == 0.0))
    return BadCase(
        f"{one_line(log.path)}: the time in column {one_line(column.name)!r} repeats in {count} of {len(steps) + 1} samples, first in "
        f"sample {int(np.argmin(steps > 0.0)) + 1}; delete the repeated rows, or name another time column with --time"
    )


def _clock(log: Log, column: ColumnOverview, why: str, *, is_sure: bool = True) -> LogClock:
    stated = column.unit if column.unit and units.same_dimension(column.unit, "s") else ""
    values = log.table.real(column.name)
    steps = np.diff(values[np.isfinite(values)])
    if steps.size == 0 or not np.all(steps > 0):
        raise BadCase(
            f"{one_line(log.path)}: the times in column {one_line(column.name)!r} do not increase from row to row; "
            "name another column with --time, or a rate with --rate-hz"
        )
    step = float(np.median(steps))
    unit = stated or (column.guess if column.kind == "time" else "") or _unit_of_step(step)
    said = f"unit {unit} stated" if stated else f"unit {unit} from its steps of {step:.4g}"
    return LogClock(
        time=column.name, unit=unit, why=f"{why}; {said}", is_sure=is_sure and (bool(stated) or unit == "s")
    )


def _stated_rate(log: Log) -> LogClock | None:
    """Return the clock of a column with one period or rate."""
    for column in log.columns:
        word = column.name.rpartition(".")[2].lower()
        if word in (*PERIODS, *RATES) and column.least == column.greatest > 0.0:
            rate = column.least if word in RATES else 1.0 / column.least
            why = f"column {one_line(column.name)!r} is {column.least:g} throughout"
            return LogClock(time=None, rate_hz=float(f"{rate:.12g}"), why=why, is_sure=False)
    return None


def _unit_of_step(step: float) -> str:
    return next(unit for unit, least in (("ns", 1e5), ("us", 500.0), ("ms", 0.5), ("s", 0.0)) if step > least)


def _is_steady(values: np.ndarray) -> bool:
    """Return whether a column may be a clock, not a counter."""
    if np.iscomplexobj(values) or values.size < 3 or not np.isfinite(values).all():
        return False
    steps = np.diff(values)
    middle = float(np.median(steps))
    return bool(np.all(steps > 0) and np.ptp(steps) <= EVEN * middle and not np.all(steps == 1.0))


def check_length(log: Log) -> None:
    """Refuse a log that is too short for a draft.

    Parameters
    ----------
    log : Log
        Log.

    Raises
    ------
    BadRecording
        The log has fewer than `FEWEST` samples.
    """
    rows = max(column.rows for column in log.columns)
    if rows < FEWEST:
        raise BadRecording(
            f"{one_line(log.path)}: {rows} samples; a diagnosis needs at least {FEWEST}, and better some thousand; give a longer log"
        )


def divide(logs: Sequence[Log], clock: LogClock) -> tuple[Part, ...]:
    """Choose the held-out recordings.

    The last third of the logs or episodes is held out. A single log is cut in two parts.

    Parameters
    ----------
    logs : sequence of Log
        Logs in the order of their names.
    clock : LogClock
        Clock of the logs.

    Returns
    -------
    tuple of Part
        Recordings to fit, then held-out recordings.
    """
    paths = [log.path for log in logs]
    if len(logs) > 1:
        kept = math.ceil(len(logs) / HELD_OUT)
        parts = [(paths[:-kept], "fit"), (paths[-kept:], "holdout")]
        return tuple(Part(paths=tuple(some), role=role) for some, role in parts)
    (log,) = logs
    if len(log.episodes) > 1:
        kept = math.ceil(len(log.episodes) / HELD_OUT)
        return (
            Part(paths=(log.path,), role="fit", episodes=log.episodes[:-kept]),
            Part(paths=(log.path,), role="holdout", episodes=log.episodes[-kept:]),
        )
    start, stop = _span(log, clock)
    grain = 10.0 ** math.floor(math.log10(stop - start)) / 100.0
    cut = round(round((start + (stop - start) * (1.0 - 1.0 / HELD_OUT)) / grain) * grain, 9)
    stem, shown = log.path.stem, cut - start if abs(start) > FAR_S else cut  # as a run counts its times
    return (
        Part(paths=(log.path,), role="fit", stop_s=cut, name=f"{stem} before {shown:.6g} s", episodes=log.episodes),
        Part(paths=(log.path,), role="holdout", start_s=cut, name=f"{stem} from {shown:.6g} s", episodes=log.episodes),
    )


def _span(log: Log, clock: LogClock) -> tuple[float, float]:
    """Return the first and the last time of a log [s]."""
    if clock.time is None:
        assert clock.rate_hz is not None
        return 0.0, (max(len(log.table[c.name]) for c in log.columns) - 1) / clock.rate_hz
    values = log.table.real(clock.time)
    values = values[np.isfinite(values)] * units.factor(clock.unit, "s")
    return float(values[0]), float(values[-1])
