"""Score of a campaign: measures with counts, exact intervals and targets."""

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from vlab.proof.equivalence import right_class
from vlab.proof.judge import ABSTAINED, NAMED, NOTHING, Judged
from vlab.proof.statistics import brier, calibration, clustered_interval, detection_limit, rate

HEADLINE = ("in-library", "other-form", "two-effects", "chain-only", "masked")
"""Suites in which something of the library is hidden that is large enough to be found; near-threshold counts apart."""
STRUCTURES = ("beam", "grid")
"""Benches whose nominal model has a mesh of its own; those of the rigs have the very masses and springs of the generator."""
CLOSE = 0.1
"""Relative error up to which a parameter is right."""
WORST = 10


def score(judged: Sequence[Judged]) -> dict[str, Any]:
    """Return the whole score as plain values."""
    suites = sorted({j.suite for j in judged})
    return {
        "cases": len(judged),
        "measures": measures(judged),
        "suites": {s: _suite([j for j in judged if j.suite == s]) for s in suites},
        "confusion": confusion(judged),
        "detection": detection(judged),
        "calibration": calibration(*_probabilities(judged))[1],
        "worst": [_worst(j) for j in worst(judged)],
        "failed": [_worst(j) for j in judged if j.error],
        "seconds": {
            "median": float(np.median([j.seconds for j in judged])) if judged else None,
            "largest": max((j.seconds for j in judged), default=None),
        },
    }


def measures(judged: Sequence[Judged]) -> list[dict[str, Any]]:
    """Return the rows of the table of measures.

    A row has measure, value, count, interval, target, whether the target is met, and whether the whole interval meets it.
    """
    known = [j for j in judged if j.suite in HEADLINE and j.in_library]
    named = [j for j in known if j.verdict == NAMED]
    nulls = [j for j in judged if j.suite == "null"]
    strange = [j for j in judged if j.suite == "out-of-library"]
    errors = [e for j in known for e in j.errors.values()]
    of_structures = [j for j in known if j.bench in STRUCTURES]
    effects = sorted({j.hidden[0] for j in known if len(j.hidden) == 1})
    of_effect = [float(np.mean([j.right_class for j in known if j.hidden == (name,)])) for name in effects]
    inside = [list(j.covered.values()) for j in known]
    own = [j for j in known if j.own_form]
    gaps = [j.gap for j in known if j.gap is not None]
    probability, outcome = _probabilities(judged)
    return [
        _rate("right effect, first answer", [j.right_effect for j in known], at_least=0.85),
        _rate("right equivalence class, first answer", [j.right_class for j in known], at_least=0.95),
        _rate("right class on the beam and the grid", [j.right_class for j in of_structures]),
        _value("right class, mean over effects hidden alone", of_effect, np.mean),
        _rate("right class and exact place", [j.right_class and bool(j.place_exact) for j in known]),
        _rate("what is hidden is in the class that the answer claims", [j.in_claimed for j in known]),
        _value("size of the claimed class, mean", [j.claimed for j in named], np.mean),
        _rate("two effects: both named, nothing else", [j.all_right for j in known if len(j.hidden) == 2]),
        _rate("one effect: nothing named beside it", [j.all_right for j in named if len(j.hidden) == 1 and j.right_class]),
        _rate("right place, exact, of what was named", [bool(j.place_exact) for j in named], at_least=0.70),
        _rate("right place, within one element or joint, of what was named", [bool(j.place_near) for j in named], at_least=0.90),
        _rate("coverage of the 90 % place set", [bool(j.place_covered) for j in named], at_least=0.85, at_most=0.95),
        _value("size of the place set, mean", [j.places for j in named], np.mean),
        _value("parameter error, median, of effects named right", errors, np.median, at_most=0.10),
        _grouped("coverage of 90 % parameter intervals, of effects named right", inside, at_least=0.85, at_most=0.95),
        _rate("right effect, all its parameters within 10 %", [_is_close(j) for j in own]),
        _value("held-out gap closed, median", gaps, np.median, at_least=0.80),
        _value("held-out gap closed, worst tenth", gaps, lambda x: np.quantile(x, 0.1)),
        _rate("null: anything but nothing-missing (false alarms)", [j.verdict != NOTHING for j in nulls], at_most=0.05),
        _rate("null, beam and grid: anything but nothing-missing", [j.verdict != NOTHING for j in nulls if j.bench in STRUCTURES]),
        _rate("null: physics named", [j.verdict == NAMED for j in nulls]),
        _rate("out of library: abstains", [j.verdict == ABSTAINED for j in strange], at_least=0.80),
        _rate("out of library: physics named", [j.verdict == NAMED for j in strange]),
        _rate("near threshold: right class", [j.right_class for j in judged if j.suite == "near-threshold"]),
        _value("Brier score", [b] if (b := brier(probability, outcome)) is not None else [], np.mean, at_most=0.10,
               of=len(probability)),
        _value("expected calibration error", [e] if (e := calibration(probability, outcome)[0]) is not None else [],
               np.mean, at_most=0.05, of=len(probability)),
    ]  # fmt: skip


