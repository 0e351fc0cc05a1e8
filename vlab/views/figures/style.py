"""The look of every figure: colours that the colour-blind tell apart, lines thinned to their extremes, units as printed.

The colours are those of Okabe and Ito [1]_, and every curve has its own line style too, so that a black-and-white print
can be read. Long traces are thinned to the extremes of short stretches: no peak is lost.

References
----------
.. [1] M. Okabe, K. Ito, *Color Universal Design*, 2008, https://jfly.uni-koeln.de/color/.
"""

import functools
import itertools
from collections.abc import Callable, Sequence
from typing import Any, ParamSpec

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from vlab.signals import Array, Channel

INK, GREY = "#000000", "#9a9a9a"
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#000000", "#56B4E9", "#E69F00")
"""Okabe-Ito without its yellow, which is too light for a line on white."""
DASHES: tuple[Any, ...] = ("-", (0, (5, 1.6)), (0, (1.2, 1.2)), (0, (6, 1.5, 1.2, 1.5)), (0, (9, 2)), (0, (3, 1)), "-")
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
POINTS = 2000
"""Most points of a line in a figure."""
STYLE = {
    "font.family": "sans-serif",
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.1,
    "lines.markersize": 4.5,
    "legend.frameon": False,
    "legend.handlelength": 3.0,
    "figure.facecolor": "white",
}
_KIND_WORDS = {"other": "", "angular-velocity": "angular velocity", "angular-acceleration": "angular acceleration"}

Options = ParamSpec("Options")


def styled(draw: Callable[Options, Figure]) -> Callable[Options, Figure]:
    """Draw in this style without changing matplotlib's own settings."""

    @functools.wraps(draw)
    def in_style(*args: Options.args, **kwargs: Options.kwargs) -> Figure:
        with mpl.rc_context(STYLE):
            return draw(*args, **kwargs)

    return in_style


def decimate(x: ArrayLike, y: ArrayLike, *, limit: int = POINTS) -> tuple[Array, Array]:
    """Return at most `limit` of the samples: the smallest and the largest of each stretch, and both ends."""
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    if len(x) <= limit:
        return x, y
    edges = np.linspace(0, len(x), max(1, (limit - 2) // 2) + 1).astype(int)
    extremes = [a + f(y[a:b]) for a, b in itertools.pairwise(edges) for f in (np.argmin, np.argmax)]
    keep = np.unique([0, *extremes, len(x) - 1])
    return x[keep], y[keep]


def as_text(words: object) -> str:
    """Return text that matplotlib draws as it stands: no mathematics, no control characters, never hidden."""
    shown = "".join(c if c.isprintable() or c == "\n" else " " for c in str(words)).replace("$", r"\$")
    return f" {shown}" if shown.startswith("_") else shown


def pretty_unit(unit: str) -> str:
    """Return a unit as it is printed: superscripts for powers, a dash for a ratio."""
    return {"": "-", "1": "-"}.get(unit, unit.replace("^2", "²").replace("^3", "³"))


def channel_label(channel: Channel) -> str:
    """Return kind and place of a channel, or its name where it has no place."""
    kind = _KIND_WORDS.get(channel.kind, channel.kind)
    return f"{kind} {channel.at}".strip() if channel.at else channel.name


def axis_label(channel: Channel, *, power: str = "") -> str:
    """Return what stands beside an axis: the channel and its unit, `power` behind it."""
    return as_text(f"{channel_label(channel)}\n[{pretty_unit(channel.unit)}{power}]")


def draw_line(axes: Any, x: ArrayLike, y: ArrayLike, index: int, **options: Any) -> Any:
    """Draw a thinned curve in the colour and line style of its index."""
    dash = "-" if np.size(x) > 4 * POINTS else DASHES[index % len(DASHES)]  # dashes drown in a thinned trace
    style = {"color": COLOURS[index % len(COLOURS)], "linestyle": dash, **options}
    return axes.plot(*decimate(x, y), **style)[0]


def stacked_axes(
    rows: int, *, width: float = 7.2, each: float = 1.35, ratios: Sequence[float] | None = None
) -> tuple[Any, Any]:
    """Return a figure and its axes, one above the other."""
    height = each * (sum(ratios) if ratios is not None else rows) + 0.8
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(rows, 1, sharex=True, squeeze=False, height_ratios=ratios)[:, 0]


def draw_legend(figure: Figure, handles: Sequence[Any], labels: Sequence[str], *, columns: int = 4) -> None:
    """Name the curves above the axes."""
    if labels:
        wide = sum(len(label) + 8 for label in labels) > 90  # characters that fit beside each other
        columns = min(2 if wide else columns, len(labels))
        figure.legend(handles, [as_text(s) for s in labels], loc="outside upper center", ncols=columns)
