"""Universal files: functions of data sets 58 and 58b as columns.

Frequency responses (complex) and time histories (real) are columns named by node: ``12+Z``, or response/reference
``12+Z/1+X``. The common abscissa is the column ``time``, ``f`` or ``abscissa``. If abscissae differ, each function has
its own, named ``f of 12+Z/1+X``. Data sets of any other number are counted and skipped. See `vlab.recordings.formats.uff58` for
one data set.
"""

import zlib
from collections import Counter
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlab.recordings.files import PathLike, refuse, written_whole
from vlab.recordings.formats.uff58 import CLOCK, Function, Lying, clock_of, clock_text, function_text, read_function
from vlab.recordings.response_labels import ResponseLabel
from vlab.recordings.table import FORMAT_VERSION, MAX_COLUMNS, Table, check_version, read_channel
from vlab.signals import Channel, FrequencyResponse, Recording

_EDGE = b"    -1"
_ABSCISSA = {17: ("time", "s"), 18: ("f", "Hz")}
_DATA_TYPES = {"displacement": 8, "velocity": 11, "acceleration": 12, "force": 13, "moment": 13, "strain": 3}
_KINDS = {
    8: ("displacement", "angle"),
    11: ("velocity", "angular-velocity"),
    12: ("acceleration", "angular-acceleration"),
    13: ("force", "moment"),
}
"""Kinds along and about an axis, by specific data type."""
_RESPONSES = (0, 4)
"""Function types of complex functions of frequency that are responses: unknown, and frequency response."""
_SIGNATURE = "vlab-recording"


def read(
    data: bytes,
    path: Path,
    *,
    names: Sequence[str] | None = None,
    columns: Sequence[str] | None = None,
    blanks: Collection[str] = frozenset(),
) -> Table:
    """Read a universal file, see `vlab.recordings.open_table`.

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
        Functions as columns.

    Raises
    ------
    BadRecording
        The file is damaged or has no data set 58.
    """
    if names is not None:
        raise refuse(path, "a universal file names its own functions", fix="leave out names")
    try:
        functions, others = _functions(data)
    except Lying as error:
        raise refuse(path, str(error), fix="the file is damaged or cut short; copy or export it again") from error
    if not functions:
        found = ", ".join(sorted(others)) or "none"
        raise refuse(path, f"no data set 58 in the file (found: {found})", fix="export functions as data set 58")
    if functions[0].ids[3].startswith(_SIGNATURE):
        return _own_table(functions, path, columns)
    notes = [f"{count} data sets {number} skipped" for number, count in sorted(others.items())]
    return _table(functions, path, columns, notes)


def _functions(data: bytes) -> tuple[list[Function], Counter[str]]:
    """Return the functions, and the count of skipped data sets."""
    functions: list[Function] = []
    others: Counter[str] = Counter()
    offset = 0
    while (start := _line(data, offset)) is not None:
        line, end = start
        if not line.strip():
            offset = end
            continue
        if line.rstrip() != _EDGE:
            raise Lying(f"byte {offset}: {line[:40]!r} where a data set begins with -1")
        head = _line(data, end)
        number = b"" if head is None else head[0][:7].strip()
        if head is None or not number.removesuffix(b"b").isdigit():
            raise Lying(f"byte {end}: a data set without a number: the file is truncated")
        if number in (b"58", b"58b"):
            function, offset = read_function(data, end)
            functions.append(function)
        else:
            others[number.decode()] += 1
            offset = head[1]
            if number.endswith(b"b"):
                raise Lying(f"the binary data set {number.decode()} has no length that is known; it cannot be skipped")
            while (part := _line(data, offset)) is not None and part[0].rstrip() != _EDGE:
                offset = part[1]
        closing = _line(data, offset)
        if closing is None or closing[0].rstrip() != _EDGE:
            raise Lying(f"data set {number.decode()} does not end with -1: the file is truncated")
        offset = closing[1]
        if len(functions) + sum(others.values()) > MAX_COLUMNS:
            raise Lying(f"more than {MAX_COLUMNS} data sets")
    return functions, others


def _line(data: bytes, offset: int) -> tuple[bytes, int] | None:
    if offset >= len(data):
        return None
    end = data.find(b"\n", offset) + 1 or len(data)
    return data[offset:end], end


def _label(function: Function) -> str:
    return f"{function.response}/{function.reference}" if function.has_reference else function.response


