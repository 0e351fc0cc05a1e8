"""Conversion of SEP005 dictionaries, the exchange form of SDyPy.

A SEP005 recording [1]_ is a list of dictionaries, one a channel. The keys are ``data``, ``name``, ``unit_str`` and
``fs`` or ``time``; any further key is optional.

References
----------
.. [1] github.com/sdypy/sep, SEP 005: timeseries.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlab import units
from vlab.errors import BadRecording, BadUnit, unknown_name
from vlab.files.text import one_line
from vlab.recordings.assemble import ColumnSpec, own_si
from vlab.recordings.formats.variables import to_float
from vlab.recordings.table import not_finite
from vlab.signals import KIND_UNITS, Channel, Recording, sample_period

_PROHIBITED = "timestamp"
_STRAIN = ("strain", "e")
_KEPT = ("start_timestamp", "end_timestamp", "group", "quantity", "unit_tex")


def from_sep005(
    channels: Sequence[Mapping[str, Any]], *, inputs: Sequence[str] = (), kinds: Mapping[str, str] | None = None
) -> Recording:
    """Return the recording of SEP005 dictionaries in SI.

    Parameters
    ----------
    channels : sequence of mappings
        One dictionary a channel, all with the same time stamps.
    inputs : sequence of str
        Names of the channels that drive the structure.
    kinds : mapping of str to str, optional
        Kind (`vlab.signals.KIND_UNITS`) by channel name. The default is the kind with the dimension of ``unit_str``.

    Returns
    -------
    Recording
        ``meta["sep005"]`` holds the optional text of each channel by name (start of the recording, group, ...).

    Raises
    ------
    BadRecording
        A dictionary that is not SEP005, channels that were not sampled together, or samples that are not finite
        numbers.
    BadUnit
        A unit is unknown or does not fit its kind.
    UnknownName
        A name in `inputs` or `kinds` is no channel.
    """
    if isinstance(channels, Mapping) or not channels:
        raise BadRecording("SEP005 is a list of dictionaries, one a channel; at least one is needed")
    names = [_text(entry, i, "name") for i, entry in enumerate(channels)]
    for name in (*inputs, *(kinds or {})):
        if name not in names:
            raise unknown_name("channel", name, names, where="SEP005")
    samples = [_array(e.get("data"), f"channel {one_line(n)!r}: data") for e, n in zip(channels, names, strict=True)]
    time = _time(channels[0], names[0], samples[0].size)
    columns, labels, notes = [], [], {}
    for i, (entry, name, values) in enumerate(zip(channels, names, samples, strict=True)):
        if values.size != time.size or (i and not np.array_equal(_time(entry, name, values.size), time)):
            raise BadRecording(
                f"SEP005: channel {one_line(name)!r} was not sampled together with {one_line(names[0])!r}; "
                "resample it, or make a recording of each"
            )
        label, factor = _spec(entry, i, name, kinds or {}, inputs)
        columns.append(values * factor)
        labels.append(label)
        texts = {key: str(entry[key]) for key in _KEPT if entry.get(key) is not None}
        notes.update({name: texts} if texts else {})
    own = channels[0].get("vlab")
    meta = dict(own.get("meta", {})) if isinstance(own, Mapping) else {}
    meta |= {"sep005": notes} if notes else {}
    return Recording(time=time, data=np.column_stack(columns), channels=tuple(labels), meta=meta)


def to_sep005(recording: Recording) -> list[dict[str, Any]]:
    """Return a recording as SEP005 dictionaries.

    An even recording with time stamps exactly k / rate has ``fs``; any other has ``time``. Kinds, places and notes,
    which SEP005 lacks, are under ``vlab``.

    Parameters
    ----------
    recording : Recording
        Recording in SI.

    Returns
    -------
    list of dict of str to object
        One dictionary a channel.
    """
    clock: dict[str, Any] = {"time": recording.time.copy()}
    if recording.is_uniform:
        for rate in (round(recording.rate, 6), recording.rate):
            if np.array_equal(np.arange(len(recording)) / rate, recording.time):
                clock = {"fs": rate}
                break
    return [
        {
            "name": channel.name,
            "data": recording.data[:, i].copy(),
            "unit_str": channel.unit,
            **clock,
            "vlab": {"kind": channel.kind, "at": channel.at, "input": channel.is_input, "meta": dict(recording.meta)},
        }
        for i, channel in enumerate(recording.channels)
    ]


def _text(entry: Any, index: int, key: str) -> str:
    if not isinstance(entry, Mapping) or not isinstance(entry.get(key), str):
        raise BadRecording(f"SEP005: entry {index} has no text {key!r}; each needs data, name, unit_str and fs or time")
    if _PROHIBITED in entry:
        raise BadRecording(f"SEP005: entry {index} has the key 'timestamp', which the form prohibits; use time or fs")
    return str(entry[key])


def _array(values: Any, what: str) -> NDArray[Any]:
    try:
        array = to_float(np.asarray(values))
    except (ValueError, TypeError) as error:
        raise BadRecording(f"SEP005: {what} is no list of numbers: {one_line(error)}") from error
    if isinstance(array, str) or np.iscomplexobj(array) or array.ndim != 1 or not array.size:
        raise BadRecording(f"SEP005: {what} is no list of real numbers")
    if not np.isfinite(array).all():
        raise BadRecording(f"SEP005: {what}: {not_finite(array)}; cut the gap out of the recording")
    return array


def _time(entry: Mapping[str, Any], name: str, count: int) -> NDArray[Any]:
    """Return the time stamps of a channel [s].

    If both are given, time and fs must agree.
    """
    where = f"channel {one_line(name)!r}"
    rate = entry.get("fs")
    if rate is None and entry.get("time") is None:
        raise BadRecording(f"SEP005: {where} has neither fs nor time")
    if rate is not None and not (isinstance(rate, int | float | np.number) and np.isfinite(rate) and rate > 0):
        raise BadRecording(f"SEP005: {where}: fs is {one_line(rate)}; it must be a positive number of Hz")
    if entry.get("time") is None:
        return np.arange(count) / float(rate)  # type: ignore[arg-type]
    time = _array(entry["time"], f"{where}: time")
    if rate is not None and time.size > 1:
        step = sample_period(time)
        if abs(step * float(rate) - 1) > 1e-3:
            raise BadRecording(f"SEP005: {where}: fs is {rate:g} Hz, the time stamps are {step:g} s apart")
    return time


def _spec(
    entry: Mapping[str, Any], index: int, name: str, kinds: Mapping[str, str], inputs: Sequence[str]
) -> tuple[Channel, float]:
    unit = _text(entry, index, "unit_str").translate(units.SIGNS)
    own = entry.get("vlab")
    own = own if isinstance(own, Mapping) else {}
    kind = kinds.get(name) or str(own.get("kind", "")) or _kind(unit, name, str(entry.get("quantity", "")))
    spec = ColumnSpec(
        column=name,
        kind=kind,
        unit=unit,
        at=str(own.get("at", "")),
        name=name,
        is_input=name in inputs or own.get("input") is True,
    )
    if unit == "" and KIND_UNITS[kind] is None:
        return Channel(name=name, kind=kind, unit="", at=spec.at, is_input=spec.is_input), 1.0
    try:
        return spec.channel_and_factor()
    except BadUnit as error:
        raise BadUnit(f"SEP005: channel {one_line(name)!r} ({kind}): {error}") from error


def _kind(unit: str, name: str, quantity: str) -> str:
    """Return the kind of channel with a unit's dimension."""
    try:
        si = own_si(unit)
    except BadUnit as error:
        raise BadUnit(f"SEP005: channel {one_line(name)!r}: {error}") from error
    if si == "1":
        return "strain" if quantity in _STRAIN else "other"
    return next((kind for kind, kind_unit in KIND_UNITS.items() if kind_unit == si), "other")
