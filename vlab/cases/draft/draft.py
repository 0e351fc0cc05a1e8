"""Draft of a case from a model and its logs."""

import collections
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from vlab.cases.draft.logs import Log, LogClock, Part, check_length, choose_clock, divide, open_log
from vlab.cases.draft.matching import LeftOut, Match, Matched, match_columns, unused_places
from vlab.cases.draft.model import open_model, relative, without_column
from vlab.cases.draft.text import case_text, jumps_of
from vlab.cases.draft.unit_choice import CONFIRMED, choose_units, percent, residual_share
from vlab.cases.draft.wraps import with_wraps
from vlab.cases.places import joints_of
from vlab.cases.written_out import natural_key
from vlab.errors import BadCase
from vlab.files.text import one_line
from vlab.plants.base import Plant
from vlab.recordings.bound import RECORDING
from vlab.recordings.table import MOST_LISTED


@dataclass(frozen=True, kw_only=True)
class Draft:
    """Drafted case.

    Parameters
    ----------
    text : str
        Text of the case file.
    channels : tuple of Match
        Matched columns.
    left_out : tuple of LeftOut
        Columns without use.
    clock : LogClock
        Clock of the logs.
    parts : tuple of Part
        Recordings with their roles.
    unsure : tuple of str
        Guesses and gaps for the user to look at.
    leaves_folder : bool
        Whether a file lies outside the folder of the case.
    """

    text: str
    channels: tuple[Match, ...]
    left_out: tuple[LeftOut, ...]
    clock: LogClock
    parts: tuple[Part, ...]
    unsure: tuple[str, ...]
    leaves_folder: bool

    def to_json(self) -> dict[str, Any]:
        """Return plain values for a JSON document."""
        return {
            "channels": [
                {
                    "column": m.label,
                    "at": m.at,
                    "kind": m.kind,
                    "unit": m.unit,
                    "input": m.is_input,
                    "why": m.why,
                    "why_unit": m.why_unit,
                    "sure": m.is_sure,
                }
                for m in self.channels
            ],
            "unsure": list(self.unsure),
            "left_out": [{"column": left.label, "why": left.why} for left in self.left_out],
            "time": {
                "column": self.clock.time,
                "unit": self.clock.unit,
                "rate_hz": self.clock.rate_hz,
                "why": self.clock.why,
                "sure": self.clock.is_sure,
            },
            "recordings": [
                {
                    "files": [str(path) for path in part.paths],
                    "role": part.role,
                    "episodes": list(part.episodes),
                    "start_s": part.start_s,
                    "stop_s": part.stop_s,
                }
                for part in self.parts
            ],
            "allow_outside": self.leaves_folder,
        }


def draft_case(
    model: str, logs: Sequence[Path], folder: Path, *, time: str | None = None, rate_hz: float | None = None
) -> Draft:
    """Draft a case.

    Parameters
    ----------
    model : str
        MJCF file, structure file, or built-in structure.
    logs : sequence of Path
        Recordings or run folders; their names give the order.
    folder : Path
        Folder of the case file.
    time : str, optional
        Time column, where the names do not tell.
    rate_hz : float, optional
        Sample rate of logs without times [Hz].

    Returns
    -------
    Draft
        Text of the case file, and how the text came about.

    Raises
    ------
    BadCase
        No column fits the model, no column counts the time, or the arguments are no model and logs.
    BadRecording
        A log is damaged.
    BadStructure
        The model cannot be built.
    """
    logs = [path / RECORDING if (path / RECORDING).is_file() else path for path in logs]  # a run folder
    unique = {os.path.realpath(path): path for path in logs}  # a log that is named twice would verify itself
    counts = collections.Counter(map(os.path.realpath, logs))
    again = [f"{unique[p].name} is named {n} times and taken once" for p, n in counts.items() if n > 1]
    paths = sorted(unique.values(), key=lambda path: natural_key(str(path)))
    opened = open_model(model, folder)
    read = [open_log(path) for path in paths]
    clock = choose_clock(read[0], time=time, rate_hz=rate_hz)
    check_length(read[0])
    matched = match_columns(read[0], opened.plant, clock.time)
    if not any(not match.is_input for match in matched.used):
        raise _no_output(read[0], opened.plant, matched, opened.hints)
    kept, aside = _alike(read, clock, matched.used)
    channels = choose_units(read[0], clock, opened.plant, with_wraps(kept, matched.used))
    clock, channels = _confirmed(read[0], clock, opened.plant, channels)
    parts = divide(kept, clock)
    remarks = [*again, *matched.unread, *aside, *opened.hints, *_doubts(opened.plant, channels)]
    text = case_text(opened, folder, kept, parts, clock, channels, matched.left_out, remarks)
    doubtful = _doubtful(channels)
    if not clock.is_sure:
        what = f"{clock.rate_hz:g} Hz" if clock.time is None else f"{one_line(clock.time)} is the time in {clock.unit}"
        doubtful.insert(0, f"{what}: {one_line(clock.why)}")
    return Draft(
        text=text,
        channels=channels,
        left_out=matched.left_out,
        clock=clock,
        parts=parts,
        unsure=(*doubtful, *remarks),
        leaves_folder=opened.is_outside or any(relative(log.path, folder)[1] for log in kept),
    )


