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
from vlab.signals import Array


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
        sum(run.y.size for run in refiner.runs),
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
    return sum(h.score > order[0].score - HYPOTHESIS_FITS.hopeless for h in order)


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


def on_whole_runs(
    whole: LeastSquares,
    narrow: LeastSquares,
    hypotheses: Sequence[Hypothesis],
    most: int = HYPOTHESIS_FITS.whole_finished,
    thetas: Sequence[Array] = (),
    iterations: int = HYPOTHESIS_FITS.whole_iterations,
    screened: Sequence[Candidate] = (),
    start: Fit | None = None,
) -> list[Hypothesis]:
    """Return hypotheses scored on windows and whole runs, half each.

    Windows test a law on the present motion; whole runs test long-term phase and hysteresis. Only the first `most` are
    fitted again. The others receive the largest change among the first.

    Parameters
    ----------
    whole, narrow : LeastSquares
        Whole runs and windows.
    hypotheses : sequence of Hypothesis
        Hypotheses with equal numbers of effects, by score.
    most : int
        Number of hypotheses to fit again.
    thetas : sequence of (n_changes,) arrays
        Further starts of the uncertain parameters, since a frequency error of half a cycle over a run loses the fit.
    iterations : int
        Most iterations.
    screened : sequence of Candidate
        Values from the screening, as further starts of hysteretic laws. Windows do not show a set left by an earlier
        event.
    start : Fit or None
        Other parameters for `screened`.

    Returns
    -------
    list of Hypothesis
        Hypotheses by score.
    """
    if narrow.runs == whole.runs:
        return list(hypotheses)
    chosen = list(hypotheses)[:most]
    fresh_values = {c.label: c for c in reversed(screened) if c.effect.has_state}

    def fitted_on(h: Hypothesis) -> Fit:
        own = whole.fit(h.terms, h.fit, iterations, thetas)
        fresh = fresh_values.get(h.label)
        if fresh is None or scored_by(whole, own).normalised_residual <= HYPOTHESIS_FITS.enough:
            return own
        return min(own, whole.fit(terms_of([fresh]), start), key=whole.negative_log_posterior)

    fits = side_by_side(fitted_on, chosen)
    fits = _on_from_the_best(whole, fits)
    both = []
    for h, fit in zip(chosen, fits, strict=True):
        both.append(with_whole_runs(h, whole, fit))
    log_rms_residual = max(
        (b.log_rms_residual - h.log_rms_residual for b, h in zip(both, chosen, strict=True)), default=0.0
    )
    negative_log_prior = max(
        (b.negative_log_prior - h.negative_log_prior for b, h in zip(both, chosen, strict=True)), default=0.0
    )
    more = max(
        (b.normalised_residual**2 - h.normalised_residual**2 for b, h in zip(both, chosen, strict=True)), default=0.0
    )
    rest = [
        replace(
            h,
            log_rms_residual=h.log_rms_residual + log_rms_residual,
            negative_log_prior=h.negative_log_prior + negative_log_prior,
            normalised_residual=float(np.sqrt(max(h.normalised_residual**2 + more, 0.0))),
        )
        for h in list(hypotheses)[most:]
    ]
    return by_score(both, rest)


def with_whole_runs(hypothesis: Hypothesis, whole: LeastSquares, fit: Fit) -> Hypothesis:
    """Return a hypothesis of windows with its fit to whole runs.

    Windows and whole runs have half of the score each. The prior is that of the whole runs: window starts are smoothed
    without the law, and the uncertain parameters compensate.

    Parameters
    ----------
    hypothesis : Hypothesis
        Hypothesis scored in windows.
    whole : LeastSquares
        Whole runs.
    fit : Fit
        Fit to whole runs.

    Returns
    -------
    Hypothesis
        Hypothesis scored on both.
    """
    own = scored_by(whole, fit)
    return replace(
        hypothesis,
        log_rms_residual=0.5 * (hypothesis.log_rms_residual + own.log_rms_residual),
        negative_log_prior=own.negative_log_prior,
        normalised_residual=float(np.sqrt(0.5 * (hypothesis.normalised_residual**2 + own.normalised_residual**2))),
        whole=fit,
    )


def _on_from_the_best(whole: LeastSquares, fits: Sequence[Fit]) -> list[Fit]:
    """Return nearly equal fits, continued from the best one's common parameters.

    A richer law may converge before its special case does.
    """
    if len(fits) < 2:
        return list(fits)
    best = min(fits, key=lambda fit: fit.cost)
    near = [i for i, fit in enumerate(fits) if fit.cost <= HYPOTHESIS_FITS.nearly_as_little * best.cost]
    if len(near) < 2:
        return list(fits)

    def on(i: int) -> Fit:
        again = whole.fit(fits[i].terms, _as_in(best, fits[i]), HYPOTHESIS_FITS.whole_iterations)
        return min(fits[i], again, key=whole.negative_log_posterior)

    better = dict(zip(near, side_by_side(on, near), strict=True))
    return [better.get(i, fit) for i, fit in enumerate(fits)]


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


def _as_in(best: Fit, fit: Fit) -> Fit:
    """Return a fit with the values that another fit shares."""
    terms = [
        replace(term, values={name: other.values.get(name, value) for name, value in term.values.items()})
        for term, other in zip(fit.terms, best.terms, strict=False)
    ]
    return replace(best, terms=(*terms, *fit.terms[len(terms) :]))


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
