"""Right answers by level: place, then family, effect and form.

A level is right only together with all levels before it. Partial verdicts are counted apart.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from vlab.proof.equivalence import right_class
from vlab.proof.judge import NAMED, Judged, same_place
from vlab.proof.score import HEADLINE
from vlab.proof.servo_scoring import PARTLY, UNKNOWN
from vlab.proof.statistics import rate

LEVELS = ("place", "family", "effect", "form")
"""LEVELS: exact place; family of laws; effect in class (`vlab.proof.equivalence`); the very law of the catalogue."""
ALL = "all"
"""ALL: name of the row of all benches."""


def depth(truth: Mapping[str, Any], answer: Mapping[str, Any]) -> int:
    """Return how many levels of the first finding are right.

    Parameters
    ----------
    truth : mapping
        Truth of a case.
    answer : mapping
        Answer to the case, with any verdict.

    Returns
    -------
    int
        Number of `LEVELS`, of the hidden effect that agrees best; 0 without a finding.
    """
    first = next(iter(answer.get("findings", [])), None)
    if first is None:
        return 0
    return max((_depth(truth, hidden, first) for hidden in truth["hidden"]), default=0)


def _depth(truth: Mapping[str, Any], hidden: Mapping[str, Any], finding: Mapping[str, Any]) -> int:
    effect = finding["effect"]
    is_in_class = effect in right_class(dict(truth), dict(hidden))
    levels = (
        same_place(finding["place"], dict(hidden)),
        is_in_class or finding.get("family") == hidden["family"],
        is_in_class,
        has_own_law(hidden) and effect == finding.get("form", effect) == hidden["effect"],
    )
    return next((i for i, is_right in enumerate(levels) if not is_right), len(LEVELS))


def has_own_law(hidden: Mapping[str, Any]) -> bool:
    """Return whether a hidden effect has the law of its catalogue entry."""
    return bool(hidden["accepted"]) and bool(hidden["same_parameters"])


def level_rows(judged: Sequence[Judged], truths: Mapping[str, Any], answers: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the counts of right levels by bench and verdict.

    Only cases with a detectable effect of the catalogue count. The complete verdict is counted out of all of them, a
    partial verdict out of the cases with that verdict. The form counts where the hidden law is that of the catalogue.

    Parameters
    ----------
    judged : sequence of Judged
        Judged cases.
    truths, answers : mapping
        Truths and answers by the name of the case.

    Returns
    -------
    list of dict
        Bench, verdict, number of cases, and a rate for each of `LEVELS`; no rows of partial verdicts that nobody gave.
    """
    known = [j for j in judged if j.suite in HEADLINE and j.in_library]
    rows = []
    for bench in [ALL, *sorted({j.bench for j in known})]:
        here = [j for j in known if bench in (ALL, j.bench)]
        for verdict in (NAMED, PARTLY, UNKNOWN):
            of = here if verdict == NAMED else [j for j in here if j.verdict == verdict]
            if of:
                rows.append(
                    {"bench": bench, "verdict": verdict, "cases": len(of), **_rates(of, verdict, truths, answers)}
                )
    return rows


def _rates(
    of: Sequence[Judged], verdict: str, truths: Mapping[str, Any], answers: Mapping[str, Any]
) -> dict[str, dict[str, Any]]:
    """Return the rate of every level among cases."""
    depths = [depth(truths[j.case], answers[j.case]) if j.verdict == verdict else 0 for j in of]
    own = [all(has_own_law(hidden) for hidden in truths[j.case]["hidden"]) for j in of]
    flags = {level: [reached > i for reached in depths] for i, level in enumerate(LEVELS)}
    flags["form"] = [is_right for is_right, is_own in zip(flags["form"], own, strict=True) if is_own]
    return {level: rate(flags[level]).to_json() for level in LEVELS}


def level_table(rows: Sequence[Mapping[str, Any]]) -> tuple[list[str], list[list[Any]]]:
    """Return heads and rows of the table of levels.

    Parameters
    ----------
    rows : sequence of mapping
        Rows of `level_rows`.

    Returns
    -------
    tuple
        Headings and rows.
    """
    heads = ["bench", "verdict", "cases", "place", "and family", "and effect", "and form"]
    return heads, [[r["bench"], r["verdict"], r["cases"], *(_shown(r[level]) for level in LEVELS)] for r in rows]


def _shown(found: Mapping[str, Any]) -> str | None:
    """Return a count with its exact interval."""
    if not found["of"]:
        return None
    low, high = found["ci95"]
    return f"{found['count']}/{found['of']} ({low:.2f} to {high:.2f})"
