"""Stated probabilities: decisions at a threshold, and the log score.

The log score is the mean negative log likelihood [1]_: ``-ln p`` where the finding is there, ``-ln(1 - p)`` where not.

References
----------
.. [1] I. J. Good, "Rational decisions", *Journal of the Royal Statistical Society B* 14 (1952) 107-114.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from vlab.proof.judge import NAMED, Judged
from vlab.proof.servo_scoring import PARTLY, UNKNOWN, is_part_right
from vlab.proof.statistics import brier, rate

THRESHOLDS = (0.0, 0.5, 0.7, 0.8, 0.9, 0.95)
"""THRESHOLDS [1]: least stated probabilities at which somebody would act on a name; 0 for every name."""
EDGE = 0.001
"""EDGE [1]: probabilities nearer to 0 or 1 count as this far from them, 0 to 0.5; a wrong certainty costs 6.9 nat.
Default: the smallest probability that a report prints as a number. Raising it pardons wrong certainties."""
ENDS = (0.1, 0.9)
"""ENDS [1]: quantiles of the stated probabilities that show their spread."""
ALL = "all"
"""ALL: name of the row of all verdicts."""


def decision_rows(judged: Sequence[Judged]) -> list[dict[str, Any]]:
    """Return right and wrong names by their least stated probability.

    Parameters
    ----------
    judged : sequence of Judged
        Judged cases of all suites.

    Returns
    -------
    list of dict
        For each of `THRESHOLDS`: numbers of names, right ones (in class) and wrong ones, of which with nothing hidden
        and of which outside the catalogue; the number of abstentions, which have no name as probable; the share of
        wrong names with its exact interval.
    """
    rows = []
    for threshold in THRESHOLDS:
        named = [j for j in judged if j.verdict == NAMED and (j.probability or 0.0) >= threshold]
        wrong = [j for j in named if not j.right_class]
        rows.append(
            {
                "threshold": threshold,
                "named": len(named),
                "right": len(named) - len(wrong),
                "wrong": len(wrong),
                "wrong_null": sum(not j.hidden for j in wrong),
                "wrong_outside": sum(bool(j.hidden) and not j.in_library for j in wrong),
                "abstained": len(judged) - len(named),
                "wrong_share": rate([not j.right_class for j in named]).to_json(),
            }
        )
    return rows


def decision_table(rows: Sequence[Mapping[str, Any]]) -> tuple[list[str], list[list[Any]]]:
    """Return heads and rows of the table of decisions.

    Parameters
    ----------
    rows : sequence of mapping
        Rows of `decision_rows`.

    Returns
    -------
    tuple
        Headings and rows.
    """
    heads = ["stated at least", "named", "right", "wrong", "nothing hidden", "outside", "abstained", "wrong of named"]
    keys = ("named", "right", "wrong", "wrong_null", "wrong_outside", "abstained")
    shown = []
    for row in rows:
        share, (low, high) = row["wrong_share"]["rate"], row["wrong_share"]["ci95"]
        words = None if share is None else f"{share:.3f} ({low:.3f} to {high:.3f})"
        shown.append([f"{row['threshold']:g}" if row["threshold"] else "any", *(row[key] for key in keys), words])
    return heads, shown


def log_score(probability: Sequence[float], outcome: Sequence[bool]) -> float | None:
    """Return the mean negative log likelihood of outcomes.

    Parameters
    ----------
    probability : sequence of float
        Stated probabilities [1].
    outcome : sequence of bool
        Whether the stated event holds.

    Returns
    -------
    float or None
        Score [nat], smaller is better; None of nothing.
    """
    if not len(probability):
        return None
    p, holds = np.clip(np.asarray(probability, dtype=float), EDGE, 1.0 - EDGE), np.asarray(outcome, dtype=bool)
    return float(-np.mean(np.log(np.where(holds, p, 1.0 - p))))


def stated_rows(
    judged: Sequence[Judged], truths: Mapping[str, Any], answers: Mapping[str, Any]
) -> list[dict[str, Any]]:
    """Return the scores of stated probabilities by verdict.

    The event is that of the first finding: the named effect is there, or for the unknown law something at the place.
    Verdicts without a finding state no probability and do not count.

    Parameters
    ----------
    judged : sequence of Judged
        Judged cases of all suites.
    truths, answers : mapping
        Truths and answers by the name of the case.

    Returns
    -------
    list of dict
        Verdict, number of cases, share that holds, `ENDS` of the probabilities, Brier score, log score [nat], and the
        log score of that share stated always. Probabilities that say nothing of a case score no better.
    """
    found: dict[str, list[tuple[float, bool]]] = {ALL: []}
    for j in judged:
        told = _told(j, truths[j.case], answers[j.case])
        if told is not None:
            found[ALL].append(told)
            found.setdefault(j.verdict, []).append(told)
    return [_row(verdict, [p for p, _ in pairs], [holds for _, holds in pairs]) for verdict, pairs in found.items()]


def _told(j: Judged, truth: Mapping[str, Any], answer: Mapping[str, Any]) -> tuple[float, bool] | None:
    """Return the probability that an answer states, and whether its event holds."""
    if j.verdict == NAMED:
        return None if j.probability is None else (j.probability, j.hit)
    first = next(iter(answer.get("findings", [])), None)
    if j.verdict not in (PARTLY, UNKNOWN) or first is None or first.get("probability") is None:
        return None
    if j.verdict == UNKNOWN:
        return float(first["probability"]), is_part_right(truth, answer)
    return float(first["probability"]), any(first["effect"] in hidden["accepted"] for hidden in truth["hidden"])


def _row(verdict: str, probability: Sequence[float], outcome: Sequence[bool]) -> dict[str, Any]:
    share = rate(outcome).value
    ends = np.quantile(probability, ENDS).tolist() if len(probability) else [None, None]
    return {
        "verdict": verdict,
        "of": len(probability),
        "holds": share,
        "low": ends[0],
        "high": ends[1],
        "brier": brier(probability, outcome),
        "log_score": log_score(probability, outcome),
        "constant": None if share is None else log_score([share] * len(outcome), outcome),
    }


def stated_table(rows: Sequence[Mapping[str, Any]]) -> tuple[list[str], list[list[Any]]]:
    """Return heads and rows of the table of stated probabilities.

    Parameters
    ----------
    rows : sequence of mapping
        Rows of `stated_rows`.

    Returns
    -------
    tuple
        Headings and rows.
    """
    heads = ["verdict", "cases", "holds", "10 % below", "10 % above", "Brier", "log score (nat)", "of the share alone"]
    keys = ("verdict", "of", "holds", "low", "high", "brier", "log_score", "constant")
    return heads, [[row[key] for key in keys] for row in rows]
