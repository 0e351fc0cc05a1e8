"""Trials of extended models on hold-out recordings."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain, islice

import numpy as np

from vlab.cases.channel_map import Run
from vlab.diagnose.data_findings import DataFindings
from vlab.diagnose.diagnosis import Attempt, Finding
from vlab.diagnose.findings import findings_of_attempt
from vlab.diagnose.inference.evidence import Hypothesis, effective_sample_size
from vlab.diagnose.inference.model_choice import Choice
from vlab.diagnose.inference.prior_check import has_plausible_parameters, is_plausible_beside_noise
from vlab.diagnose.parameters.terms import Fit, Term
from vlab.diagnose.problem import Problem
from vlab.diagnose.search.ablation import ablate
from vlab.diagnose.settings import ATTEMPT, MODEL_CHOICE
from vlab.diagnose.validation.checked import Checked
from vlab.diagnose.validation.gap import total, verifying
from vlab.diagnose.validation.simulation import ExtendedModel, SimulationCache, check, extended, spread_over
from vlab.diagnose.verdict import explains_most, explains_part, follows
from vlab.physics.effect import Effect


@dataclass(frozen=True, kw_only=True, eq=False)
class Trials:
    """Recordings and models for trials of extended models.

    Parameters
    ----------
    problem : Problem
        Problem.
    seen : DataFindings
        Findings from the data alone.
    runs : sequence of Run
        Recordings of the trials.
    before, nominal : ExtendedModel
        Calibrated and nominal model.
    change : callable or None
        Change of every extended model, such as finer steps.
    cache : dict
        Simulations of the calibrated and the nominal model.
    """

    problem: Problem
    seen: DataFindings
    runs: Sequence[Run]
    before: ExtendedModel
    nominal: ExtendedModel
    change: Callable[[ExtendedModel], ExtendedModel] | None = None
    cache: SimulationCache = field(default_factory=dict)

    def with_change(self, change: Callable[[ExtendedModel], ExtendedModel]) -> "Trials":
        """Return the trials with all models changed."""
        return replace(self, before=change(self.before), nominal=change(self.nominal), change=change)

    @cached_property
    def _spread(self) -> list[dict[str, float]]:
        """Spread of the channels of every run over all recordings."""
        everything = [*self.problem.runs, *(run for run in self.runs if run not in self.problem.runs)]
        return [spread_over(everything, run) for run in self.runs]

    def of(self, fit: Fit, terms: Sequence[Finding]) -> Attempt:
        """Return the errors of a fit and the data findings.

        Parameters
        ----------
        fit : Fit
            Fit of the extended model.
        terms : sequence of Finding
            Reported effects of the fit.

        Returns
        -------
        Attempt
            Attempt.
        """
        problem, seen, change = self.problem, self.seen, self.change or _same
        findings = (*seen.of_law(problem), *terms, *seen.of_sensors(problem))
        after = change(seen.on(extended(problem, fit))) if findings else None
        checked = check(
            self.runs,
            self.before,
            after,
            seen.benign_interferences,
            nominal=self.nominal,
            ablations=ablate(problem, fit, seen, findings).changed(change),
            horizon_s=problem.horizon_s,
            band_hz=problem.model_kind.predicted_band(problem.highest_hz),
            cache=self.cache,
        )
        own = (replace(c, spread=s) for c, s in zip(checked, self._spread, strict=True))
        return Attempt(findings=findings, fit=fit, checked=tuple(own))

    def on_fitted(self, fit: Fit, findings: Sequence[Finding]) -> tuple[Checked, ...]:
        """Return the errors of a fit on the fitted recordings.

        Parameters
        ----------
        fit : Fit
            Fit of the extended model.
        findings : sequence of Finding
            Reported effects of the fit.

        Returns
        -------
        tuple of Checked
            Errors.
        """
        return replace(self, runs=self.problem.runs).of(fit, findings).checked

    def of_hypothesis(self, hypothesis: Hypothesis, effects: Sequence[Effect]) -> Attempt:
        """Return the errors of an unchosen hypothesis.

        Parameters
        ----------
        hypothesis : Hypothesis
            Hypothesis.
        effects : sequence of Effect
            Candidate effects.

        Returns
        -------
        Attempt
            Attempt.
        """
        whole, idle = hypothesis.long_fit, set(hypothesis.long_fit.unidentified)
        named = zip(whole.terms, whole.nested_model(effects), strict=True)
        identified = tuple(nested for term, nested in named if term.label not in idle)
        fit = replace(whole, terms=identified or whole.nested_model(effects))
        attempt = self.of(fit, findings_of_attempt(hypothesis, fit, self.problem))
        return replace(attempt, hypothesis=_labels(hypothesis.terms))

    def plainest(
        self,
        attempt: Attempt,
        hypotheses: Iterable[Hypothesis],
        refit: Callable[[Sequence[Term], Fit], Fit],
        findings_of: Callable[[Fit], Sequence[Finding]],
        stands: Callable[[Attempt], bool],
    ) -> Attempt:
        """Return the attempt of fewest effects that predicts as well.

        A further effect may fit a mismatch of another cause. Hypotheses without the effect then predict as well after a
        refit. An effect that does nothing in these recordings stays.

        Parameters
        ----------
        attempt : Attempt
            Attempt on these recordings.
        hypotheses : iterable of Hypothesis
            Fitted hypotheses, best first.
        refit : callable
            Returns the final fit of terms from another fit.
        findings_of : callable
            Returns the findings of a fit.
        stands : callable
            Whether an attempt with fewer effects is as good an answer.

        Returns
        -------
        Attempt
            First attempt that `attempt` exceeds by no more than indistinguishable hypotheses differ; otherwise `attempt`.
        """
        tests, sites = verifying(attempt.checked), _sites(attempt.fit.terms)
        is_idle = any(all(part.is_idle for part in parts) for parts in zip(*(c.parts for c in tests), strict=False))
        if is_idle or len(sites) < 2 or len(attempt.checked) != len(self.runs):
            return attempt
        left, noise = total(tests, "after"), total(tests, "noise")
        samples = sum(len(c.measured) for c in tests)
        size = effective_sample_size(min(noise, left) ** 2, max(left**2 - noise**2, 0.0), samples)
        most = left * np.exp(MODEL_CHOICE.alike / size)
        fewer = [h for h in hypotheses if h.terms and _sites(h.terms) < sites]
        for h in sorted(fewer, key=lambda h: len(h.terms))[: ATTEMPT.most_attempts]:
            fit = refit(h.long_fit.terms, attempt.fit)
            other = self.of(fit, findings_of(fit))
            # implausible parameters absorb what the missing effect did
            is_plausible = has_plausible_parameters(fit)
            if is_plausible and total(verifying(other.checked), "after") <= most and stands(other):
                return other
        return attempt

    def probable(
        self,
        attempt: Attempt,
        choice: Choice,
        refit: Callable[[Sequence[Term], Fit], Fit],
        findings_of: Callable[[Fit], Sequence[Finding]],
        stands: Callable[[Attempt], bool],
    ) -> Attempt:
        """Return an attempt without effects that hardly any probable hypothesis has.

        Improbable effects leave together if the rest stands, otherwise the least probable ones.

        Parameters
        ----------
        attempt : Attempt
            Attempt on these recordings.
        choice : Choice
            Choice with its ranking.
        refit : callable
            Returns the final fit of terms from another fit.
        findings_of : callable
            Returns the findings of a fit.
        stands : callable
            Whether an attempt with fewer effects may be reported.

        Returns
        -------
        Attempt
            Refitted attempt whose families have more than half of the posterior each, as far as fewer effects stand.
        """
        all_terms = attempt.fit.terms
        shares = [choice.share_of({term.effect.family}) for term in all_terms]
        improbable = [k for k in np.argsort(shares, kind="stable") if shares[k] <= 0.5 and shares[k] < max(shares)]
        for count in range(len(improbable), 0, -1):
            terms = [term for k, term in enumerate(all_terms) if k not in improbable[:count]]
            fit = refit(terms, attempt.fit)
            fewer = self.of(fit, findings_of(fit))
            if stands(fewer):
                return fewer
        return attempt


def leaves_noise(
    problem: Problem, seen: DataFindings, holdouts: Sequence[Run], nominal: ExtendedModel, fit: Fit
) -> bool:
    """Return whether a calibrated model explains all recordings but for noise of any colour.

    Parameters
    ----------
    problem : Problem
        Problem with the fitted recordings.
    seen : DataFindings
        Findings from the data alone.
    holdouts : sequence of Run
        Hold-out recordings.
    nominal : ExtendedModel
        Nominal model.
    fit : Fit
        Fit of the calibrated model.

    Returns
    -------
    bool
        False beside implausible parameters or findings from the data alone, too.
    """
    if seen.is_missing or not is_plausible_beside_noise(fit):
        return False
    trials = Trials(problem=problem, seen=seen, runs=holdouts, before=extended(problem, fit), nominal=nominal)
    errors = (trials.on_fitted(fit, ()), trials.of(fit, ()).checked if holdouts else ())
    return all(follows(checked, model_kind=problem.model_kind, is_plausible=True) for checked in errors if checked)


def without_useless(
    attempt: Attempt, first: int, again: Callable[[Fit], Attempt], stands: Callable[[Attempt], bool]
) -> Attempt:
    """Return an attempt without terms that are idle on hold-out data.

    An effect of a fit that does not help to predict other data is dropped (ablation). An idle effect stays, since its
    data cannot refute it.

    Parameters
    ----------
    attempt : Attempt
        Attempt with a part per finding.
    first : int
        Index of the finding of the first term.
    again : callable
        Attempt with a fit of fewer terms.
    stands : callable
        Whether the attempt with fewer terms is as good an answer.

    Returns
    -------
    Attempt
        Attempt with useful and idle terms; `attempt` itself where all terms stay, or fewer do not stand.
    """
    useful = _useful_terms(attempt, first)
    if len(useful) == len(attempt.fit.terms):
        return attempt
    fewer = again(replace(attempt.fit, terms=useful))
    return fewer if stands(fewer) else attempt


def _useful_terms(attempt: Attempt, first: int) -> tuple[Term, ...]:
    """Return the useful and the idle terms, or all terms."""
    kept = []
    for i, term in enumerate(attempt.fit.terms, start=first):
        parts = [(run, run.parts[i]) for run in attempt.checked if len(run.parts) > i and not run.parts[i].is_idle]
        if not parts or sum(part.left**2 - run.after**2 for run, part in parts) > 0.0:
            kept.append(term)
    return tuple(kept) or attempt.fit.terms


def best_attempt(
    first: Attempt,
    others: Iterable[Attempt],
    is_partial: Callable[[Attempt], bool] | None = None,
    errors: dict[frozenset[str], float] | None = None,
) -> Attempt | None:
    """Return the attempt that explains most, or else a part.

    Of the attempts that hold-out data do not refute, at most `ATTEMPT.most_attempts` follow the first one.

    Parameters
    ----------
    first : Attempt
        Attempt with the chosen hypothesis.
    others : iterable of Attempt
        Lazily evaluated attempts with other hypotheses, best first.
    is_partial : callable or None
        Whether an attempt may be reported as a partial explanation; `explains_part` by default.
    errors : dict of frozenset of str to float, optional
        Extended by the hold-out error of every attempt, before the next attempt is judged: by the labels of its hypothesis,
        and infinite where the data refute it.

    Returns
    -------
    Attempt or None
        Best attempt; None where all diverge.
    """
    is_partial = is_partial or (lambda attempt: explains_part(attempt.checked))
    errors = {} if errors is None else errors
    tried: list[Attempt] = []
    left = ATTEMPT.most_attempts + 1
    for attempt in chain([first] if first.findings else [], islice(others, left + MODEL_CHOICE.ranked)):
        is_out = _is_refuted(attempt)
        tried.append(attempt)
        errors.clear()  # the recordings that all are tried on may have become fewer
        errors.update(_errors_where_they_act(tried))
        left -= not is_out
        if left == 0 or (is_partial(attempt) and explains_most(attempt.checked)):
            break
    parts = [attempt for attempt in tried if is_partial(attempt)]  # more is known now
    most = [attempt for attempt in parts if explains_most(attempt.checked)]
    return next(chain(most, parts, (attempt for attempt in tried if attempt.holds)), None)


def _errors_where_they_act(attempts: Sequence[Attempt]) -> dict[frozenset[str], float]:
    """Return the errors of attempts on the same recordings.

    The error is infinite where data refute an attempt. Attempts that act in no recording have no entry. A recording counts
    if all others are tried on it, and one acts there.
    """
    acting = [attempt for attempt in attempts if any(not c.is_idle for c in attempt.checked)]
    if not acting:
        return {}
    common = set.intersection(*({c.name for c in attempt.checked} for attempt in acting))
    shown = common & {c.name for attempt in acting for c in attempt.checked if not c.is_idle}

    def error(attempt: Attempt) -> float:
        return np.inf if _is_refuted(attempt) else total([c for c in attempt.checked if c.name in shown], "after")

    compared = acting if shown else [attempt for attempt in acting if _is_refuted(attempt)]
    return {attempt.hypothesis or _labels(attempt.fit.terms): error(attempt) for attempt in compared}


def further_attempts(
    first: Attempt, hypotheses: Iterable[Hypothesis], attempt_of: Callable[[Hypothesis], Attempt]
) -> Iterator[Attempt]:
    """Yield attempts with other hypotheses.

    Where hold-out data refute a set of effects, one effect of the set may fit a mismatch of another cause. Hypotheses
    with fewer effects of the set come first then. An effect that is refuted alone only imitates the cause, so hypotheses
    without it come before those with it.

    Parameters
    ----------
    first : Attempt
        Attempt with the chosen hypothesis.
    hypotheses : iterable of Hypothesis
        Other hypotheses, best first.
    attempt_of : callable
        Returns the attempt with a hypothesis.

    Yields
    ------
    Attempt
        Attempts in the order of trial.
    """
    left, attempt = [h for h in hypotheses if h.terms], first
    refuted: list[frozenset[str]] = []
    while left:
        refuted += [_labels(attempt.fit.terms)] if _is_refuted(attempt) else []
        alone = set().union(*(known for known in refuted if len(known) == 1))
        parts = [h for h in left if any(_labels(h.terms) < known for known in refuted)]
        others = [h for h in left if not _labels(h.terms) & alone]
        tried = (parts or others or left)[0]
        left.remove(tried)
        attempt = attempt_of(tried)
        yield attempt


def _labels(terms: Sequence[Term]) -> frozenset[str]:
    """Return the labels of effects."""
    return frozenset(term.label for term in terms)


def _is_refuted(attempt: Attempt) -> bool:
    """Return whether effects improve no prediction of hold-out data in which they act."""
    tests = [c for c in attempt.checked if not c.is_idle]
    return bool(attempt.fit.terms and tests) and not total(tests, "after") < total(tests, "start")


def is_better_table(table: Attempt, attempt: Attempt | None) -> bool:
    """Return whether a tabulated force stands for an unknown law.

    Parameters
    ----------
    table : Attempt
        Attempt with a tabulated force.
    attempt : Attempt or None
        Best attempt with effects of the catalogue.

    Returns
    -------
    bool
        Whether the table explains most with plausible parameters, and predicts better than the attempt.
    """
    known = np.inf if attempt is None else total(attempt.checked, "after")
    explains = explains_most(table.checked) and has_plausible_parameters(table.fit)
    return explains and total(table.checked, "after") < known


def _sites(terms: Sequence[Term]) -> set[tuple[str, str]]:
    """Return family and location of terms."""
    return {(term.effect.family, term.place.name) for term in terms}


def _same(model: ExtendedModel) -> ExtendedModel:
    return model
