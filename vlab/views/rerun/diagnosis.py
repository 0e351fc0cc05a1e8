"""Rerun file of a diagnosis: measurement, simulations and residuals."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun.blueprint as rrb

from vlab.diagnose.advice import before_heading
from vlab.diagnose.validation.checked import Checked
from vlab.signals import Recording
from vlab.views.figures import channel_label, pretty_unit
from vlab.views.rerun.documents import cell, fact_list, log_document
from vlab.views.rerun.rrd import blueprint, identity_of, plain, role_rgb, rrd_file
from vlab.views.rerun.traces import axis_unit, log_series, plot_view

ROWS = 4
"""ROWS [-]: channels on one page."""
WIDTHS = {"measured": 2.5, "nominal": 1.5, "calibrated": 1.5, "extended": 1.5}
"""WIDTHS [points]: line width by role, drawn in this order; of nominal and calibrated model only the nearer is drawn."""


def write_scene(path: Path | str, checked: Sequence[Checked], *, title: str, facts: Mapping[str, object]) -> Path:
    """Write checked recordings beside their simulations, one page each.

    Each row is a channel. The left panel shows the overlaid curves, the right panel the residuals.

    Parameters
    ----------
    path : Path or str
        Output file.
    checked : sequence of Checked
        Checked recordings.
    title : str
        Title of the scene.
    facts : mapping
        Further lines of the document.

    Returns
    -------
    Path
        Written file.

    Raises
    ------
    OutputRefused
        The file cannot be written.
    """
    pages, lines = (
        [],
        [
            "",
            f"| recording | channel | unit | {before_heading(checked)} NRMSE | extended NRMSE | noise |",
            "|---|---|---|---|---|---|",
        ],
    )
    for i, run in enumerate(checked):
        rows = []
        for j, (name, errors) in enumerate(run.channels.items()):
            channel = run.measured.channels[run.measured.index(name)]
            unit, origin = pretty_unit(channel.unit), f"/diagnosis/{i}/{j}"
            shown = axis_unit(channel.unit)[1]
            over = plot_view(
                f"{channel_label(channel)} [{shown}]", origin, contents=[f"$origin/{_entity(n)}" for n in WIDTHS]
            )
            rest = plot_view(f"residual [{shown}]", origin, contents=["$origin/left/**"])
            rows.append(rrb.Horizontal(over, rest, column_shares=[3, 2], name=plain(name)))
            numbers = " | ".join(f"{e:.3g}" for e in errors[1:])
            lines.append(f"| {cell(run.name)} | {cell(name)} | {cell(unit)} | {numbers} |")
        for first in range(0, len(rows), ROWS):
            more = f", channels {first + 1} to {min(first + ROWS, len(rows))}" if len(rows) > ROWS else ""
            pages.append(rrb.Vertical(*rows[first : first + ROWS], name=plain(f"{run.name} ({run.role}){more}")))
    views = rrb.Tabs(*pages) if len(pages) > 1 else pages[0]
    layout = blueprint(rrb.Horizontal(views, rrb.TextDocumentView(name="facts", origin="/facts"), column_shares=[3, 1]))
    with rrd_file(path, title, layout, identity_of(*_recordings(checked))) as stream:
        for i, run in enumerate(checked):
            for j, name in enumerate(run.channels):
                _log_channel(stream, run, name, f"diagnosis/{i}/{j}")
        log_document(stream, fact_list(title, facts) + "\n" + "\n".join(lines))
    return Path(path)


def _recordings(checked: Sequence[Checked]) -> list[Recording]:
    return [r for run in checked for r in (run.measured, run.standing, run.extended) if r is not None]


def _log_channel(stream: Any, run: Checked, name: str, origin: str) -> None:
    factor, _ = axis_unit(run.measured.channels[run.measured.index(name)].unit)
    time, truth = run.measured.time, factor * run.measured[name]
    shown = {"measured": run.measured, run.stands: run.standing, "extended": run.extended}
    for label, width in WIDTHS.items():
        recording, colour = shown.get(label), role_rgb(label)
        if recording is None:
            continue  # unbounded simulation, or no added physics
        values = factor * np.asarray(recording[name])
        log_series(stream, f"{origin}/{_entity(label)}", time, values, label, colour, width=width)
        if label != "measured":
            log_series(stream, f"{origin}/left/{_entity(label)}", time, truth - values, f"residual, {label}", colour)


def _entity(label: str) -> str:
    """Return the entity of a curve.

    The viewer draws entities by name, so the thick measurement comes first.
    """
    return f"{list(WIDTHS).index(label)}-{label}"
