"""Figures of frequency responses: magnitude, phase and coherence."""

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from vlab.errors import BadRecording, unknown_name
from vlab.signals import Array, FrequencyResponse
from vlab.units import same_dimension
from vlab.views.figures.style import (
    ROLES,
    as_text,
    decimate,
    draw_legend,
    draw_line,
    pretty_unit,
    set_decades,
    stacked_axes,
    styled,
)


@styled
def frf_figure(
    measured: FrequencyResponse | None = None,
    analytical: FrequencyResponse | None = None,
    output: str = "",
    input: str = "",
    *,
    labels: tuple[str, str] = ("measured", "FE model"),
    overlays: Sequence[tuple[str, FrequencyResponse]] = (),
    log_frequency: bool = False,
    title: str = "",
) -> Figure:
    """Draw magnitude, phase and coherence over one frequency axis.

    Parameters
    ----------
    measured, analytical : FrequencyResponse or None
        Compared pair.
    output, input : str
        Channel names, or the part after the colon (``"base"`` finds ``"sensor:base"``); the first channels by
        default.
    labels : (str, str)
        Names of the pair.
    overlays : sequence of (label, FrequencyResponse)
        Further responses, for example of open and closed loop.
    log_frequency : bool
        Whether the frequency axis is logarithmic.
    title : str
        Title of the figure.

    Returns
    -------
    Figure
        Figure.

    Raises
    ------
    BadRecording
        There is no response, or units differ.
    UnknownName
        A response has no such output or input.
    """
    pair = zip(labels, (measured, analytical), strict=True)
    curves = [(label, frf) for label, frf in (*pair, *overlays) if frf is not None]
    if not curves or any(frf.freq.size < 2 for _, frf in curves):
        raise BadRecording("no frequency response with at least two lines was given to draw")
    unit = _common_unit([frf.unit for _, frf in curves if frf.unit])
    output, input = output or curves[0][1].outputs[0], input or curves[0][1].inputs[0]
    columns = [(_column("output", frf.outputs, output), _column("input", frf.inputs, input)) for _, frf in curves]
    has_coherence = any(frf.coherence is not None for _, frf in curves)
    figure, axes = stacked_axes(2 + has_coherence, ratios=[2.2, 1.2, 0.9][: 2 + has_coherence])
    phases = [np.degrees(np.angle(frf.H[:, i, j])) for (_, frf), (i, j) in zip(curves, columns, strict=True)]
    low = _phase_cut(phases)
    handles = []
    for k, ((label, frf), (i, j), phase) in enumerate(zip(curves, columns, phases, strict=True)):
        size, look = np.abs(frf.H[:, i, j]), ROLES.get(label, {})
        handles.append(draw_line(axes[0], frf.freq, np.where(size > 0, size, np.nan), k, **look))
        draw_line(axes[1], *_unjoined(*decimate(frf.freq, _wrapped(phase, low))), k, **look)
        if frf.coherence is not None:
            draw_line(axes[2], frf.freq, frf.coherence[:, i], k, **look)
    _label_response(axes, [frf.freq for _, frf in curves], unit, low, log_frequency)
    axes[0].set_title(as_text(title or f"{output} from {input}"), loc="left")
    if len(curves) > 1 or overlays:
        draw_legend(figure, handles, [label for label, _ in curves])
    return figure


def _label_response(axes: Any, freqs: Sequence[Array], unit: str, low: float, log_frequency: bool) -> None:
    ticks = np.arange(np.ceil(low / 90) * 90, low + 361, 90)
    axes[0].set(yscale="log", ylabel=f"magnitude\n[{unit}]")
    axes[1].set(ylabel="phase [deg]", ylim=(low - 10, low + 370), yticks=ticks)
    set_decades(axes[0].yaxis)
    if len(axes) > 2:
        axes[2].set(ylabel="coherence [-]", ylim=(-0.05, 1.05), yticks=(0, 0.5, 1))
    start, stop = min(freq[freq > 0][0] if log_frequency else freq[0] for freq in freqs), max(f[-1] for f in freqs)
    if log_frequency:
        axes[-1].set_xscale("log")
    axes[-1].set(xlabel="frequency [Hz]", xlim=(start, stop))


def _common_unit(given: Sequence[str]) -> str:
    """Return the common unit of an axis."""
    bare = [re.sub(r"^\(([^()]*)\)(?=/|$)", r"\1", unit) for unit in given]
    for unit in bare[1:]:
        if unit != bare[0] and not same_dimension(unit, bare[0]):
            raise BadRecording(
                f"frequency responses in {bare[0]} and in {unit} do not share an axis; integrate() or differentiate() one"
            )
    return pretty_unit(bare[0]) if bare else "SI"


def _column(kind: str, names: Sequence[str], wanted: str) -> int:
    if wanted in names:
        return names.index(wanted)
    same = [i for i, name in enumerate(names) if name.rpartition(":")[2] == wanted.rpartition(":")[2]]
    if len(same) != 1:
        raise unknown_name(kind, wanted, names, where="frequency response")
    return same[0]


def _wrapped(degrees: Array, low: float) -> Array:
    return (degrees - low) % 360.0 + low


def _phase_cut(phases: Sequence[Array]) -> float:
    """Return the phase cut with the fewest jumps."""
    cuts = (-180.0, -270.0, -90.0, -225.0, -135.0, -315.0, -45.0)
    jumps = [sum(np.count_nonzero(np.abs(np.diff(_wrapped(p, low))) > 180) for p in phases) for low in cuts]
    return cuts[jumps.index(min(jumps))]


def _unjoined(x: Array, degrees: Array) -> tuple[Array, Array]:
    """Break a line at its jumps across the cut."""
    at = np.flatnonzero(np.abs(np.diff(degrees)) > 180) + 1
    return np.insert(x, at, x[at]), np.insert(degrees, at, np.nan)