def _table(functions: list[Function], path: Path, columns: Sequence[str] | None, notes: list[str]) -> Table:
    found: dict[str, NDArray[Any]] = {}
    units: dict[str, str] = {}
    first = functions[0]
    is_shared = all(
        f.abscissa_type == first.abscissa_type and np.array_equal(f.abscissa, first.abscissa) for f in functions
    )
    times = Counter[str]()
    responses = []
    for function in functions:
        label = _label(function)
        times[label] += 1
        label += f" #{times[label]}" if times[label] > 1 else ""
        name, unit = _ABSCISSA.get(function.abscissa_type, ("abscissa", ""))
        axis = name if is_shared else f"{name} of {label}"
        found[axis] = function.abscissa
        units[axis] = function.abscissa_unit or unit
        found[label] = function.values
        if function.unit:
            units[label] = function.unit
        if function.kind in _RESPONSES and np.iscomplexobj(function.values):
            responses.append(_response_label(function, label, axis))
        title = function.ids[0]
        notes.append(f"{label}: {title}" if title and title != "NONE" else label)
    if any(f.is_even and not f.ids[4].startswith(CLOCK) for f in functions):
        notes.append("even abscissae are as the header rounds them, to 6 digits: a clock may be off by 1 in 1e6")
    if columns is not None:
        found = {name: values for name, values in found.items() if name in columns} or found
    units = {name: unit for name, unit in units.items() if unit and name in found}
    kept = tuple(one for one in responses if one.column in found and one.frequency in found)
    return Table(path=path, columns=found, notes=tuple(notes), units=units, responses=kept)


def _response_label(function: Function, column: str, axis: str) -> ResponseLabel:
    kinds = [_KINDS.get(code, ("", "")) for code in (function.data_type, function.reference_type)]
    motion, drive = (
        pair["R" in place] for pair, place in zip(kinds, (function.response, function.reference), strict=True)
    )
    return ResponseLabel(
        output=function.response,
        input=function.reference if function.has_reference else "",
        motion=motion,
        drive=drive,
        column=column,
        frequency=axis,
    )


# ------------------------------------------------------------------------------------------------- vlab's own form


def write_uff(recording: Recording, path: PathLike) -> tuple[str, ...]:
    """Write a recording as data sets 58b, see `vlab.recordings.write_recording`.

    There is one data set a channel. The samples are exact. Time stamps of the exact form start + k / rate are exact
    too; a note gives the change of any other. Uneven time stamps are refused, because the format keeps them in single
    precision.

    Parameters
    ----------
    recording : Recording
        Recording in SI.
    path : str or path
        Path of the file.

    Returns
    -------
    tuple of str
        Losses.

    Raises
    ------
    BadRecording
        The time stamps are uneven, or the recording has no channel.
    """
    if not recording.is_uniform:
        fix = "resample it, or write .parquet or .mat"
        raise refuse(path, "UFF 58 keeps uneven time stamps in single precision only", fix=fix)
    law, lost = clock_of(recording.time)
    notes = [] if lost == 0.0 else [f"the time stamps became even: they change by up to {lost:.3g} s"]
    if recording.meta:
        notes.append("the notes (meta) are not kept in UFF 58")
    texts = []
    for i, channel in enumerate(recording.channels):
        side = "input" if channel.is_input else "output"
        ids = (
            channel.name,
            "; ".join((channel.kind, channel.unit, channel.at, side)),
            "",
            f"{_SIGNATURE} {FORMAT_VERSION} {i + 1} {len(recording.channels)}",
            clock_text(law),
        )
        ids = (*ids[:2], _checksum(ids, recording.data[:, i]), *ids[3:])
        _check_ids(ids, path, channel)
        function = Function(
            ids=ids,
            kind=1,
            response=str(i + 1),
            abscissa=recording.time,
            values=np.ascontiguousarray(recording.data[:, i]),
            abscissa_type=17,
            abscissa_unit="s",
            unit=channel.unit,
            data_type=_DATA_TYPES.get(channel.kind, 0),
            is_even=True,
        )
        texts.append(function_text(function, law))
    if not texts:
        raise refuse(path, "a recording without channels cannot be written as UFF 58", fix="write .parquet")
    with written_whole(path) as stream:
        for text in texts:
            stream.write(text)
    return tuple(notes)


