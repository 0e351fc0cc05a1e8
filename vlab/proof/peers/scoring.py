"""Score of the peers beside the diagnosis on the same cases."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from vlab.proof.judge import NAMED, Judged
from vlab.proof.score import baseline_rows
from vlab.proof.statistics import rate

WHERE = ", where it has the law"
"""WHERE: end of a row for the cases that hide an effect of the peer."""


def peer_rows(judged: Sequence[Judged], answers: dict[str, Any], truths: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the rows of the table of peers.

    The rows of `vlab.proof.score.baseline_rows` count right classes and closed gaps where something of the catalogue is
    hidden. A peer's row also has its false alarms on cases with nothing hidden. Held-out error and CPU time are medians over
    all cases that the peer treats. The diagnosis stands beside, on the same cases.

    Parameters
    ----------
    judged : sequence of Judged
        Judged cases.
    answers, truths : dict
        Answers and truths by the name of the case.

    Returns
    -------
    list of dict
        Rows.
    """
    rows = []
    for row in baseline_rows(judged, answers, truths):
        done = [] if row["method"].endswith(WHERE) else _treated(row["method"], judged, answers)
        rows.append({**row, **_over_all(done, answers)} if done else row)
    known = {row["method"] for row in rows}
    for method in sorted({m for j in judged for m in answers[j.case].get("baselines", {})} - known):
        done = _treated(method, judged, answers)  # no case hides anything of the catalogue
        empty = {"method": method, "cases": 0, "right_class": None, "gap_closed": None, "note": ""}
        rows.append({**empty, "vlab": {"right_class": None, "gap_closed": None}, **_over_all(done, answers)})
    return rows


Treated = tuple[Judged, Mapping[str, Any]]
"""Judged case, and the result of a peer on it."""


def _treated(method: str, judged: Sequence[Judged], answers: Mapping[str, Any]) -> list[Treated]:
    """Return the cases that a peer treats, with its results."""
    results = [(j, answers[j.case].get("baselines", {}).get(method)) for j in judged]
    return [(j, b) for j, b in results if b is not None and not b.get("note")]


def _over_all(done: Sequence[Treated], answers: Mapping[str, Any]) -> dict[str, Any]:
    """Return usable cases, false alarms, held-out errors and CPU times."""
    nulls = [(j, b) for j, b in done if not j.hidden]
    ours = [answers[j.case] for j, _ in done]
    return {
        "usable": len(done),
        "false_alarms": rate([bool(b.get("named")) for _, b in nulls]).to_json(),
        "nrmse": _median([b.get("nrmse") for _, b in done]),
        "cpu_seconds": _median([b.get("cpu_seconds") for _, b in done]),
        "vlab_beside": {
            "false_alarms": rate([j.verdict == NAMED for j, _ in nulls]).to_json(),
            "nrmse": _median([(a.get("heldout") or {}).get("nrmse_after") for a in ours]),
            "cpu_seconds": _median([a.get("cpu_seconds") for a in ours]),
        },
    }


def _median(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.median(known)) if known else None


def peer_table(found: Mapping[str, Any]) -> tuple[list[str], list[list[Any]]]:
    """Return heads and rows of the table of peers.

    Parameters
    ----------
    found : mapping
        Score.

    Returns
    -------
    tuple
        Headings and rows; an entry of two parts holds the peer's and the diagnosis' value.
    """
    heads = ["method", "usable", "right class", "vlab", "false alarms", "vlab", "gap closed", "vlab",
             "held-out error", "vlab", "CPU s", "vlab", ""]  # fmt: skip
    rows = []
    for b in found["baselines"]:
        beside = b.get("vlab_beside", {})
        rows.append(
            [
                b["method"],
                b.get("usable", b["cases"]),
                _share(b.get("right"), b["right_class"]),
                b["vlab"]["right_class"],
                _share(b.get("false_alarms")),
                _share(beside.get("false_alarms")),
                b["gap_closed"],
                b["vlab"]["gap_closed"],
                b.get("nrmse"),
                beside.get("nrmse"),
                b.get("cpu_seconds"),
                beside.get("cpu_seconds"),
                b["note"],
            ]
        )
    return heads, rows


def _share(counted: Mapping[str, Any] | None, otherwise: float | None = None) -> Any:
    """Return a count of a total as text."""
    return f"{counted['count']}/{counted['of']}" if counted and counted.get("of") else otherwise
