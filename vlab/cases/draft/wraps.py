"""Wrapped angles of drafted columns."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from vlab import units
from vlab.cases.draft.logs import Log
from vlab.cases.draft.matching import Match
from vlab.recordings.wraps import TURN, wraps

UNITS = ("rad", "deg")
"""UNITS: units whose turn the jumps of a column without a stated unit are compared with."""


def with_wraps(logs: Sequence[Log], used: Sequence[Match]) -> tuple[Match, ...]:
    """Return matched columns with their jumps by a full turn.

    Parameters
    ----------
    logs : sequence of Log
        Logs with the columns.
    used : sequence of Match
        Matched columns.

    Returns
    -------
    tuple of Match
        Columns; `wraps` and `turn` of an angle that jumps are set.
    """
    return tuple(_with_wraps(logs, match) if match.kind == "angle" else match for match in used)


def _with_wraps(logs: Sequence[Log], match: Match) -> Match:
    stated = (match.stated,) if match.stated and units.same_dimension(match.stated, "rad") else UNITS
    for unit in stated:
        turn = TURN / units.factor(unit, "rad")
        count = 0
        for log in logs:
            names = [c.name for c in log.columns if match.label in (c.name, log.label(c.name))]
            values = log.table.real(names[0])
            count += int(wraps(values[np.isfinite(values)], turn, is_target=match.is_input).size)
        if count:
            return replace(match, wraps=count, turn=unit)
    return match
