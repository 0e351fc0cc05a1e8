"""Which of a screening's thousands of candidates are worth a fit."""

from collections.abc import Sequence

from vlab.diagnose.inference.evidence import Hypothesis
from vlab.diagnose.parameters.terms import Candidate, Term
from vlab.diagnose.settings import SHORTLIST


def shortlisted(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return the best place of the effects that gained most, and of the best of other families."""
    order = _without_embellishments([c for c in best_of_effects(candidates) if c.log_likelihood_gain > 0])
    stands_out = bool(order) and order[0].log_likelihood_gain > SHORTLIST.clear
    share = 1.0 if stands_out else 0.0
    most = SHORTLIST.shortlist + (
        SHORTLIST.families if stands_out else 2 * SHORTLIST.families
    )  # where nothing stands out, every family is tried
    out = order[: SHORTLIST.shortlist]
    families = {c.effect.family for c in out}
    for candidate in order[SHORTLIST.shortlist :]:
        if len(out) >= most:
            break
        if candidate.effect.family not in families and candidate.log_likelihood_gain > SHORTLIST.least_gain * share:
            families.add(candidate.effect.family)
            out.append(candidate)
    return out


def best_of_effects(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return every effect at its best place, candidates being sorted."""
    best: dict[str, Candidate] = {}
    for candidate in candidates:
        best.setdefault(candidate.effect.name, candidate)
    return list(best.values())


def best_places(candidates: Sequence[Candidate], most: int) -> set[str]:
    """Return the labels of every effect at the places where it gained most."""
    count: dict[str, int] = {}
    out = set()
    for candidate in candidates:
        count[candidate.effect.name] = count.get(candidate.effect.name, 0) + 1
        if count[candidate.effect.name] <= most:
            out.add(candidate.label)
    return out


def related_candidates(candidates: Sequence[Candidate], fitted: Sequence[Hypothesis]) -> list[Candidate]:
    """Return the effects of kindred families at the place of the best fit that are not fitted yet: only fits tell them apart."""
    if not fitted or len(fitted[0].terms) != 1:
        return []
    best, known = fitted[0].terms[0], {h.label for h in fitted}
    families = {best.effect.family, *best.effect.traits.related}
    return [
        c
        for c in candidates
        if c.place.name == best.place.name
        and c.effect.family in families
        and c.effect.kind == best.effect.kind
        and c.label not in known
        and (c.log_likelihood_gain > 0 or not c.effect.amplitudes)
    ]


def same_site_alternatives(table: Sequence[Candidate], second: Candidate) -> list[Candidate]:
    """Return other effects of a second one's family at its place, which only a fit can tell apart."""
    own = [c for c in table if c.effect.family == second.effect.family and c.place.name == second.place.name]
    return best_of_effects([c for c in own if c.log_likelihood_gain > SHORTLIST.least_gain])[
        : SHORTLIST.same_site_alternatives
    ]


def completing(first: Term, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return what usually stands beside an effect at its place: each takes up so much of the other that a regression beside it shows
    little."""
    name = first.effect.traits.accompanied_by
    return [
        c
        for c in candidates
        if c.effect.name == name and c.place.name == first.place.name and c.log_likelihood_gain > SHORTLIST.least_gain
    ]


def plain_form(candidate: Candidate, table: Sequence[Candidate]) -> Candidate:
    """Return the effect itself in the place of another form of it that gains little more: fits say which form it is."""
    plain = (c for c in table if c.effect.name == candidate.effect.form_of and c.place.name == candidate.place.name)
    return next(
        (c for c in plain if c.log_likelihood_gain > SHORTLIST.nearly * candidate.log_likelihood_gain), candidate
    )


def _without_embellishments(candidates: list[Candidate]) -> list[Candidate]:
    """Drop candidates that gain no more than a simpler one of their family does, at the same place, or little more than the effect that
    they are a form of."""
    out: list[Candidate] = []
    for c in candidates:
        simpler = [
            d
            for d in candidates
            if d.effect.family == c.effect.family
            and d.place.name == c.place.name
            and len(d.effect.parameters) < len(c.effect.parameters)
            and d.log_likelihood_gain >= c.log_likelihood_gain - SHORTLIST.least_gain
        ]
        if not simpler and plain_form(c, candidates) is c:
            out.append(c)
    return out
