"""Nyquist plot of a loop with one channel or several."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from vlab.errors import BadRecording
from vlab.views.figures.style import COLOURS, GREY, INK, as_text, styled

NEAR = 3.0
"""NEAR [-]: half width of the drawing around -1."""


@styled
def nyquist_figure(freq: ArrayLike, loop: ArrayLike, *, title: str = "") -> Figure:
    """Draw det(I + L) - 1 over frequency.

    With a stable open loop, the closed loop is stable if the curve does not encircle -1. For one channel the curve is
    L itself. On the circle of radius one about -1 the return difference has size one. Outside the circle, feedback
    reduces disturbances.

    Parameters
    ----------
    freq : (n,) array
        Frequencies [Hz], increasing.
    loop : (n, m, m) or (n,) complex array
        Loop gain L, negative feedback.
    title : str
        Title of the figure.

    Returns
    -------
    Figure
        Figure.

    Raises
    ------
    BadRecording
        Fewer than two points, inconsistent shapes, or numbers that are not finite.
    """
    f, L = np.asarray(freq, dtype=float), np.asarray(loop, dtype=complex)
    L = L[:, None, None] if L.ndim == 1 else L
    if f.ndim != 1 or f.size < 2 or L.ndim != 3 or len(L) != f.size or L.shape[1] != L.shape[2]:
        raise BadRecording(f"a loop gain of shape {L.shape} on {f.shape} frequencies cannot be drawn")
    if not (np.all(np.isfinite(L)) and np.all(np.isfinite(f))):
        raise BadRecording("the loop gain holds a number that is not finite")
    curve = np.linalg.det(np.eye(L.shape[1]) + L) - 1
    figure = Figure(figsize=(8.4, 4.2), layout="constrained")
    whole, close = figure.subplots(1, 2)
    angle = np.linspace(0, 2 * np.pi, 200)
    name = "det(I + L) - 1" if L.shape[1] > 1 else "L"
    axes: Any
    for axes in (whole, close):
        axes.plot(curve.real, curve.imag, color=COLOURS[0], lw=1.0)
        axes.plot(curve.real, -curve.imag, color=COLOURS[0], lw=0.7, linestyle=":")
        axes.plot(-1 + np.cos(angle), np.sin(angle), color=GREY, lw=0.8, linestyle="--")
        axes.plot([-1.0], [0.0], marker="+", color=INK, markersize=9)
        axes.set(xlabel=f"Re {name} [-]", ylabel=f"Im {name} [-]")
    peak = int(np.abs(curve).argmax())
    to_unbounded = {"ha": "right", "xytext": (-4, 0)} if curve[peak].real > 0 else {"ha": "left", "xytext": (4, 0)}
    at = (curve[peak].real, curve[peak].imag)
    whole.annotate(f"{f[peak]:.3g} Hz", at, textcoords="offset points", fontsize=7.5, color=INK, **to_unbounded)
    whole.set_aspect("equal", adjustable="datalim")
    close.set(xlim=(-NEAR - 1, NEAR - 1), ylim=(-NEAR, NEAR), title="around -1")
    close.set_aspect("equal")
    whole.set_title(as_text(title))
    return figure
