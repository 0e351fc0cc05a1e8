"""Quantisation of channels, from the empirical characteristic function.

The function of values on multiples of a step q has a peak at the frequency 1/q. The function of smooth motion has
decayed there, by then below noise. Coarse steps explain a good part of a residual; fine steps are usual.

A motion that dwells at a few positions has such a peak too. Values after a jump of half a step or more must therefore
stand on the steps as well: a quantised channel jumps from step to step, a moving one shows values in between.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import erfc
from scipy.stats import binom

from vlab.cases.channel_map import Run, compared_names
from vlab.diagnose.data.noise import noise_levels
from vlab.diagnose.settings import QUANTISATION, VERDICT
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True)
class SensorStep:
    """Quantisation step of a channel.

    Parameters
    ----------
    channel : str
        Channel.
    step, sd : float
        Step and its standard deviation [SI unit of the channel].
    share : float
        Step over the channel's rms.
    """

    channel: str
    step: float
    sd: float
    share: float

    @property
    def line(self) -> str:
        """Note on a step that counts as noise."""
        return (
            f"{self.channel} stands on steps of {self.step:.3g}, {100 * self.share:.2g} % of its rms: counted as noise"
        )

    def on(self, values: Array) -> Array:
        """Return quantised values."""
        return np.asarray(self.step * np.round(values / self.step))


def sensor_steps(runs: Sequence[Run]) -> tuple[SensorStep, ...]:
    """Identify coarse quantisation of channels, pooled over runs.

    Parameters
    ----------
    runs : sequence of Run
        Recordings.

    Returns
    -------
    tuple of SensorStep
        Steps above the benign size.
    """
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
    """Return the largest quantisation step and its standard deviation, or None."""
    low, high = float(values.min()), float(values.max())
    if not least > 0 or high - low < QUANTISATION.fewest * least:
        return None
    width = least / QUANTISATION.fine
    count, _ = np.histogram(values, np.arange(low, high + 2 * width, width))
    size = 1 << int(np.ceil(np.log2(QUANTISATION.padded * len(count))))
    seen = np.abs(np.fft.rfft(count, size)) / len(values)
    cycles = np.fft.rfftfreq(size, width)
    inside = np.flatnonzero((cycles >= QUANTISATION.fewest / (high - low)) & (cycles <= 1.0 / least))
    if inside.size < 3:
        return None
    still = float(np.median(seen[inside]))  # a constant value has no step
    wanted = np.where(cycles * np.std(values) >= 1.0, QUANTISATION.sharp, QUANTISATION.exact)
    first, last = QUANTISATION.before_peak
    peaks = [
        i
        for i in inside
        if seen[i] >= seen[i - 1]
        and seen[i] >= seen[i + 1]
        and seen[i] - still > wanted[i] * (1.0 - still)
        # values concentrate at rest after a decay, and the function is large everywhere
        and (
            seen[i] - still > QUANTISATION.all * (1.0 - still)
            or seen[i] > QUANTISATION.clear * np.min(seen[int(first * i) : max(int(last * i), int(first * i) + 1)])
        )
    ]
    steps = (_refined(values, cycles[i], cycles[1]) for i in peaks[: QUANTISATION.most_peaks])
    return next((s for s in steps if _stands_on(values, s[0])), None)


def _stands_on(values: Array, step: float) -> bool:
    return _jumps(values, step) and not _passes_between(values, step) and not _lies_between(values, step)


def _jumps(values: Array, step: float) -> bool:
    """Return whether values after a jump stand on the steps."""
    moved = values[1:][np.abs(np.diff(values)) > 0.5 * step]
    least = QUANTISATION.sharp if np.std(values) >= step else QUANTISATION.exact
    return moved.size >= QUANTISATION.fewest_jumps and abs(np.exp(2j * np.pi * moved / step).mean()) > least


def _lies_between(values: Array, step: float) -> bool:
    """Return whether more values lie between steps than noise behind a quantiser puts there.

    A motion between two ends stands on the steps at rest and passes between them. Normal noise of the same modulus of the
    characteristic function leaves fewer values there.
    """
    turns = np.exp(2j * np.pi * values / step)
    modulus = float(abs(turns.mean()))
    away = np.abs(np.angle(turns * np.conj(turns.mean()))) > 2 * np.pi * QUANTISATION.between
    sd = np.sqrt(-2.0 * np.log(min(modulus, 1.0 - 1e-12)))
    expected = max(float(erfc(2 * np.pi * QUANTISATION.between / (np.sqrt(2.0) * sd))), VERDICT.false_alarm_rate)
    return int(np.count_nonzero(away)) > int(binom.isf(VERDICT.false_alarm_rate, len(values), expected))


def _passes_between(values: Array, step: float) -> bool:
    """Return whether a series crosses steps smoothly, as between stops.

    Noise behind a quantiser jumps back and forth instead.
    """
    turns = np.exp(2j * np.pi * values / step)
    turns *= np.conj(turns.mean()) / np.abs(turns.mean())
    between = (
        np.abs(np.angle(turns[1:])) > 2 * np.pi * QUANTISATION.between
    )  # interference and drift on the steps stay near the steps
    return (
        bool(between.any()) and float(np.mean(np.real(turns[1:] * np.conj(turns[:-1]))[between])) > QUANTISATION.smooth
    )


def _refined(values: Array, cycle: float, width: float) -> tuple[float, float]:
    """Return the step at a characteristic function's peak, with standard deviation."""
    fine = np.linspace(cycle - width, cycle + width, QUANTISATION.refined)
    sharp = np.abs(np.exp(2j * np.pi * np.outer(fine, values)).mean(axis=1))
    k = int(np.argmax(sharp))
    step = float(1.0 / fine[k])
    scatter = np.sqrt(max(-2.0 * np.log(min(float(sharp[k]), 1.0)), 1e-12)) * step / (2 * np.pi)
    lever = max(float(np.std(values)) / step, 0.5)
    # a finer converter behind the coarse one rounds its steps the same way every time
    different = len(np.unique(values))
    sd = max(scatter / (lever * np.sqrt(different)), 0.25 * step * step * (fine[1] - fine[0]))
    return step, float(sd)
