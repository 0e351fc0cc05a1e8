"""Figures of robustness: axes with units, curves where the data are."""

import numpy as np
import pytest

from vlab.errors import BadRecording
from vlab.lab.laws import published_law
from vlab.lab.prediction import loop_on
from vlab.lab.robustness import damper_strengths, robustness_report
from vlab.views.figures.robustness import dampers_figure, levels_figure, sweep_figure


def test_sweeps_are_drawn_over_delay_and_gain(beam, fe, laboratory):
    report = robustness_report(loop_on(fe, published_law(beam, "mfdrf"), laboratory.converter))
    left, right = sweep_figure([("MFDRF", report)]).axes
    assert left.get_xlabel() == "delay [samples]"
    assert "[1/s]" in left.get_ylabel()
    assert "linear within" in left.get_ylabel()
    assert right.get_xlabel() == "factor on all commands [-]"
    assert left.lines[0].get_ydata() == pytest.approx([p["growth_per_s"] for p in report["delay_sweep"]])


def test_a_report_without_sweeps_cannot_be_drawn(beam, fe, laboratory):
    report = robustness_report(loop_on(fe, published_law(beam, "mfdrf"), laboratory.converter), sweeps=False)
    with pytest.raises(BadRecording, match="no robustness report with sweeps"):
        sweep_figure([("MFDRF", report)])


def test_damper_strengths_are_drawn_with_their_unit(beam, fe, laboratory):
    freq = np.linspace(1.0, 100.0, 50)
    strengths = damper_strengths(loop_on(fe, published_law(beam, "mfdrf"), laboratory.converter), freq)
    (axes,) = dampers_figure(freq, strengths, marks=[(41.0, "observed")]).axes
    assert axes.get_ylabel() == "damper strength [N s/m]"
    assert [line.get_ydata()[0] for line in axes.lines[:3]] == pytest.approx(list(strengths[0]))
    assert any("observed" in text.get_text() for text in axes.texts)


def test_levels_are_logarithmic():
    (axes,) = levels_figure(
        [("rest", np.arange(5.0), np.zeros(5)), ("grows", np.arange(5.0), np.exp(np.arange(5.0)))]
    ).axes
    assert axes.get_yscale() == "log"
    assert axes.get_xlabel() == "time [s]"
