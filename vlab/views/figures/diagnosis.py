"""Figures of a diagnosis: overlays, residuals, alternatives, calibrated parameters."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from scipy import signal

from vlab.signals import Array, Channel, FrequencyResponse, Recording
from vlab.views.figures.style import (
    COLOURS,
    GREY,
    INK,
    ROLES,
    as_text,
    channel_label,
    draw_legend,
    draw_line,
    pretty_unit,
    readable,
    set_decades,
    set_log_axis,
    stacked_axes,
    styled,
)

WINDOW = 0.06
"""WINDOW [-]: shortest enlarged stretch as a share of the recording."""
LEAST_SAMPLES = 150
"""LEAST_SAMPLES [samples]: shortest enlarged stretch."""
SEGMENTS = 8
MOST_LABELLED = 100.0
"""MOST_LABELLED [-]: largest frequency ratio of a half-width panel with labels within decades."""
LAW = ROLES["extended"]["color"]
"""LAW: colour of a fitted law."""
LOOKS = {name: ROLES[name] for name in ("measured", "nominal", "calibrated", "extended")}
"""LOOKS: line styles of the measurement and of every model."""


@styled
def overlay_figure(
    measured: Recording,
    calibrated: Recording,
    extended: Recording | None,
    channel: str,
    *,
    noise: float,
    worst_s: float,
    before: str = "calibrated",
) -> Figure:
    """Draw a channel of the measurement and the models.

    The panels show the whole recording, the worst stretch enlarged, the residuals, and the spectra.

    Parameters
    ----------
    measured : Recording
        Measured recording.
    calibrated : Recording
        Simulation of the model named by `before`.
    extended : Recording or None
        Simulation of the extended model; None without added physics.
    channel : str
        Name of the channel.
    noise : float
        Standard deviation of the channel's noise, in its unit.
    worst_s : float
        Middle of the enlarged stretch [s].
    before : str
        ``"calibrated"``, or ``"nominal"`` if that model is nearer.

    Returns
    -------
    Figure
        Figure with four panels.
    """
    label = measured.channels[measured.index(channel)]
    factor, unit = readable(label, float(np.abs(measured[channel]).max()))
    noise = factor * noise
    curves = [
        (name, LOOKS[name], factor * r[channel])
        for name, r in (("measured", measured), (before, calibrated), ("extended", extended))
        if r is not None
    ]
    figure, (whole, zoom, rest, spectra) = stacked_axes(4, each=1.3, ratios=[1.1, 1.2, 1.0, 1.3], shares_x=False)
    time = measured.time
    near = stretch(time, worst_s)
    handles: dict[str, Any] = {}
    for name, look, values in curves:
        draw_line(whole, time, values, 0, **{**look, "linestyle": "-"}, lw=0.7)
        handles[name] = draw_line(zoom, time[near], values[near], 0, **look, lw=1.2)
        if name != "measured":
            draw_line(rest, time, factor * measured[channel] - values, 0, **{**look, "linestyle": "-"}, lw=0.7)
    handles["noise"] = rest.axhspan(-noise, noise, color="#cccccc", zorder=0)
    whole.axvspan(time[near][0], time[near][-1], color="#f0e3c4", zorder=0)
    for axes, what in (
        (whole, channel_label(label)),
        (zoom, f"where the {before} model is furthest off, around {worst_s:.4g} s"),
    ):
        axes.set_title(as_text(what), loc="left")
    rest.set_title("residual: measured minus simulated; grey: noise, one standard deviation", loc="left")
    for axes in (whole, zoom, rest):
        axes.margins(x=0)
        axes.set(ylabel=f"[{pretty_unit(unit)}]", xlabel="time [s]")
        axes.ticklabel_format(axis="y", scilimits=(-3, 4))
    _spectra(spectra, measured, curves, noise)
    spectra.set_title("measured, and the residual of each model" + ("; dotted: noise" if noise > 0 else ""), loc="left")
    spectra.set(ylabel=f"[{pretty_unit(unit)}/√Hz]")
    draw_legend(figure, list(handles.values()), list(handles))
    return figure


def stretch(time: Array, middle: float) -> Any:
    """Return the samples of the enlarged stretch around a time."""
    count = min(len(time), max(LEAST_SAMPLES, round(WINDOW * len(time))))
    first = int(np.clip(np.searchsorted(time, middle) - count // 2, 0, len(time) - count))
    return slice(first, first + count)


def _even(recording: Recording, values: Array) -> tuple[Array, float]:
    """Return values at even times, and their rate."""
    rate = (len(recording) - 1) / float(recording.time[-1] - recording.time[0])
    if recording.is_uniform:
        return values, rate
    return np.interp(recording.time[0] + np.arange(len(recording)) / rate, recording.time, values), rate


def _spectra(axes: Any, measured: Recording, curves: Sequence[tuple[str, Any, Array]], noise: float) -> None:
    """Draw the spectra of the measurement (first) and the residuals."""
    truth, highest = curves[0][2], 0.0
    for name, look, values in curves:
        even, rate = _even(measured, truth if name == "measured" else truth - values)
        freq, power = signal.welch(even - even.mean(), rate, nperseg=max(len(even) // SEGMENTS, min(len(even), 16)))
        keep = (freq > 0) & (power > 0)
        draw_line(axes, freq[keep], np.sqrt(power[keep]), 0, **look)
        highest = max(highest, rate / 2)
    if noise > 0:
        axes.axhline(noise / np.sqrt(highest), color=GREY, lw=1.0, linestyle=":")
    axes.set(yscale="log", xlabel="frequency [Hz]")
    set_decades(axes.yaxis)
    set_log_axis(axes)
    axes.margins(x=0)


@styled
def response_figure(curves: Sequence[tuple[str, FrequencyResponse]], output: Channel, source: Channel) -> Figure:
    """Draw one frequency response of measurement and models.

    Parameters
    ----------
    curves : sequence of tuple
        Label and response of each curve.
    output : Channel
        Output channel.
    source : Channel
        Input channel.

    Returns
    -------
    Figure
        Figure with magnitude and coherence.
    """
    figure, (size, coherence) = stacked_axes(2, each=0.85, ratios=[2.4, 1.0])
    handles = []
    for name, frf in curves:
        handles.append(draw_line(size, frf.freq, np.abs(frf.H[:, 0, 0]), 0, **LOOKS[name]))
        if name == "measured" and frf.coherence is not None:
            draw_line(coherence, frf.freq, frf.coherence[:, 0], 0, **LOOKS[name])
    whole = f"({output.unit})" if "/" in output.unit else output.unit or "1"
    # an input that a case scales has the unit of the model's command, which the case does not state
    unit = pretty_unit(f"{whole}/{source.unit}") if source.unit else f"{pretty_unit(whole)} per unit of the command"
    size.set(yscale="log", ylabel=f"magnitude\n[{unit}]")
    set_decades(size.yaxis)
    set_log_axis(size)
    size.set_title(as_text(f"{channel_label(output)} from {channel_label(source)}"), loc="left")
    coherence.set(ylim=(-0.05, 1.05), yticks=(0, 0.5, 1), ylabel="coherence\nmeasured [-]", xlabel="frequency [Hz]")
    size.margins(x=0)
    draw_legend(figure, handles, [name for name, _ in curves])
    return figure


@styled
def mismatch_figure(
    rows: Sequence[str],
    edges_hz: Array,
    bands: Array,
    times: Sequence[tuple[Array, Array]],
    *,
    title: str = "",
    scale: float | None = None,
) -> Figure:
    """Draw residuals of channels over frequency and time.

    Parameters
    ----------
    rows : sequence of str
        Label of each channel and recording.
    edges_hz : (n + 1,) array
        Edges of the bands [Hz].
    bands : (n_rows, n) array
        Rms residual in the band over the rms of the channel [-].
    times : sequence of (time [s], error)
        Rms residual in moving windows over the rms of the channel [-], one pair per row.
    title : str
        Title of the figure.
    scale : float or None
        Residual of the brightest colour [-], to compare two figures; by default the largest of this one.

    Returns
    -------
    Figure
        Figure with two panels.
    """
    count = len(rows)
    figure = Figure(figsize=(7.2, max(2.2, 1.4 + 0.3 * count)), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=[1.15, 1.0])
    values = np.concatenate([bands.ravel(), *[e for _, e in times]])
    high = float(np.max(values, initial=1e-6)) if scale is None else max(scale, 1e-6)
    norm = LogNorm(max(high / 1000, 1e-9), max(high, 2e-9))
    floor = norm.vmin or 1e-9
    left.pcolormesh(
        edges_hz, np.arange(count + 1) - 0.5, np.maximum(bands, floor), norm=norm, cmap="cividis", shading="flat"
    )
    set_log_axis(left, decades_only=bool(edges_hz[-1] > MOST_LABELLED * edges_hz[0]))
    left.set(xlabel="frequency [Hz]", yticks=np.arange(count), yticklabels=[as_text(r) for r in rows])
    image = None
    for i, (middles, errors) in enumerate(times):
        half = (middles[1] - middles[0]) / 2 if len(middles) > 1 else 0.5
        edges = np.append(middles - half, middles[-1] + half)
        image = right.pcolormesh(
            edges, [i - 0.5, i + 0.5], np.maximum(errors[None], floor), norm=norm, cmap="cividis", shading="flat"
        )
    right.set(xlabel="time [s]", yticks=np.arange(count), yticklabels=[])
    for axes in (left, right):
        axes.grid(False)
        axes.set_ylim(count - 0.5, -0.5)
    left.set_title(as_text(title), loc="left")
    if image is not None:
        figure.colorbar(image, ax=[left, right], label="error / rms of\nthe channel [-]", fraction=0.05)
    return figure


@styled
def ranking_figure(
    options: Sequence[tuple[str, float, float]], chosen: int = 0, *, is_probability: bool = True
) -> Figure:
    """Draw probabilities or residual shares of alternatives, and their residuals.

    Parameters
    ----------
    options : sequence of (label, probability or share, residual)
        Alternatives, with residuals in multiples of the noise.
    chosen : int
        Index of the reported alternative; -1 for none.
    is_probability : bool
        Whether the second number is a probability.

    Returns
    -------
    Figure
        Figure with two panels.
    """
    count, lines = len(options), 1 + any(" + " in label for label, _, _ in options)
    figure = Figure(figsize=(7.2, 1.1 + 0.28 * lines * count), layout="constrained")
    bars, rest = figure.subplots(1, 2, sharey=True, width_ratios=[2.0, 1.0])
    colours = [COLOURS[0] if i == chosen else "#9fc5de" for i in range(count)]
    bars.barh(np.arange(count), [p for _, p, _ in options], color=colours, height=0.7)
    widest = 1.0 if is_probability else max(1.0, *(p for _, p, _ in options))
    for i, (_, p, _) in enumerate(options):
        text = "< 0.1 %" if is_probability and p < 1e-3 else f"{100 * p:.3g} %"
        bars.text(p + 0.01 * widest, i, text, va="center", fontsize=8)
    bars.set(
        xlim=(0, 1.18 * widest),
        xlabel="probability [-]" if is_probability else "residual / residual of the calibrated model [-]",
        yticks=np.arange(count),
        yticklabels=[as_text(o[0].replace(" + ", "\n+ ")) for o in options],
    )
    levels = np.array([level for _, _, level in options])
    rest.plot(levels, np.arange(count), "o", color=INK, ms=5)
    rest.axvline(1.0, color=GREY, lw=1.0, linestyle=":")
    finite = levels[np.isfinite(levels)]
    if finite.size and finite.max() > 8 * max(finite.min(), 1e-9):
        rest.set_xscale("log")
    rest.set(xlabel="residual / noise [-]")
    for axes in (bars, rest):
        axes.grid(visible=False, axis="y")
        axes.set_ylim(count - 0.4, -0.6)
    return figure


def _change(name: str, value: float, sd: float) -> str:
    if name.startswith("place:"):
        return f"{1e3 * value:+.3g} mm  (± {1e3 * sd:.3g} mm)"
    if ":centre-of-mass:" in name:
        return f"{100 * value:+.3g} % of the radius of gyration  (± {100 * sd:.3g} %)"
    return f"× {np.exp(value):.4g}  (± {100 * sd:.3g} %)"


@styled
def calibration_figure(rows: Sequence[tuple[str, float, float]]) -> Figure:
    """Draw calibrated parameters over one and three prior standard deviations.

    Parameters
    ----------
    rows : sequence of (name, log-factor, prior standard deviation)
        Parameters; for ``place:NAME`` the distance [m] instead of the factor, for a centre of mass the shift.

    Returns
    -------
    Figure
        Figure with one row per parameter.
    """
    texts = [_change(*row) for row in rows]
    figure = Figure(figsize=(7.2, 1.0 + 0.24 * len(rows)), layout="constrained")
    axes = figure.subplots()
    moved = np.array([value / sd for _, value, sd in rows])
    for size, colour in ((3.0, "#eeeeee"), (1.0, "#d5d5d5")):
        axes.axvspan(-size, size, color=colour, zorder=0)
    far = np.abs(moved) > 2.5
    axes.hlines(np.arange(len(rows)), 0, moved, color=GREY, lw=0.8)
    for group, colour, marker in ((~far, COLOURS[0], "o"), (far, COLOURS[1], "D")):
        axes.plot(moved[group], np.flatnonzero(group), marker, color=colour, ms=6, linestyle="none")
    limit = max(3.6, 1.1 * float(np.abs(moved).max(initial=0.0)))
    for i, text in enumerate(texts):
        axes.text(1.02 * limit, i, text, va="center", fontsize=8, clip_on=False)
    axes.set(xlim=(-limit, limit), yticks=np.arange(len(rows)), yticklabels=[as_text(name) for name, _, _ in rows])
    axes.set_xlabel("deviation from the nominal model [prior standard deviations]")
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.grid(visible=False, axis="y")
    return figure


@styled
def force_figure(
    curves: Sequence[tuple[str, str, Array, Array | None, Array]],
    ylabel: str,
    *,
    series: tuple[Array, Array, Array | None] | None = None,
) -> Figure:
    """Draw a fitted law over its variables.

    Parameters
    ----------
    curves : sequence of (x label, x unit, x, free estimate or None, law)
        One panel each; arrays have one value per sample.
    ylabel : str
        Quantity and unit of the law.
    series : (time [s], law, free estimate or None) or None
        Stretch in time.

    Returns
    -------
    Figure
        Figure with one panel per variable.
    """
    wide = len(curves)
    figure = Figure(figsize=(7.2, 3.4 if series is None else 5.2), layout="constrained")
    grid = figure.add_gridspec(1 if series is None else 2, wide, height_ratios=None if series is None else [1.5, 1.0])
    handles: dict[str, Any] = {}
    for k, (name, unit, x, free, force) in enumerate(curves):
        axes = figure.add_subplot(grid[0, k])
        axes.locator_params(axis="x", nbins=6)  # separate numbers on half the width
        if free is not None:
            dots = _thinned(x, free)
            handles["force found without a law"] = axes.plot(*dots, ".", color="#b5b5b5", ms=2.2, zorder=1)[0]
            rising = np.gradient(x) >= 0.0  # one value of friction or hysteresis per direction
            for what, marker, branch in (("rising", ">", rising), ("falling", "<", ~rising)):
                middle = _medians(x[branch], free[branch])
                look: dict[str, Any] = {"color": INK, "ms": 4, "mfc": "white", "zorder": 3}
                handles[f"its median, {what}"] = axes.plot(*middle, marker, **look)[0]
        dots = _thinned(x, force)
        handles["fitted law along the motion"] = axes.plot(*dots, ".", color=LAW, ms=3.2, zorder=2)[0]
        axes.set(xlabel=as_text(f"{name} [{pretty_unit(unit)}]"), ylabel=as_text(ylabel) if k == 0 else "")
        axes.ticklabel_format(scilimits=(-3, 4))
        _limit(axes, free, force)
    if series is not None:
        axes = figure.add_subplot(grid[1, :])
        time, force, free = series
        if free is not None:
            draw_line(axes, time, free, 0, color="#9a9a9a", linestyle="-", lw=0.8)
        draw_line(axes, time, force, 0, color=LAW, linestyle="-")
        axes.set(xlabel="time [s]", ylabel=as_text(ylabel))
        axes.margins(x=0)
        axes.ticklabel_format(axis="y", scilimits=(-3, 4))
        _limit(axes, free, force)
    draw_legend(figure, list(handles.values()), list(handles), columns=3)
    return figure


def _limit(axes: Any, free: Array | None, force: Array) -> None:
    """Exclude the outermost per cent of the scatter."""
    low, high = float(force.min()), float(force.max())
    if free is not None:
        low, high = min(low, float(np.quantile(free, 0.005))), max(high, float(np.quantile(free, 0.995)))
    room = 0.08 * (high - low) or 1.0
    axes.set_ylim(low - room, high + room)


def _thinned(x: Array, y: Array, most: int = 500) -> tuple[Array, Array]:
    keep = np.linspace(0, len(x) - 1, min(most, len(x))).astype(int)
    return x[keep], y[keep]


def _medians(x: Array, y: Array, bins: int = 15) -> tuple[Array, Array]:
    if x.size < 2:
        return np.zeros(0), np.zeros(0)
    edges = np.linspace(np.quantile(x, 0.01), np.quantile(x, 0.99), bins + 1)
    which = np.digitize(x, edges) - 1
    found = [
        (np.median(x[which == b]), np.median(y[which == b])) for b in range(bins) if np.count_nonzero(which == b) >= 20
    ]
    return tuple(np.array(found).reshape(-1, 2).T)  # type: ignore[return-value]
