"""Sizes of recorded and simulated motion, whose ratio is that of two units.

The bands of a channel tell a unit where the model follows the recording. The size alone tells less, and asks.
"""

from collections.abc import Collection

import numpy as np

from vlab.cases.case import Case
from vlab.cases.checks.beside import Beside
from vlab.cases.checks.correction import Column, Correction, Found, Taken, columns_of, mend_in, slips_of
from vlab.cases.checks.slips import NEAR, REACH

MISTAKEN = ("rad", "deg", "m", "mm")
"""MISTAKEN: units of an angle and of a length that logs often have without saying so."""


def check_sizes(case: Case, now: Beside, aside: Collection[str] = ()) -> list[Found]:
    """Return outputs whose size is that of the model in another unit.

    Parameters
    ----------
    case : Case
        Case with its model.
    now : Beside
        Recordings and their simulation.
    aside : collection of str
        Channels with another finding.

    Returns
    -------
    list of Found
        Notes with the edit of the case; none for a channel whose recordings disagree.
    """
    out = []
    for name, column in columns_of(case).items():
        ratios = [] if name in aside or name not in now.channels else _ratios(now, name)
        unit, ratio = _unit_of(column, ratios)
        if unit:
            taken = Taken(channel=name, source=name, factor=slips_of(column)[unit], unit=unit)
            edit = Correction(taken=(taken,)).edits(case)
            text = (
                f"{name} moves {ratio:.3g} times as far as the model, as if its numbers were in {unit} and not in "
                f"{column.unit}{mend_in(case)}{edit}"
            )
            out.append(Found(severity="note", text=text, channels=(name,), mend=edit))
    return out


def _ratios(now: Beside, name: str) -> list[float]:
    """Return recorded over simulated rms in each recording; empty where one has none."""
    out = []
    for run, own in zip(now.runs, now.simulated, strict=True):
        if name not in run.measured.names:
            continue
        is_read = run.measured.is_read(name)
        sizes = [0.0 if one is None else float(np.std(one[name][is_read])) for one in (run.measured, own)]
        if run.law is not None or not all(0.0 < size < np.inf for size in sizes):
            return []
        out.append(sizes[0] / sizes[1])
    return out


def _unit_of(column: Column, ratios: list[float]) -> tuple[str, float]:
    """Return the unit that explains all ratios, with their median; "" for none."""
    if not ratios:
        return "", 1.0
    for unit, slip in slips_of(column).items():
        size = np.log(slip)
        is_known = unit in MISTAKEN and column.unit in MISTAKEN and abs(size) > np.log(REACH)
        if is_known and max(abs(np.log(ratios) - size)) <= NEAR * abs(size):
            return unit, float(np.median(ratios))
    return "", 1.0
