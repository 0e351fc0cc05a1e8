"""Assembly of a recording from columns: labels and SI units."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vlab import units
from vlab.errors import BadRecording, BadUnit, unknown_name
from vlab.files.text import one_line
from vlab.recordings.files import refuse
from vlab.recordings.table import Table
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
    """

    column: str
    kind: str
    unit: str = ""
    at: str = ""
    name: str = ""
    scale: float | None = None
    offset: float = 0.0
    is_input: bool = False

    def __post_init__(self) -> None:
        if self.kind not in KIND_UNITS:
            raise BadRecording(
                str(unknown_name("kind of channel", self.kind, KIND_UNITS, where=f"column {self.column!r}"))
            )
        if self.scale is not None and not (np.isfinite(self.scale) and self.scale != 0.0):
            raise BadRecording(f"column {self.column!r}: the scale is {self.scale}; it must be finite and not zero")

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
        Name of the time column. Exactly one of `rate_hz` and `time` is given.
    time_unit : str
        Unit of the time column.
    start_s, stop_s : float, optional
        Kept range start <= t < stop [s], in the file's time.

    Returns
    -------
    Recording
        In SI; ``meta["file"]`` names the file.

    Raises
    ------
    BadRecording
        Rate and time both or neither given, unequal lengths, complex columns, times that do not increase, or fewer than
        two samples in the window.
    BadUnit
        A unit is unknown, does not fit its kind or contradicts the file.
    UnknownName
        A column is not in the file.
    """
    if not columns:
        raise refuse(table.path, "no column was chosen", fix="describe at least one channel")
    data, channels = [], []
    for spec in columns:
        values = table.real(spec.column)
        try:
            channel, factor = spec.channel_and_factor()
            if spec.scale is None:
                table.check_unit(spec.column, spec.unit, channel.unit)
        except BadUnit as error:
            raise BadUnit(f"{one_line(table.path)}: column {one_line(spec.column)!r} ({spec.kind}): {error}") from error
        with np.errstate(over="ignore"):  # a later check for finite samples finds an overflow
            data.append((values - spec.offset) * factor)
        channels.append(channel)
    stamps = _times(table, columns[0].column, rate_hz, time, time_unit)
    _check_lengths(table, columns, data, stamps.size, time)
    keep = (stamps >= (-np.inf if start_s is None else start_s)) & (stamps < (np.inf if stop_s is None else stop_s))
    if keep.sum() < 2:
        span = f"{stamps[0]:g} to {stamps[-1]:g} s"
        raise refuse(
            table.path, f"{keep.sum()} samples from start {start_s} to stop {stop_s} s; the recording runs from {span}"
        )
    try:
        matrix = np.column_stack(data)[keep]
        return Recording(time=stamps[keep], data=matrix, channels=tuple(channels), meta={"file": str(table.path)})
    except BadRecording as error:
        raise refuse(table.path, str(error)) from error


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
        if values.size != samples:
            what = f"column {spec.column!r} has {values.size} samples, {against} {samples}"
            raise refuse(table.path, what, fix="they were not sampled together")


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
    return np.arange(table[first].size) / rate_hz
