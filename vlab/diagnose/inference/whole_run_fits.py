"""Fits of many hypotheses to whole runs."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from vlab.diagnose.inference.evidence import Hypothesis
from vlab.diagnose.inference.hypothesis_fits import by_score, fitted, scored_by, terms_of
from vlab.diagnose.inference.least_squares import LeastSquares
from vlab.diagnose.parameters.terms import Candidate, Fit, Term
from vlab.diagnose.settings import FIT, HYPOTHESIS_FITS
from vlab.parallel import side_by_side
from vlab.signals import Array


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
    both = [with_whole_runs(h, whole, fit) for h, fit in zip(chosen, fits, strict=True)]
    return by_score(both, changed_alike(list(hypotheses)[most:], chosen, both))


def fitted_on_both(whole: LeastSquares, narrow: LeastSquares, terms: Sequence[Term], start: Fit) -> Hypothesis:
    """Fit effects to whole runs, then in windows.

    Parameters
    ----------
    whole, narrow : LeastSquares
        Whole runs and windows.
    terms : sequence of Term
        Effects at locations.
    start : Fit
        Fit to start from.

    Returns
    -------
    Hypothesis
        Hypothesis scored on both.
    """
    fit = whole.fit(terms, start, FIT.iterations)
    if narrow.runs == whole.runs:
        return replace(scored_by(whole, fit), whole=fit)
    short = fitted(narrow, fit.terms, replace(fit, starts={}), HYPOTHESIS_FITS.quick)
    return with_whole_runs(short, whole, fit)


def changed_alike(
    hypotheses: Sequence[Hypothesis], before: Sequence[Hypothesis], after: Sequence[Hypothesis]
) -> list[Hypothesis]:
    """Return hypotheses whose scores change as those of others.

    Parameters
    ----------
    hypotheses : sequence of Hypothesis
        Hypotheses.
    before, after : sequence of Hypothesis
        Others before and after a fit; the change for the worse counts.

    Returns
    -------
    list of Hypothesis
        Hypotheses.
    """
    both = list(zip(after, before, strict=True))
    log_rms = max((b.log_rms_residual - h.log_rms_residual for b, h in both), default=0.0)
    prior = max((b.negative_log_prior - h.negative_log_prior for b, h in both), default=0.0)
    more = max((b.normalised_residual**2 - h.normalised_residual**2 for b, h in both), default=0.0)
    return [
        replace(
            h,
            log_rms_residual=h.log_rms_residual + log_rms,
            negative_log_prior=h.negative_log_prior + prior,
            normalised_residual=float(np.sqrt(max(h.normalised_residual**2 + more, 0.0))),
        )
        for h in hypotheses
    ]


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


def _as_in(best: Fit, fit: Fit) -> Fit:
    """Return a fit with the values that another fit shares."""
    terms = [
        replace(term, values={name: other.values.get(name, value) for name, value in term.values.items()})
        for term, other in zip(fit.terms, best.terms, strict=False)
    ]
    return replace(best, terms=(*terms, *fit.terms[len(terms) :]))
