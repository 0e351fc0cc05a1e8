"""Zeros of channels: every fit has them free, and those that are off by more than any laboratory's are physics left out."""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from vlab.diagnose.parameters.terms import Fit
from vlab.diagnose.problem import Problem
from vlab.diagnose.settings import SENSOR_OFFSET
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True)
class SensorOffset:
    """A channel whose zero is off.

    Parameters
    ----------
    offset, sd : float
        In the channel's unit; the spread is that of the zeros of single recordings.
    """

    channel: str
    offset: float
    sd: float


def find_sensor_offsets(problem: Problem, fit: Fit, unknown: Collection[str] = ()) -> tuple[SensorOffset, ...]:
    """Return the channels whose zeros a fit puts far off, where no effect of the fit says so already.

    Parameters
    ----------
    unknown : collection of str
        Channels of whose zeros nothing was known, see `vlab.diagnose.parameters.static_offset`.
    """
    said = {t.place.index for t in fit.terms if t.effect.name in ("sensor-offset", "sensor-drift")}
    benign, error = _benign(problem, fit)
    out = []
    for i, (name, offset) in enumerate(zip(problem.names, fit.offsets, strict=True)):
        if i not in said and name not in unknown and abs(offset) > benign[i]:
            samples = sum(len(run) for run in problem.signals)
            spread = float(error[i] / np.sqrt(max(samples, 1)))
            out.append(SensorOffset(channel=name, offset=float(offset), sd=max(spread, 0.01 * abs(float(offset)))))
    return tuple(out)


def explained_sensor_offsets(problem: Problem, fit: Fit) -> tuple[str, ...]:
    """Return the channels whose zeros an effect of a fit puts as far off: a refit without it must not have them among its own."""
    benign, _ = _benign(problem, fit)
    offsets = {t.place.index: t.values["offset"] for t in fit.terms if t.effect.name == "sensor-offset"}
    return tuple(problem.names[i] for i, offset in offsets.items() if abs(offset) > benign[i])


def _benign(problem: Problem, fit: Fit) -> tuple[Array, Array]:
    """Return how far off every channel's zero may be, and what a fit leaves of it, (n_channels,) each."""
    scale = np.max([run.scale for run in problem.signals], axis=0)
    error = np.sqrt(np.mean(fit.error**2, axis=0)) * scale
    return np.maximum(SENSOR_OFFSET.benign_offset * scale, SENSOR_OFFSET.over_error * error), error
