"""Hypotheses, their scores, and what every search leaves to choose from."""

from dataclasses import dataclass, field

import numpy as np

from vlab.diagnose.terms import Fit, Term

WORTH = 40.0
"""Independent samples that a score counts at most. The recordings hold many more, but what a model leaves of them is its own
error, which does not average out: five per cent less of it are odds of e^2, not of e^50."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Hypothesis:
    """A fitted set of effects.

    Parameters
    ----------
    fit : Fit
        In windows, where there are any.
    score : float
        Log evidence by Schwarz's approximation, of at most `WORTH` samples; larger is better.
    level : float
        Root mean square of the remaining difference over the noise.
    gain : float
        Log-likelihood gained in the screening.
    whole : Fit or None
        Over whole runs, where it was fitted to them.
    """

    fit: Fit
    score: float
    level: float
    gain: float = 0.0
    whole: Fit | None = None

    @property
    def long_fit(self) -> Fit:
        """The fit over the longest stretches that there is."""
        return self.fit if self.whole is None else self.whole

    @property
    def calibration(self) -> float:
        """How much less likely its uncertain parameters are than their priors' means, as a logarithm."""
        return 0.5 * (self.fit.chi2 - self.fit.cost)

    @property
    def terms(self) -> tuple[Term, ...]:
        """Its effects."""
        return self.fit.terms

    @property
    def label(self) -> str:
        """Its effects and places in one string."""
        return " + ".join(t.label for t in self.terms) or "nothing"


def scored(fit: Fit, samples: float, worth: float, gain: float = 0.0, tried: int = 1) -> Hypothesis:
    """Return a fit as a hypothesis with its score.

    Parameters
    ----------
    samples : float
        Values that its cost sums over.
    worth : float
        Of how many independent values the data hold.
    tried : int
        Among how many effects at places every one of its effects was picked: it pays for that.
    """
    level = float(np.sqrt(fit.cost / samples))
    count = sum(len(t.effect.parameters) for t in fit.terms)
    counted = min(worth, WORTH)
    score = -counted * np.log(max(level, 1.0)) - 0.5 * (fit.chi2 - fit.cost) - 0.5 * count * np.log(counted)
    return Hypothesis(fit=fit, score=float(score - len(fit.terms) * np.log(max(tried, 1))), level=level, gain=gain)


@dataclass(frozen=True, kw_only=True, eq=False)
class Found:
    """What a search found.

    Parameters
    ----------
    before : Hypothesis
        The same physics with its uncertain parameters refitted.
    hypotheses : tuple of Hypothesis
        All that were fitted, best first, without `before`.
    places : mapping of str to Hypothesis
        The best hypothesis with its first effect at other places, by place.
    """

    before: Hypothesis
    hypotheses: tuple[Hypothesis, ...]
    places: dict[str, Hypothesis] = field(default_factory=dict)
