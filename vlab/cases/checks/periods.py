"""Check of a stated period against the recorded inputs."""

from collections.abc import Sequence

import numpy as np

from vlab.cases.channel_map import Run
from vlab.cases.checks.correction import Found

UNEQUAL = 0.05
"""UNEQUAL [1]: rms difference of inputs one period apart, over their rms, above which the period is doubtful. Noise of a
measured input and jitter of a clock stay below."""


def check_periods(runs: Sequence[Run]) -> list[Found]:
    """Return stated periods after which the inputs do not repeat.

    Parameters
    ----------
    runs : sequence of Run
        Recordings; those without ``period_s`` pass.

    Returns
    -------
    list of Found
        Warnings.
    """
    out = []
    for run in runs:
        if run.period_s is None:
            continue
        time = run.measured.time - run.measured.time[0]
        if run.period_s > 0.5 * time[-1]:
            text = f"{run.name}: period_s = {run.period_s:g} s, and {time[-1]:g} s hold less than two periods"
            out.append(Found(severity="warning", text=text))
            continue
        inside = time + run.period_s <= time[-1]
        for drive in run.drives:
            u = run.measured[drive.channel]
            apart = np.interp(time[inside] + run.period_s, time, u) - u[inside]
            share = float(np.sqrt(np.mean(apart**2)) / (np.std(u) or 1.0))
            if share > UNEQUAL:
                text = (
                    f"{run.name}: {drive.channel} differs by {100 * share:.2g} % of its rms from itself a period of "
                    f"{run.period_s:g} s later; correct period_s"
                )
                out.append(Found(severity="warning", text=text))
    return out
