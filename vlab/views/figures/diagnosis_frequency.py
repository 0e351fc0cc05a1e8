"""Figures of a diagnosis in frequency: responses and modes."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from vlab.signals import Array, ComplexArray
from vlab.views.figures import INK, MARKERS, pretty_unit
from vlab.views.figures.diagnosis import LOOKS
from vlab.views.figures.style import as_text, draw_legend, draw_line, styled


@styled
def response_overlay(
    freq: Array,
    curves: Sequence[tuple[str, ComplexArray]],
    noise: Array,
    *,
    unit: str,
    title: str,
    has_phase: bool = True,
) -> Figure:
    """Draw a response of the measurement and the models.

    Parameters
    ----------
    freq : array
        Frequencies [Hz].
    curves : sequence of (label, (n,) complex array)
        ``"measured"`` first, then ``"nominal"``, ``"calibrated"``, ``"extended"``.
    noise : (n,) array
        Standard deviation of the measured response.
    unit : str
        Unit of the response.
    title : str
        Title of the figure.
    has_phase : bool
        Whether the measured phase is known.

    Returns
    -------
    Figure
        Figure with two or three panels.
    """
    ratios = [2.2, 1.0, 1.4] if has_phase else [2.2, 1.4]
    figure = Figure(figsize=(7.2, 1.35 * sum(ratios) + 0.8), layout="constrained")
    axes = figure.subplots(len(ratios), 1, sharex=True, height_ratios=ratios)
    size, rest = axes[0], axes[-1]
    measured = curves[0][1]
    handles = {}
    for label, H in curves:
        width = 1.4 if label == "measured" else 1.0
        handles[label] = draw_line(size, freq, np.abs(H), 0, **{**LOOKS[label], "lw": width})
        if has_phase:
            degrees = (np.degrees(np.angle(H)) + 200) % 360 - 200  # keep a noisy phase near 180 degrees on one side
            jumps = np.abs(np.diff(degrees, prepend=degrees[0])) > 200
            draw_line(axes[1], freq, np.where(jumps, np.nan, degrees), 0, **LOOKS[label])
        if label != "measured":
            left = np.abs(measured - H) if has_phase else np.abs(np.abs(measured) - np.abs(H))
            draw_line(rest, freq, np.maximum(left, 1e-300), 0, **LOOKS[label])
    handles["noise"] = draw_line(rest, freq, noise, 0, color="#cccccc", linestyle="-", lw=1.6)
    low = float(np.abs(measured).min())
    size.set(yscale="log", ylabel=as_text(f"magnitude\n[{pretty_unit(unit)}]"))
    size.set_ylim(bottom=max(0.2 * low, 1e-6 * float(np.abs(measured).max())))
    size.set_title(as_text(title), loc="left")
    if has_phase:
        axes[1].set(ylim=(-205, 165), yticks=(-180, -90, 0, 90), ylabel="phase\n[degrees]")
    rest.set(yscale="log", xlabel="frequency [Hz]", ylabel=as_text(f"residual\n[{pretty_unit(unit)}]"))
    rest.set_ylim(bottom=max(0.2 * float(noise.min()), 1e-6 * float(np.abs(measured).max())))
    for one in axes:
        one.margins(x=0)
    draw_legend(figure, list(handles.values()), list(handles), columns=5)
    return figure


@styled
def modes_figure(
    freq: Array, panels: Sequence[tuple[str, Sequence[tuple[str, Array]], Array]], *, title: str
) -> Figure:
    """Draw deviations of models from a modal table.

    Parameters
    ----------
    freq : (n,) array
        Measured natural frequencies [Hz].
    panels : sequence of (axis label, sequence of (model, (n,) values), (n,) standard deviations)
        One entry per quantity.
    title : str
        Title of the figure.

    Returns
    -------
    Figure
        Figure with one panel per quantity.
    """
    figure = Figure(figsize=(7.2, 1.5 + 0.36 * len(freq)), layout="constrained")
    axes = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    rows = np.arange(1, len(freq) + 1)
    handles: dict[str, Any] = {}
    for one, (label, models, sd) in zip(axes, panels, strict=True):
        one.axvline(0.0, color=INK, lw=0.8)
        one.barh(rows, 2 * sd, left=-sd, height=0.7, color="#e4e4e4", zorder=0)
        offsets = np.linspace(-0.2, 0.2, len(models)) if len(models) > 1 else np.zeros(1)
        for k, ((name, values), offset) in enumerate(zip(models, offsets, strict=True)):
            known = np.isfinite(values)
            handles[name] = one.plot(
                values[known], (rows + offset)[known], MARKERS[k], color=LOOKS[name]["color"], zorder=2
            )[0]
        one.set(xlabel=as_text(label), ylim=(len(freq) + 0.6, 0.4))
    axes[0].set_yticks(rows, [f"{k}: {f:.4g} Hz" for k, f in zip(rows, freq, strict=True)])
    axes[0].set_title(as_text(title), loc="left")
    draw_legend(figure, list(handles.values()), list(handles))
    return figure
