"""Analytical responses as figures."""

import numpy as np
import pytest

from vlab.errors import UnknownName
from vlab.views.figures.structure_response import response_figures


def test_velocity_and_displacement_are_drawn_and_differ_by_the_frequency(fe):
    figures = response_figures(fe, "base", ["40in"])
    assert list(figures) == ["frf-velocity-40in", "frf-displacement-40in"]
    velocity, displacement = (figure.axes[0].lines[0] for figure in figures.values())
    assert figures["frf-velocity-40in"].axes[0].get_ylabel() == "magnitude\n[m/s/N]"
    assert figures["frf-displacement-40in"].axes[0].get_ylabel() == "magnitude\n[m/N]"
    hz = 5.0  # a curve is thinned where it is drawn, each in its own way
    size = [np.interp(hz, line.get_xdata(), line.get_ydata()) for line in (velocity, displacement)]
    assert size[0] / size[1] == pytest.approx(2 * np.pi * hz, rel=0.02)


def test_all_coils_by_default(fe):
    assert len(response_figures(fe, "base")) == 2 * len(fe.structure.coil)


def test_unknown_places_are_refused(fe):
    with pytest.raises(UnknownName, match="unknown place '41in'"):
        response_figures(fe, "base", ["41in"])
