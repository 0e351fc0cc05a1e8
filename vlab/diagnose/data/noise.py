"""Noise of recorded channels, and how the noise was obtained.

The first of these sources that a channel has counts:

1. the noise that the case states;
2. the differences of repeats: all noise, of any colour, through the structure as well;
3. the floor of one record: white noise of the sensor alone.

The third is a lower bound of what the best model leaves. Noise of other colour and noise through the structure look like
missing physics in one record.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np

from vlab.cases.channel_map import Run
from vlab.diagnose.data.noise_floor import FloorSource, even_floor, uneven_floor
from vlab.diagnose.data.repeats import repeat_noise
from vlab.diagnose.settings import NOISE
from vlab.signals import ORDER, Array

NoiseSource = Literal["stated", "recordings", "periods"] | FloorSource
_WORDS: dict[str, str] = {
    "stated": "as the case states",
    "recordings": "from the differences of {count} repeated recordings",
    "periods": "from the differences of {count} periods",
    "spectrum": "from the floor of the spectrum",
    "inputs": "from the spectrum without the response to the inputs",
    "innovations": "from the innovations of a linear model",
    "neighbours": "from the differences of neighbouring samples",
    "steps": "from the steps of the readings",
    "least": "assumed, as the recording shows less",
}


@dataclass(frozen=True, kw_only=True)
class NoiseEstimate:
    """Noise of one channel of a recording.

    Parameters
    ----------
    sigma : float
        Standard deviation for the weights of a fit: of equivalent white noise, or of all noise between repeats [SI].
    rms : float
        Noise rms that the best model leaves, after any low-pass of the recording [SI].
    source : str
        ``"stated"``, ``"recordings"``, ``"periods"``, or a source of `Floor`.
    count : int
        Number of repeats; 0 without.
    """

    sigma: float
    rms: float
    source: NoiseSource
    count: int = 0

    @property
    def is_of_repeats(self) -> bool:
        """Whether the estimate holds all noise, mains interference included."""
        return self.source in ("recordings", "periods")

    @property
    def words(self) -> str:
        """How the noise was obtained, in words."""
        return _WORDS[self.source].format(count=self.count)


@lru_cache(maxsize=128)
def estimate_noise(run: Run, channel: str) -> NoiseEstimate:
    """Estimate the noise of a channel of a run.

    Parameters
    ----------
    run : Run
        Recording.
    channel : str
        Channel.

    Returns
    -------
    NoiseEstimate
        Noise with its source.
    """
    measured, read = run.measured, run.measured.is_read(channel)
    known = known_noise(run, channel, measured[channel])
    time = None if measured.is_uniform and read.all() else measured.time[read]
    return known or _of_record(time, measured[channel][read], _inputs(run), is_motion(run, channel))


def is_motion(run: Run, channel: str) -> bool:
    """Return whether a channel is a motion under held inputs.

    Neither displacement nor velocity can answer the present input that is held from its sample; an input that varies up to its sample can act before.
    """
    return (
        all(drive.is_held for drive in run.drives)
        and ORDER.get(run.measured.channels[run.measured.index(channel)].kind, 2) < 2
    )


def noise_levels(run: Run, names: Sequence[str]) -> Array:
    """Return the noise levels (n_names,) of a run's channels."""
    return np.array([estimate_noise(run, name).sigma for name in names])


def known_noise(run: Run, channel: str, column: Array, thin: int = 1) -> NoiseEstimate | None:
    """Return stated noise, or noise between repeats.

    Stated noise counts as white at the rate of the file, so a thinned record keeps a part of the noise.

    Parameters
    ----------
    run : Run
        Recording.
    channel : str
        Channel of the recording.
    column : (n,) array
        Channel on its clock [SI].
    thin : int
        Decimation factor of the clock.

    Returns
    -------
    NoiseEstimate or None
        Stated noise, or the noise between repeats; None without either.
    """
    least = NOISE.least_noise * (float(np.std(column)) or 1.0)
    stated = next((c.noise for c in run.compared if c.channel == channel), None)
    if stated is not None:
        level = max(stated / np.sqrt(thin), least)
        return NoiseEstimate(sigma=level, rms=level, source="stated")
    repeats = repeat_noise(run, channel)
    if repeats is None:
        return None
    level = max(repeats.rms(thin), least)
    return NoiseEstimate(sigma=level, rms=level, source=repeats.of, count=repeats.count)


def uneven_noise(time: Array, column: Array) -> float:
    """Return the noise level at uneven times.

    Parameters
    ----------
    time : (n,) array
        Time stamps [s].
    column : (n,) array
        Channel [SI].

    Returns
    -------
    float
        Standard deviation [unit of the channel].
    """
    return uneven_floor(time, column).sigma


def noise_level(column: Array, inputs: Array | None = None, *, is_motion: bool = False) -> float:
    """Return the noise level of an evenly sampled channel.

    Parameters
    ----------
    column : (n,) array
        Channel [SI].
    inputs : (n, k) array or None
        Inputs; response to the inputs is no noise. Without inputs every floor is noise.
    is_motion : bool
        Whether the channel is a displacement or a velocity.

    Returns
    -------
    float
        Standard deviation [unit of the channel].
    """
    return even_floor(column, inputs, is_motion=is_motion).sigma


def noise_notes(runs: Sequence[Run], names: Sequence[str]) -> list[str]:
    """Return lines on the noise of channels.

    A line gives the noise over the rms, and the source.

    Parameters
    ----------
    runs : sequence of Run
        Recordings.
    names : sequence of str
        Channels.

    Returns
    -------
    list of str
        Lines with the median over the recordings.
    """
    lines = []
    for name in names:
        found = [(estimate_noise(run, name), float(np.std(run.measured[name]))) for run in runs]
        moving = [(noise.rms / size, noise.words) for noise, size in found if size > 0]
        if moving:
            middle = sorted(moving)[(len(moving) - 1) // 2]
            lines.append(f"noise of {name}: {100 * middle[0]:.2g} % of its rms, {middle[1]}")
    return lines


def _of_record(time: Array | None, column: Array, inputs: Array | None, is_motion: bool) -> NoiseEstimate:
    floor = even_floor(column, inputs, is_motion=is_motion) if time is None else uneven_floor(time, column)
    return NoiseEstimate(sigma=floor.sigma, rms=floor.rms, source=floor.source)


def _inputs(run: Run) -> Array | None:
    return np.column_stack([run.measured[drive.channel] for drive in run.drives]) if run.drives else None
