"""Sensor offsets, free in every fit and reported where large."""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from vlab.diagnose.parameters.terms import Fit
from vlab.diagnose.problem import Problem
from vlab.diagnose.settings import SENSOR_OFFSET
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True)
class SensorOffset:
    """Large offset of a channel.

    Parameters
    ----------
    channel : str
        Channel.
    offset, sd : float
        Offset and its standard deviation [SI unit of the channel].
    """

    channel: str
    offset: float
    sd: float


def find_sensor_offsets(problem: Problem, fit: Fit, unknown: Collection[str] = ()) -> tuple[SensorOffset, ...]:
    """Return a fit's large sensor offsets beside those of effects.

    Parameters
    ----------
    problem : Problem
        Problem.
    fit : Fit
        Fit.
    unknown : collection of str
        Channels with a subtracted static offset.

    Returns
    -------
    tuple of SensorOffset
        Offsets.
    """
    explained = {t.place.index for t in fit.terms if t.effect.name in ("sensor-offset", "sensor-drift")}
    benign, error = _benign(problem, fit)
    out = []
    for i, (name, offset) in enumerate(zip(problem.names, fit.offsets, strict=True)):
        if i not in explained and name not in unknown and abs(offset) > benign[i]:
            samples = sum(len(run) for run in problem.signals)
            spread = float(error[i] / np.sqrt(max(samples, 1)))
            out.append(
                SensorOffset(
                    channel=name, offset=float(offset), sd=max(spread, SENSOR_OFFSET.least_sd * abs(float(offset)))
                )
            )
    return tuple(out)


def explained_sensor_offsets(problem: Problem, fit: Fit) -> tuple[str, ...]:
    """Return channels whose large offset is an effect of a fit.

    A refit without that effect must not absorb the offset.

    Parameters
    ----------
    problem : Problem
        Problem.
    fit : Fit
        Fit.

    Returns
    -------
    tuple of str
        Channels.
    """
    benign, _ = _benign(problem, fit)
    offsets = {t.place.index: t.values["offset"] for t in fit.terms if t.effect.name == "sensor-offset"}
    return tuple(problem.names[i] for i, offset in offsets.items() if abs(offset) > benign[i])


def _benign(problem: Problem, fit: Fit) -> tuple[Array, Array]:
    """Return the benign offset and residual of every channel, (n_channels,)."""
    scale = np.max([run.scale for run in problem.signals], axis=0)
    error = np.sqrt(np.mean(fit.error**2, axis=0)) * scale
    return np.maximum(SENSOR_OFFSET.benign_offset * scale, SENSOR_OFFSET.over_error * error), error
