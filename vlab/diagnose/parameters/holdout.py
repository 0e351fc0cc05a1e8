"""Hold-out recordings of a case."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vlab.cases.case import Case
from vlab.cases.channel_map import Run
from vlab.cases.clock import plan_clock
from vlab.diagnose.data.repeats import with_repeats
from vlab.diagnose.data.settled import with_unsettled
from vlab.diagnose.parameters.recorded_runs import with_noise_of
from vlab.diagnose.settings import RECORDED_RUNS
from vlab.errors import BadCase


@dataclass(frozen=True, kw_only=True, eq=False)
class HoldOut:
    """Hold-out recordings of a case.

    Parameters
    ----------
    runs : tuple of Run
        Recordings that can verify a finding.
    notes : tuple of str
        Missing channels, repeated inputs and unused data.
    is_new : bool
        Whether a recording has other inputs than the fitted ones. Equal inputs show the same motion with other noise, and
        cannot refute a law with many free numbers.
    """

    runs: tuple[Run, ...] = ()
    notes: tuple[str, ...] = ()
    is_new: bool = False


def read_holdout(case: Case, names: Sequence[str], fitted: Sequence[Run] = ()) -> HoldOut:
    """Read the hold-out recordings of a case.

    Parameters
    ----------
    case : Case
        Case.
    names : sequence of str
        Channels of the recordings to fit.
    fitted : sequence of Run
        Recordings to fit.

    Returns
    -------
    HoldOut
        Usable recordings and notes.

    Raises
    ------
    BadRecording
        A file is damaged or contradicts the case.
    BadCase
        A recording cannot drive the model, takes too many steps, or is also fitted.
    """
    runs, notes = [], []
    for run in case.runs(("holdout",)):
        plan_clock(case.plant.timestep, run)
        same = next((f.name for f in fitted if np.array_equal(f.measured.data, run.measured.data)), None)
        if same is not None:
            raise BadCase(
                f"{case.path}: {run.name} is held out and has the very samples of {same}, which is fitted: it verifies nothing; "
                "hold out another recording"
            )
        if not moves(run):
            notes.append(f"{run.name}: no compared sensor moves, so it verifies nothing and is left out")
            continue
        few, least = len(run.measured), RECORDED_RUNS.fewest_samples
        if few < least:
            notes.append(f"{run.name}: {few} samples verify nothing, so it is left out; at least {least} do")
            continue
        runs.append(run)
        absent = [name for name in names if name not in run.measured.names]
        if absent:
            notes.append(f"{run.name} lacks {', '.join(absent)}; it is checked on its other channels")
    held_out = with_unsettled(with_repeats(runs, fitted), case.plant)
    names_of = {id(f.measured): f.name for f in fitted}
    of_fitted = {run.name: [names_of[id(m)] for m in run.repeats if id(m) in names_of] for run in held_out}
    repeated = {name: same[0] for name, same in of_fitted.items() if same}
    notes += [
        f"{name} repeats the inputs of {same}, which is fitted: it verifies the noise, not another motion"
        for name, same in repeated.items()
    ]
    if not runs:
        notes.append("no hold-out recording: nothing could be verified on data that the search did not use")
    return HoldOut(
        runs=with_noise_of(held_out, [*held_out, *fitted]),
        notes=(*notes, *_unused(case)),
        is_new=len(repeated) < len(runs),
    )


def moves(run: Run) -> bool:
    """Return whether any compared channel of a run moves."""
    return any(np.ptp(run.measured[c.channel]) > 0 for c in run.compared)


def _unused(case: Case) -> list[str]:
    kinds = [name for name in ("frf", "modal") if getattr(case.table, name)]
    if not kinds:
        return []
    tables = " and ".join(f"[[{kind}]]" for kind in kinds)
    return [f"{tables} not used: the case has recordings over time to fit; diagnose them in a case of their own"]
