"""Confirmation of the choice in MuJoCo."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from vlab.diagnose.data_findings import DataFindings
from vlab.diagnose.inference.calibration import calibrate
from vlab.diagnose.inference.evidence import Hypothesis
from vlab.diagnose.inference.hypothesis_fits import by_score, scored_by
from vlab.diagnose.inference.least_squares import LeastSquares
from vlab.diagnose.inference.model_choice import Choice, choose_model, is_prior_driven
from vlab.diagnose.inference.simulator_least_squares import SimulatorLeastSquares
from vlab.diagnose.parameters.terms import Fit, Term
from vlab.diagnose.problem import Problem
from vlab.diagnose.search.final_fit import final_fit, loudest_and_quietest
from vlab.diagnose.search.selection import TimeFound
from vlab.diagnose.settings import CONFIRMATION, FIT, GAP, MODEL_CHOICE, VERDICT
from vlab.diagnose.validation.gap import gap_closed, total
from vlab.diagnose.validation.simulation import ExtendedModel, check, extended
from vlab.diagnose.verdict import errors_of
from vlab.physics.effect import Effect


@dataclass(frozen=True, kw_only=True, eq=False)
class Confirmed:
    """Confirmed choice with final fits and notes.

    Parameters
    ----------
    choice : Choice
        Choice.
    before, after : Fit
        Final fits of calibrated and extended model.
    rejected : tuple of str
        Notes on rejected hypotheses.
    """

    choice: Choice
    before: Fit
    after: Fit
    rejected: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class Confirmation:
    """Models and data for the confirmation of a choice.

    Parameters
    ----------
    problem : Problem
        Problem.
    whole : LeastSquares
        Fits to whole runs.
    start : Fit
        Fit without effects.
    seen : DataFindings
        Findings from the data alone.
    effects : sequence of Effect
        Candidate effects.
    is_linear : bool
        Whether the search used the linear time-invariant class.
    """

    problem: Problem
    whole: LeastSquares
    start: Fit
    seen: DataFindings
    effects: Sequence[Effect]
    is_linear: bool

    def confirm(self, found: TimeFound) -> Confirmed:
        """Return the best hypothesis that MuJoCo confirms on fitted recordings.

        A law fitted on the reduced model may diverge in MuJoCo, or deform the model beyond its modes. The next
        hypothesis follows then. Without any confirmation the best hypothesis remains.

        Parameters
        ----------
        found : TimeFound
            Result of the search.

        Returns
        -------
        Confirmed
            Confirmed choice.
        """
        return self._or_rival(found, self._first_confirmed(found))

    def _first_confirmed(self, found: TimeFound) -> Confirmed:
        """Return the first hypothesis by score that MuJoCo confirms."""
        first: Confirmed | None = None
        rejected: list[tuple[str, str]] = []
        simplified: set[str] = set()
        unconfirmed = 0
        while unconfirmed < CONFIRMATION.most_tried:
            choice = choose_model(found)
            best = choice.best
            before = after = self._plain_in_mujoco if self.is_linear and not best.terms else self._plain
            if best.terms:
                on_reduced_model = self._exactly(best)
                if on_reduced_model.unidentified:
                    rejected.append(
                        (best.label, f"of {', '.join(on_reduced_model.unidentified)} the last fit leaves nothing")
                    )
                    rest = [t for t in on_reduced_model.terms if t.label not in on_reduced_model.unidentified]
                    found = self._with(_without(found, best, on_reduced_model.unidentified), rest, on_reduced_model)
                    continue
                simpler = self._simpler(found, best, on_reduced_model) if best.label not in simplified else found
                simplified.add(best.label)
                if simpler is not found:
                    found = simpler
                    continue
                after = (
                    final_fit(self.problem, self.whole, on_reduced_model, self.seen.limit)
                    if self.is_linear
                    else on_reduced_model
                )
                if (
                    after is not on_reduced_model
                ):  # a law that carries over to MuJoCo unchanged keeps the uncertain parameters
                    before = self._plain_in_mujoco
            confirmed = Confirmed(choice=choice, before=before, after=after, rejected=_dropped(rejected))
            first = first or confirmed
            if not best.terms:
                break
            if not self.is_linear or self._is_confirmed(confirmed):
                return self._with_fewer(found, confirmed)
            rejected.append((best.label, "its law fits in the reduced model, but not in MuJoCo"))
            found = _without(found, best)
            unconfirmed += 1
        assert first is not None
        # without confirmation the first hypothesis is reported, so it was not rejected
        label = first.choice.best.label
        return replace(first, rejected=_dropped([(name, why) for name, why in rejected if name != label]))

    @cached_property
    def _plain(self) -> Fit:
        """Calibrated model, linearised at its own parameters."""
        fit = self.whole.fit((), self.start)
        if not isinstance(self.whole, SimulatorLeastSquares):
            return fit
        return calibrate(self.whole.moving, fit)[1] or fit

    @cached_property
    def _plain_in_mujoco(self) -> Fit:
        return final_fit(self.problem, self.whole, self._plain, self.seen.limit)

    def _exactly(self, best: Hypothesis) -> Fit:
        """Return the converged fit of a hypothesis.

        A comparison needs less convergence than a parameter value.
        """
        iterations = FIT.iterations if self.is_linear else CONFIRMATION.steps_along_motion
        return self.whole.fit(best.terms, best.long_fit, iterations, tolerance=FIT.exact)

    def _simpler(self, found: TimeFound, best: Hypothesis, fit: Fit) -> TimeFound:
        """Return the result with an indistinguishable nested law.

        The nested law replaces an indistinguishable hypothesis. Otherwise the law with vanishing parts joins the
        hypotheses, for the choice by score.
        """
        lesser = fit.nested_model(self.effects)
        options = [(lesser, FIT.iterations)] if lesser != fit.terms else []
        was = scored_by(self.whole, fit)
        for terms, iterations in [*options, *((terms, 0) for terms in fit.nested(self.effects))]:
            plain = self.whole.fit(terms, fit, iterations)
            now = scored_by(self.whole, plain)
            if best.effective_samples * (now.log_rms_residual - was.log_rms_residual) < MODEL_CHOICE.alike:
                own = replace(
                    best,
                    fit=plain,
                    whole=plain,
                    log_rms_residual=best.log_rms_residual + now.log_rms_residual - was.log_rms_residual,
                    negative_log_prior=now.negative_log_prior,
                    normalised_residual=best.normalised_residual * now.normalised_residual / was.normalised_residual,
                )
                alike = [h for h in found.hypotheses if h.label == own.label]
                return _instead(found, by_score([own], alike)[0], [best, *alike])
        return self._with(found, lesser, fit) if options else found

    def _with(self, found: TimeFound, terms: Sequence[Term], start: Fit) -> TimeFound:
        """Return the result with effects fitted from another fit, where better."""
        if not terms:
            return found
        fit = self.whole.fit(terms, start, FIT.iterations)
        own = replace(scored_by(self.whole, fit), whole=fit, effective_samples=found.before.effective_samples)
        worse = [h for h in found.hypotheses if h.label == own.label]
        return found if any(h.score >= own.score for h in worse) else _instead(found, own, worse)

    def _with_fewer(self, found: TimeFound, confirmed: Confirmed) -> Confirmed:
        """Return the confirmation with one effect instead of several.

        One effect suffices where MuJoCo's error is no worse: the others then compensate the reduced model's error. The
        one effect is the most probable alone, which need not be among the several.
        """
        both = confirmed.choice.best
        if len(both.terms) < 2:
            return confirmed
        alone = replace(found, hypotheses=tuple(h for h in found.hypotheses if len(h.terms) == 1))
        single = choose_model(alone).best
        if not single.terms:
            return confirmed
        if not self.problem.model_kind.has_mesh_error and is_prior_driven(both, single):
            return confirmed  # one effect suffices with implausible parameters only
        one = self._first_confirmed(alone)
        error = self._error(one)
        if not (np.isfinite(error) and error <= GAP.no_worse * self._error(confirmed)):
            return confirmed
        why = f"the residual in MuJoCo is as small with {one.choice.best.label} alone"
        return replace(one, rejected=(*confirmed.rejected, *_dropped([(both.label, why)])))

    def _or_rival(self, found: TimeFound, confirmed: Confirmed) -> Confirmed:
        """Return the confirmation of the better of two rivals.

        The rival is the most probable effect of other physics, and MuJoCo must follow the recordings better with the
        rival. The linearisation along a motion errs most for large effects. Where a fit leaves more than noise, this
        error ranks the effects as much as their laws do.
        """
        best = confirmed.choice.best
        if self.is_linear or len(best.terms) != 1 or best.normalised_residual <= MODEL_CHOICE.above_noise:
            return confirmed
        physics = best.terms[0].effect.physics
        others = (h for h in found.hypotheses if len(h.terms) == 1 and h.terms[0].effect.physics != physics)
        rival = self._first_confirmed(replace(found, hypotheses=tuple(others)))
        if not rival.choice.best.terms or not GAP.no_worse * self._error(rival) < self._error(confirmed):
            return confirmed
        why = f"the residual in MuJoCo is smaller with {rival.choice.best.label}"
        return replace(rival, rejected=(*confirmed.rejected, *_dropped([(best.label, why)])))

    def _is_confirmed(self, confirmed: Confirmed) -> bool:
        """Return whether MuJoCo closes enough of the gap.

        The loudest and the quietest recording are simulated.
        """
        models, hum = self._models(confirmed), self.seen.benign_interferences
        checked = check(loudest_and_quietest(self.problem), *models, hum, horizon_s=self.problem.horizon_s)
        errors = errors_of(checked)
        gap = gap_closed(errors["before"], errors["after"], errors["noise"])
        return gap is None or gap >= VERDICT.least_to_noise

    def _error(self, confirmed: Confirmed) -> float:
        """Return the error of the extended model on the fitted recordings.

        Along a motion the weights are those of the fit. Shares of each recording's rms would let a recording that hardly
        moves decide.
        """
        if isinstance(self.whole, SimulatorLeastSquares):
            return self.whole.residual_in_mujoco(confirmed.after)
        checked = check(self.problem.runs, *self._models(confirmed), horizon_s=self.problem.horizon_s)
        return total(checked, "after")

    def _models(self, confirmed: Confirmed) -> tuple[ExtendedModel, ExtendedModel]:
        """Return calibrated and extended model with data findings."""
        return (
            self.seen.on(extended(self.problem, confirmed.before)),
            self.seen.on(extended(self.problem, confirmed.after)),
        )


def _instead(found: TimeFound, own: Hypothesis, others: Sequence[Hypothesis]) -> TimeFound:
    """Return a result with one hypothesis in place of others."""
    return replace(found, hypotheses=tuple(by_score([own], [h for h in found.hypotheses if h not in others])))


def _without(found: TimeFound, hypothesis: Hypothesis, unidentified: Sequence[str] = ()) -> TimeFound:
    """Return a result without a hypothesis.

    Hypotheses that add an unidentified term to the rest are removed as well.
    """
    rest = {t.label for t in hypothesis.terms} - set(unidentified)

    def stays(h: Hypothesis) -> bool:
        labels = {t.label for t in h.terms}
        return h is not hypothesis and not (unidentified and rest and rest < labels)

    return replace(found, hypotheses=tuple(h for h in found.hypotheses if stays(h)))


def _dropped(rejected: Sequence[tuple[str, str]]) -> tuple[str, ...]:
    """Return notes on rejected hypotheses."""
    return tuple(f"{label}: {why}; dropped" for label, why in rejected)
