"""Events that leave something for good: what windows, which begin from the motion as it is, know nothing of."""

from collections.abc import Sequence
from dataclasses import replace

from vlab.diagnose.inference.evidence import Hypothesis
from vlab.diagnose.inference.hypothesis_fits import scored_by
from vlab.diagnose.inference.least_squares import LeastSquares
from vlab.diagnose.kernels.parallel import side_by_side
from vlab.diagnose.parameters.terms import Candidate, Fit, Term
from vlab.diagnose.settings import PERMANENT_CHANGE


def find_permanent_changes(
    whole: LeastSquares, windows: LeastSquares, in_windows: Fit, candidates: Sequence[Candidate]
) -> list[Hypothesis]:
    """Return laws of events that last, at the places and with the values that leave least of whole runs, not yet fitted.

    Parameters
    ----------
    in_windows : Fit
        Of the same physics, in windows: where these do not show an event, its uncertain parameters need not make up for one.
    candidates : sequence of Candidate
        The screening's, for the places.
    """
    terms = [c for c in candidates if c.effect.lasts]
    tried = side_by_side(lambda c: _best(whole, c, in_windows), terms)
    order = sorted(range(len(terms)), key=lambda i: (tried[i][0], terms[i].label))
    out = []
    for i in order[: PERMANENT_CHANGE.most]:
        term = tried[i][1]
        plain = Term(effect=term.effect, place=term.place, values=term.values)
        # in windows it is as if it was not there
        out.append(scored_by(windows, replace(in_windows, terms=(plain,)), terms[i].log_likelihood_gain))
    return out


def _best(whole: LeastSquares, candidate: Candidate, start: Fit) -> tuple[float, Term]:
    """Return a candidate with the values that leave least of whole runs, and how much."""
    own = {p.name: candidate.place.stiffness for p in candidate.effect.amplitudes}
    of = {p.name: whole.screen.reference(p.reference, candidate.place) for p in candidate.effect.shapes}
    _, term = whole.cheapest(
        candidate, [{**own, **{n: x * s for n, x in of.items()}} for s in PERMANENT_CHANGE.shares], start
    )
    found = term.values
    return whole.cheapest(
        candidate, [{**own, **{n: found[n] * s for n in of}} for s in PERMANENT_CHANGE.between], start
    )
