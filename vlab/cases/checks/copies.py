"""Check of held-out recordings against copies of fitted ones."""

from collections.abc import Sequence

import numpy as np

from vlab.cases.channel_map import Run
from vlab.cases.checks.correction import Found


def check_copies(runs: Sequence[Run]) -> list[Found]:
    """Return held-out recordings whose readings are those of a fitted one.

    Noise differs between two measurements, so equal readings in all channels are one measurement twice. A file that is
    named twice is refused earlier; copies under other names show in the values only.

    Parameters
    ----------
    runs : sequence of Run
        Recordings.

    Returns
    -------
    list of Found
        Fatal findings: a copy verifies nothing.
    """
    out = []
    fitted = [run for run in runs if run.role == "fit"]
    for held in (run for run in runs if run.role != "fit"):
        twin = next((run for run in fitted if _is_copy(run, held)), None)
        if twin is not None:
            text = (
                f"{held.name}: all readings equal those of {twin.name}, which is fitted, so the held-out recording "
                "verifies nothing; name another recording, or hold out a part of the recording by start_s and stop_s"
            )
            out.append(Found(severity="fatal", text=text))
    return out


def _is_copy(one: Run, other: Run) -> bool:
    names = [c.channel for c in other.compared]
    if len(one.measured) != len(other.measured) or not names:
        return False
    if any(name not in one.measured.names for name in names):
        return False
    mine, its = one.measured.select(names).data, other.measured.select(names).data
    return bool(np.ptp(its, axis=0).any() and np.array_equal(mine, its, equal_nan=True))
