"""Two runs in one Rerun file, overlaid."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rerun.blueprint as rrb

from vlab.errors import BadRecording
from vlab.lab.run_folder import RunSettings, load_run
from vlab.signals import Recording
from vlab.structure import load_structure
from vlab.structure.model import Structure
from vlab.views.figures import channel_label, pretty_unit
from vlab.views.rerun.documents import cell, fact_list, log_document
from vlab.views.rerun.frames import Motion
from vlab.views.rerun.rrd import BLUE, ORANGE, blueprint, identity_of, plain, rrd_file
from vlab.views.rerun.structure import StructureScene, sensible_exaggeration
from vlab.views.rerun.traces import axis_unit, log_series, plot_view

ROWS = 4
"""ROWS [-]: channels on one page."""
LETTERS, COLOURS = "ab", (BLUE, ORANGE)
WIDTHS = (2.5, 1.5)
"""WIDTHS [points]: line widths of the two runs; the viewer draws the second run over the first, which must show."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ShownRun:
    """Run of a comparison.

    Parameters
    ----------
    name : str
        Name of its curves.
    """

    name: str
    recording: Recording
    settings: RunSettings
    structure: Structure
    motion: Motion


def load_two(paths: Sequence[Path]) -> list[ShownRun]:
    """Load two run folders, with distinct names.

    Parameters
    ----------
    paths : sequence of Path
        Two run folders.

    Returns
    -------
    list of ShownRun
        Runs in the same order.

    Raises
    ------
    BadRecording
        The folders are not two run folders of `vlab experiment`, or one is damaged.
    """
    names = [path.resolve().name for path in paths]
    if names[0] == names[1]:
        names = (
            [str(path) for path in paths]
            if paths[0] != paths[1]
            else [f"{name} {k + 1}" for k, name in enumerate(names)]
        )
    out = []
    for path, name in zip(paths, names, strict=True):
        recording, settings = load_run(path)
        if settings is None:
            raise BadRecording(
                f"{path}: two runs are shown from their folders; give folders written by vlab experiment"
            )
        if settings.is_own_model:
            raise BadRecording(
                f"{path}: two runs are shown of beam, grid and structure files; show one run of your model"
            )
        structure = load_structure(settings.inside(path).structure)
        motion = Motion.read(path / "run.rrd")
        out.append(ShownRun(name=name, recording=recording, settings=settings, structure=structure, motion=motion))
    return out


def write_two_runs(path: Path | str, runs: Sequence[ShownRun], *, exaggeration: float | None = None) -> Path:
    """Write two overlaid runs as an arranged Rerun file.

    Each channel of either run has one plot. The structures share one factor on their deflections. Equal structures
    share one picture.

    Parameters
    ----------
    path : Path or str
        Output file.
    runs : sequence of ShownRun
        Two runs.
    exaggeration : float or None
        Factor on the deflections [-]; a visible one by default.

    Returns
    -------
    Path
        Written file.

    Raises
    ------
    OutputRefused
        The file cannot be written.
    """
    scenes = _scenes(runs, exaggeration)
    channels = {c.name: c for run in reversed(runs) for c in run.recording.channels}
    order = list(dict.fromkeys(c.name for run in runs for c in run.recording.channels))
    order.sort(key=lambda name: channels[name].kind in ("command", "force", "excitation"))  # responses first
    rows = []
    for i, name in enumerate(order):
        label = f"{channel_label(channels[name])} [{axis_unit(channels[name].unit)[1]}]"
        rows.append(plot_view(label, f"/channels/{i}"))
    pages = [rrb.Vertical(*rows[i : i + ROWS], name=plain(f"{order[i]} ...")) for i in range(0, len(rows), ROWS)]
    plots = rrb.Tabs(*pages) if len(pages) > 1 else pages[0]
    paper = rrb.TextDocumentView(name="facts", origin="/facts")
    layout = blueprint(rrb.Horizontal(_picture(runs, scenes), plots, paper, column_shares=[3, 4, 3]))
    title = " beside ".join(run.name for run in runs)
    with rrd_file(path, plain(title), layout, identity_of(*(run.recording for run in runs))) as stream:
        log_document(stream, _document(title, runs, scenes, order))  # first, to be visible during loading
        for scene in scenes:
            scene.log(stream)
        for i, name in enumerate(order):
            factor = axis_unit(channels[name].unit)[0]
            for letter, colour, width, run in zip(LETTERS, COLOURS, WIDTHS, runs, strict=True):
                if name in run.recording.names:
                    time, values = run.recording.time, factor * run.recording[name]
                    log_series(stream, f"channels/{i}/{letter}", time, values, plain(run.name), colour, width=width)
    return Path(path)


def _scenes(runs: Sequence[ShownRun], exaggeration: float | None) -> list[StructureScene]:
    largest = max(run.motion.largest for run in runs)
    size = min(_size(run.structure) for run in runs)
    factor = sensible_exaggeration(largest, size) if exaggeration is None else exaggeration
    return [
        StructureScene(run.structure, run.motion, factor, root=f"structures/{letter}", colour=colour)
        for letter, colour, run in zip(LETTERS, COLOURS, runs, strict=True)
    ]


def _size(structure: Structure) -> float:
    corners = np.array([structure.position(p.name) for p in structure.point])
    return float(np.hypot(*np.ptp(corners, axis=0)))


def _picture(runs: Sequence[ShownRun], scenes: Sequence[StructureScene]) -> Any:
    first, second = (run.structure for run in runs)
    if first == second:
        title = f"{runs[0].name} blue, {runs[1].name} orange, × {scenes[0].factor:g}"
        return max(scenes, key=lambda scene: scene.motion.largest).view(title, "/structures")
    return rrb.Vertical(*(s.view(f"{r.name}: {s.title()}") for r, s in zip(runs, scenes, strict=True)))


def _document(title: str, runs: Sequence[ShownRun], scenes: Sequence[StructureScene], order: Sequence[str]) -> str:
    """Return settings and levels of both runs."""
    a, b = (asdict(run.settings) for run in runs)
    differ = {key: f"{_said(a[key])} / {_said(b[key])}" for key in a if a[key] != b[key]}
    facts: Mapping[str, object] = {
        "blue": runs[0].name,
        "orange": runs[1].name,
        "settings that differ": "" if differ else "none",
        **differ,
        "largest deflection": " / ".join(f"{1000 * scene.motion.largest:.3g} mm" for scene in scenes),
    }
    lines = ["", "| channel | unit | rms, blue | rms, orange | orange / blue |", "|---|---|---|---|---|"]
    for name in order:
        levels = [_rms(run.recording, name) for run in runs]
        unit = next(r.recording.channels[r.recording.index(name)].unit for r in runs if name in r.recording.names)
        ratio = f"{levels[1] / levels[0]:.3g}" if levels[0] and levels[1] is not None else "-"
        shown = " | ".join("-" if level is None else f"{level:.3g}" for level in levels)
        lines.append(f"| {cell(name)} | {cell(pretty_unit(unit))} | {shown} | {ratio} |")
    return fact_list(title, facts) + "\n".join(lines)


def _rms(recording: Recording, name: str) -> float | None:
    return float(np.sqrt(np.mean(recording[name] ** 2))) if name in recording.names else None


def _said(value: object) -> str:
    if isinstance(value, (tuple, list)):
        return "; ".join(map(str, value)) or "none"
    return "none" if value in ("", None) else str(value)
