"""Fits of many hypotheses: quick fits, converged fits, whole runs, other locations."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from vlab.diagnose.inference.evidence import Hypothesis, scored
from vlab.diagnose.inference.least_squares import LeastSquares
from vlab.diagnose.parameters.terms import Candidate, Fit, Term, is_meant, of_element
from vlab.diagnose.parameters.tolerance import is_within_tolerance, modal_tolerances
from vlab.diagnose.settings import FIT, HYPOTHESIS_FITS
from vlab.parallel import side_by_side
from vlab.physics.effect import LinearPortEffect


def terms_of(candidates: Sequence[Candidate]) -> list[Term]:
    """Return candidates as terms of a hypothesis."""
    return [Term(effect=c.effect, place=c.place, values=c.values) for c in candidates]


def floor_of(refiner: LeastSquares) -> float:
    """Return the normalised residual of noise alone."""
    return float(np.sqrt(refiner.noise_share))


def scored_by(refiner: LeastSquares, fit: Fit, log_likelihood_gain: float = 0.0) -> Hypothesis:
    """Return a fit as a scored hypothesis.

    Parameters
    ----------
    refiner : LeastSquares
        Runs and weights.
    fit : Fit
        Fit.
    log_likelihood_gain : float
        Log-likelihood gain in the screening [nat].

    Returns
    -------
    Hypothesis
        Hypothesis.
    """
    return scored(
        fit,
        refiner.n_values,
        refiner.effective_samples,
        log_likelihood_gain,
        floor=floor_of(refiner),
    )


def fitted(
    refiner: LeastSquares,
    terms: Sequence[Term],
    start: Fit,
    iterations: int = HYPOTHESIS_FITS.quick,
    log_likelihood_gain: float = 0.0,
) -> Hypothesis:
    """Return a hypothesis fitted from another fit."""
    own = refiner.beside(terms)
    return scored_by(own, own.fit(terms, start, iterations), log_likelihood_gain)


def each_fitted(refiner: LeastSquares, candidates: Sequence[Candidate], start: Fit) -> list[Hypothesis]:
    """Return quick fits of candidates, one by one.

    Parameters
    ----------
    refiner : LeastSquares
        Runs and weights.
    candidates : sequence of Candidate
        Candidates.
    start : Fit
        Fit to start from.

    Returns
    -------
    list of Hypothesis
        Hypotheses.
    """
    trials = [(c, HYPOTHESIS_FITS.first) for one in candidates for c in _of_few_values(refiner, one)]
    trials += [(c, HYPOTHESIS_FITS.quick) for one in candidates for c in as_large_as_the_model(refiner, one)]

    def tried(trial: tuple[Candidate, int]) -> Hypothesis:
        candidate, iterations = trial
        return fitted(refiner, terms_of([candidate]), start, iterations, candidate.log_likelihood_gain)

    first = side_by_side(tried, trials)
    best: dict[str, Hypothesis] = {}
    for h in by_score(first):
        best.setdefault(h.label, h)

    def fit(c: Candidate) -> Hypothesis:
        coarse = best.get(c.label)
        if coarse is None:
            return fitted(refiner, terms_of([c]), start, log_likelihood_gain=c.log_likelihood_gain)
        return fitted(refiner, coarse.terms, coarse.fit, log_likelihood_gain=c.log_likelihood_gain)

    return side_by_side(fit, candidates)


def _of_few_values(refiner: LeastSquares, candidate: Candidate) -> list[Candidate]:
    """Return a candidate with every value of its discrete parameters.

    Derivatives are zero there, and a wrong period may gain more in the screening. The screened value may lie beyond
    the grid.
    """
    h = refiner.runs[0].h
    discrete = [p for p in candidate.effect.parameters if p.grain and p.reference == "step"]
    return [
        *([candidate] if discrete else []),
        *(
            replace(candidate, values={**candidate.values, p.name: k * h})
            for p in discrete
            for k in range(round(p.grid[0]), round(p.grid[-1]) + 1)
        ),
    ]


def as_large_as_the_model(refiner: LeastSquares, candidate: Candidate) -> list[Candidate]:
    """Return a linear effect as large as the model's own impedance.

    The regression is linear in the effect. A damper that locks a joint, or a support that doubles a frequency, has a second
    optimum far from the regression's value.

    Parameters
    ----------
    refiner : LeastSquares
        Fits, with the reduced model.
    candidate : Candidate
        Candidate with the value of the regression.

    Returns
    -------
    list of Candidate
        The candidate at the size at which a mode's impedance doubles; none for other effects and smaller sizes.
    """
    effect, place = candidate.effect, candidate.place
    if not isinstance(effect, LinearPortEffect) or len(effect.parameters) != 1:
        return []
    (parameter,), omega = effect.parameters, refiner.reduced_model.omega
    moved = np.sum(place.rows**2, axis=0)
    mass, damping, stiffness = (abs(part) for part in effect.impedance({parameter.name: 1.0}, place.stiffness))
    change, swings = (mass * omega**2 + damping * omega + stiffness) * moved, omega > 0.0
    share = float(np.max(change[swings] / omega[swings] ** 2, initial=0.0))
    if not share:
        return []
    size = min(1.0 / share, parameter.high)
    return [replace(candidate, values={parameter.name: size})] if size > candidate.values[parameter.name] else []


def pairs_fitted(refiner: LeastSquares, pairs: Sequence[tuple[Hypothesis, Candidate]]) -> list[Hypothesis]:
    """Return quick fits of second effects with fitted hypotheses.

    Parameters
    ----------
    refiner : LeastSquares
        Runs and weights.
    pairs : sequence of (Hypothesis, Candidate)
        Hypotheses and second effects.

    Returns
    -------
    list of Hypothesis
        Hypotheses.
    """

    def fit(pair: tuple[Hypothesis, Candidate]) -> Hypothesis:
        first, second = pair
        terms = [*first.terms, *terms_of([second])]
        return fitted(
            refiner, terms, first.long_fit, log_likelihood_gain=first.log_likelihood_gain + second.log_likelihood_gain
        )

    return side_by_side(fit, pairs)


def by_score(*hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Return hypotheses in order of score, the best first."""
    return sorted((h for some in hypotheses for h in some), key=lambda h: -h.score)