def _probabilities(judged: Sequence[Judged]) -> tuple[list[float], list[bool]]:
    named = [j for j in judged if j.probability is not None]
    return [float(j.probability or 0.0) for j in named], [j.hit for j in named]


def _is_close(j: Judged) -> bool:
    return j.right_effect and bool(j.errors) and max(j.errors.values()) <= CLOSE


def _met(value: float | None, at_least: float | None, at_most: float | None) -> bool | None:
    if value is None or (at_least is None and at_most is None):
        return None
    return (at_least is None or value >= at_least) and (at_most is None or value <= at_most)


def _target(at_least: float | None, at_most: float | None) -> str:
    if at_least is not None and at_most is not None:
        return f"{at_least:g} to {at_most:g}"
    return f">= {at_least:g}" if at_least is not None else f"<= {at_most:g}" if at_most is not None else ""


def _rate(
    name: str,
    flags: Sequence[bool],
    *,
    at_least: float | None = None,
    at_most: float | None = None,
    interval: tuple[float, float] | None = None,
) -> dict[str, Any]:
    found = rate(flags)
    low, high = found.interval if interval is None else interval
    whole = [_met(end, at_least, at_most) for end in (low, high)]
    return {
        "measure": name,
        **found.to_json(),
        "ci95": [low, high],
        "value": found.value,
        "target": _target(at_least, at_most),
        "met": _met(found.value, at_least, at_most),
        "shown": None if found.value is None or None in whole else all(whole),
    }


def _grouped(name: str, groups: Sequence[Sequence[bool]], **target: float) -> dict[str, Any]:
    """Return a row of truth values that come in dependent groups."""
    flags = [flag for group in groups for flag in group]
    return _rate(name, flags, **target, interval=clustered_interval(groups))


def _value(
    name: str,
    values: Sequence[float],
    of_all: Any,
    *,
    at_least: float | None = None,
    at_most: float | None = None,
    of: int | None = None,
) -> dict[str, Any]:
    value = float(of_all(values)) if len(values) else None
    return {
        "measure": name,
        "value": value,
        "of": len(values) if of is None else of,
        "target": _target(at_least, at_most),
        "met": _met(value, at_least, at_most),
    }


def _suite(judged: Sequence[Judged]) -> dict[str, Any]:
    """Return the counts of one suite."""
    verdicts = Counter(j.verdict for j in judged)
    return {
        "cases": len(judged),
        "verdicts": dict(sorted(verdicts.items())),
        "right": rate([not j.is_wrong for j in judged]).to_json(),
        "right_effect": rate([j.right_effect for j in judged]).to_json(),
        "benches": {
            b: rate([not j.is_wrong for j in judged if j.bench == b]).to_json()
            for b in sorted({j.bench for j in judged})
        },
        "noise": {
            n: rate([not j.is_wrong for j in judged if j.noise == n]).to_json()
            for n in sorted({j.noise for j in judged})
        },
    }


def confusion(judged: Sequence[Judged]) -> dict[str, dict[str, int]]:
    """Return how often each truth got each answer; two hidden effects are one truth."""
    out: dict[str, dict[str, int]] = {}
    for j in judged:
        truth = " + ".join(sorted(j.hidden)) or "nothing"
        row = out.setdefault(truth if j.in_library or not j.hidden else f"({truth})", {})
        row[j.answered] = row.get(j.answered, 0) + 1
    return dict(sorted(out.items()))


def detection(judged: Sequence[Judged]) -> dict[str, dict[str, Any]]:
    """Return the detection limits of every effect hidden alone in a rig.

    The entry ``"all"`` has those of all effects together.

    They are those of being named in class, and under ``"noticed"`` those of any verdict but nothing-missing. Of the two
    structures the size says nothing: it is measured with the generator's fine mesh, what the nominal one leaves is on top.
    """
    alone = [j for j in judged if len(j.hidden) == 1 and j.in_library and j.size and j.bench not in STRUCTURES]
    groups: dict[str, list[Judged]] = {"all": alone}
    for j in alone:
        groups.setdefault(j.hidden[0], []).append(j)
    return {name: _detection(group) for name, group in sorted(groups.items()) if group}


