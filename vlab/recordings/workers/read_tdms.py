"""Isolated TDMS reader: channels, units and waveform time stamps."""

import io
import logging
from typing import Any

import numpy as np
from nptdms import TdmsFile
from sandbox import Skip  # type: ignore[import-not-found]

_MOST = 10_000


class _Strict(logging.Handler):
    """Log handler that turns npTDMS warnings into errors.

    The warnings concern wrong versions, inconsistent sizes and invalid text.
    """

    def emit(self, record: logging.LogRecord) -> None:
        raise ValueError(f"npTDMS warns: {record.getMessage()[:300]}")


def read(data: bytes, options: dict[str, Any]) -> dict[str, Any]:
    """Return the channels of a file in memory.

    Parameters
    ----------
    data : bytes
        Bytes of the file.
    options : dict of str to object
        ``limit`` [bytes].

    Returns
    -------
    dict of str to object
        ``variables``, ``units``, ``meta`` and ``notes``.

    Raises
    ------
    ValueError
        The file is truncated or too large.
    """
    _check_segments(data)
    logging.getLogger("nptdms").handlers[:] = [_Strict(logging.WARNING)]
    with TdmsFile.open(io.BytesIO(data)) as file:  # reads the description of the samples; the samples follow below
        if file.file_status.incomplete_final_segment:
            raise ValueError("the file is truncated: its last segment is not whole")
        channels = [(group.name, channel) for group in file.groups() for channel in group.channels()]
        declared = sum(len(channel) * max(8, channel.dtype.itemsize) for _, channel in channels)
        if len(channels) > _MOST or declared > options["limit"]:
            what = f"{len(channels)} channels and {declared} bytes"
            raise ValueError(f"the file declares {what}; at most {_MOST} and {options['limit']} are read")
        found: list[tuple[str, Any]] = []
        units: dict[str, str] = {}
        clocks: dict[str, set[tuple[float, float, int]]] = {}
        for group, channel in channels:
            name = f"{group}/{channel.name}"
            values = _samples(channel)
            found.append((name, values))
            unit = channel.properties.get("unit_string")
            if isinstance(unit, str) and unit:
                units[name] = unit
            clock = _clock(channel)
            if clock is not None and isinstance(values, np.ndarray):
                clocks.setdefault(group, set()).add((*clock, values.size))
        for group, shared in clocks.items():
            start, step, size = next(iter(shared))
            if len(shared) == 1:
                found.append((f"{group}/time", start + np.arange(size) * step))
                units[f"{group}/time"] = "s"
            else:
                found.append((f"{group}/time", Skip("not one clock: the channels of the group have several")))
        meta = {str(key): value for key, value in file.properties.items() if isinstance(value, str)}
    return {"variables": found, "units": units, "meta": meta, "notes": []}


def _check_segments(data: bytes) -> None:
    """Check the declared lengths of all segments.

    npTDMS takes an incomplete last segment for the end of the file.
    """
    offset = 0
    while offset < len(data):
        if len(data) - offset < 28 or data[offset : offset + 4] != b"TDSm":
            raise ValueError(f"byte {offset}: no whole head of a segment; the file is truncated or damaged")
        length = int.from_bytes(data[offset + 12 : offset + 20], "little") + 28
        if length > len(data) - offset:
            raise ValueError(f"byte {offset}: a segment of {length} bytes in the {len(data) - offset} that are left")
        offset += length


def _samples(channel: Any) -> Any:
    if channel.dtype.kind not in "biufc":
        return Skip(f"of type {channel.dtype}, not numbers; a time must be in seconds")
    if not len(channel):
        return np.empty(0)
    values = np.asarray(channel[:])  # scaled by the file's own factors
    if len(values) != len(channel):
        raise ValueError(f"channel {channel.name!r} declares {len(channel)} samples and holds {len(values)}")
    return values


def _clock(channel: Any) -> tuple[float, float] | None:
    """Return start and step of a waveform [s]."""
    step, start = (channel.properties.get(key) for key in ("wf_increment", "wf_start_offset"))
    if not isinstance(step, float) or not 0 < step < float("inf"):
        return None
    return (float(start) if isinstance(start, float) else 0.0), step
