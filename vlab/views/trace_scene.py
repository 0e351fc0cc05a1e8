"""Traces in a Rerun scene: every sample of every channel, one plot for each kind and unit."""

from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from vlab.signals import Array, Channel, Recording
from vlab.views.figures import COLOURS, channel_label, pretty_unit
from vlab.views.rrd import plain, time_columns

PEAKS = rr.components.AggregationPolicy.MinMax
"""How the viewer thins a trace; its own default, the average, would hide the peaks."""
_KIND_ORDER = ("displacement", "velocity", "acceleration", "force", "command", "excitation")


def log_series(
    stream: Any, path: str, time: Array, values: Array, label: str, colour: Any, *, width: float = 1.5
) -> None:
    """Log one curve of a plot, its peaks kept however far out the viewer zooms."""
    stream.log(path, rr.SeriesLines(names=label, colors=[colour], widths=width, aggregation_policy=PEAKS), static=True)
    stream.send_columns(
        path, time_columns(time, np.arange(time.size, dtype=np.int64)), rr.Scalars.columns(scalars=values)
    )


def _groups(recording: Recording) -> dict[tuple[str, str], list[Channel]]:
    """Return the channels by kind and unit, responses first."""
    known = {kind: i for i, kind in enumerate(_KIND_ORDER)}
    keys = sorted({(c.kind, c.unit) for c in recording.channels}, key=lambda key: (known.get(key[0], -1), key))
    return {key: [c for c in recording.channels if (c.kind, c.unit) == key] for key in keys}


def log_traces(stream: Any, recording: Recording) -> None:
    """Log all channels of a recording."""
    for i, channels in enumerate(_groups(recording).values()):
        for k, channel in enumerate(channels):
            label = f"{channel_label(channel)} [{pretty_unit(channel.unit)}]"
            path = rr.new_entity_path(["traces", str(i), channel.name])
            log_series(stream, path, recording.time, recording[channel.name], label, _rgb(k))


def trace_views(recording: Recording) -> list[Any]:
    """Return the plots of what `log_traces` logs."""
    views = []
    for i, (kind, unit) in enumerate(_groups(recording)):
        views.append(plot_view(f"{kind} [{pretty_unit(unit)}]", f"/traces/{i}"))
    return views


def plot_view(name: str, origin: str, *, contents: Any = "$origin/**") -> Any:
    """Return a plot over time whose zoom is that of the others."""
    return rrb.TimeSeriesView(
        name=plain(name),
        origin=origin,
        contents=contents,
        axis_x=rrb.TimeAxis(link=rrb.components.LinkAxis.LinkToGlobal),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop),
    )


def _rgb(index: int) -> tuple[int, ...]:
    colour = COLOURS[index % len(COLOURS)]
    return (120, 120, 120) if colour == "#000000" else tuple(int(colour[i : i + 2], 16) for i in (1, 3, 5))
