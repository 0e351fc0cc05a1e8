"""Starting vectors of a fit.

The starts are estimates of the screening, and an earlier fit with small new terms.
"""

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np

from vlab.diagnose.inference.parameter_vector import ParameterVector
from vlab.diagnose.inference.score_test import ScoreTest
from vlab.diagnose.parameters.terms import Candidate, Fit, Term, of_element
from vlab.diagnose.settings import FIT
from vlab.signals import Array


class Started(Protocol):
    """Protocol of fits with a screening, as of `vlab.diagnose.inference.least_squares.LeastSquares`."""

    screen: ScoreTest

    def initial(
        self, vector: ParameterVector, values: Sequence[Mapping[str, float]], theta: Array, start: Fit | None
    ) -> Array:
        """Return the vector of values with a fit's offsets and states."""

    def costs(self, vector: ParameterVector, X: Array) -> Array:
        """Return the costs (n_sets,) of parameter vectors."""


def starting_vectors(of: Started, vector: ParameterVector, start: Fit | None, thetas: Sequence[Array]) -> list[Array]:
    """Return the starting vectors of a fit, the most promising first.

    Parameters
    ----------
    of : Started
        Fits with a screening.
    vector : ParameterVector
        Meaning of the entries.
    start : Fit or None
        Earlier fit.
    thetas : sequence of (n_changes,) arrays
        Further starts of the uncertain parameters, where `start` has all terms.

    Returns
    -------
    list of (n,) array
        Vectors.
    """
    terms = vector.terms
    known = {} if start is None else {t.label: t for t in start.terms}
    theta = of.screen.theta if start is None else start.theta
    if all(t.label in known for t in terms):
        own = [known[t.label].values for t in terms]
        return _ordered(of, vector, [of.initial(vector, own, x, start) for x in (theta, *thetas)])
    joint = _by_screening(of, vector, start)
    X = np.array([*joint, *_beside_earlier(of, vector, start, known, theta)])
    costs = of.costs(vector, X)
    together, apart = int(np.argmin(costs[: len(joint)])), len(joint) + int(np.argmin(costs[len(joint) :]))
    first = [X[together], X[apart]] if costs[together] <= costs[apart] else [X[apart], X[together]]
    if start is None or start.prior_cost < FIT.distant * vector.r:
        return first
    # far from its priors the other fit has absorbed the missing physics
    own = [known.get(term.label, term).values for term in terms]
    return [*first, of.initial(vector, own, np.zeros_like(theta), start)]


def _by_screening(of: Started, vector: ParameterVector, start: Fit | None) -> list[Array]:
    """Return the joint estimates of the screenings."""
    candidates = [
        Candidate(effect=t.effect, place=t.place, values=dict(t.values), log_likelihood_gain=0.0) for t in vector.terms
    ]
    given = [screen.given(candidates) for screen in (of.screen, *of.screen.slower)]
    return [
        of.initial(vector, values, joint, start)
        for joint, values in (estimate for g in given for estimate in (g.estimate, g.cautious))
    ]


def _beside_earlier(
    of: Started, vector: ParameterVector, start: Fit | None, known: Mapping[str, Term], theta: Array
) -> list[Array]:
    """Return an earlier fit with new terms in several sizes."""
    terms, out = vector.terms, []
    for size in FIT.beside:
        small = [{p.name: t.values[p.name] * size for p in t.effect.amplitudes} for t in terms]
        own = [
            known[t.label].values if t.label in known else {**t.values, **less}
            for t, less in zip(terms, small, strict=True)
        ]
        out.append(of.initial(vector, own, theta, start))
    natural = [known.get(term.label, of_element(term)) for term in terms]
    if any(there is not here for there, here in zip(natural, terms, strict=True)):
        out.append(of.initial(vector, [t.values for t in natural], theta, start))
    return out


def _ordered(of: Started, vector: ParameterVector, starts: list[Array]) -> list[Array]:
    """Return starts in order of cost; with a law the best alone."""
    if len(starts) == 1:
        return starts
    costs = of.costs(vector, np.array(starts))
    return [starts[i] for i in np.argsort(costs, kind="stable")][: 1 if vector.terms else None]
