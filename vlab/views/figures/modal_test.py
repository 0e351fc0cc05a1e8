"""Figures of a modal test: poles, shapes, distortion, indicators."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from vlab.errors import BadRecording
from vlab.modal.appropriation import mode_indicator
from vlab.modal.distortion import Distortion
from vlab.modal.poles import PoleEstimate
from vlab.signals import Array, FrequencyResponse
from vlab.views.figures.style import COLOURS, GREY, INK, as_text, draw_legend, draw_line, pretty_unit, styled

MOST_DAMPED = 0.3
"""MOST_DAMPED [-]: largest damping ratio in the chart; larger ones belong to lags and residual terms."""


@styled
def stabilisation_figure(estimate: PoleEstimate) -> Figure:
    """Draw the poles of every model order.

    A filled dot repeats a pole of the next lower order.

    Parameters
    ----------
    estimate : PoleEstimate
        Estimated poles with their chart.

    Returns
    -------
    Figure
        Stabilisation chart.
    """
    chart = estimate.stabilisation
    keep = (
        (chart.freq >= estimate.fitted.freq[0]) & (chart.freq <= estimate.fitted.freq[-1]) & (chart.zeta < MOST_DAMPED)
    )
    figure = Figure(figsize=(7.2, 4.2), layout="constrained")
    axes: Any = figure.subplots()
    behind = axes.twinx()
    level = np.sqrt(np.sum(np.abs(estimate.fitted.H) ** 2, axis=(1, 2)))
    summed = draw_line(behind, estimate.fitted.freq, level, 0, color=GREY)
    behind.set(yscale="log", ylabel=as_text(f"all fitted responses\n[{pretty_unit(estimate.fitted.unit) or 'SI'}]"))
    behind.grid(visible=False)
    axes.set_zorder(behind.get_zorder() + 1)
    axes.patch.set_visible(False)
    handles = [summed]
    for is_stable, face in ((True, COLOURS[0]), (False, "none")):
        here = keep & (chart.is_stable == is_stable)
        style = {"marker": "o", "linestyle": "none", "markersize": 2.8, "color": COLOURS[0], "markerfacecolor": face}
        handles.append(axes.plot(chart.freq[here], chart.order[here], **style)[0])
    for hz in estimate.freq:
        line = axes.axvline(hz, color=COLOURS[1], lw=0.9, linestyle="--")
    handles.append(line)
    axes.set(
        xlabel="frequency [Hz]", ylabel="model order [-]", xlim=(estimate.fitted.freq[0], estimate.fitted.freq[-1])
    )
    draw_legend(figure, handles, ["sum of the fit", "stable pole", "new pole", "reported mode"])
    return figure


@styled
def shapes_figure(
    freq: Array,
    estimated: Array,
    peaks: Array,
    outputs: tuple[str, ...],
    *,
    true: Array | None = None,
    columns: int = 4,
) -> Figure:
    """Draw each mode shape over the outputs.

    Parameters
    ----------
    freq : array
        Natural frequencies [Hz].
    estimated, peaks : (n_outputs, n_modes) array
        Real shapes, scaled to largest component 1 and matched in sign.
    outputs : tuple of str
        Names of the outputs.
    true : (n_outputs, n_modes) array or None
        Shapes of the plant, NaN without such a mode.
    columns : int
        Panels per row.

    Returns
    -------
    Figure
        Figure with one panel per mode.
    """
    n = freq.size
    columns = min(columns, n)
    rows = -(-n // columns)
    figure = Figure(figsize=(1.9 * columns + 1.4, (0.17 * len(outputs) + 0.55) * rows + 0.6), layout="constrained")
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    at = np.arange(len(outputs))
    handles: dict[str, Any] = {}
    for j, axes in enumerate(panels.flat):
        if j >= n:
            axes.set_visible(False)
            continue
        axes.axvline(0.0, color=INK, lw=0.7)
        axes.hlines(at, 0.0, estimated[:, j], color=COLOURS[0], lw=1.6)
        handles["fit"] = axes.plot(estimated[:, j], at, "o", color=COLOURS[0], markersize=3.6)[0]
        style = {"linestyle": "none", "markerfacecolor": "none", "markersize": 6.5}
        agreed = peaks[:, j] * np.sign(peaks[:, j] @ estimated[:, j] or 1.0)
        handles["peak level"] = axes.plot(agreed, at, marker="s", color=COLOURS[1], **style)[0]
        if true is not None and np.all(np.isfinite(true[:, j])):
            agreed = true[:, j] * np.sign(true[:, j] @ estimated[:, j] or 1.0)
            handles["plant"] = axes.plot(agreed, at, marker="|", color=INK, **style)[0]
        axes.set_title(f"{j + 1}: {freq[j]:.4g} Hz")
        axes.set(
            yticks=at, yticklabels=[as_text(name) for name in outputs], xlim=(-1.15, 1.15), ylim=(len(at) - 0.5, -0.5)
        )
    figure.supxlabel("deflection relative to the largest [-]", fontsize=9)
    draw_legend(figure, list(handles.values()), list(handles))
    return figure


@styled
def distortion_figure(part: Distortion, output: str) -> Figure:
    """Draw the linear output with noise and distortion.

    Parameters
    ----------
    part : Distortion
        Distortion of one input.
    output : str
        Name of the output.

    Returns
    -------
    Figure
        Figure.
    """
    if output not in part.outputs:
        raise BadRecording(f"there is no output {output!r} in the separation (has: {', '.join(part.outputs)})")
    o = part.outputs.index(output)
    single = np.sqrt(part.realisations) * part.amplitude  # from the mean over realisations to one realisation
    figure = Figure(figsize=(7.2, 3.6), layout="constrained")
    axes: Any = figure.subplots()
    curves = {"linear output": np.abs(part.G[:, o]) * part.amplitude, "noise": part.noise_sd[:, o] * single}
    if part.total_sd is not None:
        curves["noise and distortion"] = part.total_sd[:, o] * single
    handles = [draw_line(axes, part.freq, _drawn(level), k) for k, level in enumerate(curves.values())]
    labels = list(curves)
    lines = part.detection
    for name, which, marker, colour in (
        ("even lines", lines.is_even, "^", COLOURS[3]),
        ("odd lines left out", ~lines.is_even, "v", COLOURS[6]),
    ):
        if which.any():
            style = {"linestyle": "none", "markersize": 2.6, "color": colour}
            handles.append(axes.plot(lines.freq[which], _drawn(lines.level[which, o]), marker=marker, **style)[0])
            labels.append(name)
    axes.set(yscale="log", xlabel="frequency [Hz]", xlim=(part.freq[0], part.freq[-1]))
    axes.set_ylabel(as_text(f"amplitude of a line\n[{pretty_unit(part.units[o])}]"))
    axes.set_title(as_text(f"{output} from {part.input}"), loc="left")
    draw_legend(figure, handles, labels, columns=3)
    return figure


def _drawn(level: Array) -> Array:
    return np.where(level > 0, level, np.nan)


@styled
def indicator_figure(receptance: FrequencyResponse, modes: Array) -> Figure:
    """Draw the multivariate mode indicator functions.

    Each dip to 0 is a mode that forces in phase can hold alone.

    Parameters
    ----------
    receptance : FrequencyResponse
        Fitted responses.
    modes : array
        Natural frequencies [Hz].

    Returns
    -------
    Figure
        Figure.
    """
    values, _ = mode_indicator(receptance)
    figure = Figure(figsize=(7.2, 2.8), layout="constrained")
    axes: Any = figure.subplots()
    handles = [draw_line(axes, receptance.freq, values[:, k], k) for k in range(values.shape[1])]
    for hz in modes:
        axes.axvline(hz, color=GREY, lw=0.8, linestyle=":")
    axes.set(xlabel="frequency [Hz]", ylabel="mode indicator [-]", ylim=(0, 1.02))
    axes.set_xlim(receptance.freq[0], receptance.freq[-1])
    draw_legend(figure, handles, [f"indicator {k + 1}" for k in range(values.shape[1])])
    return figure
