"""Comparison of recorded and simulated channels in third-octave bands.

A nominal model's frequencies are off by some per cent. Near a lightly damped resonance phase and size therefore differ,
also over time. Between resonances model and recording agree. Hence every band counts alike, whatever its power.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from vlab.signals import Array, ComplexArray

WIDTH = 1.25
"""WIDTH [1]: ratio of a band's edges, a third of an octave. The band is wider than the frequency error of a nominal
model."""
LINES = 4
"""LINES [1]: fewest spectral lines in a band, and below the first band. A Hann window widens a line by two on both
sides."""
STRONG = 1e-4
"""STRONG [1]: smallest power of a band relative to the strongest simulated band. Weaker bands contain window
leakage."""
UPPER = 0.8
"""UPPER [1]: highest frequency used, as a share of half the sample rate. Above it filters and holds shape the
recording."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Bands:
    """Power and cross-power of recorded and simulated channels.

    Parameters
    ----------
    hz : (n,) array
        Lower band edges [Hz].
    recorded, simulated : (n,) array
        Power in each band.
    cross : (n,) complex array
        Power of the recorded signal times the conjugate simulated signal.
    of_line : (n_lines,) array of int
        Band of every spectral line; -1 outside all bands.
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
        """Real part of the coherence in each band, (n,).

        The range is -1 (opposite sign) to 1.
        """
        return np.asarray(self.cross.real / np.sqrt(self.recorded * self.simulated))

    @cached_property
    def log_ratio(self) -> Array:
        """Logarithm of recorded over simulated amplitude, (n,)."""
        return np.asarray(0.5 * np.log(self.recorded / self.simulated))

    def agreeing(self, sign: float, least: float) -> float:
        """Return the share of bands with a given sign.

        Parameters
        ----------
        sign : float
            1 or -1.
        least : float
            Smallest likeness that counts.
        """
        return float(np.mean(sign * self.likeness >= least))

    def remains(self, factor: float = 1.0) -> Array:
        """Return the residual share of recorded power, (n,).

        Parameters
        ----------
        factor : float
            Factor on the simulation.

        Returns
        -------
        array
            Share in each band, at most 1.
        """
        power = self.recorded - 2.0 * factor * self.cross.real + factor**2 * self.simulated
        return np.asarray(np.minimum(power / self.recorded, 1.0))

    def left(self, factor: float = 1.0) -> float:
        """Return the median residual share over the bands."""
        return float(np.median(self.remains(factor)))


def together(found: Sequence[Bands]) -> Bands:
    """Return the joined bands of several channels."""
    joined = {
        name: np.concatenate([getattr(b, name) for b in found]) for name in ("hz", "recorded", "simulated", "cross")
    }
    return Bands(**joined, of_line=np.zeros(0, dtype=int))


def bands(time: Array, recorded: Array, simulated: Array) -> Bands:
    """Return the bands of two simultaneous channels.

    A constant channel has no bands.

    Parameters
    ----------
    time : (n,) array
        Time stamps [s]; both channels are interpolated if uneven.
    recorded, simulated : (n,) array

    Returns
    -------
    Bands
        Bands with enough lines and power.
    """
    freq, (Y, S) = spectra(time, recorded, simulated)
    return bands_of_spectra(freq, Y, S, lowest=(LINES - 1) * freq[1] if len(freq) > 1 else np.inf)


def spectra(time: Array, *columns: Array) -> tuple[Array, list[ComplexArray]]:
    """Return Hann-windowed spectra about the mean.

    Parameters
    ----------
    time : array
        Time stamps [s].
    columns : array
        Signals, (n,) each.

    Returns
    -------
    tuple of (array, list of complex array)
        Frequencies [Hz] up to `UPPER`, and one spectrum a column.
    """
    n = len(time)
    grid = np.linspace(time[0], time[-1], n)
    if not np.allclose(grid, time, rtol=0.0, atol=1e-4 * (grid[1] - grid[0])):
        columns = tuple(np.interp(grid, time, column) for column in columns)
    window = np.hanning(n)
    freq = np.fft.rfftfreq(n, grid[1] - grid[0])
    keep = freq <= UPPER * 0.5 / (grid[1] - grid[0])
    return freq[keep], [np.fft.rfft((c - c.mean()) * window)[keep] for c in columns]


def bands_of_spectra(freq: Array, recorded: ComplexArray, simulated: ComplexArray, lowest: float = 0.0) -> Bands:
    """Return bands of two spectra or responses.

    Only bands with strong simulated power remain.

    Parameters
    ----------
    freq : (n,) array
        Increasing frequencies [Hz].
    recorded : complex array
        Recorded spectrum or response, (n,).
    simulated : complex array
        Simulated spectrum or response, (n,).
    lowest : float
        Lowest frequency used [Hz].

    Returns
    -------
    Bands
        Bands.
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
    """Return bands of two responses with equal weight a line.

    The amplitude of a band is the median ratio, its direction the mean direction. Power weights would be wrong here. A
    response has no weak input lines, and a sharp resonance would hold all power of a band.

    Parameters
    ----------
    freq : (n,) array
        Increasing frequencies [Hz].
    measured, own : (n,) complex array
        Nonzero responses of measurement and model.

    Returns
    -------
    Bands
        Bands.
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
    """Return the first line of each band, and the end.

    The end is one past the last line of the last band. Lines below `lowest` belong to no band.
    """
    edges = [int(np.searchsorted(freq, lowest))]
    while edges[-1] < len(freq):
        edges.append(max(int(np.searchsorted(freq, WIDTH * freq[edges[-1]])), edges[-1] + LINES))
    starts = np.array([start for start, end in pairwise(edges) if end <= len(freq)], dtype=int)
    return starts, edges[len(starts)]
