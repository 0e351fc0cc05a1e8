"""One answer beside one truth."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from vlab.proof.equivalence import right_class

MOST_ERROR = 10.0
"""Relative error of a parameter that an answer does not give, and of any that is further off."""
ADDED_SINCE = {"integral-action": "servo-integral-gain", "cogging": "cogging"}
"""ADDED_SINCE [-]: effects that the library received after cases with them were drawn as outside it."""
NAMED, NOTHING, ABSTAINED = "missing-physics", "nothing-missing", "none-of-these"


@dataclass(frozen=True, kw_only=True)
class Judged:
    """What came of one case.

    Parameters
    ----------
    hidden : tuple of str
        True effects.
    answered : str
        The first effect that was named, else the verdict.
    right_effect : bool
        The first finding has the very name of what is hidden; with two hidden effects of either.
    right_class : bool
        It has a name that no experiment of the kind could tell from it, see `vlab.proof.equivalence`.
    in_claimed : bool
        What is hidden is among the effects that the answer itself says it cannot tell from its first finding.
    all_right : bool
        Every hidden effect was named in class, and nothing else.
    hit : bool
        The first finding, which is what its probability speaks of, is there.
    place_exact, place_near, place_covered : bool or None
        Of the finding that was judged; None where nothing was named.
    places : int
        Size of the set of places.
    own_form : bool
        One thing is hidden, with the catalogue's own law and parameters.
    errors : dict
        Relative error by parameter, of a right effect whose law has the same parameters.
    covered : dict
        Whether the 90 % interval holds the true value.
    gap : float or None
        Share of the held-out gap closed; zero where nothing was added; None where there was no gap.
    size : float or None
        What a refit leaves of what is hidden, in units of the noise.
    """

    case: str
    suite: str
    bench: str
    noise: str
    hidden: tuple[str, ...]
    form: str
    in_library: bool
    verdict: str
    answered: str
    right_effect: bool
    right_class: bool
    in_claimed: bool
    all_right: bool
    hit: bool
    place_exact: bool | None
    place_near: bool | None
    place_covered: bool | None
    places: int
    claimed: int
    probability: float | None
    own_form: bool = False
    errors: dict[str, float] = field(default_factory=dict)
    covered: dict[str, bool] = field(default_factory=dict)
    gap: float | None = None
    size: float | None = None
    seconds: float = 0.0
    error: str = ""
    truth_place: str = ""
    place: str = ""

    @property
    def is_wrong(self) -> bool:
        """Whether it counts against the tool in its suite."""
        if not self.hidden:
            return self.verdict != NOTHING
        if not self.in_library:
            return self.verdict != ABSTAINED
        return not (self.all_right if len(self.hidden) > 1 else self.right_class)


def judge(truth: dict[str, Any], answer: dict[str, Any]) -> Judged:
    """Judge the answer to a case."""
    findings = answer.get("findings", []) if answer["verdict"] == NAMED else []
    hidden = [_with_added(h, findings) for h in truth["hidden"]]
    first: dict[str, Any] | None = findings[0] if findings else None
    in_library = bool(hidden) and all(h["accepted"] for h in hidden)
    meant = _meant(truth, first, hidden)
    size = truth.get("size")
    gap = (answer.get("heldout") or {}).get("gap_closed") if answer["verdict"] == NAMED else 0.0
    return Judged(
        case=truth["case"],
        suite=truth["suite"],
        bench=truth["bench"],
        noise=truth["noise"],
        hidden=tuple(h["effect"] for h in hidden),
        form=" + ".join(h["form"] for h in hidden if h["form"]),
        in_library=in_library,
        verdict=answer["verdict"],
        answered=first["effect"] if first else answer["verdict"],
        right_effect=first is not None and any(first["effect"] == h["effect"] for h in hidden if h["accepted"]),
        right_class=first is not None and any(first["effect"] in right_class(truth, h) for h in hidden),
        in_claimed=first is not None and any(_is_claimed(h, first) for h in hidden),
        all_right=bool(hidden) and _match(findings, [right_class(truth, h) for h in hidden]),
        hit=first is not None and any(first["effect"] in h["accepted"] for h in hidden),
        **_place(first, meant or (hidden[0] if hidden else None)),
        claimed=len(first.get("class", ())) if first else 0,
        probability=float(first["probability"]) if first and first.get("probability") is not None else None,
        own_form=len(hidden) == 1 and bool(hidden[0]["accepted"]) and hidden[0]["same_parameters"],
        **_parameters(first, meant),
        gap=gap,
        size=None if size is None else float(size["left"]),
        seconds=float(answer.get("seconds", 0.0)),
        error=answer.get("error", ""),
        truth_place=" + ".join(h["place"] for h in hidden),
        place=first["place"] if first else "",
    )


def _with_added(hidden: dict[str, Any], findings: list[dict[str, Any]]) -> dict[str, Any]:
    """Return a hidden effect, accepted if a finding names a later effect."""
    name = ADDED_SINCE.get(hidden["effect"])
    is_named = not hidden["accepted"] and any(f["effect"] == name for f in findings)
    return {**hidden, "accepted": [name]} if is_named else hidden


def _is_claimed(hidden: dict[str, Any], finding: dict[str, Any]) -> bool:
    return bool({finding["effect"], *finding.get("class", ())} & set(hidden["accepted"]))


def _meant(truth: dict[str, Any], first: dict[str, Any] | None, hidden: list[dict[str, Any]]) -> dict[str, Any] | None:
    """Return the hidden effect that a finding names, or one of its class."""
    if first is None:
        return None
    named = [h for h in hidden if first["effect"] in h["accepted"]]
    alike = [h for h in hidden if first["effect"] in right_class(truth, h)]
    options = named or alike or [h for h in hidden if _is_claimed(h, first)]
    at_place = [h for h in options if same_place(first["place"], h)]
    return next(iter(at_place or options), None)


def _match(findings: list[dict[str, Any]], accepted: list[set[str]]) -> bool:
    """Return whether every set of names has one finding, and every finding a set."""
    left = list(findings)
    for names in accepted:
        match = next((f for f in left if f["effect"] in names), None)
        if match is None:
            return False
        left.remove(match)
    return not left


def _bare(place: str) -> str:
    """Return a place's name without what different listings put before it."""
    kind, colon, rest = place.partition(":")
    name = rest.removeprefix("probe:").removeprefix("sensor:").removeprefix("coil:") if colon else place
    return f"{kind}:{name}" if colon and kind not in ("coil", "amplifier") else (f"actuator:{name}" if colon else name)


