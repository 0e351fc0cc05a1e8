"""One answer beside one truth."""

from dataclasses import dataclass, field
from typing import Any

from vlab.proof.equivalence import right_class

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
    right_effect, right_class : bool
        Of the first finding; with two hidden effects it may be either.
    all_right : bool
        Every hidden effect was named in class, and nothing else.
    place_exact, place_near, place_covered : bool or None
        Of the finding that was judged; None where nothing was named.
    places : int
        Size of the set of places.
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
    all_right: bool
    place_exact: bool | None
    place_near: bool | None
    place_covered: bool | None
    places: int
    claimed: int
    probability: float | None
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
        return self.verdict != ABSTAINED if not self.in_library else not self.right_class


def judge(truth: dict[str, Any], answer: dict[str, Any]) -> Judged:
    """Judge the answer to a case."""
    hidden = truth["hidden"]
    findings = answer.get("findings", []) if answer["verdict"] == NAMED else []
    first: dict[str, Any] | None = findings[0] if findings else None
    in_library = bool(hidden) and all(h["accepted"] for h in hidden)
    meant = _meant(truth, first, hidden)
    size = truth.get("size")
    heldout = answer.get("heldout") or {}
    gap = heldout.get("gap_closed") if answer["verdict"] == NAMED else (0.0 if heldout else None)
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
        right_effect=first is not None and meant is not None and first["effect"] in meant["accepted"],
        right_class=first is not None and meant is not None and _in_class(truth, meant, first),
        all_right=bool(hidden) and _all_right(truth, findings, hidden),
        **_place(first, meant or (hidden[0] if hidden else None)),
        claimed=len(first.get("class", ())) if first else 0,
        probability=float(first["probability"]) if first else None,
        **_parameters(first, meant),
        gap=gap,
        size=None if size is None else float(size["left"]),
        seconds=float(answer.get("seconds", 0.0)),
        error=answer.get("error", ""),
        truth_place=" + ".join(h["place"] for h in hidden),
        place=first["place"] if first else "",
    )


def _in_class(truth: dict[str, Any], hidden: dict[str, Any], finding: dict[str, Any]) -> bool:
    claimed = {finding["effect"], *finding.get("class", ())}
    right = right_class(truth, hidden)
    return finding["effect"] in right or bool(claimed & set(hidden["accepted"]))


def _meant(truth: dict[str, Any], first: dict[str, Any] | None, hidden: list[dict[str, Any]]) -> dict[str, Any] | None:
    """Return the hidden thing that a finding speaks of: the one it names, else in class; None for neither."""
    if first is None:
        return None
    named = [h for h in hidden if first["effect"] in h["accepted"]]
    alike = [h for h in hidden if h["accepted"] and _in_class(truth, h, first)]
    options = named or alike
    at_place = [h for h in options if same_place(first["place"], h)]
    return next(iter(at_place or options), None)


def _all_right(truth: dict[str, Any], findings: list[dict[str, Any]], hidden: list[dict[str, Any]]) -> bool:
    left = list(findings)
    for h in hidden:
        match = next((f for f in left if h["accepted"] and _in_class(truth, h, f)), None)
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
    for name, true in hidden["parameters"].items():
        given = first.get("parameters", {}).get(name)
        if given is None or true == 0.0 or given.get("value") is None:
            continue
        errors[name] = abs(given["value"] - true) / abs(true)
        ci = given.get("ci90") or [None, None]
        covered[name] = None not in ci and min(ci) <= true <= max(ci)
    return {"errors": errors, "covered": covered}
