"""Choice among hypotheses: number of effects, effect class, location and probability."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import stats

from vlab.diagnose.inference.evidence import Found, Hypothesis
from vlab.diagnose.parameters.terms import Fit
from vlab.diagnose.settings import EVIDENCE, INTERFERENCE, MODEL_CHOICE, VERDICT


@dataclass(frozen=True, kw_only=True, eq=False)
class Choice:
    """Choice on the fitted recordings.

    Parameters
    ----------
    best : Hypothesis
        Chosen hypothesis; `Found.before` where nothing is missing.
    alike : tuple of Hypothesis
        Indistinguishable hypotheses, the best included.
    probability : float
        Posterior probability of the best effects at any location [1].
    ranking : tuple of (Hypothesis, float)
        Other hypotheses with probabilities, best first.
    places : dict
        Posterior probability of every location of the first effect.
    shares : mapping of str to float
        Marginal probability of each of the best effects.
    gained : float
        Log posterior gain over the calibrated model beyond the threshold [nat].
    is_prior_driven : bool
        Whether the gain is mostly prior density of the uncertain parameters, or their prior density alone is enough.
    reserve : float
        Probability of physics outside the catalogue beside those of the hypotheses, once some are refuted [1].
    """

    best: Hypothesis
    alike: tuple[Hypothesis, ...]
    probability: float
    ranking: tuple[tuple[Hypothesis, float], ...]
    places: dict[str, float]
    shares: Mapping[str, float] = field(default_factory=dict)
    gained: float = 0.0
    is_prior_driven: bool = False
    reserve: float = 0.0

    @property
    def tried(self) -> tuple[tuple[Hypothesis, float], ...]:
        """All hypotheses with probabilities, the chosen one first."""
        return ((self.best, self.probability), *self.ranking) if self.best.terms else self.ranking

    def share_of(self, families: Collection[str]) -> float:
        """Return the posterior share of some families among all fitted effects.

        Parameters
        ----------
        families : collection of str
            Families of one hypothesis.

        Returns
        -------
        float
            Share of the hypotheses with an effect of one of the families [1].
        """
        shares = [(p, any(t.effect.family in families for t in h.terms)) for h, p in self.tried if h.terms]
        return sum(p for p, is_own in shares if is_own) / max(sum(p for p, _ in shares), 1e-300)

    def given_predictions(self, errors: Mapping[frozenset[str], float]) -> "Choice":
        """Return the choice after the prediction of hold-out data.

        Hold-out data weigh the hypotheses by their likelihood, at the effective sample size of model error. A hypothesis that
        was not tried on them counts as the best one that was.

        Parameters
        ----------
        errors : mapping of frozenset of str to float
            Relative error on hold-out data by the labels of each tried hypothesis; infinite where the data refute it.

        Returns
        -------
        Choice
            Choice in which refuted hypotheses have no probability, and worse ones are not indistinguishable.
        """
        tried = [error for error in errors.values() if np.isfinite(error)]
        least = max(min(tried, default=1.0), float(np.finfo(float).tiny))

        def weight(h: Hypothesis) -> float:
            error = errors.get(frozenset(t.label for t in h.terms), least)
            return float((least / max(error, least)) ** EVIDENCE.model_error_samples)  # 0 if refuted

        return replace(
            self,
            alike=tuple(h for h in self.alike if weight(h) > np.exp(-MODEL_CHOICE.alike)),
            probability=self.probability * weight(self.best),
            ranking=tuple((h, p * weight(h)) for h, p in self.ranking),
            reserve=MODEL_CHOICE.lapse if np.inf in errors.values() else self.reserve,
        )


def is_prior_driven(more: Hypothesis, less: Hypothesis) -> bool:
    """Return whether a gain is mostly prior density, beyond chance.

    Parameters
    ----------
    more, less : Hypothesis
        Hypotheses with and without the gain.

    Returns
    -------
    bool
        Whether the prior gain exceeds the likelihood gain, and what the largest of all parameters has by chance.
    """
    gain = less.negative_log_prior - more.negative_log_prior
    likelihood = more.effective_samples * (less.log_rms_residual - more.log_rms_residual)
    return gain > max(likelihood, _gain_by_chance(less.fit))


def _gain_by_chance(fit: Fit) -> float:
    """Return the prior gain that the largest of many deviations has by chance [nat].

    The deviations are standard normal in as many directions as the recordings inform. The largest one exceeds the quantile
    with the false-alarm rate (Bonferroni).
    """
    directions = max(float(np.sum(fit.information)), 1.0)
    return 0.5 * float(stats.norm.isf(0.5 * VERDICT.false_alarm_rate / directions)) ** 2


def is_plausible_alone(more: Hypothesis, less: Hypothesis) -> bool:
    """Return whether prior density alone pays for further effects.

    The parameters without the effects are then implausible, however much the residual falls as well.

    Parameters
    ----------
    more, less : Hypothesis
        Hypotheses with and without the effects.

    Returns
    -------
    bool
        Whether the prior gain exceeds the threshold of an effect.
    """
    return less.negative_log_prior - more.negative_log_prior > MODEL_CHOICE.beyond_prior


def _excess(hypothesis: Hypothesis) -> float:
    return max(hypothesis.normalised_residual**2 - 1.0, 0.0)


def gain_beyond(more: Hypothesis, less: Hypothesis) -> float:
    """Return the gain of further effects beyond the threshold.

    Parameters
    ----------
    more, less : Hypothesis
        Hypotheses with and without the further effects.

    Returns
    -------
    float
        Log posterior gain beyond the threshold [nat].
    """
    if any(
        _is_mains_frequency(t.values["frequency"])
        for t in more.terms
        if t.effect.name in ("sinusoidal-force", "mains-hum")
    ):
        return -np.inf
    known = {t.label for t in less.terms}
    added = [t for t in more.terms if t.label not in known]
    count = sum(len(t.effect.parameters) for t in added)
    # a nonlinear law may absorb errors of the model, but prior density beyond chance comes from none
    is_plain = all(t.effect.is_linear or t.effect.traits.is_linear for t in added) or is_prior_driven(more, less)
    enough = (MODEL_CHOICE.of_linear if is_plain else MODEL_CHOICE.beyond_prior) + 2.0 * max(count - 1, 0)
    enough += MODEL_CHOICE.of_pairs if len(added) > 1 else 0.0
    return more.score - less.score + more.complexity - less.complexity - enough


def _is_mains_frequency(frequency: float) -> bool:
    return any(
        abs(frequency - k * mains) < MODEL_CHOICE.near_mains
        for mains in INTERFERENCE.mains_hz
        for k in INTERFERENCE.harmonics
    )


def choose_model(found: Found) -> Choice:
    """Choose the hypothesis with the fewest sufficient effects.

    Parameters
    ----------
    found : Found
        Result of a search.

    Returns
    -------
    Choice
        Choice.
    """
    before, singles = found.before, [h for h in found.hypotheses if len(h.terms) == 1]
    doubles = [h for h in found.hypotheses if len(h.terms) == 2]
    best = before
    if singles:
        one = singles[0]
        explains = before.normalised_residual > MODEL_CHOICE.above_noise and _excess(before) - _excess(
            one
        ) >= MODEL_CHOICE.explained * _excess(before)
        if explains or gain_beyond(one, before) > 0:
            best = one
    if best is not before and doubles:
        two = doubles[0]
        gained = _excess(one) - _excess(two)
        first_is_enough = one.normalised_residual <= MODEL_CHOICE.above_noise
        explains = gained >= MODEL_CHOICE.explained * _excess(one) and gained >= MODEL_CHOICE.second_share * _excess(
            before
        )
        if (explains and not first_is_enough) or gain_beyond(two, one) > 0:
            best = two
        best = _with_more_effects(found, best)
    elif (
        doubles and before.normalised_residual > MODEL_CHOICE.above_noise
    ):  # one of two effects alone may explain nothing
        two = doubles[0]
        if _excess(before) - _excess(two) >= MODEL_CHOICE.together * _excess(before) and gain_beyond(two, before) > 0:
            best = two
    best = _with_one_law(found, best)
    if best is before:
        return Choice(best=before, alike=(), probability=1.0, ranking=_ranking(found, before), places={})
    same = [h for h in found.hypotheses if len(h.terms) == len(best.terms)]
    alike = tuple(h for h in same if h.score >= best.score - MODEL_CHOICE.alike)
    probability, ranking = _probabilities(found, best)
    options = [(best, probability), *ranking]
    return Choice(
        best=best,
        alike=alike,
        probability=probability,
        ranking=ranking,
        places=_places(found, best),
        shares={name: sum(p for h, p in options if name in _names(h)) for name in _names(best)},
        gained=gain_beyond(best, before),
        is_prior_driven=is_prior_driven(best, before) or is_plausible_alone(best, before),
    )


def _with_one_law(found: Found, best: Hypothesis) -> Hypothesis:
    """Return laws of one family at many locations, where the laws pay.

    No hypothesis with one effect less leads to such laws, and the best one may consist of other effects. Both count from
    the calibrated model. The forms of the laws may differ, as friction with and without a smooth transition does.
    """
    laws = [
        h for h in found.hypotheses if len(h.terms) > len(best.terms) and len({t.effect.family for t in h.terms}) == 1
    ]
    gained = 0.0 if best is found.before else max(gain_beyond(best, found.before), 0.0)
    if not laws or gain_beyond(laws[0], found.before) <= gained:
        return best
    return _with_more_effects(found, laws[0])


def _with_more_effects(found: Found, best: Hypothesis) -> Hypothesis:
    """Return the largest hypothesis whose every further effect pays."""
    while True:
        larger = [h for h in found.hypotheses if len(h.terms) == len(best.terms) + 1 and len(h.terms) > 2]
        if not larger or gain_beyond(larger[0], best) <= 0.0:
            return best
        best = larger[0]


def _shares(hypotheses: Sequence[Hypothesis]) -> list[float]:
    """Return the relative probabilities of hypotheses from their scores."""
    scores = np.array([h.score for h in hypotheses])
    weights = np.exp(scores - scores.max())
    return [float(w) for w in weights / weights.sum()]


def _names(hypothesis: Hypothesis) -> tuple[str, ...]:
    return tuple(sorted(t.effect.physics for t in hypothesis.terms))


def _probabilities(found: Found, best: Hypothesis) -> tuple[float, tuple[tuple[Hypothesis, float], ...]]:
    """Return the probability of the best effects, and the ranking of others.

    All have the same number of effects.
    """
    same = [h for h in found.hypotheses if len(h.terms) == len(best.terms)]
    by_effect: dict[tuple[str, ...], Hypothesis] = {}
    for h in [best, *sorted(same, key=lambda h: -h.score)]:
        by_effect.setdefault(_names(h), h)
    options = [*by_effect.values(), found.before]
    weights = [(1.0 - MODEL_CHOICE.lapse) * weight for weight in _shares(options)]
    ranking = sorted(zip(options[1:], weights[1:], strict=True), key=lambda pair: -pair[1])
    return weights[0], tuple(ranking)


def _ranking(found: Found, best: Hypothesis) -> tuple[tuple[Hypothesis, float], ...]:
    options = [best, *found.hypotheses[: MODEL_CHOICE.ranked]]
    weights = _shares(options)
    return tuple(zip(options[1:], weights[1:], strict=True))


def _places(found: Found, best: Hypothesis) -> dict[str, float]:
    first = best.terms[0].place.name
    options = {k: h for k, h in found.places.items() if _names(h) == _names(best)} or {first: best}
    weights = _shares(list(options.values()))
    return dict(sorted(zip(options, weights, strict=True), key=lambda pair: -pair[1]))
