"""Figures of recordings: time histories, spectra, measurement beside simulation."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy import signal

from vlab.errors import BadRecording, unknown_name
from vlab.signals import Array, Channel, Recording
from vlab.views.figures.style import (
    POINTS,
    ROLES,
    as_text,
    axis_label,
    channel_label,
    decimate,
    draw_legend,
    draw_line,
    pretty_unit,
    readable,
    set_decades,
    stacked_axes,
    styled,
)


def aligned(measured: Recording, simulated: Recording, channel: str) -> tuple[Array, Array, Array]:
    """Return time and both signals in their overlap.

    Parameters
    ----------
    measured : Recording
        Measured recording, whose times are used.
    simulated : Recording
        Simulated recording.
    channel : str
        Name of the channel.

    Returns
    -------
    tuple
        Time [s], measured and simulated values.

    Raises
    ------
    BadRecording
        The recordings do not overlap in time, or the channel has two units.
    """
    units = [recording.channels[recording.index(channel)].unit for recording in (measured, simulated)]
    if units[0] != units[1]:
        raise BadRecording(
            f"channel {channel!r} is in {units[0]} where measured and in {units[1]} where simulated; convert one"
        )
    if np.array_equal(measured.time, simulated.time):
        return measured.time, measured[channel], simulated[channel]
    slack = 1e-9 * float(np.ptp(measured.time))
    inside = (measured.time >= simulated.time[0] - slack) & (measured.time <= simulated.time[-1] + slack)
    if np.count_nonzero(inside) < 2:
        raise BadRecording(
            f"the recordings do not overlap in time: measured {measured.time[0]:g} to {measured.time[-1]:g} s, "
            f"simulated {simulated.time[0]:g} to {simulated.time[-1]:g} s"
        )
    time = measured.time[inside]
    return time, measured[channel][inside], np.interp(time, simulated.time, simulated[channel])


def residual_percent(measured: Array, simulated: Array) -> float:
    """Return the rms residual in per cent."""
    scale = float(np.sqrt(np.mean(measured**2)))
    return 100.0 * float(np.sqrt(np.mean((measured - simulated) ** 2))) / scale if scale else np.inf


@styled
def traces_figure(
    recordings: Sequence[tuple[str, Recording]],
    channels: Sequence[str] | None = None,
    *,
    start: float | None = None,
    stop: float | None = None,
    limit: int = POINTS,
    is_titled: bool = False,
    roles: Sequence[str] | None = None,
) -> Figure:
    """Draw time histories, one axis per channel, with overlaid recordings.

    Parameters
    ----------
    recordings : sequence of (label, Recording)
        Recordings in drawing order.
    channels : sequence of str or None
        Drawn channels; all by default.
    start, stop : float or None
        Drawn stretch [s].
    limit : int
        Most points of a line.
    is_titled : bool
        Whether the name of a channel stands above its axes, for long names.
    roles : sequence of str or None
        Role of each recording, a key of ``ROLES``; by default the curves have no role, and their colours only differ.

    Returns
    -------
    Figure
        Figure.
    """
    found = _channels(recordings, channels)
    figure, axes = stacked_axes(len(found), each=1.1)
    handles: dict[str, Any] = {}
    for row, channel in zip(axes, found, strict=True):
        drawn = [r[channel.name][_stretch(r.time, start, stop)] for _, r in recordings if channel.name in r.names]
        factor, unit = readable(channel, max((float(np.abs(y).max()) for y in drawn if y.size), default=0.0))
        for k, (label, recording) in enumerate(recordings):
            if channel.name in recording.names:
                keep = _stretch(recording.time, start, stop)
                x, y = recording.time[keep], factor * recording[channel.name][keep]
                look = {} if roles is None else ROLES[roles[k]]
                dash = {"linestyle": "-"} if x.size > 4 * limit else {}
                handles[label] = draw_line(row, *decimate(x, y, limit=limit), k, **{"lw": 0.8, **look, **dash})
        row.set_ylabel(as_text(f"[{pretty_unit(unit)}]") if is_titled else axis_label(channel, unit=unit))
        if is_titled:
            row.set_title(as_text(channel_label(channel)), loc="left")
        row.ticklabel_format(axis="y", scilimits=(-3, 4))
        row.margins(x=0)
    axes[-1].set_xlabel("time [s]")
    figure.align_ylabels(axes)
    if len(recordings) > 1:
        draw_legend(figure, list(handles.values()), list(handles))
    return figure


def _stretch(time: Array, start: float | None, stop: float | None) -> NDArray[np.bool_]:
    low, high = -np.inf if start is None else start, np.inf if stop is None else stop
    return np.asarray((time >= low) & (time <= high))


def _channels(recordings: Sequence[tuple[str, Recording]], names: Sequence[str] | None) -> list[Channel]:
    known = {channel.name: channel for _, recording in reversed(recordings) for channel in recording.channels}
    order = dict.fromkeys(channel.name for _, recording in recordings for channel in recording.channels)
    for name in names or ():
        if name not in known:
            raise unknown_name("channel", name, order)
    found = [known[name] for name in (order if names is None else names)]
    if not found:
        raise BadRecording("no channel was given to draw")
    return found


def _density(recording: Recording, values: Array, segment_s: float | None) -> tuple[Array, Array]:
    """Return the amplitude spectral density [unit/sqrt(Hz)]."""
    if recording.is_uniform:
        rate = recording.rate
    else:
        time = np.linspace(recording.time[0], recording.time[-1], len(recording))
        rate, values = 1.0 / float(time[1] - time[0]), np.interp(time, recording.time, values)
    length = len(values) // 8 if segment_s is None else round(segment_s * rate)
    freq, power = signal.welch(values, rate, nperseg=min(max(length, 16), len(values)))
    return freq[1:], np.sqrt(power[1:])


@styled
def spectrum_figure(
    recordings: Sequence[tuple[str, Recording]],
    channels: Sequence[str] | None = None,
    *,
    segment_s: float | None = None,
    highest_hz: float | None = None,
) -> Figure:
    """Draw amplitude spectral densities (Welch, Hann window), one axis per channel.

    Parameters
    ----------
    recordings : sequence of (label, Recording)
        Recordings in drawing order.
    channels : sequence of str or None
        Drawn channels; all by default.
    segment_s : float or None
        Length of a segment [s]; an eighth of the recording by default.
    highest_hz : float or None
        End of the frequency axis [Hz].

    Returns
    -------
    Figure
        Figure.
    """
    found = _channels(recordings, channels)
    figure, axes = stacked_axes(len(found), each=1.3)
    handles: dict[str, Any] = {}
    for row, channel in zip(axes, found, strict=True):
        for k, (label, recording) in enumerate(recordings):
            if channel.name in recording.names:
                freq, density = _density(recording, recording[channel.name], segment_s)
                keep = (density > 0) & (freq <= (np.inf if highest_hz is None else highest_hz))
                handles[label] = draw_line(row, freq[keep], density[keep], k)
        row.set(yscale="log", ylabel=axis_label(channel, power="/√Hz"))
        set_decades(row.yaxis)
        row.margins(x=0)
    axes[-1].set_xlabel("frequency [Hz]")
    if len(recordings) > 1:
        draw_legend(figure, list(handles.values()), list(handles))
    return figure


@styled
def comparison_figure(
    measured: Recording,
    simulated: Recording,
    channel: str,
    *,
    start: float | None = None,
    stop: float | None = None,
    segment_s: float | None = None,
    highest_hz: float | None = None,
) -> Figure:
    """Draw a channel of measurement and simulation.

    Different times are matched by linear interpolation of the simulation. The measurement must be evenly sampled.

    Parameters
    ----------
    measured : Recording
        Measured recording.
    simulated : Recording
        Simulated recording.
    channel : str
        Name of the channel.
    start, stop : float or None
        Drawn stretch [s]; residual and spectra use the whole recording.
    segment_s : float or None
        Length of a segment of the spectra [s]; an eighth of the recording by default.
    highest_hz : float or None
        End of the frequency axis [Hz].

    Returns
    -------
    Figure
        Figure.
    """
    time, truth, model = aligned(measured, simulated, channel)
    label = measured.channels[measured.index(channel)]
    figure = Figure(figsize=(7.2, 5.4), layout="constrained")
    over, rest, spectra = figure.subplots(3, 1, height_ratios=[1.2, 0.9, 1.3])
    rest.sharex(over)
    keep = _stretch(time, start, stop)
    factor, unit = readable(label, float(np.abs(truth).max()))
    shown = {"measured": factor * truth, "nominal": factor * model, "residual": factor * (truth - model)}
    widths = {"measured": 1.8, "nominal": 0.8, "residual": 0.9}  # the nominal model lies over the measurement
    for axes, what in ((over, "measured"), (over, "nominal"), (rest, "residual")):
        draw_line(axes, time[keep], shown[what][keep], 0, **{**ROLES[what], "linestyle": "-", "lw": widths[what]})
    rest.set_title(f"rms of the residual: {residual_percent(truth, model):.3g} % of the measurement's", loc="left")
    over.tick_params(labelbottom=False)
    over.set_title(as_text(channel_label(label)), loc="left")
    for axes in (over, rest):
        axes.margins(x=0)
        axes.set_ylabel(as_text(f"[{pretty_unit(unit)}]"))
        axes.ticklabel_format(axis="y", scilimits=(-3, 4))
    handles = []
    for what, values in shown.items():
        freq, density = _density(measured, values, segment_s)
        keep = (density > 0) & (freq <= (np.inf if highest_hz is None else highest_hz))
        handles.append(draw_line(spectra, freq[keep], density[keep], 0, **ROLES[what]))
    rest.set_xlabel("time [s]")
    spectra.set(yscale="log", xlabel="frequency [Hz]", ylabel=as_text(f"[{pretty_unit(unit)}/√Hz]"))
    spectra.margins(x=0)
    figure.align_ylabels()
    draw_legend(figure, handles, ["measured", "nominal model", "residual"])
    return figure
