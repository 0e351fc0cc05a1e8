"""Trials of extended models on hold-out recordings."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, islice

from vlab.cases.channel_map import Run
from vlab.diagnose.data_findings import DataFindings
from vlab.diagnose.diagnosis import Attempt, Finding
from vlab.diagnose.findings import findings_of_attempt
from vlab.diagnose.inference.evidence import Hypothesis
from vlab.diagnose.parameters.terms import Fit, Term
from vlab.diagnose.problem import Problem
from vlab.diagnose.search.ablation import ablate
from vlab.diagnose.settings import ATTEMPT
from vlab.diagnose.validation.simulation import ExtendedModel, SimulationCache, check, extended
from vlab.diagnose.verdict import explains_most, explains_part
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
            cache=self.cache,
        )
        return Attempt(findings=findings, fit=fit, checked=tuple(checked))

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
        fit = replace(hypothesis.long_fit, terms=hypothesis.long_fit.nested_model(effects))
        return self.of(fit, findings_of_attempt(hypothesis, fit, self.problem))


def without_useless(
    attempt: Attempt, first: int, again: Callable[[Fit], Attempt], stands: Callable[[Attempt], bool]
) -> Attempt:
    """Return an attempt without the terms that do not help on hold-out data.

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
    """Return the useful and the idle terms; all terms where none is useful."""
    kept = []
    for i, term in enumerate(attempt.fit.terms, start=first):
        parts = [(run, run.parts[i]) for run in attempt.checked if len(run.parts) > i and not run.parts[i].is_idle]
        if not parts or sum(part.left**2 - run.after**2 for run, part in parts) > 0.0:
            kept.append(term)
    return tuple(kept) or attempt.fit.terms


def best_attempt(
    first: Attempt, others: Iterable[Attempt], is_partial: Callable[[Attempt], bool] | None = None
) -> Attempt | None:
    """Return the attempt that explains most, else a part, else the best without divergence.

    Parameters
    ----------
    first : Attempt
        Attempt with the chosen hypothesis.
    others : iterable of Attempt
        Lazily evaluated attempts with other hypotheses, best first.
    is_partial : callable or None
        Whether an attempt may be reported as a partial explanation; `explains_part` by default.

    Returns
    -------
    Attempt or None
        Best attempt; None where all diverge.
    """
    is_partial = is_partial or (lambda attempt: explains_part(attempt.checked))
    part = best = None
    for attempt in chain([first] if first.findings else [], islice(others, ATTEMPT.most_attempts)):
        if is_partial(attempt):
            if explains_most(attempt.checked):
                return attempt
            part = part or attempt
        best = best or (attempt if attempt.holds else None)
    return part or best


def _same(model: ExtendedModel) -> ExtendedModel:
    return model
