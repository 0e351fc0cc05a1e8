"""Pipeline of a diagnosis from recordings: preparation, search, confirmation, validation, report."""

import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from vlab.cases.case import Case
from vlab.cases.checks import FileCheck, check_recordings
from vlab.diagnose.advice import (
    coloured_noise_note,
    fit_note,
    idle_note,
    implausible_parameters,
    next_measurement,
    not_excluded,
    notes_on_models,
    residual_note,
    scope_note,
)
from vlab.diagnose.data.quality import assess_quality
from vlab.diagnose.data_findings import look_at_data
from vlab.diagnose.diagnosis import NAMING, Attempt, Diagnosis, Finding, RejectedCase, Verdict, reject_case
from vlab.diagnose.findings import alternatives, by_what_they_explain, findings_of_terms, graded, one_per_law
from vlab.diagnose.frequency_pipeline import FrequencyDiagnosed, diagnose_frequency, is_in_frequency
from vlab.diagnose.inference.model_choice import Choice
from vlab.diagnose.inference.prior_check import has_plausible_parameters, is_plausible_beside_noise
from vlab.diagnose.inference.sensor_offset import find_sensor_offsets
from vlab.diagnose.parameters.holdout import read_holdout
from vlab.diagnose.parameters.locations import check_candidates, limited
from vlab.diagnose.parameters.shared_numbers import with_whole_gains
from vlab.diagnose.parameters.static_offset import StaticOffset, remove_static_offsets
from vlab.diagnose.parameters.terms import Fit
from vlab.diagnose.predictors.recorded_motion import refuse_recorded_contacts
from vlab.diagnose.problem import Problem, model_kind_of
from vlab.diagnose.search.ablation import wrong_offsets
from vlab.diagnose.search.alternative_conventions import choose_convention
from vlab.diagnose.search.attempt import (
    Trials,
    best_attempt,
    further_attempts,
    is_better_table,
    leaves_noise,
    without_useless,
)
from vlab.diagnose.search.confirmation import Confirmation
from vlab.diagnose.search.deadline import Deadline
from vlab.diagnose.search.left_out_recordings import with_left_out
from vlab.diagnose.search.limits import Limits
from vlab.diagnose.search.model_class import choose_model_class
from vlab.diagnose.search.sampling_convention import note_of_conventions
from vlab.diagnose.search.selection import TimeFound
from vlab.diagnose.search.stages import Judged, Searched
from vlab.diagnose.search.unknown_geometry import (
    is_better_with_geometry,
    is_geometry_contradicted,
    may_be_simpler,
    unknown_geometry_note,
    unstated_geometry,
)
from vlab.diagnose.settings import VERDICT
from vlab.diagnose.validation.checked import Checked
from vlab.diagnose.validation.gap import explained_share, total
from vlab.diagnose.validation.mismatch import locate_mismatch
from vlab.diagnose.validation.next_experiment import separate
from vlab.diagnose.validation.simulation import ExtendedModel, check, coarse_steps, extended, with_finer_steps
from vlab.diagnose.verdict import (
    closes_gap,
    decide_verdict,
    explains_most,
    is_needed_beside_data,
    is_partial_explanation,
    is_within_noise,
    unproven_note,
)
from vlab.physics.catalogue import CANDIDATES, last_resort
from vlab.physics.effect import Effect

NO_SENSOR_FAULT = "effects beside sensor faults predict no hold-out recording; effects without sensor faults do"
"""Note on a finding of a search without sensor faults."""

