"""Permanent changes by events, visible in whole runs only.

Windows start from the state after the event.
"""

from collections.abc import Sequence
from dataclasses import replace

from vlab.diagnose.inference.evidence import Hypothesis
from vlab.diagnose.inference.hypothesis_fits import scored_by
from vlab.diagnose.inference.least_squares import LeastSquares
from vlab.diagnose.parameters.terms import Candidate, Fit, Term
from vlab.diagnose.settings import PERMANENT_CHANGE
from vlab.parallel import side_by_side


def find_permanent_changes(
    whole: LeastSquares, windows: LeastSquares, in_windows: Fit, candidates: Sequence[Candidate]
) -> list[Hypothesis]:
    """Return the best laws of permanent change, without a fit.

    Parameters
    ----------
    whole : LeastSquares
        Fits to whole runs.
    windows : LeastSquares
        Fits in windows.
    in_windows : Fit
        Fit in windows without the event, whose uncertain parameters need not compensate it.
    candidates : sequence of Candidate
        Screening, for the locations.

    Returns
    -------
    list of Hypothesis
        Hypotheses scored in windows.
    """
    terms = [c for c in candidates if c.effect.lasts]
    tried = side_by_side(lambda c: _best(whole, c, in_windows), terms)
    order = sorted(range(len(terms)), key=lambda i: (tried[i][0], terms[i].label))
    out = []
    for i in order[: PERMANENT_CHANGE.most]:
        term = tried[i][1]
        plain = Term(effect=term.effect, place=term.place, values=term.values)
        # windows do not show the event
        out.append(scored_by(windows, replace(in_windows, terms=(plain,)), terms[i].log_likelihood_gain))
    return out


def _best(whole: LeastSquares, candidate: Candidate, start: Fit) -> tuple[float, Term]:
    """Return a candidate's least cost, with its values."""
    own = {p.name: candidate.place.stiffness for p in candidate.effect.amplitudes}
    of = {p.name: whole.screen.reference(p.reference, candidate.place) for p in candidate.effect.shapes}
    _, term = whole.cheapest(
        candidate, [{**own, **{n: x * s for n, x in of.items()}} for s in PERMANENT_CHANGE.shares], start
    )
    found = term.values
    return whole.cheapest(
        candidate, [{**own, **{n: found[n] * s for n in of}} for s in PERMANENT_CHANGE.between], start
    )
