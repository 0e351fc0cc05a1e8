"""Style of every figure: safe colours, thinned lines, printed units.

The colours are those of Okabe and Ito [1]_, distinct for colour-blind readers. Every curve also has its own line
style for black-and-white print. Long traces are thinned to the extremes of short stretches, so no peak is lost.

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
from matplotlib.layout_engine import LayoutEngine
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator
from numpy.typing import ArrayLike

from vlab.signals import Array, Channel

INK, GREY = "#000000", "#9a9a9a"
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#000000", "#56B4E9", "#E69F00")
"""COLOURS: Okabe-Ito without yellow, which is too light for a line on white."""
DASHES: tuple[Any, ...] = ("-", (0, (5, 1.6)), (0, (1.2, 1.2)), (0, (6, 1.5, 1.2, 1.5)), (0, (9, 2)), (0, (3, 1)), "-")
ROLES: dict[str, dict[str, Any]] = {
    "measured": {"color": INK, "linestyle": "-"},
    "estimated": {"color": INK, "linestyle": "-"},
    "simulated": {"color": INK, "linestyle": "-"},
    "nominal": {"color": GREY, "linestyle": (0, (2.5, 1.2))},
    "FE model": {"color": GREY, "linestyle": (0, (5, 1.6))},
    "calibrated": {"color": COLOURS[1], "linestyle": (0, (5, 1.6))},
    "fitted": {"color": COLOURS[1], "linestyle": (0, (5, 1.6))},
    "extended": {"color": COLOURS[0], "linestyle": "-"},
    "residual": {"color": COLOURS[2], "linestyle": "-"},
}
"""ROLES: looks of curves with a role. Data are black, a model before any fit is grey, a fitted model orange, a model with
its missing physics blue. "simulated" means the record of a simulated experiment, which takes the place of a measurement."""
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
POINTS = 2000
"""POINTS [-]: most points of a line in a figure."""
SHORT = 0.5
"""SHORT [m, m/s]: length or speed below which millimetres read better."""
STYLE = {
    "font.family": "sans-serif",
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    "axes.titley": 1.0,
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

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

Options = ParamSpec("Options")


class ColumnLayout(LayoutEngine):
    """Positions of axes in one column.

    The room for titles, labels and legend follows from their presence. Nothing is measured, because measuring all texts
    takes longer than drawing them.
    """

    _adjust_compatible, _colorbar_gridspec = True, False
    LEFT, RIGHT, EDGE = 0.95, 0.12, 0.05
    """LEFT, RIGHT, EDGE [inch]: room for vertical labels and ticks, at the right, and at top and bottom."""
    LABEL, TICKS, TITLE, GAP, LINE = 0.19, 0.23, 0.22, 0.16, 0.2
    """LABEL, TICKS, TITLE, GAP, LINE [inch]: height of a horizontal label, of tick labels, of a title, of a gap without
    title, and of a line of the legend."""

    def execute(self, fig: Any) -> None:
        """Place the axes and their labels.

        Parameters
        ----------
        fig : Figure
            Figure with axes in one column.
        """
        width, height = fig.get_size_inches()
        rows = sorted(fig.axes, key=lambda axes: axes.get_subplotspec().rowspan.start)
        ratios = rows[0].get_gridspec().get_height_ratios()
        titled = [any(axes.get_title(loc) for loc in ("left", "center", "right")) for axes in rows]
        above = [self.TITLE if has_title else self.GAP for has_title in titled]
        below = [
            self.TICKS * bool(axes.xaxis.get_tick_params()["labelbottom"]) + self.LABEL * bool(axes.get_xlabel())
            for axes in rows
        ]
        lines = sum(-(-len(legend.texts) // max(legend._ncols, 1)) for legend in fig.legends)
        room = height - 2 * self.EDGE - self.LINE * lines - sum(above) - sum(below)
        across, top = width - self.LEFT - self.RIGHT, height - self.EDGE - self.LINE * lines
        for axes, ratio, over, under in zip(rows, ratios, above, below, strict=True):
            tall = max(room * ratio / sum(ratios), self.LINE)
            top -= over + tall
            axes.set_position((self.LEFT / width, top / height, across / width, tall / height))
            axes.yaxis.set_label_coords(-(self.LEFT - 0.37) / across, 0.5)
            axes.xaxis.set_label_coords(0.5, -self.TICKS / tall)
            top -= under


def styled(draw: Callable[Options, Figure]) -> Callable[Options, Figure]:
    """Decorate a drawing function with this style.

    Parameters
    ----------
    draw : callable
        Function that returns a figure.

    Returns
    -------
    callable
        Function with the same arguments.
    """

    @functools.wraps(draw)
    def in_style(*args: Options.args, **kwargs: Options.kwargs) -> Figure:
        with mpl.rc_context(STYLE):
            return draw(*args, **kwargs)

    return in_style


def decimate(x: ArrayLike, y: ArrayLike, *, limit: int = POINTS) -> tuple[Array, Array]:
    """Return extremes of short stretches, and both ends.

    Parameters
    ----------
    x : ArrayLike
        Abscissas.
    y : ArrayLike
        Ordinates.
    limit : int
        Most returned samples.

    Returns
    -------
    tuple
        Thinned abscissas and ordinates.
    """
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    if len(x) <= limit:
        return x, y
    edges = np.linspace(0, len(x), max(1, (limit - 2) // 2) + 1).astype(int)
    extremes = [a + f(y[a:b]) for a, b in itertools.pairwise(edges) for f in (np.argmin, np.argmax)]
    keep = np.unique([0, *extremes, len(x) - 1])
    return x[keep], y[keep]


def as_text(words: object) -> str:
    """Return text without mathematics and control characters, visible in matplotlib."""
    shown = "".join(c if c.isprintable() or c == "\n" else " " for c in str(words)).replace("$", r"\$")
    return f" {shown}" if shown.startswith("_") else shown


def pretty_unit(unit: str) -> str:
    """Return a printed unit."""
    return {"": "-", "1": "-"}.get(unit, unit.replace("^2", "²").replace("^3", "³"))


def channel_label(channel: Channel) -> str:
    """Return kind and place of a channel."""
    kind = _KIND_WORDS.get(channel.kind, channel.kind)
    return f"{kind} {channel.at}".strip() if channel.at else channel.name


def axis_label(channel: Channel, *, power: str = "", unit: str = "") -> str:
    """Return the axis label of a channel, in its own unit by default."""
    return as_text(f"{channel_label(channel)}\n[{pretty_unit(unit or channel.unit)}{power}]")


def readable(channel: Channel, largest: float) -> tuple[float, str]:
    """Return factor and unit for legible values of a channel.

    Parameters
    ----------
    channel : Channel
        Channel in SI.
    largest : float
        Largest size of the values.

    Returns
    -------
    tuple of (float, str)
        Millimetres for short lengths, degrees for angles, else the channel's unit.
    """
    if channel.unit == "rad":
        return float(np.degrees(1.0)), "deg"
    if channel.unit in ("m", "m/s") and 0 < largest < SHORT:
        return 1e3, f"m{channel.unit}"
    return 1.0, channel.unit


def set_log_axis(axes: Any, *, decades_only: bool = False) -> None:
    """Label a logarithmic horizontal axis with plain numbers."""
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(10.0, (1.0,) if decades_only else (1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())


def set_decades(axis: Any) -> None:
    """Label the decades of a logarithmic axis in plain text.

    Plain text is drawn faster than formulas.
    """
    axis.set_major_formatter(FuncFormatter(lambda x, _: _decade(x)))
    axis.set_minor_locator(NullLocator())


def _decade(value: float) -> str:
    exponent = round(np.log10(value)) if value > 0 else 0
    if not np.isclose(value, 10.0**exponent):
        return ""
    return f"{value:g}" if abs(exponent) < 4 else "10" + str(exponent).translate(_RAISED)


def draw_line(axes: Any, x: ArrayLike, y: ArrayLike, index: int, **options: Any) -> Any:
    """Draw a thinned curve in an indexed style."""
    dash = "-" if np.size(x) > 4 * POINTS else DASHES[index % len(DASHES)]  # dashes are invisible in a thinned trace
    style = {"color": COLOURS[index % len(COLOURS)], "linestyle": dash, **options}
    return axes.plot(*decimate(x, y), **style)[0]


def stacked_axes(
    rows: int,
    *,
    width: float = 7.2,
    each: float = 1.35,
    ratios: Sequence[float] | None = None,
    shares_x: bool = True,
) -> tuple[Any, Any]:
    """Return a figure and its axes in one column.

    Parameters
    ----------
    rows : int
        Number of axes.
    width, each : float
        Width of the figure, and height of axes with a ratio of one [inch].
    ratios : sequence of float or None
        Heights relative to `each`; all one by default.
    shares_x : bool
        Whether the axes have one horizontal axis, labelled at the bottom.

    Returns
    -------
    tuple of (Figure, array of Axes)
        Figure and axes from the top.
    """
    height = each * (sum(ratios) if ratios is not None else rows) + 0.8
    figure = Figure(figsize=(width, height), layout=ColumnLayout())
    return figure, figure.subplots(rows, 1, sharex=shares_x, squeeze=False, height_ratios=ratios)[:, 0]


def draw_legend(figure: Figure, handles: Sequence[Any], labels: Sequence[str], *, columns: int = 4) -> None:
    """Name the curves above the axes."""
    if labels:
        wide = sum(len(label) + 8 for label in labels) > 90  # characters per row
        columns = min(2 if wide else columns, len(labels))
        figure.legend(handles, [as_text(s) for s in labels], loc="outside upper center", ncols=columns)
