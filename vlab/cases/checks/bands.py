"""A recorded channel beside a simulated one by bands of frequency, in each of which they say the same, the opposite or nothing.

A model of which nothing was fitted is off by some per cent in its frequencies, so at a light resonance it has another phase and size
than the thing, over time as well. Between the resonances both agree. Bands of a third of an octave therefore all count alike,
however much power is in them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from vlab.signals import Array, ComplexArray

WIDTH = 1.25
"""Ratio of a band's edges: a third of an octave, wider than a naive model's frequencies are off."""
LINES = 4
"""Fewest lines of a spectrum in a band, also below the first one: a Hann window widens a line by two on both sides."""
STRONG = 1e-4
"""Bands of a simulation with a smaller share of its strongest one's power hold what its window leaks."""
UPPER = 0.8
"""Share of half the sample rate above which filters and holds, not the model, shape a recording."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Bands:
    """Power and cross-power of a recorded and a simulated channel.

    Parameters
    ----------
    hz : (n,) array
        Lower edges.
    recorded, simulated : (n,) array
        Power in each band.
    cross : (n,) complex array
        Of the recorded times the conjugate simulated.
    of_line : (n_lines,) array of int
        The band of every line of the spectra; -1 of those in none.
    """

    hz: Array
    recorded: Array
    simulated: Array
    cross: ComplexArray
    of_line: Array

    def __len__(self) -> int:
        return len(self.hz)

    @cached_property
    def likeness(self) -> Array:
        """Real part of the coherent share in each band, from -1 (turned) to 1, (n,)."""
        return np.asarray(self.cross.real / np.sqrt(self.recorded * self.simulated))

    @cached_property
    def log_ratio(self) -> Array:
        """Logarithm of the recorded over the simulated size in each band, (n,)."""
        return np.asarray(0.5 * np.log(self.recorded / self.simulated))

    def agreeing(self, sign: float, least: float) -> float:
        """Return the share of the bands in which both are alike with a sign, by at least so much."""
        return float(np.mean(sign * self.likeness >= least))

    def remains(self, factor: float = 1.0) -> Array:
        """Return the share of the recorded power that the simulation times a factor leaves in each band; at most 1, (n,)."""
        power = self.recorded - 2.0 * factor * self.cross.real + factor**2 * self.simulated
        return np.asarray(np.minimum(power / self.recorded, 1.0))

    def left(self, factor: float = 1.0) -> float:
        """Return the median of what remains over the bands."""
        return float(np.median(self.remains(factor)))


def together(found: Sequence[Bands]) -> Bands:
    """Return the bands of several channels as those of one."""
    joined = {
        name: np.concatenate([getattr(b, name) for b in found]) for name in ("hz", "recorded", "simulated", "cross")
    }
    return Bands(**joined, of_line=np.zeros(0, dtype=int))


def bands(time: Array, recorded: Array, simulated: Array) -> Bands:
    """Return two channels sampled at the same times by bands; no band where either stands still.

    Parameters
    ----------
    time : (n,) array
        [s]; where it is uneven both are interpolated.
    recorded, simulated : (n,) array
    """
    freq, (Y, S) = spectra(time, recorded, simulated)
    return bands_of_spectra(freq, Y, S, lowest=(LINES - 1) * freq[1])


def spectra(time: Array, *columns: Array) -> tuple[Array, list[ComplexArray]]:
    """Return frequencies [Hz], up to `UPPER`, and the spectra of columns about their means under a Hann window."""
    n = len(time)
    grid = np.linspace(time[0], time[-1], n)
    if not np.allclose(grid, time, rtol=0.0, atol=1e-4 * (grid[1] - grid[0])):
        columns = tuple(np.interp(grid, time, column) for column in columns)
    window = np.hanning(n)
    freq = np.fft.rfftfreq(n, grid[1] - grid[0])
    keep = freq <= UPPER * 0.5 / (grid[1] - grid[0])
    return freq[keep], [np.fft.rfft((c - c.mean()) * window)[keep] for c in columns]


def bands_of_spectra(freq: Array, recorded: ComplexArray, simulated: ComplexArray, lowest: float = 0.0) -> Bands:
    """Return two spectra, or responses, by bands in which the simulated one is strong.

    Parameters
    ----------
    freq : (n,) array
        Increasing [Hz].
    lowest : float
        Lines below are left out [Hz].
    """
    starts, last = _edges(freq, lowest)
    of_line = np.full(len(freq), -1)
    Y, S = recorded[:last], simulated[:last]
    if not len(starts):
        none = np.zeros(0)
        return Bands(hz=none, recorded=none, simulated=none, cross=none.astype(complex), of_line=of_line)
    with np.errstate(over="ignore", invalid="ignore"):
        power = [np.add.reduceat(np.abs(x) ** 2, starts) for x in (Y, S)]
        cross = np.add.reduceat(Y * np.conj(S), starts)
    usable = np.isfinite(power[0]) & np.isfinite(power[1]) & (power[0] > 0.0) & (power[1] > 0.0)
    usable &= power[1] >= STRONG * np.max(power[1], initial=0.0, where=usable)
    band = np.searchsorted(starts, np.arange(starts[0], last), side="right") - 1
    of_line[starts[0] : last] = np.where(usable, np.cumsum(usable) - 1, -1)[band]
    return Bands(
        hz=freq[starts][usable],
        recorded=power[0][usable],
        simulated=power[1][usable],
        cross=cross[usable],
        of_line=of_line,
    )


def bands_of_responses(freq: Array, measured: ComplexArray, own: ComplexArray) -> Bands:
    """Return two responses by bands in which every line counts alike: the median of their ratio, and the mean of its direction.

    A response has no input whose weak lines would be noise, and resonances so sharp that their power is all of a band's.

    Parameters
    ----------
    freq : (n,) array
        Increasing [Hz].
    measured, own : (n,) complex array
        Of a measurement and of a model, without zeros.
    """
    starts, last = _edges(freq, 0.0)
    ratio = measured[:last] / own[:last]
    parts = np.split(ratio, starts[1:]) if len(starts) else []
    size = np.array([np.exp(np.median(np.log(np.abs(part)))) for part in parts])
    direction = np.array([np.mean(part / np.abs(part)) for part in parts], dtype=complex)
    return Bands(
        hz=freq[starts],
        recorded=size**2,
        simulated=np.ones(len(parts)),
        cross=size * direction,
        of_line=np.repeat(np.arange(len(parts)), [len(part) for part in parts]),
    )


def _edges(freq: Array, lowest: float) -> tuple[Array, int]:
    """Return the first lines of the bands, and one past the last line of the last one; lines below a frequency are in none."""
    edges = [int(np.searchsorted(freq, lowest))]
    while edges[-1] < len(freq):
        edges.append(max(int(np.searchsorted(freq, WIDTH * freq[edges[-1]])), edges[-1] + LINES))
    starts = np.array([start for start, end in pairwise(edges) if end <= len(freq)], dtype=int)
    return starts, edges[len(starts)]
