"""Hypotheses, their scores, and what every search leaves to choose from."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from vlab.diagnose.parameters.terms import Fit, Term
from vlab.diagnose.settings import EVIDENCE


@dataclass(frozen=True, kw_only=True, eq=False)
class Hypothesis:
    """A fitted set of effects.

    Parameters
    ----------
    fit : Fit
        In windows, where there are any.
    level : float
        Root mean square of the remaining difference over the noise.
    misfit : float
        Logarithm of the level, or of what noise alone leaves where it is below that.
    price : float
        What the uncertain parameters are less likely than their priors' means, as a logarithm, and what the search costs.
    worth : float
        Independent values that the misfit counts as.
    gain : float
        Log-likelihood gained in the screening.
    whole : Fit or None
        Over whole runs, where it was fitted to them.
    """

    fit: Fit
    normalised_residual: float
    log_rms_residual: float
    negative_log_prior: float
    effective_samples: float = EVIDENCE.model_error_samples
    log_likelihood_gain: float = 0.0
    whole: Fit | None = None

    @property
    def score(self) -> float:
        """Log evidence by Schwarz's approximation; larger is better."""
        return float(-self.effective_samples * self.log_rms_residual - self.negative_log_prior - self.complexity)

    @property
    def complexity(self) -> float:
        """What its effects' parameters cost: each the logarithm of how many values of it the data tell apart, or that there are."""
        told = 0.5 * float(np.log(self.effective_samples))
        parameters = [p for t in self.terms for p in t.effect.parameters]
        return sum(min(told, float(np.log(len(p.grid)))) if p.grain else told for p in parameters)

    @property
    def long_fit(self) -> Fit:
        """The fit over the longest stretches that there is."""
        return self.fit if self.whole is None else self.whole

    @property
    def prior_departure(self) -> float:
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


def scored(
    fit: Fit,
    samples: float,
    effective_samples: float,
    log_likelihood_gain: float = 0.0,
    tried: int = 1,
    floor: float = 1.0,
) -> Hypothesis:
    """Return a fit as a hypothesis with its score, all that it leaves taken for the model's own error.

    Parameters
    ----------
    samples : float
        Values that its cost sums over.
    worth : float
        Of how many independent values the data hold.
    tried : int
        Among how many effects at places every one of its effects was picked: it pays for that.
    floor : float
        Level that noise alone leaves.
    """
    normalised_residual = float(np.sqrt(fit.cost / samples))
    return Hypothesis(
        fit=fit,
        normalised_residual=normalised_residual,
        log_rms_residual=float(np.log(max(normalised_residual, floor))),
        negative_log_prior=0.5 * (fit.chi2 - fit.cost)
        + len(fit.terms) * float(np.log(max(tried, 1)))
        + _implausible(fit),
        effective_samples=min(effective_samples, EVIDENCE.model_error_samples),
        log_likelihood_gain=log_likelihood_gain,
    )


def _implausible(fit: Fit) -> float:
    """Return the logarithm of the odds against the effects of a fit before anything was recorded: a spring that is nonlinear about
    no rest position, or pushes away from none, bends to whatever friction and drift leave of a free motion; and where one drive alone
    comes to its limit, all of them may have the same."""
    free_starts = sum(t.effect.needs_rest and not t.place.is_held for t in fit.terms)
    alike = sum(bool(t.place.also) and t.effect.traits.is_usually_single for t in fit.terms)
    return EVIDENCE.unheld * free_starts + EVIDENCE.all_alike * alike


def effective_sample_size(noise: float, error: float, samples: float) -> float:
    """Return as how many independent values recordings count whose noise averages out and whose model's own error does not.

    With noise of variance f and an error of the model of variance m spread over `EVIDENCE.model_error_samples` directions, the log-likelihood that a
    smaller difference gains is its decrease over twice f/n + m/`EVIDENCE.model_error_samples`, n the samples.

    Parameters
    ----------
    noise, error : float
        The variances, in the same unit.
    samples : float
        Independent values that the recordings hold.
    """
    return float((noise + error) / (noise / samples + error / EVIDENCE.model_error_samples))


def weighed(
    hypotheses: Sequence[Hypothesis], noise: float, error: float, samples: float, least_error: float = 0.0
) -> list[Hypothesis]:
    """Return hypotheses with what they leave taken as noise as far as it can be noise, and the rest as the model's own error.

    So all samples count where noise is all that the best hypothesis leaves, and no more than `EVIDENCE.model_error_samples` where the model's error is;
    see `effective_sample_size`.

    Parameters
    ----------
    noise : float
        Share of the noise in the variance that levels are counted in.
    error : float
        The same of the model's own error, at least.
    samples : float
        Independent values that the recordings hold.
    least_error : float
        Variance of what integration alone leaves: to leave less than noise and that is no merit.
    """
    if not hypotheses or samples <= EVIDENCE.model_error_samples:
        return list(hypotheses)
    least = min(h.normalised_residual for h in hypotheses)
    error = max(error, least**2 - (1.0 + EVIDENCE.noise_known) * noise)
    effective_samples = effective_sample_size(noise, error, samples)
    floor = 0.5 * float(np.log(max(noise + least_error, 1e-300))) if least_error else -np.inf
    return [
        replace(h, effective_samples=float(effective_samples), log_rms_residual=max(h.log_rms_residual, floor))
        for h in hypotheses
    ]


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