def _confirmed(
    log: Log, clock: LogClock, plant: Plant, channels: Sequence[Match]
) -> tuple[LogClock, tuple[Match, ...]]:
    """Return guesses as sure where the simulation follows the readings.

    No other clock and no other order of the places leaves so little. A common unit of all angles may.
    """
    if clock.is_sure and all(match.is_place_sure for match in channels):
        return clock, tuple(channels)
    left = residual_share(log, clock, plant, channels)
    if left > CONFIRMED:
        return clock, tuple(channels)
    said = f"simulated so, {percent(left)} of the readings is left over"
    sure = clock if clock.is_sure else replace(clock, why=f"{clock.why}; {said}", is_sure=True)
    return sure, tuple(
        match if match.is_place_sure else replace(match, why=f"{match.why}; {said}", is_place_sure=True)
        for match in channels
    )


def _alike(logs: Sequence[Log], clock: LogClock, used: Sequence[Match]) -> tuple[list[Log], list[str]]:
    """Return the logs like the first, and remarks on the others."""
    wanted = [match.label for match in used] + ([clock.time] if clock.time is not None else [])
    kept, aside = [], []
    for log in logs:
        known = {name for column in log.columns for name in (column.name, log.label(column.name))}
        lacking = [name for name in wanted if name not in known]
        if lacking:
            aside.append(f"{log.path.name} is left out, for the file has no column {', '.join(map(repr, lacking))}")
        else:
            kept.append(log)
    return kept, aside


def _doubts(plant: Plant, channels: Sequence[Match]) -> list[str]:
    """Return remarks on what the columns leave open."""
    out = without_column(unused_places(plant, channels))
    if not any(match.is_input for match in channels):
        out.insert(0, "no column drives the model: the recordings count as free motion")
    return out


def _doubtful(channels: Sequence[Match]) -> list[str]:
    """Return the guesses on columns, one line a reason."""
    out = [
        f"{one_line(m.label)} {'drives' if m.is_input else 'shows'} {one_line(m.at)}: {one_line(m.why)}"
        for m in channels
        if not m.is_place_sure
    ]
    out += [f"{one_line(m.label)} is read with unwrap = true: {jumps_of(m)}" for m in channels if m.wraps]
    reasons: dict[str, list[str]] = {}
    for m in channels:
        if not m.is_unit_sure:
            why = m.why_unit if m.scale is None else f"state scale, the model unit per {m.unit}"
            reasons.setdefault(f"{m.unit}: {why}", []).append(one_line(m.label))
    return out + [f"{', '.join(names[:MOST_LISTED])} in {one_line(reason)}" for reason, names in reasons.items()]


def _no_output(log: Log, plant: Plant, matched: Matched, hints: Sequence[str]) -> BadCase:
    """Return the error for a log without any motion of the model."""
    sensors = [tap.name for tap in plant.sensors]
    sites = [name for name in plant.ports if name.startswith("site:")]
    places = [*sensors, *(f"joint:{name}" for name in joints_of(plant)), *sites]
    names = [log.label(c.name) for c in log.columns]
    driven = [match.label for match in matched.used]
    found = f", only inputs ({', '.join(map(repr, driven))})" if driven else ""
    reasons = [*matched.unread, *hints]
    why = f"; {reasons[0]}" if reasons else ""
    return BadCase(
        f"{one_line(log.path)}: no column shows a sensor, joint or site of the model{found}; columns: "
        f"{', '.join(map(repr, names[:MOST_LISTED]))}; places: {', '.join(places[:MOST_LISTED]) or 'none'}{why}; "
        "name a column after its joint, sensor or site, or write the case by hand"
    )
