"""Shortlist of a screening's candidates for fits."""

from collections.abc import Sequence

from vlab.diagnose.inference.evidence import Hypothesis
from vlab.diagnose.parameters.terms import Candidate, Term
from vlab.diagnose.settings import MODEL_CHOICE, SCORE_TEST, SHORTLIST


def shortlisted(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return the best candidates by effect, and by further families.

    Parameters
    ----------
    candidates : sequence of Candidate
        Candidates by gain.

    Returns
    -------
    list of Candidate
        Shortlist.
    """
    order = _without_embellishments([c for c in best_of_effects(candidates) if c.log_likelihood_gain > 0])
    stands_out = bool(order) and order[0].log_likelihood_gain > SHORTLIST.clear
    share = 1.0 if stands_out else 0.0
    most = SHORTLIST.shortlist + (
        SHORTLIST.families if stands_out else 2 * SHORTLIST.families
    )  # without a dominant candidate every family is tried
    out = order[: SHORTLIST.shortlist]
    families = {c.effect.family for c in out}
    for candidate in order[SHORTLIST.shortlist :]:
        if len(out) >= most:
            break
        if candidate.effect.family not in families and candidate.log_likelihood_gain > SHORTLIST.least_gain * share:
            families.add(candidate.effect.family)
            out.append(candidate)
    labels = {c.label for c in out}
    return out + [c for c in _plainest(out, candidates) if c.label not in labels]


def _plainest(shortlist: Sequence[Candidate], candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return the plainest effect of every candidate's family at its location.

    A richer law gains more in the regression, which is linear in the amplitudes. A large change, such as a damper that
    locks a joint, needs a fit.
    """
    out: dict[str, Candidate] = {}
    for one in shortlist:
        same = [
            c
            for c in candidates
            if (c.effect.family, c.effect.kind, c.place.name) == (one.effect.family, one.effect.kind, one.place.name)
            and len(c.effect.parameters) < len(one.effect.parameters)
            and c.log_likelihood_gain > SHORTLIST.least_gain
        ]
        if same:
            plain = min(same, key=lambda c: (len(c.effect.parameters), -c.log_likelihood_gain))
            out.setdefault(plain.label, plain)
    return list(out.values())


def best_of_effects(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return every effect at its best location."""
    best: dict[str, Candidate] = {}
    for candidate in candidates:
        best.setdefault(candidate.effect.name, candidate)
    return list(best.values())


def best_places(candidates: Sequence[Candidate], most: int) -> set[str]:
    """Return the labels of every effect's best locations.

    Parameters
    ----------
    candidates : sequence of Candidate
        Candidates by gain.
    most : int
        Number of locations per effect.

    Returns
    -------
    set of str
        Labels.
    """
    count: dict[str, int] = {}
    out = set()
    for candidate in candidates:
        count[candidate.effect.name] = count.get(candidate.effect.name, 0) + 1
        if count[candidate.effect.name] <= most:
            out.add(candidate.label)
    return out


def is_another_start(candidate: Candidate, known: Sequence[Candidate]) -> bool:
    """Return whether a fit of a candidate starts elsewhere than those of known ones.

    A scanned shape, such as a pitch, has narrow peaks of likelihood, and no fit moves from one to another.

    Parameters
    ----------
    candidate : Candidate
        Candidate.
    known : sequence of Candidate
        Candidates with fits.

    Returns
    -------
    bool
        False if a known candidate has the same effect and location, and scanned shapes within the widest zoom.
    """
    scanned = [p.name for p in candidate.effect.shapes if p.scan]
    widest = max(SCORE_TEST.zoom)
    return not any(
        c.label == candidate.label
        and all(1.0 / widest < c.values[name] / candidate.values[name] < widest for name in scanned)
        for c in known
    )


def related_candidates(candidates: Sequence[Candidate], fitted: Sequence[Hypothesis]) -> list[Candidate]:
    """Return unfitted related effects at the best location.

    Only fits distinguish related families.

    Parameters
    ----------
    candidates : sequence of Candidate
        Candidates by gain.
    fitted : sequence of Hypothesis
        Fitted hypotheses, best first.

    Returns
    -------
    list of Candidate
        Candidates.
    """
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


def rivals_of(candidate: Candidate, table: Sequence[Candidate]) -> list[Candidate]:
    """Return indistinguishable effects of a candidate's family.

    The rivals act at the same location, or gain as much: an offset of a command is a constant force where the actuator
    acts.

    Parameters
    ----------
    candidate : Candidate
        Candidate.
    table : sequence of Candidate
        Its screening, by gain.

    Returns
    -------
    list of Candidate
        Every other effect at its best location.
    """
    least = candidate.log_likelihood_gain - MODEL_CHOICE.alike
    own = [
        c
        for c in table
        if c.effect.family == candidate.effect.family
        and c.effect.name != candidate.effect.name
        and c.log_likelihood_gain > SHORTLIST.least_gain
        and (c.place.name == candidate.place.name or c.log_likelihood_gain >= least)
    ]
    return best_of_effects(own)[: SHORTLIST.rivals]


def completing(first: Term, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return usual companions of an effect at its location.

    Companions absorb so much of each other that a conditional screening shows little.

    Parameters
    ----------
    first : Term
        First effect.
    candidates : sequence of Candidate
        Candidates.

    Returns
    -------
    list of Candidate
        Companions.
    """
    name = first.effect.traits.accompanied_by
    return [
        c
        for c in candidates
        if c.effect.name == name and c.place.name == first.place.name and c.log_likelihood_gain > SHORTLIST.least_gain
    ]


def plain_form(candidate: Candidate, table: Sequence[Candidate]) -> Candidate:
    """Return a candidate's plain form, where nearly equal."""
    plain = (c for c in table if c.effect.name == candidate.effect.form_of and c.place.name == candidate.place.name)
    return next(
        (c for c in plain if c.log_likelihood_gain > SHORTLIST.nearly * candidate.log_likelihood_gain), candidate
    )


def _without_embellishments(candidates: list[Candidate]) -> list[Candidate]:
    """Drop candidates that gain little more than a simpler one."""
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
