"""Assembly of a recording from columns: labels and SI units."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vlab import units
from vlab.errors import BadRecording, BadUnit, unknown_name
from vlab.files.text import one_line
from vlab.recordings.clocks import OnClock, filled, held, held_on, line_on, reading_on
from vlab.recordings.files import refuse
from vlab.recordings.table import Table
from vlab.recordings.wraps import unwrapped
from vlab.signals import KIND_UNITS, Array, Channel, Recording

_SI = (
    "1",
    "rad/s",
    *dict.fromkeys(unit for unit in KIND_UNITS.values() if unit),
    "Hz",
    "rad/s^2",
    "Pa",
    "W",
    "kg",
    "s",
    "N/m",
    "K",
    "T",
)
"""SI units for channels of a free kind; the first unit of the right dimension applies."""

ROUNDING = 0.02
"""ROUNDING [steps]: largest distance of a time stamp from an even grid. At half the sample rate the distance turns the
phase by 3.6 degrees."""


@dataclass(frozen=True, kw_only=True)
class ColumnSpec:
    """Description of one column of a file.

    Parameters
    ----------
    column : str
        Name of the column in the file.
    kind : str
        One of `vlab.signals.KIND_UNITS`.
    unit : str
        Unit of the numbers in the file.
    at : str
        Place, actuator or sensor of the channel.
    name : str
        Channel name in the recording; by default the place, or else the column.
    scale : float, optional
        Model unit per file unit, in place of the unit conversion.
    offset : float
        Reading at zero, in the unit of the file; the offset is subtracted.
    is_input : bool
        Whether the channel drives the structure.
    is_held : bool
        Whether an input with a time of its own stays constant between its samples.
    stands : bool
        Whether blank cells of an input stand for the last value.
    unwrap : bool
        Whether the jumps of an angle by a full turn are removed.
    time, time_unit : str
        Time column of the channel alone, and its unit; the recording's by default.
    """

    column: str
    kind: str
    unit: str = ""
    at: str = ""
    name: str = ""
    scale: float | None = None
    offset: float = 0.0
    is_input: bool = False
    is_held: bool = False
    stands: bool = False
    unwrap: bool = False
    time: str = ""
    time_unit: str = "s"

    def __post_init__(self) -> None:
        if self.kind not in KIND_UNITS:
            raise BadRecording(
                str(unknown_name("kind of channel", self.kind, KIND_UNITS, where=f"column {self.column!r}"))
            )
        if self.scale is not None and not (np.isfinite(self.scale) and self.scale != 0.0):
            raise BadRecording(f"column {self.column!r}: the scale is {self.scale}; it must be finite and not zero")
        if self.unwrap and self.kind != "angle":
            raise BadRecording(f"column {self.column!r}: unwrap is for an angle, and the column is {self.kind}")

    def channel_and_factor(self) -> tuple[Channel, float]:
        """Return the SI label and the factor from file numbers.

        With a scale, the file's unit no longer determines the channel's unit. A channel of a free kind, and a voltage
        or current that drives an actuator, is then in the model's own unit. Its label has no unit.
        """
        si = KIND_UNITS[self.kind]
        if self.scale is not None:
            is_electric = self.is_input and self.kind in ("voltage", "current")  # scaled to its unit
            unit, factor = "" if is_electric else si or "", float(self.scale)
        else:
            unit = si or own_si(self.unit)
            factor = units.factor(self.unit, unit)
        return Channel(
            name=self.name or self.at or self.column, kind=self.kind, unit=unit, at=self.at, is_input=self.is_input
        ), factor


def own_si(unit: str) -> str:
    """Return the SI unit of the same dimension.

    The function serves channels of a free kind.

    Parameters
    ----------
    unit : str
        Unit as written.

    Returns
    -------
    str
        SI unit.

    Raises
    ------
    BadUnit
        No kind of channel has the dimension.
    """
    if unit in _SI:
        return unit
    angular = any(word in unit for word in ("deg", "rad"))
    candidates = ("Hz",) if unit.endswith("Hz") else ("rad", *_SI) if angular else _SI
    for si in candidates:
        if units.same_dimension(unit, si):
            return si
    units.factor(unit, unit)  # raises the message for an unknown unit
    raise BadUnit(
        f"unit {unit!r} is of no kind that a channel has ({', '.join(_SI)}); give a scale to the model's unit instead"
    )


def to_recording(
    table: Table,
    columns: Sequence[ColumnSpec],
    *,
    rate_hz: float | None = None,
    time: str | None = None,
    time_unit: str = "s",
    start_s: float | None = None,
    stop_s: float | None = None,
) -> Recording:
    """Label the columns of a table and convert to SI.

    Parameters
    ----------
    table : Table
        The file.
    columns : sequence of ColumnSpec
        Columns to take, in channel order.
    rate_hz : float, optional
        Sample rate [Hz] of a file without a time column; the first sample is then at t = 0.
    time : str, optional
        Name of the time column. Exactly one of `rate_hz` and `time` is given, unless every channel has its own time:
        the compared channel with most samples then gives the clock.
    time_unit : str
        Unit of the time column.
    start_s, stop_s : float, optional
        Kept range start <= t < stop [s], in the file's time.

    Returns
    -------
    Recording
        In SI; ``meta["file"]`` names the file and ``meta["reading"]`` lists what was put on another clock or left out.
        ``missing`` marks blank cells of compared channels.

    Raises
    ------
    BadRecording
        Rate and time both or neither given, unequal lengths, complex columns, or times that do not increase. Blank cells
        of an input that does not stand, or fewer than two samples in the window.
    BadUnit
        A unit is unknown, does not fit its kind or contradicts the file.
    UnknownName
        A column is not in the file.
    """
    if not columns:
        raise refuse(table.path, "no column was chosen", fix="describe at least one channel")
    labelled = [_labelled(table, spec) for spec in columns]
    channels, data = tuple(channel for channel, _ in labelled), [values for _, values in labelled]
    notes: list[str] = []
    if time is None and rate_hz is None and all(spec.time for spec in columns):
        time, time_unit = _own_clock(table, columns)
    stamps = _times(table, columns[0].column, rate_hz, time, time_unit)
    _check_lengths(table, columns, data, stamps.size, time)
    if time is not None and not np.isfinite(stamps).all():
        stamps, data = _without_blank_times(table, columns, data, stamps, time, notes)
    placed = [_placed(table, spec, v, stamps, notes) for spec, v in zip(columns, data, strict=True)]
    known = np.logical_and.reduce([p.is_known for p in placed])
    if not known.all() and known.any():
        first, last = np.flatnonzero(known)[[0, -1]]
        notes.append(
            f"{int((~known).sum())} samples without a known input left out ({stamps[first]:g} to {stamps[last]:g} s kept)"
        )
    keep = known & _within(stamps, start_s, stop_s)
    if keep.sum() < 2:
        span = f"{stamps[0]:g} to {stamps[-1]:g} s"
        raise refuse(
            table.path, f"{keep.sum()} samples from start {start_s} to stop {stop_s} s; the recording runs from {span}"
        )
    missing = ~np.column_stack([p.is_read for p in placed])
    try:
        matrix = np.column_stack([p.values for p in placed])[keep]
        meta = {"file": str(table.path), **({"reading": tuple(notes)} if notes else {})}
        mask = missing[keep] if missing.any() else None
        return Recording(time=stamps[keep], data=matrix, channels=channels, meta=meta, missing=mask)
    except BadRecording as error:
        raise refuse(table.path, str(error)) from error


def _labelled(table: Table, spec: ColumnSpec) -> tuple[Channel, Array]:
    """Return the label of a column and its values in SI."""
    values = table.real(spec.column)
    try:
        channel, factor = spec.channel_and_factor()
        if spec.scale is None:
            table.check_unit(spec.column, spec.unit, channel.unit)
    except BadUnit as error:
        raise BadUnit(f"{one_line(table.path)}: column {one_line(spec.column)!r} ({spec.kind}): {error}") from error
    with np.errstate(over="ignore"):  # a later check for finite samples finds an overflow
        values = (values - spec.offset) * factor
        return channel, unwrapped(values) if spec.unwrap else values  # an angle is in radians here


def _within(stamps: Array, start_s: float | None, stop_s: float | None) -> Array:
    start, stop = -np.inf if start_s is None else start_s, np.inf if stop_s is None else stop_s
    return np.asarray((stamps >= start) & (stamps < stop))


def on_even_stamps(recording: Recording) -> Recording:
    """Return a recording with rounded stamps back on an even grid.

    A file with six decimals of a second moves a stamp by up to half a microsecond, without any sampling jitter. Stamps
    count as rounded if each is within `ROUNDING` of an even grid. ``meta["stamps"]`` then notes the correction. Any
    other recording is unchanged.

    Parameters
    ----------
    recording : Recording
        Recording in SI.

    Returns
    -------
    Recording
        Recording.
    """
    if recording.is_uniform:
        return recording
    even = np.linspace(recording.time[0], recording.time[-1], len(recording))
    step = float(even[1] - even[0])
    farthest = float(np.abs(recording.time - even).max())
    if farthest > ROUNDING * step:
        return recording
    said = f"put on an even grid of {1 / step:.9g} Hz, by at most {farthest:.2g} s"
    return replace(recording, time=even, meta={**recording.meta, "stamps": said})


def _check_lengths(
    table: Table, columns: Sequence[ColumnSpec], data: list[Array], samples: int, time: str | None
) -> None:
    against = f"column {columns[0].column!r}" if time is None else f"the time column {time!r}"
    for spec, values in zip(columns, data, strict=True):
        if values.size != samples and not spec.time:
            what = f"column {spec.column!r} has {values.size} samples, {against} {samples}"
            raise refuse(
                table.path, what, fix="they were not sampled together; give each channel its time column: time = ..."
            )


def _times(table: Table, first: str, rate_hz: float | None, time: str | None, time_unit: str) -> Array:
    if (rate_hz is None) == (time is None):
        given = "neither a rate nor a time column is" if rate_hz is None else "a rate and a time column are both"
        raise refuse(
            table.path,
            f"{given} given",
            fix=f"give rate_hz or the name of the time column (columns: {', '.join(table.names[:20])})",
        )
    if time is not None:
        try:
            table.check_unit(time, time_unit, "s")
            return np.asarray(table.real(time) * units.factor(time_unit, "s"))
        except BadUnit as error:
            stated = table.units.get(time, "")
            fix = f'; say time_unit = "{one_line(stated)}"' if stated and units.same_dimension(stated, "s") else ""
            raise BadUnit(f"{one_line(table.path)}: time column {one_line(time)!r}: {error}{fix}") from error
    if rate_hz is None or not (np.isfinite(rate_hz) and rate_hz > 0):
        raise refuse(table.path, f"the rate is {rate_hz} Hz; it must be positive")
    rows = np.arange(table[first].size) if table.rows is None else table.rows - table.rows[0]
    return np.asarray(rows / rate_hz)


# ---- clocks of their own and blank cells ----------------------------------------------------------------------------


def _own_clock(table: Table, columns: Sequence[ColumnSpec]) -> tuple[str, str]:
    """Return time column and unit of the compared channel with most samples."""
    outputs = [spec for spec in columns if not spec.is_input] or list(columns)
    best = max(outputs, key=lambda spec: int(np.isfinite(table.real(spec.column)).sum()))
    return best.time, best.time_unit


def _without_blank_times(
    table: Table, columns: Sequence[ColumnSpec], data: list[Array], stamps: Array, time: str, notes: list[str]
) -> tuple[Array, list[Array]]:
    """Return times and columns without the rows whose time is blank.

    A shorter column of a table ends in blank cells.
    """
    is_there = np.isfinite(stamps)
    for spec, values in zip(columns, data, strict=True):
        if not spec.time and np.isfinite(values[~is_there]).any():
            bad = int(np.flatnonzero(~is_there & np.isfinite(values))[0])
            what = f"the time column {time!r} is blank at sample {bad}, where {spec.column!r} has a value"
            raise refuse(table.path, what, fix="fill the times, or give the channel its own time column")
    notes.append(f"{int((~is_there).sum())} rows without a time left out")
    return stamps[is_there], [v if s.time else v[is_there] for s, v in zip(columns, data, strict=True)]


def _placed(table: Table, spec: ColumnSpec, values: Array, stamps: Array, notes: list[str]) -> OnClock:
    """Return a channel on the clock of the recording."""
    if spec.time:
        own = _times(table, spec.column, None, spec.time, spec.time_unit)
        if own.size != values.size:
            what = f"column {spec.column!r} has {values.size} samples, its time column {spec.time!r} {own.size}"
            raise refuse(table.path, what, fix="name the time column of the same topic or table")
        is_there = np.isfinite(own) & ~np.isnan(values)
        own, values = own[is_there], values[is_there]
        _check_own_times(table, spec, own)
        if not np.array_equal(own, stamps):
            return _on_other_clock(spec, own, values, stamps, notes)
    all_known = np.ones(len(values), dtype=bool)
    blank = np.isnan(values)
    if not blank.any():
        return OnClock(values=values, is_known=all_known, is_read=all_known)
    count, first = int(blank.sum()), int(np.argmax(blank))
    if len(values) - count < 2:
        raise refuse(
            table.path, f"column {spec.column!r} has {len(values) - count} readings", fix="name another column"
        )
    if not spec.is_input:
        between, is_read = filled(values)
        notes.append(f"{spec.column}: {count} of {len(values)} samples have no reading and are not compared")
        return OnClock(values=between, is_known=all_known, is_read=is_read)
    if not spec.stands:
        what = f"column {spec.column!r} drives the model and is blank at sample {first} ({count} of {len(values)})"
        fix = 'say blank = "hold" in its channel where the last value stands, or cut the part with start_s and stop_s'
        raise refuse(table.path, what, fix=fix)
    stood, is_known = held(values)
    notes.append(f"{spec.column}: {count} of {len(values)} cells are blank; the last value stands")
    return OnClock(values=stood, is_known=is_known, is_read=is_known)


def _check_own_times(table: Table, spec: ColumnSpec, own: Array) -> None:
    if own.size < 2:
        raise refuse(
            table.path, f"column {spec.column!r} has {own.size} samples with a time", fix="name another column"
        )
    if not np.all(np.diff(own) > 0):
        bad = int(np.argmin(np.diff(own))) + 1
        what = f"the times {spec.time!r} of column {spec.column!r} do not increase at sample {bad} (t = {own[bad]:g} s)"
        raise refuse(table.path, what, fix="name the right time column")


def _on_other_clock(spec: ColumnSpec, own: Array, values: Array, stamps: Array, notes: list[str]) -> OnClock:
    rate = (own.size - 1) / (own[-1] - own[0])
    said = f"{spec.column}: {own.size} samples at {rate:.4g} Hz on their own clock"
    if not spec.is_input:
        out = reading_on(stamps, own, values)
        notes.append(f"{said}, at {int(out.is_read.sum())} of {stamps.size} samples of the recording")
        return out
    notes.append(f"{said}, " + ("as means over the steps of the recording" if spec.is_held else "by straight lines"))
    return held_on(stamps, own, values) if spec.is_held else line_on(stamps, own, values)
