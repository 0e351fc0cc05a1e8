"""Figures of a design: loop plots and robustness."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from vlab.controllers.designed_law import Design
from vlab.controllers.loop_matrices import loops_of, response
from vlab.fe.model import FeModel
from vlab.lab.prediction import SampledLoop
from vlab.lab.robustness import damper_strengths
from vlab.signals import Array, FrequencyResponse
from vlab.views.figures import frf_figure, nyquist_figure, pole_figure, to_png, to_svg
from vlab.views.figures.robustness import dampers_figure, sweep_figure

DRAWN = 16
"""DRAWN [-]: highest mode of the structure in the drawing of a law as dampers."""
CHORD_DEG = 2.0
"""CHORD_DEG [deg]: turn between two points of a resonance circle. A chord is off the circle by 0.02 % of the radius, less
than the width of its line."""


def write_figures(folder: Path, figures: dict[str, Figure]) -> None:
    """Write each figure as NAME.svg and NAME.png."""
    for name, figure in figures.items():
        (folder / f"{name}.svg").write_text(to_svg(figure), encoding="utf-8")
        (folder / f"{name}.png").write_bytes(to_png(figure))


def design_figures(fe: FeModel, design: Design, *, title: str, top: float, damping: float) -> dict[str, Figure]:
    """Return Bode, Nyquist and pole plots of a design.

    Parameters
    ----------
    fe : FeModel
        FE model.
    design : Design
        Design.
    title : str
        Title of the figures.
    top : float
        Highest drawn frequency [Hz].
    damping : float
        Requested damping ratio [-].

    Returns
    -------
    dict
        Figures by file name.
    """
    loops, channels = loops_of(design), design.model.channels
    freq = _lines(_lowest(fe), top, [loops.plant.poles(), loops.closed.poles()])

    def frf(system: Any) -> FrequencyResponse:
        outputs = tuple(f"velocity:{name}" for name in channels)
        inputs = tuple(f"force:{name}" for name in channels)
        return FrequencyResponse(freq=freq, H=response(system, freq), outputs=outputs, inputs=inputs, unit="m/s/N")

    at = fe.structure.exciter if fe.structure.exciter in channels else channels[0]
    plant, closed = frf(loops.plant), frf(loops.closed)
    names = ("open loop", "closed loop")
    return {
        "bode": frf_figure(plant, closed, at, at, labels=names, title=title, log_frequency=True),
        "nyquist": nyquist_figure(freq, response(loops.gain, freq), title=title),
        "poles": _poles(loops.plant.poles(), loops.closed.poles(), damping=damping, top=top),
    }


def loop_figures(fe: FeModel, loop: SampledLoop, *, title: str, top: float, damping: float) -> dict[str, Figure]:
    """Return Nyquist and pole plots of a sampled loop.

    Parameters
    ----------
    fe : FeModel
        FE model.
    loop : SampledLoop
        Sampled loop.
    title : str
        Title of the figures.
    top : float
        Highest drawn frequency [Hz].
    damping : float
        Requested damping ratio [-].

    Returns
    -------
    dict
        Figures by file name.
    """
    free, closed = (part.closed().s for part in (loop.with_gain(0.0), loop))
    freq = _lines(_lowest(fe), top, [free, closed])
    return {
        "nyquist": nyquist_figure(freq, loop.opened(freq), title=title),
        "poles": _poles(free, closed, damping=damping, top=top),
    }


def robustness_figures(loop: SampledLoop, report: dict[str, Any], name: str) -> dict[str, Figure]:
    """Return robustness sweeps and damper strengths of a law.

    Parameters
    ----------
    loop : SampledLoop
        Sampled loop.
    report : dict
        Report of `vlab.lab.robustness.robustness_report`.
    name : str
        Name of the law.

    Returns
    -------
    dict
        Figures by file name.
    """
    figures = {"robustness-sweeps": sweep_figure([(name, report)])}
    if loop.at_coils.shape == loop.at_sensors.shape:
        modes = loop.omega[:DRAWN] / (2 * np.pi)
        marks = [(float(hz), f"mode {i + 1}") for i, hz in enumerate(modes)]
        freq = np.geomspace(0.5 * modes[0], min(1.1 * modes[-1], loop.rate / 2), 800)
        figures["robustness-dampers"] = dampers_figure(freq, damper_strengths(loop, freq), marks=marks)
    return figures


def _poles(free: Array, closed: Array, *, damping: float, top: float) -> Figure:
    return pole_figure([("open loop", free), ("closed loop", closed)], damping=(damping,), highest_hz=top)


def _lowest(fe: FeModel) -> float:
    """Return a frequency well below the first mode [Hz]."""
    return 0.3 * float(fe.linear.freq[fe.linear.freq > 0].min())


def _lines(low: float, high: float, poles: list[Any]) -> Array:
    """Return frequencies [Hz], dense around resonances for round Nyquist circles."""
    lines = [np.geomspace(low, high, 800)]
    turns = np.radians(np.arange(-180.0 + CHORD_DEG, 180.0, CHORD_DEG))
    around = np.tan(turns / 2.0)  # half widths of the resonance at equal turns on its circle
    for s in np.concatenate(poles):
        if 0 < s.imag < 2 * np.pi * high:
            lines.append((s.imag + abs(s.real) * around) / (2 * np.pi))
    freq = np.unique(np.concatenate(lines))
    return freq[(freq >= low) & (freq <= high)]
