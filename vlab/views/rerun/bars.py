"""Bars over time in a Rerun scene, in columns for all times."""

from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import ArrayLike
from rerun.components import ColorBatch, LengthBatch, TensorDataBatch

from vlab.signals import Array
from vlab.views.rerun.rrd import PAPER, plain

_LOOK = rr.BarChart
"""_LOOK: archetype with the component descriptions of a bar chart."""


def log_bars(
    stream: Any, path: str, indexes: list[Any], heights: Array, *, middles: ArrayLike, width: float, colour: Any
) -> None:
    """Log bars whose heights change over time.

    `rr.BarChart.columns` takes one row only (rerun-sdk 0.41). This function assembles the column of its tensors.

    Parameters
    ----------
    stream : object
        Rerun stream.
    path : str
        Entity.
    indexes : list of TimeColumn
        Times of the rows.
    heights : (n_rows, n_bars) array
        One row per time.
    middles : (n_bars,) array
        Positions of the bars.
    width : float
        Width of each bar, in the unit of `middles`.
    colour : object
        Colour of the bars.
    """
    left = np.asarray(middles, dtype=float) - width / 2  # the viewer draws a bar from its left edge
    look = [
        rr.DescribedComponentBatch(ColorBatch([colour]), _LOOK.descriptor_color()),
        rr.DescribedComponentBatch(TensorDataBatch(left), _LOOK.descriptor_abscissa()),
        rr.DescribedComponentBatch(LengthBatch(np.full(left.size, width)), _LOOK.descriptor_widths()),
    ]
    stream.log(path, look, static=True)
    rows = [
        TensorDataBatch(np.ascontiguousarray(row)).as_arrow_array() for row in np.asarray(heights, dtype=np.float32)
    ]
    if rows:
        column = rr.ComponentColumn(_LOOK.descriptor_values(), TensorDataBatch(pa.concat_arrays(rows)))
        stream.send_columns(path, indexes, [column])


def bar_view(name: str, origin: str) -> Any:
    """Return a view of the bars under an entity.

    Parameters
    ----------
    name : str
        Name of the view.
    origin : str
        Entity.

    Returns
    -------
    object
        View.
    """
    return rrb.BarChartView(
        name=plain(name),
        origin=origin,
        plot_legend=rrb.PlotLegend(visible=False),
        background=rrb.archetypes.PlotBackground(color=PAPER),
    )
