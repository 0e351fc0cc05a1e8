"""One answer to a real case beside its key."""

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from scipy.optimize import linear_sum_assignment

from vlab.proof.real.known import KnownCase, KnownEffect

Met = Literal["met", "in part", "family", "abstained", "missed", "failed", "undocumented", "no key"]
"""Result of a comparison with the key: all effects named at their places; some of them; all families, with another effect or
place; no finding; other findings; no answer; nothing documented to compare with; no key."""
MOST = 100
"""MOST [-]: bound on the number of effects of a case; a right name outweighs as many right families."""


def judge_real(known: KnownCase | None, answer: Mapping[str, Any]) -> dict[str, Any]:
    """Compare an answer with the key of its case.

    A finding meets an effect by one of its accepted names at an accepted place. Every finding meets one effect at most.

    Parameters
    ----------
    known : KnownCase or None
        Key.
    answer : mapping
        Answer.

    Returns
    -------
    dict
        ``met``; whether ``effect``, ``family`` and ``place`` are right, None where unknown. ``further`` lists findings
        that meet nothing. ``probability`` is the least one of the other findings.
    """
    findings = list(answer.get("findings", []))
    out: dict[str, Any] = dict.fromkeys(("effect", "family", "place", "probability"))
    out["further"] = [f["effect"] for f in findings]
    if "error" in answer:
        return {**out, "met": "failed"}
    if known is None or not known.is_documented:
        return {**out, "met": "no key" if known is None else "undocumented"}
    if not findings:
        return {**out, "met": "met" if known.abstention else "abstained"}
    pairs = _pairs(known.effect, findings)
    matched = [found for _, found in pairs if found is not None]
    out["further"] = [f["effect"] for f in findings if not any(f is one for one in matched)]
    stated = [f["probability"] for f in matched if f.get("probability") is not None]
    out["probability"] = min(stated) if stated else None
    if not pairs:  # only an abstention is right
        return {**out, "met": "missed"}
    names = [found is not None and _is_named(effect, found) for effect, found in pairs]
    places = [found is not None and is_placed(effect, found) for effect, found in pairs if effect.places]
    out["effect"] = all(names) if any(effect.effects for effect in known.effect) else None
    out["family"] = all(found is not None for _, found in pairs)
    out["place"] = all(places) if places else None
    right = [
        found is not None and name and is_placed(effect, found)
        for name, (effect, found) in zip(names, pairs, strict=True)
    ]
    return {**out, "met": _met(right, bool(out["family"]), bool(matched))}


def _met(right: Sequence[bool], has_families: bool, has_any: bool) -> Met:
    if all(right):
        return "met"
    if any(right):
        return "in part"
    if has_families:
        return "family"
    return "in part" if has_any else "missed"


def _pairs(
    effects: Sequence[KnownEffect], findings: Sequence[dict[str, Any]]
) -> list[tuple[KnownEffect, dict[str, Any] | None]]:
    """Return every known effect with its finding, if any.

    The assignment has as many right names at right places as possible, then right names, then right families.
    """
    grades = np.array([[_grade(effect, found) for found in findings] for effect in effects])
    grades = grades.reshape(len(effects), len(findings))
    chosen = dict(zip(*linear_sum_assignment(grades, maximize=True), strict=True))
    return [
        (effect, findings[chosen[i]] if i in chosen and grades[i, chosen[i]] > 0 else None)
        for i, effect in enumerate(effects)
    ]


def _grade(effect: KnownEffect, found: Mapping[str, Any]) -> int:
    """Return how well a finding meets an effect."""
    if _is_named(effect, found):
        return MOST**2 if is_placed(effect, found) else MOST
    return int(found.get("family") in effect.families)


def _is_named(effect: KnownEffect, found: Mapping[str, Any]) -> bool:
    """Return whether a finding has an accepted name or, without names, family."""
    return found["effect"] in effect.effects if effect.effects else found.get("family") in effect.families


def is_placed(effect: KnownEffect, found: Mapping[str, Any]) -> bool:
    """Return whether a finding is at an accepted place, if stated.

    Parameters
    ----------
    effect : KnownEffect
        Known effect.
    found : mapping
        Finding.

    Returns
    -------
    bool
        Whether any of its places is accepted.
    """
    places = {found["place"], *(p["place"] for p in found.get("places", []))}
    return not effect.places or bool(places & set(effect.places))
