"""Figure of real cases: hold-out error of every model."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from vlab.proof.real.table import ERRORS, SHOWN_NAME
from vlab.views.figures.style import COLOURS, GREY, INK, as_text, draw_legend, styled

LOOKS: dict[str, dict[str, Any]] = {
    "nominal": {"color": GREY, "marker": "o"},
    "calibrated": {"color": COLOURS[1], "marker": "s"},
    "extended": {"color": COLOURS[0], "marker": "D"},
    "linear": {"color": COLOURS[2], "marker": "^", "mfc": "none"},
    "nonlinear": {"color": COLOURS[3], "marker": "v", "mfc": "none"},
}
"""LOOKS: filled markers for models of physics, open ones for black boxes."""
LEAST, MOST = 0.05, 300.0
"""LEAST, MOST [%]: ends of the axis; errors beyond lie at the ends."""


@styled
def real_figure(rows: Sequence[Mapping[str, Any]]) -> Figure:
    """Draw the hold-out error of every model by case.

    Parameters
    ----------
    rows : sequence of mapping
        Cases of `vlab.proof.real.prove.prove_real`. Cases without an error on hold-out data are left out.

    Returns
    -------
    Figure
        One line a case, one marker a model, on a logarithmic axis.
    """
    shown = [row for row in rows if row["is_held_out"] and any(v is not None for v in row["errors"].values())]
    figure = Figure(figsize=(7.2, 1.2 + 0.3 * max(len(shown), 1)), layout="constrained")
    axes = figure.subplots()
    handles: dict[str, Any] = {}
    for i, row in enumerate(shown):
        values = {model: row["errors"][model] for model in ERRORS}
        known = {model: float(np.clip(100 * v, LEAST, MOST)) for model, v in values.items() if v is not None}
        axes.plot([min(known.values()), max(known.values())], [i, i], color="#dddddd", lw=2.0, zorder=1)
        for model, value in known.items():
            label = SHOWN_NAME.get(model, f"{model} model")
            handles[label] = axes.plot(value, i, ls="none", ms=6, zorder=2, **LOOKS[model])[0]
        if row["noise"]:
            noise = float(np.clip(100 * row["noise"], LEAST, MOST))
            handles["noise"] = axes.plot(noise, i, "|", color=INK, ms=9)[0]
    axes.set(
        xscale="log",
        xlim=(0.9 * LEAST, 1.1 * MOST),
        ylim=(max(len(shown), 1) - 0.5, -0.5),
        xlabel=f"error on hold-out recordings [% of their rms]\nat the ends of the axis: at most {LEAST:g}, at least {MOST:g}",
        yticks=np.arange(len(shown)),
        yticklabels=[as_text(row["case"]) for row in shown],
    )
    axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    order = [SHOWN_NAME.get(model, f"{model} model") for model in ERRORS] + ["noise"]
    names = [name for name in order if name in handles]
    draw_legend(figure, [handles[name] for name in names], names, columns=3)
    return figure