def same_place(place: str, hidden: dict[str, Any]) -> bool:
    """Say whether a place is the hidden one, by any of its names."""
    return _bare(place) in {_bare(p) for p in (hidden["place"], *hidden["places_alike"])}


def _place(first: dict[str, Any] | None, hidden: dict[str, Any] | None) -> dict[str, Any]:
    if first is None or hidden is None:
        return {"place_exact": None, "place_near": None, "place_covered": None, "places": 0}
    exact = same_place(first["place"], hidden)
    near = {_bare(p) for p in hidden["places_near"]}
    return {
        "place_exact": exact,
        "place_near": exact or _bare(first["place"]) in near,
        "place_covered": any(same_place(p, hidden) for p in first.get("places_90", ())),
        "places": len(first.get("places_90", ())),
    }


def _parameters(first: dict[str, Any] | None, hidden: dict[str, Any] | None) -> dict[str, Any]:
    if first is None or hidden is None or not hidden["same_parameters"] or first["effect"] != hidden["effect"]:
        return {"errors": {}, "covered": {}}
    errors, covered = {}, {}
    given, true = _comparable(first.get("parameters", {}), hidden["parameters"])
    for name, value in true.items():
        if value == 0.0:
            continue
        found = given.get(name, {}).get("value")
        errors[name] = MOST_ERROR if found is None else min(abs(found - value) / abs(value), MOST_ERROR)
        ci = given.get(name, {}).get("ci90") or [None, None]
        covered[name] = None not in ci and min(ci) <= value <= max(ci)
    return {"errors": errors, "covered": covered}


def _comparable(given: dict[str, Any], true: dict[str, float]) -> tuple[dict[str, Any], dict[str, float]]:
    """Return parameters under the same names; without steady phase, the amplitude."""
    if "amplitude" in given and {"sine", "cosine"} <= set(true):
        rest = {name: value for name, value in true.items() if name not in ("sine", "cosine")}
        return given, {"amplitude": float(np.hypot(true["sine"], true["cosine"])), **rest}
    return given, true
