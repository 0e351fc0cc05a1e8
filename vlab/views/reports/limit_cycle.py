"""Output folder of the 41 Hz study: JSON document and figures."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from vlab.controllers.catalogue import published_controller
from vlab.controllers.lqg import RATE
from vlab.fe.assembly import build_fe_model
from vlab.hardware import load_hardware
from vlab.lab.prediction import loop_on
from vlab.lab.robustness import damper_strengths, robustness_report
from vlab.reproduce.limit_cycle.runs import SECONDS, histories, levels_of
from vlab.reproduce.limit_cycle.study import OBSERVED_HZ, limit_cycle_report
from vlab.structure.model import Structure
from vlab.views.figures.robustness import dampers_figure, levels_figure, sweep_figure
from vlab.views.figures.svg import to_svg


def write_limit_cycle(
    folder: Path,
    structure: Structure,
    odds: dict[str, Any],
    *,
    seconds: float = SECONDS,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> dict[str, Any]:
    """Write limit-cycle.json and figures; return the document.

    Parameters
    ----------
    folder : Path
        Existing output folder.
    structure : Structure
        Structure.
    odds : dict
        Odds of the explanations, from `vlab.reproduce.limit_cycle.odds`.
    seconds : float
        Duration of the simulated experiments [s].
    seed : int
        Seed of the experiments.
    progress : callable or None
        Receives the simulated time [s], of `simulated_seconds` in all.

    Returns
    -------
    dict
        Document.
    """
    hardware, law = load_hardware().at_rate(RATE), published_controller(structure, "lqg", rate=RATE)
    fe = build_fe_model(structure)
    loop = loop_on(fe, law, hardware.converter)
    runs = histories(structure, seconds=seconds, seed=seed, progress=progress)
    document = limit_cycle_report(structure) | {"odds": odds, "histories": [run.as_dict() for run in runs]}
    freq = np.arange(1.0, 100.0, 0.25)
    marks = [(float(hz), f"mode {i + 1}") for i, hz in enumerate(fe.linear.freq[:10])]
    marks.append((OBSERVED_HZ, "observed"))
    figures = {
        "sweeps": sweep_figure([("LQG", robustness_report(loop))]),
        "dampers": dampers_figure(freq, damper_strengths(loop, freq), marks=marks),
        "levels": levels_figure([(run.name, *levels_of(run.recording, "command:base")) for run in runs]),
    }
    for name, figure in figures.items():
        (folder / f"limit-cycle-{name}.svg").write_text(to_svg(figure), encoding="utf-8")
    (folder / "limit-cycle.json").write_text(json.dumps(document, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    return document