UNKNOWN_LAW = "no effect of the catalogue explains the recordings; a tabulated force at the place does"
"""Note on a finding of last resort."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Diagnosed:
    """Diagnosis with its models.

    Parameters
    ----------
    diagnosis : Diagnosis
        Result.
    problem : Problem
        Inverse problem.
    found : TimeFound
        Hypotheses of the search.
    choice : Choice
        Chosen hypothesis.
    before, after : ExtendedModel
        Calibrated and extended model; equal without findings.
    fit : Fit
        Fit of the extended model.
    """

    diagnosis: Diagnosis
    problem: Problem
    found: TimeFound
    choice: Choice
    before: ExtendedModel
    after: ExtendedModel
    fit: Fit


def diagnose(
    case: Case,
    *,
    effects: Sequence[Effect] = (),
    at: Collection[str] = (),
    progress: Callable[[float, str], None] | None = None,
    time_limit: float | None = None,
) -> Diagnosed | FrequencyDiagnosed | RejectedCase:
    """Diagnose a case.

    Contradictory files are rejected before any search. A case of responses and modal tables alone is diagnosed in
    frequency.

    Parameters
    ----------
    case : Case
        Case.
    effects : sequence of Effect
        Candidate effects; the catalogue by default.
    at : collection of str
        Places at which effects are sought, with or without their kind; all places by default.
    progress : callable or None
        Receives the completed share and the current step.
    time_limit : float or None
        Duration [s] after which no further effects are added; the best hypothesis so far is then confirmed and validated.
        Responses and modal tables have no limit.

    Returns
    -------
    Diagnosed or FrequencyDiagnosed or RejectedCase
        Diagnosis.

    Raises
    ------
    BadCase
        No recording to fit, or a contradiction between recordings and model.
    BadRecording
        A file is damaged or contradicts the case.
    """
    effects = _sought(list(effects) or list(CANDIDATES), at)
    if is_in_frequency(case):
        return diagnose_frequency(case, effects=effects, progress=progress)
    return _Pass(
        whole_case=case,
        effects=effects,
        at=at,
        scope=scope_note(effects, at),
        report=progress or (lambda share, what: None),
        began=time.monotonic(),
        deadline=Deadline.after(time_limit),
    ).run()


@dataclass(frozen=True, kw_only=True, eq=False)
class _Pass:
    """One pass of a diagnosis from recordings.

    Parameters
    ----------
    whole_case : Case
        Case before preparation.
    effects : sequence of Effect
        Candidate effects.
    at : collection of str
        Places at which effects are sought; all if empty.
    report : callable
        Receives the completed share and the current step.
    began : float
        Start time of the diagnosis [s].
    deadline : Deadline
        End of the search.
    scope : tuple of str
        Note on a restricted search.
    note : str
        Note of an earlier pass.
    checked_file : FileCheck or None
        File check of an earlier pass.
    """

    whole_case: Case
    effects: Sequence[Effect]
    at: Collection[str]
    report: Callable[[float, str], None]
    began: float
    deadline: Deadline
    scope: tuple[str, ...] = ()
    note: str = ""
    checked_file: FileCheck | None = None

    def run(self) -> Diagnosed | RejectedCase:
        """Return the diagnosis after all passes."""
        self.report(0.0, "reading")
        meshed = model_kind_of(self.whole_case).with_corrected_mesh(self.whole_case)
        case, static_offsets = remove_static_offsets(meshed)
        file = check_recordings(case) if self.checked_file is None else self.checked_file
        if file.of("fatal"):
            return reject_case(self.whole_case, file, time.monotonic() - self.began)
        searched = self._search(case, file, static_offsets)
        self.report(0.8, "fitting whole recordings")
        is_final = bool(self.note) or bool(searched.seen.damage.fatal)
        other = None if is_final else choose_convention(searched.model_class, searched.found, self.whole_case)
        if other is not None:
            again = self._repeated(
                whole_case=other.of(self.whole_case), note=note_of_conventions([other.words]), checked_file=file
            )
            return again.run()
        judged = self._judge(searched, self._confirm(searched))
        if isinstance(judged, _Pass):
            return judged.run()
        return (
            self._with_unknown_geometry(searched, judged)
            or self._again(searched, judged)
            or self._diagnosed(searched, judged)
        )

    def _repeated(self, **changed: Any) -> "_Pass":
        """Return a changed pass with the second half of the progress."""
        report = self.report  # a repeated pass takes about as long as the first
        return replace(self, report=lambda share, what: report(0.5 + 0.5 * share, what), **changed)

    def _with_note(self, note: str) -> str:
        """Return the notes of this pass and of another one."""
        return "; ".join(filter(None, [self.note, note]))

    def _with_unknown_geometry(self, searched: Searched, judged: Judged) -> Diagnosed | None:
        """Return a better diagnosis with unstated geometry left to the recordings."""
        kinds = unstated_geometry(searched.problem, self.whole_case)
        if self.deadline.is_past or not may_be_simpler(judged, len(kinds)):
            return None
        if not is_geometry_contradicted(searched.model_class, searched.found, kinds):
            return None
        case, note = self.whole_case.with_uncertain(kinds), self._with_note(unknown_geometry_note(list(kinds)))
        again = self._repeated(whole_case=case, note=note, checked_file=searched.file).run()
        if not isinstance(again, Diagnosed) or self.deadline.is_past:  # a search cut short replaces none
            return None
        return again if is_better_with_geometry(again.diagnosis, judged, len(kinds)) else None

    def _again(self, searched: Searched, judged: Judged) -> Diagnosed | None:
        """Return the diagnosis of another search where this one fails.

        A sensor fault can absorb the linear error of a model. The second search is without these, the third for a table.
        """
        assert judged.tried is not None
        is_weak = judged.verdict == "partly-explained" and not explains_most(judged.tried.checked)
        attempt = judged.tried if is_weak else judged.attempt
        is_idle = attempt is not None and attempt.is_of_the_fit_alone  # the hold-out recordings show no mismatch
        if not (is_weak or judged.verdict == "none-of-these") or is_idle:
            return None
        left = total(attempt.checked, "after") if is_weak and attempt is not None else np.inf
        if attempt is not None and any(term.effect.kind == "sensor" for term in attempt.fit.terms):
            self.report(0.95, "searching without sensor faults")
            physics = [effect for effect in self.effects if effect.kind != "sensor"]
            other, ours, again = self._other(searched, physics, NO_SENSOR_FAULT)
            if again is not None and again.tried is not None and total(again.tried.checked, "after") < left:
                return other._diagnosed(ours, again)
        tables = _sought(last_resort(self.effects), self.at)
        if tables and searched.holdout.is_new:  # the table is verified on another motion
            self.report(0.95, "fitting a tabulated force")
            last, ours, again = self._other(searched, tables, UNKNOWN_LAW, is_single=True)
            tried = None if again is None else again.tried
            if again and tried and again.choice.gained > 0.0 and is_better_table(tried, attempt):
                return last._diagnosed(ours, replace(again, verdict="unknown-law"))
        return None

    def _other(
        self, searched: Searched, effects: Sequence[Effect], note: str, *, is_single: bool = False
    ) -> tuple["_Pass", Searched, Judged | None]:
        """Return a search of other effects and its judgement."""
        other = replace(self, effects=effects, note=self._with_note(note))
        if self.deadline.is_past:
            return other, searched, None
        limits = Limits(deadline=self.deadline, is_single=is_single)
        found = searched.model_class.search(effects, lambda share, what: None, limits)
        ours = replace(searched, found=found)
        again = other._judge(ours, other._confirm(ours))
        return other, ours, again if isinstance(again, Judged) and again.verdict in NAMING else None

    def _search(self, case: Case, file: FileCheck, static_offsets: Sequence[StaticOffset]) -> Searched:
        """Return the result of the search."""
        refuse_recorded_contacts(case)
        model_class = choose_model_class(case, self.effects)
        problem = model_class.problem
        check_candidates(self.effects, problem.places)
        holdout = read_holdout(problem.case, problem.names, problem.runs)
        seen = look_at_data(problem, assess_quality([*problem.runs, *holdout.runs], problem.runs, file), holdout.runs)
        effects = [] if seen.damage.fatal else self.effects
        is_noise = partial(leaves_noise, problem, seen, holdout.runs, ExtendedModel(plant=self.whole_case.plant))
        limits = Limits(deadline=self.deadline, is_noise=is_noise)
        found = model_class.search(effects, lambda share, what: self.report(0.8 * share, what), limits)
        return Searched(
            file=file,
            static_offsets=static_offsets,
            model_class=model_class,
            holdout=holdout,
            seen=seen,
            found=found,
            notes=self.deadline.notes,
        )

    def _confirm(self, searched: Searched) -> Judged:
        """Return the confirmed choice with its models, without a verdict."""
        problem, found = searched.problem, searched.found
        confirmation = Confirmation(
            problem=problem,
            whole=found.whole,
            start=found.before.long_fit,
            seen=searched.seen,
            effects=self.effects,
            is_linear=searched.model_class.is_linear,
        )
        confirmed = confirmation.confirm(found)
        fit_before, fit = confirmed.before, with_whole_gains(confirmed.after, problem.parameters, problem.plant)
        known = [offset.channel for offset in searched.static_offsets]
        seen = replace(searched.seen, offsets=find_sensor_offsets(problem, fit, known))
        before = extended(problem, fit_before, wrong_offsets(problem, fit, seen))
        after, without = (seen.on(extended(problem, own)) for own in (fit, fit_before))
        if seen.is_missing and fit.terms:
            on_fitted = check(problem.runs, without, after, horizon_s=problem.horizon_s)
            if not is_needed_beside_data(confirmed.choice, on_fitted, model_kind=problem.model_kind):
                fit, after = fit_before, without  # the findings from the data alone explain the recordings
        return Judged(confirmed=confirmed, seen=seen, before=before, after=after, fit=fit)

    def _judge(self, searched: Searched, judged: Judged) -> "Judged | _Pass":
        """Return the verdict, or a pass with shorter time steps."""
        self.report(0.9, "checking in MuJoCo")
        problem, seen, fit = searched.problem, judged.seen, judged.fit
        nominal = ExtendedModel(plant=self.whole_case.plant)
        trials = Trials(problem=problem, seen=seen, runs=searched.runs, before=judged.before, nominal=nominal)
        terms_of = partial(findings_of_terms, judged.choice, problem=problem)
        is_plausible = is_plausible_beside_noise(judged.confirmed.before)
        decide = partial(decide_verdict, judged.choice, model_kind=problem.model_kind, is_plausible=is_plausible)

        def verdict_on(trials: Trials, tried: Attempt) -> Verdict:
            fitted = partial(trials.on_fitted, tried.fit, terms_of(tried.fit))
            return decide(tried.checked, seen, fitted=fitted)

        tried = trials.of(fit, terms_of(fit))
        verdict = verdict_on(trials, tried)
        if verdict == "none-of-these" and tried.is_of_the_fit_alone:
            tried = with_left_out(tried, trials, searched.found.whole, judged.confirmed.before, terms_of)
            verdict = verdict_on(trials, tried)
        if verdict in NAMING:

            def stands(fewer: Attempt) -> bool:
                return verdict_on(trials, fewer) in (verdict, "missing-physics")

            tried = without_useless(
                tried, len(seen.of_law(problem)), lambda fewer: trials.of(fewer, terms_of(fewer)), stands
            )
            tried = trials.plainest(tried, searched.found.hypotheses, searched.found.whole.fit, terms_of, stands)
            verdict = verdict_on(trials, tried)
            if tried.fit is not fit:
                judged = replace(judged, fit=tried.fit, after=seen.on(extended(problem, tried.fit)))
        may_be_coarse = verdict == "none-of-these" and problem.model_kind.has_stated_time_step
        if may_be_coarse and (coarse := coarse_steps(judged.before, searched.runs, problem.horizon_s)):
            finer = trials.with_change(with_finer_steps)
            again = finer.of(tried.fit, terms_of(tried.fit))
            second = verdict_on(finer, again)
            if second != verdict:
                verdict, tried, trials = second, again, finer
                judged = replace(judged, before=trials.before, after=with_finer_steps(judged.after))
                coarse += "; the verdict is on the shorter ones"
            elif not self.note:  # the fit compensates the coarse steps, so the search repeats
                note = f"{coarse}; all of the search is with the shorter ones"
                finer_case = replace(self.whole_case, plant=with_finer_steps(trials.nominal).plant)
                return self._repeated(whole_case=finer_case, note=note, checked_file=searched.file)
            judged = replace(judged, notes=(coarse,))
        notes = (*judged.notes, *(note for checked in tried.checked for note in checked.notes))
        judged = replace(judged, verdict=verdict, tried=tried, notes=notes)
        return self._graded(searched, judged, trials) if verdict == "none-of-these" else judged

    def _graded(self, searched: Searched, judged: Judged, trials: Trials) -> Judged:
        """Return the partial explanation, or else the best attempt."""
        assert judged.tried is not None
        shares = {h.label: p for h, p in judged.choice.tried if p > VERDICT.false_alarm_rate}
        others = [h for h in searched.found.hypotheses if h.label != judged.choice.best.label]
        others.sort(key=lambda h: -shares.get(h.label, 0.0))  # then by score
        model_kind = searched.problem.model_kind
        errors: dict[frozenset[str], float] = {}
        is_partial = partial(is_partial_explanation, choice=judged.choice, errors=errors, model_kind=model_kind)
        attempt_of = partial(trials.of_hypothesis, effects=self.effects)
        attempts = further_attempts(judged.tried, others, attempt_of)
        attempt = best_attempt(judged.tried, attempts, is_partial, errors)
        if attempt is None or not is_partial(attempt):
            if attempt is not None and attempt.is_of_the_fit_alone:
                fitted = trials.on_fitted(attempt.fit, attempt.findings)
                attempt = replace(attempt, explains_fitted=closes_gap(fitted, model_kind=model_kind))
            return replace(judged, attempt=attempt)
        terms_of = partial(findings_of_terms, judged.choice, problem=searched.problem)
        attempt = without_useless(
            attempt, len(judged.seen.of_law(searched.problem)), lambda few: trials.of(few, terms_of(few)), is_partial
        )
        attempt = trials.probable(attempt, judged.choice, searched.found.whole.fit, terms_of, is_partial)
        after = judged.seen.on(extended(searched.problem, attempt.fit))
        after = after if trials.change is None else trials.change(after)
        return replace(judged, errors=errors, verdict="partly-explained", tried=attempt, fit=attempt.fit, after=after)

    def _diagnosed(self, searched: Searched, judged: Judged) -> Diagnosed:
        """Return the diagnosis with its models."""
        assert judged.tried is not None
        problem, verdict, choice = searched.problem, judged.verdict, judged.choice.given_predictions(judged.errors)
        checked, after, fit = list(judged.tried.checked), judged.after, judged.fit
        findings: Sequence[Finding] = ()
        is_aliased = choice.is_prior_driven and not closes_gap(checked, model_kind=problem.model_kind)
        if verdict == "missing-physics" and is_aliased:  # implausible parameters explain as much
            checked = [c.against_nominal() for c in checked]
        if verdict in NAMING:
            findings = by_what_they_explain(judged.tried.findings, checked)
        else:  # the extended model holds reported findings only
            after, fit = judged.before, judged.confirmed.before
            checked = [c.without_findings() for c in checked]
        if verdict in ("partly-explained", "unknown-law"):
            share, is_plausible = explained_share(checked) or 0.0, has_plausible_parameters(fit)
            findings = graded(findings, choice, share, is_plausible=is_plausible, fitted=fit.terms)
        findings, attempt, seen = one_per_law(findings), judged.attempt, judged.seen
        diagnosis = Diagnosis(
            title=problem.case.table.title,
            verdict=verdict,
            findings=tuple(findings),
            alternatives=alternatives(choice, problem, verdict, searched.found.before.normalised_residual),
            checked=tuple(checked),
            mismatch=locate_mismatch(checked),
            not_excluded=(
                *not_excluded(choice, verdict, fit.terms),
                *implausible_parameters(problem.parameters, fit.theta),
            ),
            next_measurement=self._separating_experiment(searched, judged)
            or next_measurement(choice, verdict, [f.effect for f in findings], attempt),
            attempt=attempt,
            quality=seen.quality_lines(is_named=verdict in NAMING),
            notes=self._notes(searched, judged, checked),
            calibration={p.name: float(v) for p, v in zip(problem.parameters, fit.theta, strict=True) if abs(v) > 1e-6},
            residual_is_small=is_within_noise(checked, model_kind=problem.model_kind),
            seconds=time.monotonic() - self.began,
        )
        self.report(1.0, "done")
        return Diagnosed(
            diagnosis=diagnosis,
            problem=problem,
            found=searched.found,
            choice=choice,
            before=judged.before,
            after=after,
            fit=fit,
        )

    def _separating_experiment(self, searched: Searched, judged: Judged) -> str:
        """Return the experiment that separates the two leading rivals, or ""."""
        tried, choice = judged.attempt or judged.tried, judged.choice
        # beside a complete explanation, what is clearly less probable is no rival
        rivals = choice.alike if judged.verdict == "missing-physics" else [h for h, _ in choice.tried]
        if tried is None or judged.verdict not in {*NAMING, "none-of-these"}:
            return ""
        return separate(searched.problem, rivals, searched.runs, tried.checked)

    def _notes(self, searched: Searched, judged: Judged, checked: Sequence[Checked]) -> tuple[str, ...]:
        """Return the notes of a diagnosis."""
        verdict, model_kind, attempt = judged.verdict, searched.problem.model_kind, judged.attempt
        assert judged.tried is not None
        idle = judged.tried.checked if verdict in NAMING else attempt.checked if attempt else ()
        return (
            *residual_note(verdict, checked, model_kind=model_kind),
            *coloured_noise_note(verdict, checked, model_kind=model_kind),
            *fit_note(verdict, checked, model_kind=model_kind),
            *notes_on_models(checked),
            *idle_note(idle),
            *unproven_note(verdict, attempt.checked if attempt else ()),
            *judged.notes,
            *([self.note] if self.note else []),
            *self.scope,
            *(offset.line for offset in searched.static_offsets),
            *searched.notes,
            *searched.holdout.notes,
            *searched.problem.notes,
            *judged.seen.noise,
            *judged.confirmed.rejected,
            *searched.model_class.notes,
        )


def _sought(effects: Sequence[Effect], at: Collection[str]) -> list[Effect]:
    """Return effects that are sought at some places only."""
    return [limited(effect, at) for effect in effects] if at else list(effects)
