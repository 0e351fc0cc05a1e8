"""Scoring of mechanisms, and of verdicts that name a part.

The rules of `vlab.proof.manifest.SCORING` stay as they were when the stored answers were frozen.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from vlab.proof.equivalence import BAND_HZ, right_class
from vlab.proof.judge import Judged, same_place
from vlab.proof.score import HEADLINE
from vlab.proof.statistics import rate
from vlab.proof.suites import ARM

ON_ARMS = "right class on the arms"
"""ON_ARMS: row of the arms in the table of measures."""
ARM_HZ = 6.0
"""ARM_HZ [Hz]: highest frequency in the motions of an arm, twice the highest line of a multisine: servos smooth steps."""
SWING_HZ = 3.0
"""SWING_HZ [Hz]: highest frequency of a cart's motor, and of the lower modes of free pendulums."""
BAND_HZ.setdefault(ARM, ARM_HZ)
BAND_HZ.setdefault("pendulum", SWING_HZ)
BAND_HZ.setdefault("cart", SWING_HZ)
PARTLY, UNKNOWN = "partly-explained", "unknown-law"
"""PARTLY, UNKNOWN: verdicts that name a part of the mismatch, or a place alone. They never count as right."""
WORDS = {PARTLY: "partly explained", UNKNOWN: "place found, law unknown"}


def is_part_right(truth: Mapping[str, Any], answer: Mapping[str, Any]) -> bool:
    """Return whether a partial verdict speaks of something hidden.

    Parameters
    ----------
    truth : mapping
        Truth of a case.
    answer : mapping
        Answer with a verdict of `WORDS`.

    Returns
    -------
    bool
        Whether the first finding is in class (`PARTLY`), or at the place (`UNKNOWN`), of something hidden.
    """
    first = next(iter(answer.get("findings", [])), None)
    if first is None:
        return False
    if answer["verdict"] == PARTLY:
        return any(first["effect"] in right_class(dict(truth), hidden) for hidden in truth["hidden"])
    return any(same_place(first["place"], hidden) for hidden in truth["hidden"])


def arm_rows(judged: Sequence[Judged]) -> list[dict[str, Any]]:
    """Return the row of arms for the table of measures.

    Parameters
    ----------
    judged : sequence of Judged
        Judged cases.

    Returns
    -------
    list of dict
        One row as in `vlab.proof.score.measures`; none without arms.
    """
    arms = [j for j in judged if j.bench == ARM]
    return [_row(ON_ARMS, [j.right_class for j in arms if j.suite in HEADLINE and j.in_library])] if arms else []


def partial_rows(truths: Mapping[str, Any], answers: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the rows of partial verdicts for the table of measures.

    Parameters
    ----------
    truths : mapping
        Truths by the name of the case.
    answers : mapping
        Answers by the name of the case.

    Returns
    -------
    list of dict
        Rows as in `vlab.proof.score.measures`; none for a verdict that no case has.
    """
    rows = []
    for verdict, words in WORDS.items():
        met = [name for name, answer in answers.items() if answer["verdict"] == verdict]
        if not met:
            continue
        for group, names in _groups(truths, answers).items():
            rows.append(_row(f"{group}: {words}", [name in met for name in names]))
        right = [is_part_right(truths[name], answers[name]) for name in met if truths[name]["hidden"]]
        rows.append(_row(f"{words}, something hidden: right {'class' if verdict == PARTLY else 'place'}", right))
    return rows


def _groups(truths: Mapping[str, Any], answers: Mapping[str, Any]) -> dict[str, list[str]]:
    """Return the names of the cases by what is hidden."""
    out: dict[str, list[str]] = {"one effect": [], "two effects": [], "out of library": [], "null": []}
    for name in answers:
        hidden = truths[name]["hidden"]
        if not hidden:
            out["null"].append(name)
        elif not all(h["accepted"] for h in hidden):
            out["out of library"].append(name)
        else:
            out["two effects" if len(hidden) == 2 else "one effect"].append(name)
    return out


def _row(name: str, flags: list[bool]) -> dict[str, Any]:
    found = rate(flags)
    whole = {"ci95": list(found.interval), "value": found.value, "target": "", "met": None, "shown": None}
    return {"measure": name, **found.to_json(), **whole}