def hopeful(order: Sequence[Hypothesis]) -> int:
    """Return the number of hypotheses that merit further fits.

    While no hypothesis explains the recordings, all do.

    Parameters
    ----------
    order : sequence of Hypothesis
        Hypotheses by score.

    Returns
    -------
    int
        Number from the best.
    """
    if not order or min(h.normalised_residual for h in order) > HYPOTHESIS_FITS.enough:
        return len(order)
    return len(near_best(order))


def near_best(order: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Return the hypotheses (by score) that are not hopeless beside the best."""
    return [h for h in order if h.score > order[0].score - HYPOTHESIS_FITS.hopeless]


def finished(refiner: LeastSquares, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Return hypotheses by score, the best ones converged.

    Parameters
    ----------
    refiner : LeastSquares
        Runs and weights.
    hypotheses : sequence of Hypothesis
        Hypotheses.

    Returns
    -------
    list of Hypothesis
        Hypotheses.
    """
    order = by_score(hypotheses)
    most = min(HYPOTHESIS_FITS.finished, hopeful(order))

    def fit(item: tuple[int, Hypothesis]) -> Hypothesis:
        place, h = item
        return fitted(refiner, h.terms, h.fit, FIT.iterations if place < most else 0, h.log_likelihood_gain)

    return by_score(side_by_side(fit, list(enumerate(order))))


def as_meant(whole: LeastSquares, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Return the hypotheses whose laws have values within their description.

    Laws beyond their description are fitted again from values of the local elastic elements. A gap small against the
    motion identifies its force alone: at a tenth of the stiffness and ten times the gap the law is a stop.

    Parameters
    ----------
    whole : LeastSquares
        Whole runs.
    hypotheses : sequence of Hypothesis
        Hypotheses.

    Returns
    -------
    list of Hypothesis
        Valid hypotheses.
    """
    found = side_by_side(lambda h: h if is_meant(h.long_fit.terms) else _from_elements(whole, h), list(hypotheses))
    return [h for h in found if is_meant(h.long_fit.terms)]


def with_tolerances(
    whole: LeastSquares,
    before: Hypothesis,
    hypotheses: Sequence[Hypothesis],
    enough: float,
    fit: Callable[[Sequence[Term], Fit], Hypothesis],
) -> list[Hypothesis]:
    """Return hypotheses with small linear effects taken as tolerances of the model.

    A linear effect within the stated uncertainty absorbs a part of other errors of the model. The effect is physics
    only where it explains the recordings. Elsewhere its residual and evidence count for the hypothesis without the
    effect. A law that acts as the same small stiffness then gains nothing beside it.

    Parameters
    ----------
    whole : LeastSquares
        Whole runs.
    before : Hypothesis
        Calibrated model without effects.
    hypotheses : sequence of Hypothesis
        Hypotheses.
    enough : float
        Normalised residual of an explanation.
    fit : callable
        Fits effects, from another fit. The function serves hypotheses of which no other lacks just the small effects.

    Returns
    -------
    list of Hypothesis
        The calibrated model and the hypotheses that remain.
    """
    tolerances = modal_tolerances(whole.problem.reduced_model)

    def essential(h: Hypothesis) -> tuple[Term, ...]:
        terms = h.long_fit.terms
        if h.normalised_residual <= enough:
            return terms
        return tuple(term for term in terms if not is_within_tolerance(term, tolerances))

    order = by_score([before, *hypotheses])
    richest: dict[frozenset[str], Hypothesis] = {}
    for h in order:
        richest.setdefault(_labels(essential(h)), h)
    kept = [before, *(h for h in hypotheses if len(essential(h)) == len(h.terms))]
    known, least = {_labels(h.terms) for h in kept}, max(h.score for h in kept)
    for labels, h in richest.items():
        if labels not in known and h.score > least:
            kept.append(replace(fit(essential(h), h.long_fit), effective_samples=h.effective_samples))
    return [_with_evidence_of(richest[_labels(h.terms)], h) for h in kept]


def _labels(terms: Sequence[Term]) -> frozenset[str]:
    return frozenset(term.label for term in terms)


def _with_evidence_of(richer: Hypothesis, hypothesis: Hypothesis) -> Hypothesis:
    """Return a hypothesis with the evidence of one with nuisance effects."""
    return replace(
        hypothesis,
        log_rms_residual=richer.log_rms_residual,
        negative_log_prior=richer.negative_log_prior + richer.complexity - hypothesis.complexity,
        normalised_residual=richer.normalised_residual,
    )


def _from_elements(whole: LeastSquares, hypothesis: Hypothesis) -> Hypothesis:
    """Return a hypothesis fitted from values of the local elastic elements."""
    old = hypothesis.long_fit
    terms = tuple(of_element(t) for t in old.terms)
    if not is_meant(terms):
        return hypothesis
    fit = whole.fit(terms, replace(old, terms=terms), HYPOTHESIS_FITS.whole_iterations)
    was, now = scored_by(whole, old), scored_by(whole, fit)
    return replace(
        hypothesis,
        whole=fit,
        log_rms_residual=hypothesis.log_rms_residual + now.log_rms_residual - was.log_rms_residual,
        negative_log_prior=now.negative_log_prior,
        normalised_residual=hypothesis.normalised_residual * now.normalised_residual / was.normalised_residual,
    )


def other_places(
    refiner: LeastSquares, best: Hypothesis, candidates: Sequence[Candidate], start: Fit
) -> dict[str, Hypothesis]:
    """Fit the best hypothesis with its first effect at other locations.

    Parameters
    ----------
    refiner : LeastSquares
        Runs and weights.
    best : Hypothesis
        Best hypothesis.
    candidates : sequence of Candidate
        Screening, for the locations.
    start : Fit
        Fit to start from.

    Returns
    -------
    dict of str to Hypothesis
        Hypotheses by location.
    """
    first, others = best.terms[0], best.terms[1:]
    elsewhere = [c for c in candidates if c.effect.name == first.effect.name and c.place.name != first.place.name]
    chosen = elsewhere[: HYPOTHESIS_FITS.places - 1]
    found = side_by_side(
        lambda c: fitted(refiner, [*terms_of([c]), *others], start, HYPOTHESIS_FITS.quick + 2, c.log_likelihood_gain),
        chosen,
    )
    here = fitted(
        refiner, best.terms, best.fit, HYPOTHESIS_FITS.quick + 2, best.log_likelihood_gain
    )  # in windows only, for comparison
    return {first.place.name: here, **{c.place.name: h for c, h in zip(chosen, found, strict=True)}}
