"""Wrapped angles: no model jumps by a full turn, so no fit begins."""

from collections.abc import Sequence

from vlab.cases.case import Case
from vlab.cases.channel_map import Run
from vlab.cases.checks.correction import Found, columns_of, mend_in
from vlab.recordings.quality import findings

WRAP = "wrap"
"""WRAP: kind of the finding on a recording, see `vlab.recordings.quality`."""


def check_wraps(case: Case, runs: Sequence[Run]) -> list[Found]:
    """Return angles that jump by a full turn.

    Parameters
    ----------
    case : Case
        Case with its model.
    runs : sequence of Run
        Recordings of the case.

    Returns
    -------
    list of Found
        Fatal findings with the edit of the case, one a channel.
    """
    said: dict[str, list[str]] = {}
    for run in runs:
        for found in findings(run.measured):
            if found.kind == WRAP:
                said.setdefault(found.channel, []).append(f"{run.name}: {found.text}")
    out = []
    for name, texts in said.items():
        column = columns_of(case)[name]
        if case.in_memory:
            parts = [f'"{one}": {{"unwrap": True}}' for one in column.columns]
            edit = f"channels={{{', '.join(parts)}}}"
        else:
            edit = f"unwrap = true in every {column.where}"
        others = (
            f", and as well in {len(texts) - 1} further recording{'s' if len(texts) > 2 else ''}"
            if len(texts) > 1
            else ""
        )
        text = f"{texts[0]}{others}; the angle is wrapped, and the model's turns on{mend_in(case)}{edit}"
        out.append(Found(severity="fatal", text=text, channels=(name,), mend=edit))
    return out
