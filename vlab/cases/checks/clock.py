"""Check of the time unit.

Samples too far apart for the model indicate a wrong unit, such as milliseconds read as seconds.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from vlab import units
from vlab.cases.case import Case
from vlab.cases.channel_map import Run
from vlab.cases.checks.beside import EXPLAINED, UNEXPLAINED, Beside, beside, first_seconds
from vlab.cases.description import RecordingTable
from vlab.errors import BadCase

COARSE = 50.0
"""COARSE [1]: integration steps between samples from which a smaller time unit is tried. A thousandth of the value
is less than one step."""
MOST_STEPS = 200_000
"""MOST_STEPS [1]: integration steps for simulating the start of a recording in the stated unit, after another unit
explains the recording."""
_SUFFIX = re.compile(r"(?:^|[\s_.(\[/-])(ns|us|[µμ]s|ms|s|min)[)\]]?$", re.IGNORECASE)
"""Time unit at the end of a column's name: t_ms, time (us)."""


def check_clock(case: Case, runs: Sequence[Run]) -> None:
    """Refuse recordings with a wrong time unit.

    The check precedes any long simulation.

    Parameters
    ----------
    case : Case
        Case with its model.
    runs : sequence of Run
        Recordings with mapped channels.

    Raises
    ------
    BadCase
        The time column's name has another unit, in which the samples are closer to the model's steps. Or the model
        explains the recording in another unit only.
    """
    tables = dict(case.recordings(("fit", "holdout")))
    for run in runs:
        table = tables[run.name]
        step = run.measured.sample_period
        named = _named_unit(table)
        if named is not None:
            ratio = units.factor(named, "s") / units.factor(table.time_unit, "s")
            own, other = (abs(np.log(step * r / case.plant.timestep)) for r in (1.0, ratio))
            if abs(ratio - 1.0) > 1e-9 and other < own:
                raise _refused(case, run, table, named, f"its name says {named}")
    longest = max(runs, key=lambda run: run.measured.sample_period, default=None)
    if longest is None or longest.measured.sample_period < COARSE * case.plant.timestep:
        return
    found = next((unit for unit, ratio in _other_units(tables[longest.name]) if _explains(case, longest, ratio)), None)
    if found is not None and not _is_explained(_beside(case, first_seconds(case.plant, longest, MOST_STEPS))):
        raise _refused(
            case,
            longest,
            tables[longest.name],
            found,
            "the model gives what was recorded in that time, and not as it is read",
        )


def _named_unit(table: RecordingTable) -> str | None:
    match = None if table.time is None else _SUFFIX.search(table.time.strip())
    return None if match is None else match[1].lower().translate(units.SIGNS)


def _other_units(table: RecordingTable) -> Iterator[tuple[str, float]]:
    """Yield shorter candidate units and their time factors.

    A sample rate has its thousandfold as candidate.
    """
    said = table.time_unit if table.time is not None else "s"
    for unit, ratio in units.mistaken(said, "s").items():
        if ratio < 1.0:
            yield unit, ratio


def _explains(case: Case, run: Run, ratio: float) -> bool:
    time = run.measured.time[0] + (run.measured.time - run.measured.time[0]) * ratio
    shorter = replace(run, measured=replace(run.measured, time=time), before=None, law=None)
    return run.law is None and _is_explained(_beside(case, first_seconds(case.plant, shorter)), EXPLAINED)


def _beside(case: Case, run: Run) -> Beside:
    return beside(case.plant, [run])


def _is_explained(tried: Beside, most: float = UNEXPLAINED) -> bool:
    """Return whether a model explains every assessed channel.

    Parameters
    ----------
    most : float
        Largest residual share.
    """
    said = [name for name, of_runs in tried.channels.items() if of_runs]
    return bool(said) and all(tried.left(name) <= most for name in said)


def _refused(case: Case, run: Run, table: RecordingTable, unit: str, why: str) -> BadCase:
    step = run.measured.sample_period
    many = f"samples are {step:.4g} s apart, {step / case.plant.timestep:.4g} integration steps of the model"
    if table.time is None:
        ratio = units.factor(unit, "s")
        return BadCase(
            f"{case.path}: {run.name}: {many}, as rate_hz says; {why}: is it rate_hz = {1.0 / (step * ratio):.6g}?"
        )
    return BadCase(
        f'{case.path}: {run.name}: time column {table.time!r} is read in {table.time_unit}, so that {many}; {why}: say time_unit = "{unit}"'
    )
