"""Figures with units on every axis, as functions of data."""

from vlab.views.figures.mode_difference import mode_difference_figure
from vlab.views.figures.modes import (
    bar_curve,
    frequencies_figure,
    is_upright,
    mac_figure,
    mode_shapes_figure,
)
from vlab.views.figures.nyquist import nyquist_figure
from vlab.views.figures.poles import pole_figure
from vlab.views.figures.response import frf_figure
from vlab.views.figures.style import (
    COLOURS,
    DASHES,
    GREY,
    INK,
    MARKERS,
    POINTS,
    ROLES,
    channel_label,
    decimate,
    pretty_unit,
)
from vlab.views.figures.svg import to_png, to_svg
from vlab.views.figures.traces import aligned, comparison_figure, residual_percent, spectrum_figure, traces_figure

__all__ = [
    "COLOURS",
    "DASHES",
    "GREY",
    "INK",
    "MARKERS",
    "POINTS",
    "ROLES",
    "aligned",
    "bar_curve",
    "channel_label",
    "comparison_figure",
    "decimate",
    "frequencies_figure",
    "frf_figure",
    "is_upright",
    "mac_figure",
    "mode_difference_figure",
    "mode_shapes_figure",
    "nyquist_figure",
    "pole_figure",
    "pretty_unit",
    "residual_percent",
    "spectrum_figure",
    "to_png",
    "to_svg",
    "traces_figure",
]
