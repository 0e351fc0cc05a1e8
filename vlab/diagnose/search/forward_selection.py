"""Forward selection of any number of effects.

A machine has friction in every joint, and Coulomb friction, drag and viscous damping in one. Effects are added one by one
to the best hypothesis, each from a screening beside the effects that are there. All are fitted together. The selection
ends when the approximate log evidence no longer grows.

References
----------
A. Miller, Subset Selection in Regression, 2nd ed., Chapman and Hall, 2002, section 3.2.
"""

from collections.abc import Callable, Sequence

from vlab.diagnose.inference.evidence import Hypothesis
from vlab.diagnose.inference.hypothesis_fits import finished, on_whole_runs, pairs_fitted
from vlab.diagnose.inference.least_squares import LeastSquares
from vlab.diagnose.inference.model_choice import gain_beyond
from vlab.diagnose.parameters.terms import Candidate
from vlab.diagnose.search.shortlist import plain_form
from vlab.diagnose.settings import FORWARD_SELECTION, HYPOTHESIS_FITS, SECOND_EFFECT, SHORTLIST

Beside = Callable[[Hypothesis], Sequence[Candidate]]
"""Screening of further effects beside a fitted hypothesis, by gain."""


def add_effects(
    best: Hypothesis,
    before: Hypothesis,
    windows: LeastSquares,
    whole: LeastSquares,
    beside: Beside,
    enough: float = HYPOTHESIS_FITS.enough,
) -> list[Hypothesis]:
    """Return fits of hypotheses with further effects.

    Parameters
    ----------
    best : Hypothesis
        Best hypothesis, fitted to whole runs.
    before : Hypothesis
        Calibrated model, fitted to whole runs.
    windows, whole : LeastSquares
        Fits in windows and to whole runs.
    beside : callable
        Screening beside a hypothesis.
    enough : float
        Normalised residual that needs no further effect.

    Returns
    -------
    list of Hypothesis
        All fitted hypotheses with more effects than `best`.
    """
    out: list[Hypothesis] = []
    if gain_beyond(best, before) <= 0.0:
        return out
    while best.normalised_residual > enough and len(best.terms) < FORWARD_SELECTION.most_effects:
        further = further_effects(best, beside(best))
        fits = finished(windows, pairs_fitted(windows, [(best, candidate) for candidate in further]))
        fits = on_whole_runs(whole, windows, fits)
        if not fits:
            break
        out += fits
        if gain_beyond(fits[0], best) <= 0.0:
            break
        best = fits[0]
    return out


def further_effects(best: Hypothesis, table: Sequence[Candidate]) -> list[Candidate]:
    """Return the candidates that join a hypothesis.

    They are the best of every family, and the hypothesis' own effects at their best other location. Two slip laws at one
    location are one friction.

    Parameters
    ----------
    best : Hypothesis
        Hypothesis.
    table : sequence of Candidate
        Screening beside the hypothesis, by gain.

    Returns
    -------
    list of Candidate
        Candidates by gain.
    """
    places = {term.place.name for term in best.terms if term.effect.traits.is_slip}
    taken = {(term.effect.physics, term.place.name) for term in best.terms}
    chosen: dict[str, Candidate] = {}
    own = {term.effect.physics for term in best.terms}
    for candidate in table:
        is_known = (candidate.effect.physics, candidate.place.name) in taken
        is_same_slip = candidate.effect.traits.is_slip and candidate.place.name in places
        if is_known or is_same_slip or candidate.log_likelihood_gain <= SHORTLIST.least_gain:
            continue
        key = candidate.effect.physics if candidate.effect.physics in own else f"family:{candidate.effect.family}"
        chosen.setdefault(key, candidate)
    order = sorted(chosen.values(), key=lambda c: -c.log_likelihood_gain)
    return [plain_form(candidate, table) for candidate in order[: 2 * SECOND_EFFECT.seconds]]
