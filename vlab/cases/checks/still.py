"""Sensors that never move: a recording of them fits any model, so no fit begins."""

from collections.abc import Sequence

import numpy as np

from vlab.cases.channel_map import Run, compared_names
from vlab.cases.checks.correction import Found
from vlab.recordings.quality import findings


def check_still(runs: Sequence[Run]) -> list[Found]:
    """Return sensors that stand still in every recording to fit.

    Parameters
    ----------
    runs : sequence of Run
        Recordings of a case.

    Returns
    -------
    list of Found
        Fatal findings, with the value of each recording; empty where all sensors move.
    """
    fitted = [run for run in runs if run.role == "fit"]
    names = compared_names(fitted)
    moving = {
        name
        for run in fitted
        for name in run.measured.names
        if name in names and run.measured.is_read(name).any() and np.ptp(run.measured[name]) > 0.0
    }
    still = [name for name in names if name not in moving]
    if not still:
        return []
    texts = [f"{name} stands still in every recording to fit" for name in still]
    if len(still) == len(names):
        texts = ["no sensor moves in any recording to fit"]
    values = [
        f"{run.name}: {found.text}"
        for run in fitted
        for found in findings(run.measured)
        if found.kind == "constant" and found.channel in still
    ]
    return [
        *(Found(severity="fatal", text=text, channels=tuple(still)) for text in texts),
        *(Found(severity="warning", text=text, channels=tuple(still)) for text in dict.fromkeys(values)),
    ]
