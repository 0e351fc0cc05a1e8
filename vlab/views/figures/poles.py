"""Poles in the s-plane."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from vlab.errors import BadRecording
from vlab.views.figures.style import COLOURS, GREY, INK, MARKERS, draw_legend, styled


@styled
def pole_figure(
    poles: Sequence[tuple[str, ArrayLike]], *, damping: Sequence[float] = (), highest_hz: float | None = None
) -> Figure:
    """Draw poles in the upper half of the s-plane.

    Parameters
    ----------
    poles : sequence of (label, complex array)
        Poles s [rad/s], for example of the open and the closed loop.
    damping : sequence of float
        Damping ratios of drawn lines [-].
    highest_hz : float or None
        Highest drawn frequency [Hz].

    Returns
    -------
    Figure
        Figure.
    """
    upper = []
    for label, s in poles:
        s = np.asarray(s, dtype=complex).ravel()
        keep = (s.imag >= 0) & (np.abs(s) <= 2 * np.pi * (np.inf if highest_hz is None else highest_hz))
        upper.append((label, s[keep]))
    everything = np.concatenate([s for _, s in upper]) if upper else np.array([])
    if everything.size == 0:
        raise BadRecording("no pole was given to draw")
    figure = Figure(figsize=(5.6, 4.4), layout="constrained")
    axes: Any = figure.subplots()
    handles = []
    for k, (_, s) in enumerate(upper):
        marker, face = ("x", COLOURS[0]) if k == 0 else (MARKERS[(k - 1) % len(MARKERS)], "none")
        style = {"color": COLOURS[k % len(COLOURS)], "linestyle": "none", "markerfacecolor": face, "markersize": 6}
        handles.append(axes.plot(s.real, s.imag, marker=marker, **style)[0])
    decay = np.abs(everything.real[everything.real != 0])
    if decay.size and decay.max() > 100 * decay.min():
        floor = 10.0 ** np.floor(np.log10(max(decay.min(), 1e-6 * decay.max())))
        axes.set_xscale("symlog", linthresh=floor)
    low, high = -1.5 * max(0.0, -everything.real.min()), max(1.5 * everything.real.max(), 0.0)
    room = 0.15 * max(-low, high, 1e-9) if axes.get_xscale() == "linear" else (decay.min() if decay.size else 1.0)
    low, high, top = min(low, -room), max(high, room), 1.08 * max(everything.imag.max(), 1e-9)
    axes.axvspan(0.0, high, color="#eeeeee", zorder=0)
    axes.axvline(0.0, color=INK, lw=0.8)
    _damping_lines(axes, damping, low, top)
    axes.set(xlabel="real part [rad/s]", ylabel="imaginary part [rad/s]", xlim=(low, high), ylim=(0.0, top))
    hertz = axes.secondary_yaxis("right", functions=(_per_turn, _per_second))
    hertz.set_ylabel("imaginary part / 2π [Hz]")
    draw_legend(figure, handles, [label for label, _ in upper])
    return figure


def _damping_lines(axes: Any, ratios: Sequence[float], low: float, top: float) -> None:
    imaginary = np.linspace(1e-9, top, 400)
    for ratio in ratios:
        if not 0 < ratio < 1:
            raise BadRecording(f"a line of damping ratio {ratio:g} cannot be drawn; accepted: between 0 and 1")
        real = -ratio / np.sqrt(1 - ratio**2) * imaginary
        axes.plot(real, imaginary, color=GREY, lw=0.8, linestyle=":")
        leaves_at_top = real[-1] > low
        place = (real[-1], 0.985 * top) if leaves_at_top else (0.985 * low, -0.985 * low * top / -real[-1])
        side = {"ha": "right", "va": "top"} if leaves_at_top else {"ha": "left", "va": "bottom"}
        axes.text(*place, f" ζ = {ratio:g} ", color="#555555", fontsize=7.5, **side)


def _per_turn(omega: Any) -> Any:
    return omega / (2 * np.pi)


def _per_second(freq: Any) -> Any:
    return freq * 2 * np.pi
