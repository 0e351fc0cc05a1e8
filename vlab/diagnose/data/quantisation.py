"""Steps of coarse readings, found in the recordings before any model is asked.

Values that a converter or an encoder has rounded stand on multiples of its step, or close to them where noise comes after
it: the characteristic function of their distribution has a peak at one cycle per step, where that of any smooth motion has
long died away. Fine steps are what every laboratory has; coarse ones are a good part of what a model fails to explain.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vlab.cases.channel_map import Run, compared_names
from vlab.diagnose.data.noise import noise_levels
from vlab.diagnose.settings import QUANTISATION
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True)
class SensorStep:
    """The step of a channel's readings.

    Parameters
    ----------
    step, sd : float
        In the channel's unit.
    share : float
        Of the step in the channel's rms.
    """

    channel: str
    step: float
    sd: float
    share: float

    def on(self, values: Array) -> Array:
        """Return values as they are read."""
        return np.asarray(self.step * np.round(values / self.step))


def sensor_steps(runs: Sequence[Run]) -> tuple[SensorStep, ...]:
    """Return the steps of channels whose readings are coarse, pooled over runs."""
    out = []
    for channel in compared_names(runs):
        even = [run for run in runs if run.measured.is_uniform and channel in run.measured.names]
        if not even:
            continue
        columns = [run.measured[channel] for run in even]
        noise = float(np.median([noise_levels(run, [channel]) for run in even]))
        found = _step(np.concatenate(columns), QUANTISATION.over_noise * noise)
        rms = float(np.sqrt(np.mean([np.var(column) for column in columns])))
        if found is not None and found[0] > QUANTISATION.benign_step * rms:
            out.append(SensorStep(channel=channel, step=found[0], sd=found[1], share=found[0] / rms))
    return tuple(out)


def _step(values: Array, least: float) -> tuple[float, float] | None:
    """Return the largest step that values stand on and its standard deviation; None where there is none above the least."""
    low, high = float(values.min()), float(values.max())
    if not least > 0 or high - low < QUANTISATION.fewest * least:
        return None
    width = least / QUANTISATION.fine
    count, _ = np.histogram(values, np.arange(low, high + 2 * width, width))
    size = 1 << int(np.ceil(np.log2(8 * len(count))))
    seen = np.abs(np.fft.rfft(count, size)) / len(values)
    cycles = np.fft.rfftfreq(size, width)
    inside = np.flatnonzero((cycles >= QUANTISATION.fewest / (high - low)) & (cycles <= 1.0 / least))
    if inside.size < 3:
        return None
    still = float(np.median(seen[inside]))  # what stands still has no step of its own
    wanted = np.where(cycles * np.std(values) >= 1.0, QUANTISATION.sharp, QUANTISATION.exact)
    peaks = [
        i
        for i in inside
        if seen[i] >= seen[i - 1]
        and seen[i] >= seen[i + 1]
        and seen[i] - still > wanted[i] * (1.0 - still)
        # values crowd about rest after a decay: then the function is as large all the way
        and (
            seen[i] - still > QUANTISATION.all * (1.0 - still)
            or seen[i] > QUANTISATION.clear * np.min(seen[int(0.3 * i) : max(int(0.8 * i), int(0.3 * i) + 1)])
        )
    ]
    steps = (_refined(values, cycles[i], cycles[1]) for i in peaks[: QUANTISATION.most_peaks])
    return next((step for step in steps if not _passes_between(values, step[0])), None)


def _passes_between(values: Array, step: float) -> bool:
    """Return whether a series goes from one multiple of a step to the next through what lies between, as an axis does that is driven
    from stop to stop: noise that comes after a rounding jumps there, and back."""
    turns = np.exp(2j * np.pi * values / step)
    turns *= np.conj(turns.mean()) / np.abs(turns.mean())
    between = (
        np.abs(np.angle(turns[1:])) > 2 * np.pi * QUANTISATION.between
    )  # hum and drift on top of the steps stay near them
    return (
        bool(between.any()) and float(np.mean(np.real(turns[1:] * np.conj(turns[:-1]))[between])) > QUANTISATION.smooth
    )


def _refined(values: Array, cycle: float, width: float) -> tuple[float, float]:
    """Return the step near a peak of the characteristic function, and its standard deviation."""
    fine = np.linspace(cycle - width, cycle + width, 81)
    sharp = np.abs(np.exp(2j * np.pi * np.outer(fine, values)).mean(axis=1))
    k = int(np.argmax(sharp))
    step = float(1.0 / fine[k])
    scatter = np.sqrt(max(-2.0 * np.log(min(float(sharp[k]), 1.0)), 1e-12)) * step / (2 * np.pi)
    lever = max(float(np.std(values)) / step, 0.5)
    # a finer converter behind the coarse one rounds its steps the same way every time
    different = len(np.unique(values))
    sd = max(scatter / (lever * np.sqrt(different)), 0.25 * step * step * (fine[1] - fine[0]))
    return step, float(sd)
