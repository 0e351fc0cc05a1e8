"""Residual of a simulation per channel, in time and frequency."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import signal

from vlab.errors import BadRecording
from vlab.signals import Array, Recording, rms

WINDOWS = 20
"""WINDOWS [1]: default number of moving windows over a recording, overlapping by half."""
BANDS = 12
"""BANDS [1]: default number of frequency bands, of equal width in log frequency."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Misfit:
    """Residual of one channel.

    Parameters
    ----------
    channel, unit : str
        Channel and its SI unit.
    nrmse : float
        Rms error over the recording's rms about its mean.
    vaf : float
        Variance accounted for, 1 - var(error)/var(recording); a constant error has no influence.
    mean_error, rms_error : float
        Mean and rms of simulation minus recording [unit].
    rms_ratio : float
        Rms of the recording over rms of the simulation, both about their means; infinite for a constant simulation.
    correlation : float
        Correlation of recording and simulation, from -1 to 1; 0 for a constant simulation.
    window_time_s, window_nrmse : array
        Centres of moving windows [s], and rms error there over the whole recording's rms about its mean.
    window_rms : array
        Rms of the recording about its mean in the windows [unit].
    band_edges_hz : (n + 1,) array
        Band edges [Hz]; the first is the resolution of the spectrum.
    band_share : (n,) array
        Share of the error's power about its mean in each band, with sum 1.
    band_nrmse : (n,) array
        Root of the ratio of error power to recorded power in each band.
    """

    channel: str
    unit: str
    nrmse: float
    vaf: float
    mean_error: float
    rms_error: float
    rms_ratio: float
    correlation: float
    window_time_s: Array
    window_nrmse: Array
    window_rms: Array
    band_edges_hz: Array
    band_share: Array
    band_nrmse: Array

    def to_json(self) -> dict[str, Any]:
        """Return plain values for a JSON document."""
        return {
            "channel": self.channel,
            "unit": self.unit,
            "nrmse": self.nrmse,
            "vaf": self.vaf,
            "mean_error": self.mean_error,
            "rms_error": self.rms_error,
            "rms_ratio": self.rms_ratio if np.isfinite(self.rms_ratio) else None,
            "correlation": self.correlation,
            "windows": [
                {"time_s": t, "nrmse": e, "recording_rms": r}
                for t, e, r in zip(
                    self.window_time_s.tolist(), self.window_nrmse.tolist(), self.window_rms.tolist(), strict=True
                )
            ],
            "bands": [
                {"low_hz": a, "high_hz": b, "error_share": s, "nrmse": e}
                for a, b, s, e in zip(
                    self.band_edges_hz[:-1].tolist(),
                    self.band_edges_hz[1:].tolist(),
                    self.band_share.tolist(),
                    self.band_nrmse.tolist(),
                    strict=True,
                )
            ],
        }


def misfit(
    measured: Recording,
    simulated: Recording,
    channel: str,
    *,
    windows: int = WINDOWS,
    band_edges_hz: Sequence[float] | None = None,
) -> Misfit:
    """Compare one simulated channel with the recording.

    Samples without a reading do not count.

    Parameters
    ----------
    measured, simulated : Recording
        Recordings with the same time stamps.
    channel : str
        Name of the channel.
    windows : int
        Number of moving windows, overlapping by half.
    band_edges_hz : sequence of float, optional
        Band edges [Hz]; by default `BANDS` even steps in log frequency up to half the sample rate.

    Returns
    -------
    Misfit
        Residual measures.

    Raises
    ------
    BadRecording
        The time stamps differ, or the recorded channel is constant.
    """
    if not np.array_equal(measured.time, simulated.time):
        raise BadRecording(f"channel {channel!r}: recording and simulation have different time stamps")
    read = measured.is_read(channel)
    time, y, modelled = (v[read] for v in (measured.time, measured[channel], simulated[channel]))
    error = modelled - y
    size = float(np.std(y))
    if size <= 1e-12 * float(np.abs(y).max(initial=0.0)):
        raise BadRecording(f"channel {channel!r} is constant; a misfit is measured against what moves")
    own = modelled - np.mean(modelled)
    moved = float(np.std(own))
    times, parts = _windows(time, windows)
    edges, error_power, power = _bands(time, error, y, band_edges_hz)
    total = error_power.sum()
    return Misfit(
        channel=channel,
        unit=measured.channels[measured.index(channel)].unit,
        nrmse=rms(error) / size,
        vaf=1.0 - float(np.var(error)) / size**2,
        mean_error=float(np.mean(error)),
        rms_error=rms(error),
        rms_ratio=size / moved if moved > 0.0 else float("inf"),
        correlation=float(np.mean((y - np.mean(y)) * own)) / (size * moved) if moved > 0.0 else 0.0,
        window_time_s=times,
        window_nrmse=np.array([rms(error[part]) for part in parts]) / size,
        window_rms=np.array([rms(y[part] - np.mean(y)) for part in parts]),
        band_edges_hz=edges,
        band_share=error_power / total if total > 0 else np.zeros_like(error_power),
        band_nrmse=np.sqrt(np.divide(error_power, power, out=np.zeros_like(power), where=power > 0)),
    )


def _windows(time: Array, count: int) -> tuple[Array, list[slice]]:
    """Return centres and index ranges of half-overlapping windows."""
    half = (time[-1] - time[0]) / (count + 1)
    middles = time[0] + half * np.arange(1, count + 1)
    first = np.searchsorted(time, middles - half)
    last = np.searchsorted(time, middles + half, side="right")
    return middles, [slice(int(a), int(b)) for a, b in zip(first, last, strict=True)]


def _bands(time: Array, error: Array, y: Array, edges: Sequence[float] | None) -> tuple[Array, Array, Array]:
    """Return band edges and the power of error and recording.

    Welch's method with a Hann window and eight segments.
    """
    rate = (time.size - 1) / (time[-1] - time[0])
    grid = time[0] + np.arange(time.size) / rate
    even = [v if np.allclose(grid, time, rtol=0, atol=1e-4 / rate) else np.interp(grid, time, v) for v in (error, y)]
    segment = max(min(time.size, 16), 2 * time.size // 9)  # eight segments with half overlap
    powers = []
    for values in even:
        freq, density = signal.welch(values - values.mean(), rate, nperseg=segment, detrend=False)
        powers.append(density * freq[1])
    if edges is None:
        bounds = np.geomspace(freq[1], rate / 2, BANDS + 1)
    else:
        bounds = np.asarray(edges, dtype=float)
        if bounds.size < 2 or not np.all(np.diff(bounds) > 0) or bounds[0] < 0:
            raise BadRecording(f"the band edges {list(edges)} do not increase from zero or above")
    at = np.searchsorted(bounds, freq, side="right") - 1
    at = np.clip(at, 0, bounds.size - 2)  # power beyond the outer edges counts in the outer bands
    sums = [np.bincount(at, weights=p, minlength=bounds.size - 1) for p in powers]
    return bounds, sums[0], sums[1]
