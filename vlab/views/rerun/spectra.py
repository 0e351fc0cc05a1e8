"""Short-time amplitude spectra of the sensors in a Rerun scene, as bars."""

from typing import Any

import numpy as np
import rerun.blueprint as rrb
from scipy import signal

from vlab.signals import Array, Channel, Recording
from vlab.views.figures import channel_label
from vlab.views.rerun.bars import bar_view, log_bars
from vlab.views.rerun.rrd import plain, rgb, time_columns
from vlab.views.rerun.traces import axis_unit

WINDOW_S, EVERY_S = 4.0, 0.5
"""WINDOW_S, EVERY_S [s]: window of a spectrum with lines 0.25 Hz apart, and time between two spectra."""
KEPT = 0.999
"""KEPT [-]: share of the power below the highest line."""
ROWS = 4
"""ROWS [-]: channels on one page."""
_RESPONSES = ("displacement", "velocity", "acceleration", "angle", "angular-velocity", "angular-acceleration", "strain")


class SpectrumScene:
    """Scene of short-time spectra of a recording's responses.

    Parameters
    ----------
    highest_hz : float or None
        Last line [Hz]; by default nearly all power lies below it.
    """

    def __init__(self, recording: Recording, *, highest_hz: float | None = None) -> None:
        self.rate = recording.rate
        self.channels = [c for c in recording.channels if c.kind in _RESPONSES]
        self.length = max(16, round(WINDOW_S * self.rate))
        self.freq = np.fft.rfftfreq(self.length, 1 / self.rate)
        highest = _highest(recording, self.channels) if highest_hz is None else highest_hz
        self.lines = max(2, int(np.searchsorted(self.freq, min(highest, self.rate / 2), side="right")))

    def ends(self, samples: int, since: int = 0) -> Array:
        """Return the last samples of the spectra above `since`."""
        every = max(2, round(EVERY_S * self.rate))
        ends = np.arange(every, samples + 1, every)
        return ends[ends > since]

    def spectra(self, values: Array, ends: Array) -> Array:
        """Return amplitude spectra with a Hann window.

        Parameters
        ----------
        values : array
            Samples of one channel.
        ends : array
            Last samples of the spectra.

        Returns
        -------
        array
            Amplitudes, (n_ends, n_lines).
        """
        out = np.empty((len(ends), self.lines))
        for row, end in zip(out, ends, strict=True):
            part = values[max(0, end - self.length) : end]
            window = signal.windows.hann(len(part), sym=False)
            row[:] = 2 / window.sum() * np.abs(np.fft.rfft((part - part.mean()) * window, self.length))[: self.lines]
        return out

    def log(self, stream: Any, recording: Recording, *, since: int = 0, until: int | None = None) -> None:
        """Log the spectra that end after `since` and by `until`."""
        ends = self.ends(len(recording) if until is None else until, since)
        indexes = time_columns(recording.time[ends - 1], ends - 1)
        for k, channel in enumerate(self.channels):
            rows = axis_unit(channel.unit)[0] * self.spectra(recording[channel.name], ends)
            step = float(self.freq[1])
            log_bars(stream, f"spectra/{k}", indexes, rows, middles=self.freq[: self.lines], width=step, colour=rgb(k))

    def views(self) -> list[Any]:
        """Return the views, on several pages if there are many."""
        views = []
        for k, channel in enumerate(self.channels):
            unit = axis_unit(channel.unit)[1]
            views.append(bar_view(f"{channel_label(channel)}, last {WINDOW_S:g} s [{unit}] over Hz", f"/spectra/{k}"))
        if len(views) <= ROWS:
            return views
        pages = [views[i : i + ROWS] for i in range(0, len(views), ROWS)]
        first = [plain(self.channels[i].name) for i in range(0, len(views), ROWS)]
        return [rrb.Tabs(*(rrb.Vertical(*page, name=name) for page, name in zip(pages, first, strict=True)))]


def _highest(recording: Recording, channels: list[Channel]) -> float:
    """Return the highest frequency of the spectra [Hz]."""
    highest = 1.0
    for channel in channels:
        freq, power = signal.welch(recording[channel.name], recording.rate, nperseg=min(4096, len(recording)))
        share = np.cumsum(power)
        if share[-1] > 0:
            highest = max(highest, float(freq[np.searchsorted(share, KEPT * share[-1])]))
    return 1.1 * highest
