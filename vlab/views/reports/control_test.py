"""Figures of control tests: SVG, CSV data and JSON numbers."""

import csv
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from vlab import units
from vlab.reproduce.figures.control import MODELS, ControlFigure, Panel
from vlab.reproduce.ring_down import RingDown
from vlab.views.figures import to_svg
from vlab.views.figures.style import GREY, as_text, draw_legend, draw_line, stacked_axes, styled

PRINTED = {"displacement": ("in/lbf", "m/N"), "velocity": ("in/s/lbf", "m/s/N")}
"""PRINTED: units of the dissertation's figures, and SI units."""
ENVELOPE_POINTS = 400
RESPONSE_HEADERS = ("panel", "curve", "frequency_hz", "real", "imaginary", "unit", "coherence")
RELEASE_HEADERS = ("law", "channel", "time_s", "value", "unit")


def write_control_figure(folder: Path, figure: ControlFigure) -> list[str]:
    """Write a figure as ``figure-NUMBER.svg``, ``.csv`` (SI) and ``.json``.

    Parameters
    ----------
    folder : Path
        Output folder.
    figure : ControlFigure
        Figure with its data.

    Returns
    -------
    list of str
        Names of the files.
    """
    stem = figure.number if figure.ring_downs else f"figure-{figure.number}"
    names = [f"{stem}.{kind}" for kind in ("svg", "csv", "json")]
    drawn = ring_down_figure(figure) if figure.ring_downs else control_figure_drawing(figure)
    (folder / names[0]).write_text(to_svg(drawn), encoding="utf-8")
    with (folder / names[1]).open("w", encoding="utf-8", newline="") as stream:
        rows = csv.writer(stream, lineterminator="\n")
        rows.writerow(RELEASE_HEADERS if figure.ring_downs else RESPONSE_HEADERS)
        rows.writerows(_release_rows(figure.ring_downs) if figure.ring_downs else _response_rows(figure.panels))
    text = json.dumps(figure.as_dict(), allow_nan=False, indent=2)
    (folder / names[2]).write_text(text + "\n", encoding="utf-8")
    return names


def _response_rows(panels: Sequence[Panel]) -> Iterator[tuple[Any, ...]]:
    for panel in panels:
        for curve in panel.curves:
            frf = curve.response
            coherence = [""] * frf.freq.size if frf.coherence is None else frf.coherence[:, 0].tolist()
            for f, h, c in zip(frf.freq.tolist(), frf.H[:, 0, 0].tolist(), coherence, strict=True):
                yield panel.title, curve.label, f, h.real, h.imag, frf.unit, c


def _release_rows(releases: Sequence[RingDown]) -> Iterator[tuple[Any, ...]]:
    for part in releases:
        unit = part.recording.channels[part.recording.index(part.channel)].unit
        for t, value in zip(part.recording.time.tolist(), part.recording[part.channel].tolist(), strict=True):
            yield part.law, part.channel, t, value, unit


@styled
def control_figure_drawing(figure: ControlFigure) -> Figure:
    """Draw the magnitude of every response over frequency, in printed units.

    Parameters
    ----------
    figure : ControlFigure
        Figure with its data.

    Returns
    -------
    Figure
        Figure with one panel per response.
    """
    unit, si = PRINTED[figure.quantity]
    drawing, axes = stacked_axes(len(figure.panels), each=2.4 if len(figure.panels) == 1 else 1.8)
    handles: dict[str, Any] = {}
    where = figure.title.partition(",")[0]
    for row, panel in zip(axes, figure.panels, strict=True):
        levels = []
        for curve in panel.curves:
            size = np.asarray(units.from_si(np.abs(curve.response.H[:, 0, 0]), unit, si))
            levels.append(size[size > 0])
            k = (
                0 if curve.is_measured else 2 if curve.label.endswith(MODELS["corrected-guyan"]) else 1
            )  # equal in all figures
            own = {"color": GREY, "linestyle": "-", "lw": 1.6} if curve.is_measured else {"lw": 1.0}
            handles[curve.label] = draw_line(row, curve.response.freq, np.where(size > 0, size, np.nan), k, **own)
        every = np.concatenate(levels)
        row.set(
            yscale="log",
            ylabel=f"{figure.quantity}\nper force [{unit}]",
            ylim=(0.5 * np.percentile(every, 0.5), 1.6 * every.max()),
        )
        row.set_title(as_text(f"{where}, {panel.title}" if len(axes) > 1 else figure.title), loc="left")
        row.set_xlim(min(c.response.freq[0] for c in panel.curves), max(c.response.freq[-1] for c in panel.curves))
    axes[-1].set_xlabel("frequency [Hz]")
    draw_legend(drawing, list(handles.values()), list(handles))
    return drawing


@styled
def ring_down_figure(figure: ControlFigure) -> Figure:
    """Draw every release with the envelope of the predicted first pole.

    Parameters
    ----------
    figure : ControlFigure
        Figure with its data.

    Returns
    -------
    Figure
        Figure with one panel per release.
    """
    drawing, axes = stacked_axes(len(figure.ring_downs), each=1.4)
    handles: dict[str, Any] = {}
    for row, part in zip(axes, figure.ring_downs, strict=True):
        channel = part.recording.channels[part.recording.index(part.channel)]
        t, x = part.recording.time, part.recording[part.channel]
        handles["simulated experiment"] = draw_line(row, t, x, 0, color=GREY, linestyle="-", lw=0.7)
        if part.poles is not None:
            few = np.linspace(t[0], t[-1], ENVELOPE_POINTS)
            fall = np.abs(x).max() * np.exp(part.poles.s[0].real * few)
            for sign in (1.0, -1.0):
                handles["envelope of mode 1, predicted"] = draw_line(row, few, sign * fall, 1, lw=1.0)
        row.set(ylabel=f"{channel.kind}\n[{channel.unit}]")
        row.set_xlim(0.0, min(other.recording.time[-1] for other in figure.ring_downs))
        row.ticklabel_format(axis="y", scilimits=(-3, 4))
        row.set_title(as_text(f"{part.law}: {channel.at}"), loc="left")
    axes[-1].set_xlabel("time [s]")
    draw_legend(drawing, list(handles.values()), list(handles))
    return drawing
