"""Traces in a Rerun scene, one plot per kind and unit."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from vlab.signals import Array, Channel, Recording
from vlab.views.figures import channel_label, pretty_unit
from vlab.views.rerun.rrd import PAPER, plain, rgb, time_columns

PEAKS = rr.components.AggregationPolicy.MinMax
"""PEAKS: thinning of traces by extremes; the viewer's default, the average, hides peaks."""
MILLI = {"m": "mm", "m/s": "mm/s"}
"""MILLI: units shown in thousandths; the viewer labels small values with one tick, 0."""
_KIND_ORDER = ("displacement", "velocity", "acceleration", "force", "command", "excitation")


def axis_unit(unit: str) -> tuple[float, str]:
    """Return factor and unit of an axis.

    Parameters
    ----------
    unit : str
        SI unit of the values.

    Returns
    -------
    tuple of (float, str)
        Factor on the values, and the unit for the label.
    """
    return (1e3, MILLI[unit]) if unit in MILLI else (1.0, pretty_unit(unit))


def log_series(
    stream: Any, path: str, time: Array, values: Array, label: str, colour: Any, *, width: float = 1.5
) -> None:
    """Log one curve of a plot, with visible peaks at every zoom."""
    log_many(stream, path, time, np.asarray(values)[:, None], [label], [colour], width=width)


def log_many(
    stream: Any,
    path: str,
    time: Array,
    values: Array,
    labels: Sequence[str],
    colours: Sequence[Any],
    *,
    first: int = 0,
    width: float = 1.5,
) -> None:
    """Log curves with common times as one entity.

    Parameters
    ----------
    stream : object
        Rerun stream.
    path : str
        Entity.
    time : array
        Times [s].
    values : (n, n_curves) array
        Samples of the curves.
    labels : sequence of str
        Names of the curves.
    colours : sequence of object
        Colours of the curves.
    first : int
        Number of the first sample.
    width : float
        Line width.
    """
    n, count = values.shape
    look = rr.SeriesLines(names=labels, colors=colours, widths=[width] * count, aggregation_policy=PEAKS)
    stream.log(path, look, static=True)
    columns = rr.Scalars.columns(scalars=np.ascontiguousarray(values, dtype=float).ravel()).partition([count] * n)
    stream.send_columns(path, time_columns(time, np.arange(first, first + n, dtype=np.int64)), columns)


def _groups(recording: Recording) -> dict[tuple[str, str], list[Channel]]:
    """Return the channels by kind and unit, responses first."""
    known = {kind: i for i, kind in enumerate(_KIND_ORDER)}
    keys = sorted({(c.kind, c.unit) for c in recording.channels}, key=lambda key: (known.get(key[0], -1), key))
    return {key: [c for c in recording.channels if (c.kind, c.unit) == key] for key in keys}


def log_traces(stream: Any, recording: Recording, *, since: int = 0, until: int | None = None) -> None:
    """Log a recording's channels from sample `since` to before `until`."""
    part = slice(since, until)
    for i, ((_, si), channels) in enumerate(_groups(recording).items()):
        factor, unit = axis_unit(si)
        labels = [f"{channel_label(c)} [{unit}]" for c in channels]
        values = factor * recording.data[part, [recording.index(c.name) for c in channels]]
        colours = [rgb(k) for k in range(len(channels))]
        log_many(stream, f"traces/{i}", recording.time[part], values, labels, colours, first=since)


def trace_views(recording: Recording) -> list[Any]:
    """Return the plots of the entities of `log_traces`."""
    views = []
    for i, (kind, unit) in enumerate(_groups(recording)):
        views.append(plot_view(f"{kind} [{axis_unit(unit)[1]}]", f"/traces/{i}"))
    return views


def plot_view(name: str, origin: str, *, contents: Any = "$origin/**") -> Any:
    """Return a plot over time with the common zoom.

    Parameters
    ----------
    name : str
        Name of the plot.
    origin : str
        Entity.
    contents : object
        Shown entities.

    Returns
    -------
    object
        View.
    """
    return rrb.TimeSeriesView(
        name=plain(name),
        origin=origin,
        contents=contents,
        axis_x=rrb.TimeAxis(link=rrb.components.LinkAxis.LinkToGlobal),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop),
        background=rrb.archetypes.PlotBackground(color=PAPER),
    )