def _detection(group: Sequence[Judged]) -> dict[str, Any]:
    sizes = [j.size or 0.0 for j in group]
    noticed = detection_limit(sizes, [j.verdict != NOTHING for j in group])
    return {**detection_limit(sizes, [j.right_class for j in group]), "noticed": noticed}


def worst(judged: Sequence[Judged]) -> list[Judged]:
    """Return the worst cases: wrong answers, the surest and the largest hidden things first."""
    wrong = [j for j in judged if j.is_wrong]
    return sorted(wrong, key=lambda j: (-(j.probability or 0.0), -(j.size or 0.0)))[:WORST]


def _worst(j: Judged) -> dict[str, Any]:
    return {
        "case": j.case,
        "suite": j.suite,
        "bench": j.bench,
        "hidden": list(j.hidden),
        "form": j.form,
        "truth_place": j.truth_place,
        "size": j.size,
        "answered": j.answered,
        "place": j.place,
        "probability": j.probability,
        "error": j.error,
    }


def baseline_rows(judged: Sequence[Judged], answers: dict[str, Any], truths: dict[str, Any]) -> list[dict[str, Any]]:
    """Return answers of simpler methods to the cases with an effect of the catalogue.

    The diagnosis of the same cases stands beside them.

    A method that names nothing has no right class; one that simulates nothing has no gap.
    """
    known = [j for j in judged if j.suite in HEADLINE and j.in_library]
    with_before = [j for j in known if (answers[j.case].get("heldout") or {}).get("nrmse_before") is not None]
    explained = [
        answers[j.case]["heldout"]["nrmse_before"] <= 1.5 * (answers[j.case]["heldout"]["nrmse_noise"] or 0.0)
        for j in with_before
    ]
    note = f"leaves at most 1.5 x the noise in {sum(explained)} of {len(explained)}"
    rows = [_row("linear refit only", with_before, [], [0.0] * len(with_before), note)]
    for method in sorted({m for j in known for m in answers[j.case].get("baselines", {})}):
        done = [(j, b) for j in known if (b := answers[j.case].get("baselines", {}).get(method)) is not None]
        notes = Counter(b["note"].partition(":")[2].strip() or b["note"] for _, b in done if b.get("note"))
        note = "; ".join(f"not on {n}: {text}" for text, n in notes.most_common(2))
        ran = [(j, b) for j, b in done if not b.get("note")]
        rows.append(_beside(method, ran, answers, truths, note))
        names = next((set(b["names"]) for _, b in ran if "names" in b), None)
        if names is not None:
            own = [
                (j, b) for j, b in ran if any(names & right_class(truths[j.case], h) for h in truths[j.case]["hidden"])
            ]
            rows.append(_beside(f"{method}, where it has the law", own, answers, truths, ""))
    return rows


def _beside(
    method: str,
    ran: Sequence[tuple[Judged, dict[str, Any]]],
    answers: dict[str, Any],
    truths: dict[str, Any],
    note: str,
) -> dict[str, Any]:
    named = [_named_right(b, truths[j.case]) for j, b in ran if "named" in b]
    gaps = [g for j, b in ran if (g := _gap(answers[j.case], b)) is not None]
    return _row(method, [j for j, _ in ran], named, gaps, note)


def _row(
    method: str, cases: Sequence[Judged], named: Sequence[bool], gaps: Sequence[float], note: str
) -> dict[str, Any]:
    found, ours = rate(named), [j.gap for j in cases if j.gap is not None]
    return {
        "method": method,
        "cases": len(cases),
        "right_class": found.value,
        "right": found.to_json(),
        "gap_closed": float(np.median(gaps)) if len(gaps) else None,
        "vlab": {
            "right_class": rate([j.right_class for j in cases]).value,
            "gap_closed": float(np.median(ours)) if ours else None,
        },
        "note": note,
    }


def _named_right(baseline: dict[str, Any], truth: dict[str, Any]) -> bool:
    names = {n["effect"] for n in baseline["named"]}
    return any(names & right_class(truth, h) for h in truth["hidden"])


def _gap(answer: dict[str, Any], baseline: dict[str, Any]) -> float | None:
    heldout = answer.get("heldout") or {}
    before, noise, after = heldout.get("nrmse_before"), heldout.get("nrmse_noise"), baseline.get("nrmse")
    if before is None or noise is None or after is None or before <= 1.1 * noise:
        return None
    return float((before - after) / (before - noise))
