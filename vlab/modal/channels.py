"""Input and output channels of a recording: checks and response unit."""

import numpy as np

from vlab.errors import BadRecording
from vlab.modal.quantities import response_unit_of
from vlab.signals import Array, Recording


def checked_data(
    recording: Recording, inputs: tuple[str, ...], outputs: tuple[str, ...], skip_s: float
) -> tuple[float, Array, Array]:
    """Return time step and samples of inputs and outputs.

    Parameters
    ----------
    recording : Recording
        Recording in SI.
    inputs, outputs : tuple of str
        Channel names.
    skip_s : float
        Time to drop at the start [s].

    Returns
    -------
    tuple of (float, array, array)
        Step [s], inputs and outputs, (n, n_channels) each.

    Raises
    ------
    BadRecording
        No or repeated channels, uneven time steps, no data left, or a constant input.
    """
    columns = [recording.index(name) for name in inputs + outputs]
    if not inputs or not outputs:
        what = "input" if not inputs else "output"
        raise BadRecording(
            f"no {what} channel: name the {what}s, or mark inputs with is_input (has: {recording.names})"
        )
    for name in inputs + outputs:
        if (inputs + outputs).count(name) > 1:
            raise BadRecording(f"channel {name!r} is named more than once among inputs and outputs")
    if not recording.is_uniform:
        steps = np.diff(recording.time)
        raise BadRecording(
            f"time steps from {steps.min():g} to {steps.max():g} s: a frequency response needs even sampling; resample "
            "first"
        )
    dt = float(recording.time[-1] - recording.time[0]) / (len(recording) - 1)
    first = max(0, int(np.ceil(skip_s / dt - 1e-6)))
    data = recording.data[first:, columns]
    if len(data) < 2:
        raise BadRecording(f"skip_s = {skip_s:g} s leaves nothing of {len(recording) * dt:g} s")
    x, y = data[:, : len(inputs)], data[:, len(inputs) :]
    for name, column in zip(inputs, x.T, strict=True):
        if np.ptp(column) <= 1e-12 * np.abs(column).max():  # a few thousand times one sample's rounding error
            raise BadRecording(f"input channel {name!r} is constant ({column[0]:g}): nothing was excited by it")
    return dt, x, y


def response_unit(recording: Recording, inputs: tuple[str, ...], outputs: tuple[str, ...]) -> str:
    """Return the common unit of H.

    Parameters
    ----------
    recording : Recording
        Recording in SI.
    inputs : tuple of str
        Names of the inputs.
    outputs : tuple of str
        Names of the outputs.

    Returns
    -------
    str
        Unit; "" if units differ.
    """
    over, under = ({recording.channels[recording.index(n)].unit for n in names} for names in (outputs, inputs))
    if len(over) != 1 or len(under) != 1:
        return ""
    return response_unit_of(over.pop(), under.pop())