def write_uff_response(response: FrequencyResponse, path: PathLike) -> tuple[str, ...]:
    """Write frequency responses as data sets 58b.

    The data are complex doubles, one data set for each output and input. On reading, the columns are ``f`` and ``1/2``
    for the first output and second input; the notes hold the names.

    Parameters
    ----------
    response : FrequencyResponse
        Responses over even frequencies.
    path : str or path
        Path of the file.

    Returns
    -------
    tuple of str
        Losses.

    Raises
    ------
    BadRecording
        The frequencies are uneven; the format keeps them in single precision only.
    OutputRefused
        The folder cannot be written.
    """
    law, lost = clock_of(response.freq)
    steps = np.diff(response.freq)
    if not steps.size or np.ptp(steps) > 1e-4 * steps.mean():
        raise refuse(path, "UFF 58 keeps uneven frequencies in single precision only", fix="write even frequencies")
    notes = [f"the frequencies became even: they change by up to {lost:.3g} Hz"] if lost else []
    notes += ["the coherence is not kept"] if response.coherence is not None else []
    with written_whole(path) as stream:
        for i, output in enumerate(response.outputs):
            for k, given in enumerate(response.inputs):
                ids = (f"{output} / {given}", "NONE", "NONE", "NONE", clock_text(law))
                _check_ids(ids, path, None)
                function = Function(
                    ids=ids,
                    kind=4,
                    response=str(i + 1),
                    reference=str(k + 1),
                    abscissa=response.freq,
                    values=np.ascontiguousarray(response.H[:, i, k]),
                    abscissa_type=18,
                    abscissa_unit="Hz",
                    unit=response.unit,
                    is_even=True,
                )
                stream.write(function_text(function, law))
    return tuple(notes)


def _check_ids(ids: tuple[str, ...], path: PathLike, channel: Channel | None) -> None:
    fits = all(1 <= len(text) <= 80 and text.isascii() and text.isprintable() and text == text.strip() for text in ids)
    if not fits or (channel is not None and any(";" in part for part in (channel.kind, channel.unit, channel.at))):
        name = ids[0] if channel is None else channel.name
        fix = "rename it in plain text of at most 80 signs, or write .parquet"
        raise refuse(path, f"the labels of {name!r} cannot be written as UFF text", fix=fix)
    if channel is not None and (len(channel.unit) > 20 or ids[1] != "; ".join(_labels(ids)[1:])):
        raise refuse(path, f"the labels of channel {channel.name!r} cannot be written as UFF text", fix="rename it")


def _checksum(ids: Sequence[str], values: NDArray[Any]) -> str:
    labels = zlib.crc32("\n".join([*ids[:2], *ids[3:]]).encode("ascii", errors="replace"))
    return f"crc32 {zlib.crc32(np.ascontiguousarray(values, dtype='<f8').tobytes(), labels):08x}"


def _labels(ids: Sequence[str]) -> list[str]:
    return [ids[0], *(part.strip() for part in ids[1].split(";"))]


def _own_table(functions: list[Function], path: Path, columns: Sequence[str] | None) -> Table:
    """Return the table of a `write_uff` file.

    Every label is checked for consistency.
    """
    found: dict[str, NDArray[Any]] = {}
    channels = []
    for i, function in enumerate(functions):
        version, number, count = [*function.ids[3].split()[1:], "", "", ""][:3]
        check_version(version, path)
        if (number, count) != (str(i + 1), str(len(functions))):
            what = f"function {i + 1} of {len(functions)} is labelled {function.ids[3]!r}"
            raise refuse(path, what, fix="the file is truncated or was edited; copy it again")
        channel = read_channel(_labels(function.ids), path)
        if not function.ids[4].startswith(CLOCK) or function.ids[2] != _checksum(function.ids, function.values):
            what = f"the samples or labels of {channel.name!r} are not those that were written"
            raise refuse(path, what, fix="the file was edited or is damaged")
        if np.iscomplexobj(function.values) or channel.name in ("time", *found):
            raise refuse(path, f"channel {channel.name!r} stands twice or is complex", fix="the file is damaged")
        if i and not np.array_equal(function.abscissa, found["time"]):
            raise refuse(path, "the channels have not the same time stamps", fix="the file was edited or is damaged")
        found.setdefault("time", function.abscissa)
        found[channel.name] = function.values
        channels.append(channel)
    if columns is not None:
        found = {name: values for name, values in found.items() if name in columns} or found
    return Table(path=path, columns=found, channels=tuple(c for c in channels if c.name in found))
