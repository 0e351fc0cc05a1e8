"""Loops over the samples of commands, in compiled code."""

import numpy as np

from vlab.compilation import compiled
from vlab.signals import Array


@compiled(error_model="numpy")
def starts_within_slope(commands: Array, most: float) -> Array:  # pragma: no cover - compiled
    """Return signals of limited slope before every command.

    The signals start at zero.

    Parameters
    ----------
    commands : (n, k) array
        Commands.
    most : float
        Largest change within a sample.

    Returns
    -------
    (n, k) array
        Values at the begin of every sample.
    """
    out = np.empty(commands.shape)
    for i in range(commands.shape[1]):
        now = 0.0
        for k in range(commands.shape[0]):
            out[k, i] = now
            way = commands[k, i] - now
            now += most if way > most else -most if way < -most else way
    return out


@compiled(error_model="numpy")
def play_outputs(inputs: Array, thresholds: Array) -> Array:  # pragma: no cover - compiled
    """Return the outputs of play operators from rest.

    Parameters
    ----------
    inputs : (n, m) array
        Input signals.
    thresholds : (k,) array
        Thresholds, in the unit of the inputs.

    Returns
    -------
    (n, m, k) array
        Outputs.
    """
    out = np.empty((inputs.shape[0], inputs.shape[1], len(thresholds)))
    for i in range(inputs.shape[1]):
        for j in range(len(thresholds)):
            now = 0.0
            for k in range(inputs.shape[0]):
                now = min(max(now, inputs[k, i] - thresholds[j]), inputs[k, i] + thresholds[j])
                out[k, i, j] = now
    return out
