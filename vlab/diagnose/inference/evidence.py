"""Hypotheses and their scores.

The score approximates the log evidence (Schwarz 1978): minus effective sample size times log rms residual, minus the
negative log prior, minus half the log of the effective sample size per parameter.

References
----------
G. Schwarz, Estimating the dimension of a model, Ann. Statist. 6 (1978) 461-464.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from vlab.diagnose.parameters.terms import Fit, Term
from vlab.diagnose.settings import EVIDENCE, TRIAL_SCAN
from vlab.physics.effect import Parameter


@dataclass(frozen=True, kw_only=True, eq=False)
class Hypothesis:
    """Fitted set of effects.

    Parameters
    ----------
    fit : Fit
        Fit in windows, or to whole runs without windows.
    normalised_residual : float
        Rms residual over noise and allowed model error.
    log_rms_residual : float
        Log of the normalised residual, at least that of noise alone.
    negative_log_prior : float
        Negative log prior of the uncertain parameters and effects, with the cost of the search [nat].
    effective_samples : float
        Effective sample size of the residual.
    log_likelihood_gain : float
        Log-likelihood gain in the screening [nat].
    whole : Fit or None
        Fit to whole runs, where there is one.
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
        """Approximate log evidence (Schwarz 1978); larger is better."""
        return float(-self.effective_samples * self.log_rms_residual - self.negative_log_prior - self.complexity)

    @property
    def complexity(self) -> float:
        """Log cost of the effects' parameters [nat]."""
        return cost_of_parameters([p for t in self.terms for p in t.effect.parameters], self.effective_samples)

    @property
    def long_fit(self) -> Fit:
        """Fit over the longest available stretches."""
        return self.fit if self.whole is None else self.whole

    @property
    def prior_departure(self) -> float:
        """Negative log prior of the uncertain parameters, relative to the mean [nat]."""
        return 0.5 * self.fit.prior_cost

    @property
    def terms(self) -> tuple[Term, ...]:
        """Effects of the hypothesis."""
        return self.fit.terms

    @property
    def is_one_law(self) -> bool:
        """Whether the effects are one law at several locations."""
        return len(self.terms) > 1 and len({term.effect.name for term in self.terms}) == 1

    @property
    def label(self) -> str:
        """Effects and locations in one string."""
        return " + ".join(t.label for t in self.terms) or "nothing"


def scored(
    fit: Fit,
    samples: float,
    effective_samples: float,
    log_likelihood_gain: float = 0.0,
    tried: int = 1,
    floor: float = 1.0,
) -> Hypothesis:
    """Return a fit as a scored hypothesis.

    The whole residual counts as model error.

    Parameters
    ----------
    fit : Fit
        Fit.
    samples : float
        Number of values in the fit's cost.
    effective_samples : float
        Effective sample size of the data.
    log_likelihood_gain : float
        Log-likelihood gain in the screening [nat].
    tried : int
        Number of trials from which every effect was selected, for a correction by its log.
    floor : float
        Normalised residual of noise alone.

    Returns
    -------
    Hypothesis
        Hypothesis.
    """
    normalised_residual = float(np.sqrt(fit.cost / samples))
    return Hypothesis(
        fit=fit,
        normalised_residual=normalised_residual,
        log_rms_residual=float(np.log(max(normalised_residual, floor))),
        negative_log_prior=0.5 * fit.prior_cost + len(fit.terms) * float(np.log(max(tried, 1))) + _implausible(fit),
        effective_samples=min(effective_samples, EVIDENCE.model_error_samples),
        log_likelihood_gain=log_likelihood_gain,
    )


def _implausible(fit: Fit) -> float:
    """Return the negative log prior of a fit's effects [nat].

    A nonlinear or negative spring without rest position absorbs friction and drift of free motion. A limit in all
    drives is less probable than in one.
    """
    free_starts = sum(t.effect.needs_rest and not t.place.is_held for t in fit.terms)
    alike = sum(bool(t.place.also) and t.effect.traits.is_usually_single for t in fit.terms)
    return EVIDENCE.unheld * free_starts + EVIDENCE.all_alike * alike


def cost_of_parameters(parameters: Sequence[Parameter], samples: float = EVIDENCE.model_error_samples) -> float:
    """Return the log cost of effects' parameters in the evidence.

    Every parameter costs half the log of the effective sample size; a discrete one at most the log of its number of values.

    Parameters
    ----------
    parameters : sequence of Parameter
        Parameters of the effects.
    samples : float
        Effective sample size.

    Returns
    -------
    float
        Cost [nat].
    """
    most = 0.5 * float(np.log(samples))
    return sum(min(most, float(np.log(_values_tried(p)))) if p.grain else most for p in parameters)


def _values_tried(parameter: Parameter) -> int:
    """Return the number of values of a discrete parameter."""
    return max(len(parameter.grid), TRIAL_SCAN.most if parameter.scan == "period" else 1)


def effective_sample_size(noise: float, error: float, samples: float) -> float:
    """Return the effective sample size of noise and model error together.

    Noise of variance f averages out over n samples; model error of variance m has N = `EVIDENCE.model_error_samples`
    independent values. The size is (f + m)/(f/n + m/N).

    Parameters
    ----------
    noise, error : float
        Variances f and m, in one unit.
    samples : float
        Independent samples n of the recordings.

    Returns
    -------
    float
        Effective sample size.
    """
    return float((noise + error) / (noise / samples + error / EVIDENCE.model_error_samples))


def weighed(
    hypotheses: Sequence[Hypothesis], noise: float, error: float, samples: float, least_error: float = 0.0
) -> list[Hypothesis]:
    """Return hypotheses with a common effective sample size.

    The residual counts as noise as far as possible, and as model error beyond. All samples count where the best
    hypothesis leaves noise alone.

    Parameters
    ----------
    hypotheses : sequence of Hypothesis
        Hypotheses.
    noise : float
        Variance share of the noise in the normalised residual.
    error : float
        Least variance share of the model error.
    samples : float
        Independent samples of the recordings.
    least_error : float
        Variance share of the integration error, below which a smaller residual gains nothing.

    Returns
    -------
    list of Hypothesis
        Hypotheses.
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
    """Result of a search.

    Parameters
    ----------
    before : Hypothesis
        Calibrated model without effects.
    hypotheses : tuple of Hypothesis
        All fitted hypotheses, best first.
    places : mapping of str to Hypothesis
        Best hypothesis with its first effect at other locations.
    """

    before: Hypothesis
    hypotheses: tuple[Hypothesis, ...]
    places: dict[str, Hypothesis] = field(default_factory=dict)
