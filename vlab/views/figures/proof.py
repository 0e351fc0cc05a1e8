"""Figures of a campaign's score: rates, confusion, detection limits, reliability."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy import stats

from vlab.views.figures.style import COLOURS, GREY, INK, as_text, draw_legend, set_log_axis, styled

SIZE_BINS = 6
"""SIZE_BINS [-]: groups of equally many cases in the detection rate over size."""


@styled
def rates_figure(
    rows: Sequence[tuple[str, int, int, tuple[float, float], tuple[float | None, float | None]]],
) -> Figure:
    """Draw counted rates with their intervals and targets.

    Parameters
    ----------
    rows : sequence of (name, count, of, interval, (least, most))
        Rates with the bounds of their targets; None without a bound.

    Returns
    -------
    Figure
        Figure with one row per rate.
    """
    figure = Figure(figsize=(7.2, 1.2 + 0.3 * len(rows)), layout="constrained")
    axes = figure.subplots()
    handles: dict[str, Any] = {}
    for i, (_, count, of, (low, high), target) in enumerate(rows):
        handles["counted, with its exact 95 % interval"] = axes.plot([low, high], [i, i], color=COLOURS[0], lw=2.2)[0]
        axes.plot(count / max(of, 1), i, "o", color=COLOURS[0], ms=6)
        for end, marker, name in zip(target, "><", ("target: at least", "target: at most"), strict=True):
            if end is not None:
                (handles[name],) = axes.plot(end, i, marker, color=COLOURS[1], ms=6, linestyle="none")
        axes.text(1.03, i, f"{count}/{of}", va="center", fontsize=8)
    axes.set(
        xlim=(-0.01, 1.01),
        ylim=(len(rows) - 0.5, -0.5),
        xlabel="share of the cases [-]",
        yticks=np.arange(len(rows)),
        yticklabels=[as_text(row[0]) for row in rows],
    )
    draw_legend(figure, list(handles.values()), list(handles), columns=3)
    return figure


@styled
def confusion_figure(confusion: Mapping[str, Mapping[str, int]]) -> Figure:
    """Draw counts of first answers for each hidden effect.

    A ring marks the column of the right effect.

    Parameters
    ----------
    confusion : mapping
        Counts of answers by hidden effect.

    Returns
    -------
    Figure
        Figure.
    """
    truths = list(confusion)
    verdicts = sorted({a for row in confusion.values() for a in row} - set(truths))
    answers = [t for t in truths if any(t in row for row in confusion.values())] + verdicts
    counts = np.array([[row.get(a, 0) for a in answers] for row in confusion.values()], dtype=float)
    figure = Figure(figsize=(2.4 + 0.2 * len(answers), 2.2 + 0.19 * len(truths)), layout="constrained")
    axes = figure.subplots()
    share = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    axes.imshow(share, cmap="Blues", vmin=0.0, vmax=2.5, aspect="auto")  # pale, for numbers are on top
    for i, truth in enumerate(truths):
        for j in map(int, np.flatnonzero(counts[i])):
            axes.text(j, i, f"{counts[i, j]:.0f}", ha="center", va="center", fontsize=7, color=INK)
        if truth in answers:
            axes.plot(answers.index(truth), i, "s", mfc="none", mec=COLOURS[1], mew=0.9, ms=10)
    axes.set_xticks(np.arange(len(answers)), [as_text(a) for a in answers], rotation=90, fontsize=7)
    axes.set_yticks(np.arange(len(truths)), [as_text(t) for t in truths], fontsize=7)
    axes.set(xlabel="first answer", ylabel="hidden (in brackets: not in the library)")
    axes.grid(visible=False)
    return figure


@styled
def detection_figure(sizes: Sequence[float], found: Mapping[str, Sequence[bool]]) -> Figure:
    """Draw the found share of effects over their size.

    Parameters
    ----------
    sizes : sequence of float
        Residuals in multiples of the noise.
    found : mapping of str to sequence of bool
        Result for each size, by criterion.

    Returns
    -------
    Figure
        Figure.
    """
    figure = Figure(figsize=(7.2, 3.2), layout="constrained")
    axes = figure.subplots()
    size = np.asarray(sizes, dtype=float)
    handles: dict[str, Any] = {}
    parts = [p for p in np.array_split(np.argsort(size), min(SIZE_BINS, max(size.size, 1))) if p.size]
    for k, (name, flags) in enumerate(found.items()):
        hit, colour, marker = np.asarray(flags, dtype=float), COLOURS[k], "os^"[k % 3]
        at = np.exp([np.log(size[part]).mean() for part in parts]) * (1.0 + 0.03 * k)  # separate the intervals
        share = [hit[part].mean() for part in parts]
        for x, part in zip(at, parts, strict=True):
            interval = stats.binomtest(int(hit[part].sum()), part.size).proportion_ci(0.95, method="exact")
            axes.plot([x, x], [interval.low, interval.high], color=colour, lw=1.6)
        (handles[f"{name}, with 95 % intervals"],) = axes.plot(at, share, marker, ls="-", lw=0.8, color=colour, ms=5)
    (handles["a case"],) = axes.plot(size, np.full(size.size, -0.04), "|", color=GREY, ms=7)
    axes.set(
        xlabel="residual after calibration / noise [-]",
        ylabel="share of the cases [-]",
        ylim=(-0.08, 1.06),
    )
    set_log_axis(axes)
    draw_legend(figure, list(handles.values()), list(handles))
    return figure


@styled
def reliability_figure(curve: Sequence[Mapping[str, float]]) -> Figure:
    """Draw the rate of right findings over their stated probability.

    Parameters
    ----------
    curve : sequence of mappings
        Bins of `vlab.proof.statistics.calibration`.

    Returns
    -------
    Figure
        Figure.
    """
    figure = Figure(figsize=(4.2, 3.6), layout="constrained")
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], color=GREY, linestyle=":")
    for b in curve:
        axes.plot([b["probability"]] * 2, [b["low"], b["high"]], color=COLOURS[0], lw=1.8)
        axes.plot(b["probability"], b["rate"], "o", color=COLOURS[0], ms=5)
        axes.annotate(f"{b['cases']:g}", (b["probability"], b["rate"]), (6, -3), textcoords="offset points", fontsize=8)
    axes.set(
        xlim=(0, 1.05), ylim=(0, 1.05), xlabel="probability given to the first finding [-]", ylabel="share right [-]"
    )
    return figure
