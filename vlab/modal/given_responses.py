"""Given frequency responses: checks, SI units and choice of channels."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from vlab import units
from vlab.errors import BadRecording, unknown_name
from vlab.modal.frf import MeasuredFrequencyResponse
from vlab.modal.quantities import DRIVES, kind_of_unit, response_unit_of, split_unit
from vlab.signals import KIND_UNITS, ORDER, FrequencyResponse


def in_si(frf: FrequencyResponse) -> MeasuredFrequencyResponse:
    """Return the lines above 0 Hz in SI.

    Sensors measure no response at 0 Hz.

    Parameters
    ----------
    frf : FrequencyResponse
        Responses of motions of one kind, by their unit.

    Returns
    -------
    MeasuredFrequencyResponse
        Responses in SI.

    Raises
    ------
    BadRecording
        The unit names no motion or no input, or the responses are magnitudes without a phase.
    """
    if getattr(frf, "is_magnitude", False):
        raise BadRecording("the responses are magnitudes only; poles need a phase: give complex responses")
    above, below = split_unit(frf.unit)
    motion, drive = kind_of_unit(above, tuple(ORDER)), kind_of_unit(below, (*DRIVES, *ORDER))
    if not motion or not drive:
        raise BadRecording(
            f"the response of {', '.join(frf.outputs[:4])} has the unit {frf.unit!r}; accepted: a motion per force, moment, "
            "voltage, current or motion of the base, such as 'm/s^2/N'"
        )
    si = [KIND_UNITS[motion] or "", KIND_UNITS[drive] or ""]
    factor = units.factor(above, si[0]) / units.factor(below, si[1])
    kept = {name: getattr(frf, name) for name in ("freq", "H", "outputs", "inputs", "coherence")}
    if isinstance(frf, MeasuredFrequencyResponse):
        kept |= {name: getattr(frf, name) for name in ("n_averages", "resolution_hz", "added_decay")}
        kept["variance"] = None if frf.variance is None else frf.variance * factor**2
    kept |= {"H": frf.H * factor, "unit": response_unit_of(*si)}
    given = MeasuredFrequencyResponse(**kept)
    return given.between(np.finfo(float).tiny, np.inf)


def motion_of(frf: FrequencyResponse) -> str:
    """Return the kind of motion of a response in SI."""
    return kind_of_unit(split_unit(frf.unit)[0], tuple(ORDER))


def displacement_unit(frf: FrequencyResponse) -> str:
    """Return the unit of a response in SI after integration to displacements."""
    is_angle = motion_of(frf).startswith("ang")
    return response_unit_of("rad" if is_angle else "m", split_unit(frf.unit)[1])


def chosen_channels(
    frf: MeasuredFrequencyResponse, inputs: Sequence[str], outputs: Sequence[str]
) -> MeasuredFrequencyResponse | None:
    """Return the responses of some outputs to some inputs.

    Parameters
    ----------
    frf : MeasuredFrequencyResponse
        Responses.
    inputs, outputs : sequence of str
        Names; all if empty.

    Returns
    -------
    MeasuredFrequencyResponse or None
        Chosen responses; None if the response has none of them.
    """
    rows = [frf.outputs.index(name) for name in outputs or frf.outputs if name in frf.outputs]
    columns = [frf.inputs.index(name) for name in inputs or frf.inputs if name in frf.inputs]
    if not rows or not columns:
        return None
    changes: dict[str, Any] = {
        "H": frf.H[:, rows][:, :, columns],
        "outputs": tuple(frf.outputs[k] for k in rows),
        "inputs": tuple(frf.inputs[k] for k in columns),
        "coherence": None if frf.coherence is None else frf.coherence[:, rows],
        "variance": None if frf.variance is None else frf.variance[:, rows][:, :, columns],
    }
    return replace(frf, **changes)


def choose(
    responses: Sequence[MeasuredFrequencyResponse], inputs: Sequence[str], outputs: Sequence[str]
) -> tuple[MeasuredFrequencyResponse, ...]:
    """Return the chosen responses of several.

    Parameters
    ----------
    responses : sequence of MeasuredFrequencyResponse
        Responses.
    inputs, outputs : sequence of str
        Names; all if empty.

    Returns
    -------
    tuple of MeasuredFrequencyResponse
        Chosen responses.

    Raises
    ------
    UnknownName
        No response has an input or output of that name.
    BadRecording
        No response belongs to both a chosen input and a chosen output.
    """
    for side, names in (("input", inputs), ("output", outputs)):
        known = dict.fromkeys(name for frf in responses for name in getattr(frf, f"{side}s"))
        for name in names:
            if name not in known:
                raise unknown_name(side, name, known)
    chosen = tuple(part for frf in responses if (part := chosen_channels(frf, inputs, outputs)) is not None)
    if not chosen:
        raise BadRecording(f"no response of {', '.join(outputs)} to {', '.join(inputs)} was given; name others")
    return chosen
