"""What is added to a model, tried on recordings that were kept aside; the best attempt is kept where it is not reported."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import islice

from vlab.cases.channel_map import Run
from vlab.diagnose.data_findings import DataFindings
from vlab.diagnose.diagnosis import Attempt, Finding
from vlab.diagnose.findings import findings_of_attempt
from vlab.diagnose.inference.evidence import Hypothesis
from vlab.diagnose.parameters.terms import Fit
from vlab.diagnose.problem import Problem
from vlab.diagnose.search.ablation import ablate
from vlab.diagnose.settings import ATTEMPT
from vlab.diagnose.validation.simulation import ExtendedModel, check, extended
from vlab.physics.effect import Effect


@dataclass(frozen=True, kw_only=True, eq=False)
class Trials:
    """The recordings on which what is added to a model is tried, and the models without it.

    Parameters
    ----------
    before, nominal : Amended
        The refitted model, and the model as given.
    change : callable or None
        What is done to every model besides: finer steps.
    """

    problem: Problem
    seen: DataFindings
    runs: Sequence[Run]
    before: ExtendedModel
    nominal: ExtendedModel
    change: Callable[[ExtendedModel], ExtendedModel] | None = None

    def of(self, fit: Fit, terms: Sequence[Finding]) -> Attempt:
        """Return what comes of a fit and of what the recordings show without a model.

        Parameters
        ----------
        terms : sequence of Finding
            The fit's effects as they are reported.
        """
        problem, seen, change = self.problem, self.seen, self.change or _same
        findings = (*seen.of_law(problem), *terms, *seen.of_sensors(problem))
        after = change(seen.on(extended(problem, fit))) if findings else None
        checked = check(
            self.runs,
            change(self.before),
            after,
            seen.benign_interferences,
            nominal=change(self.nominal),
            ablate=ablate(problem, fit, seen, findings).changed(change),
        )
        return Attempt(findings=findings, fit=fit, checked=tuple(checked))

    def of_hypothesis(self, hypothesis: Hypothesis, effects: Sequence[Effect]) -> Attempt:
        """Return what comes of a hypothesis that is not the chosen one, in its plainest form.

        Parameters
        ----------
        effects : sequence of Effect
            What may be missing.
        """
        fit = replace(hypothesis.long_fit, terms=hypothesis.long_fit.nested_model(effects))
        return self.of(fit, findings_of_attempt(hypothesis, fit, self.problem))


def best_attempt(first: Attempt, others: Iterable[Attempt]) -> Attempt | None:
    """Return the best attempt that did not run away; None where there is none.

    Parameters
    ----------
    first : Attempt
        With the chosen hypothesis.
    others : iterable of Attempt
        With other ones, the best first, made when they are asked for.
    """
    if first.findings and first.holds:
        return first
    return next((attempt for attempt in islice(others, ATTEMPT.most_attempts) if attempt.holds), None)


def _same(model: ExtendedModel) -> ExtendedModel:
    return model
