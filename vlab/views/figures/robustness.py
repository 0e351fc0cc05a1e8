"""Robustness of a sampled loop over delay and gain."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from vlab.errors import BadRecording
from vlab.views.figures.style import COLOURS, GREY, INK, as_text, draw_legend, draw_line, stacked_axes, styled

LINEAR = 0.1
"""LINEAR [1/s]: end of the linear part of the axis of growth, which is logarithmic on both sides."""


@styled
def sweep_figure(reports: Sequence[tuple[str, dict[str, Any]]]) -> Figure:
    """Draw the growth of the least stable pole.

    Parameters
    ----------
    reports : sequence of (label, report)
        Reports of `vlab.lab.robustness.robustness_report` with sweeps.

    Returns
    -------
    Figure
        Figure with two panels.

    Raises
    ------
    BadRecording
        There is no report, or one without sweeps.
    """
    if not reports or any("delay_sweep" not in report for _, report in reports):
        raise BadRecording("no robustness report with sweeps was given to draw")
    figure = Figure(figsize=(7.2, 3.4), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    handles = []
    for row, key, name in ((axes[0], "delay_sweep", "samples"), (axes[1], "gain_sweep", "factor")):
        row.axhspan(0.0, 1e3, color="#eeeeee", zorder=0)
        for k, (_, report) in enumerate(reports):
            points = report[key]
            line = draw_line(row, [p[name] for p in points], [p["growth_per_s"] for p in points], k)
            handles.append(line)
        row.set_yscale("symlog", linthresh=LINEAR)
        row.margins(x=0)
    growths = np.concatenate(
        [[p["growth_per_s"] for p in r[k]] for _, r in reports for k in ("delay_sweep", "gain_sweep")]
    )
    axes[0].set_ylim(1.3 * min(growths.min(), -0.1), 1.3 * max(growths.max(), 0.1))
    axes[0].axvline(reports[0][1]["delay_samples"], color=INK, lw=0.8, linestyle=":")
    axes[0].set(
        xlabel="delay [samples]", ylabel=f"growth of the least stable pole [1/s]\n(linear within ±{LINEAR:g}/s)"
    )
    axes[1].set(xlabel="factor on all commands [-]", xscale="log")
    for row, key, name in ((axes[0], "delay_sweep", "samples"), (axes[1], "gain_sweep", "factor")):
        for k, (_, report) in enumerate(reports):
            _name_modes(row, report[key], name, COLOURS[k % len(COLOURS)])
    draw_legend(figure, handles[: len(reports)], [label for label, _ in reports])
    return figure


def _name_modes(axes: Any, points: Sequence[dict[str, Any]], key: str, colour: str) -> None:
    """Write the frequency beside each single-mode stretch of a curve."""
    axes.autoscale_view()
    at = axes.transAxes.inverted().transform(axes.transData.transform([(p[key], p["growth_per_s"]) for p in points]))
    start = 0
    for i in range(1, len(points) + 1):
        if i == len(points) or points[i]["mode"] != points[start]["mode"]:
            k = (start + i - 1) // 2
            before, after = at[max(k - 2, 0), 1], at[min(k + 2, len(at) - 1), 1]
            rise = 0 if abs(after - before) < 0.04 else int(np.sign(after - before))
            if at[k, 0] < 0.2 and rise > 0:
                rise = 0  # no space to the left
            if i - start >= 3:
                axes.annotate(
                    f"{points[k]['hz']:.1f} Hz", (points[k][key], points[k]["growth_per_s"]), (-4 * rise, 4), textcoords="offset points",
                    fontsize=7, color=colour, ha={-1: "left", 0: "center", 1: "right"}[rise],
                )  # fmt: skip
            start = i


@styled
def dampers_figure(freq: ArrayLike, strengths: ArrayLike, *, marks: Sequence[tuple[float, str]] = ()) -> Figure:
    """Draw the damper strengths of a law over frequency.

    Below zero the law drives motion of that frequency.

    Parameters
    ----------
    freq : (n_freq,) array
        Frequencies [Hz].
    strengths : (n_freq, n_coils) array
        Strengths [N s/m] of `vlab.lab.robustness.damper_strengths`.
    marks : sequence of (frequency [Hz], label)
        Marked frequencies, for example of the modes.

    Returns
    -------
    Figure
        Figure.
    """
    freq, strengths = np.asarray(freq, dtype=float), np.asarray(strengths, dtype=float)
    figure, (axes,) = stacked_axes(1, each=3.0)
    low, high = float(strengths.min()), float(strengths.max())
    axes.axhspan(min(1.15 * low, -0.1), 0.0, color="#eeeeee", zorder=0)
    handles = [draw_line(axes, freq, column, k) for k, column in enumerate(strengths.T)]
    wide = freq[0] > 0 and freq[-1] > 20 * freq[0]  # a linear axis would crowd the low modes
    axes.set_xscale("log" if wide else "linear")
    axes.set(
        xlabel="frequency [Hz]",
        ylabel="damper strength [N s/m]",
        ylim=(min(1.15 * low, -0.1), high + 0.25 * (high - low)),
    )
    axes.margins(x=0)
    axes.autoscale_view()  # fix the limits now; positions in the axes depend on them
    last = -np.inf
    for hz, label in sorted(marks):
        axes.axvline(hz, color=GREY, lw=0.8, linestyle=":")
        at = float(axes.transAxes.inverted().transform(axes.transData.transform((hz, 0.0)))[0])
        if at - last > 0.02:  # names of close modes would overlap
            text = {"fontsize": 7, "rotation": 90, "va": "bottom", "ha": "center"}
            on_white = {"facecolor": "white", "edgecolor": "none", "pad": 0.8}
            axes.text(hz, high + 0.03 * (high - low), as_text(label), bbox=on_white, **text)
            last = at
    draw_legend(figure, handles, [f"combination {k + 1} of the coils" for k in range(strengths.shape[1])])
    return figure


@styled
def levels_figure(histories: Sequence[tuple[str, ArrayLike, ArrayLike]], *, ylabel: str = "command, rms [N]") -> Figure:
    """Draw levels over time on a logarithmic axis.

    Parameters
    ----------
    histories : sequence of (label, time [s], level)
        Curves.
    ylabel : str
        Label of the level axis.

    Returns
    -------
    Figure
        Figure.
    """
    figure, (axes,) = stacked_axes(1, each=3.0)
    handles = [draw_line(axes, time, np.maximum(level, 1e-300), k) for k, (_, time, level) in enumerate(histories)]
    axes.set(xlabel="time [s]", ylabel=ylabel, yscale="log")
    axes.margins(x=0)
    draw_legend(figure, handles, [label for label, _, _ in histories], columns=2)
    return figure
