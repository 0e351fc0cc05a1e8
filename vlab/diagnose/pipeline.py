"""Pipeline of a diagnosis from recordings: preparation, search, confirmation, validation, report."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from vlab.cases.case import Case
from vlab.cases.checks import FileCheck, check_recordings
from vlab.cases.misfit import misfit
from vlab.diagnose.advice import idle_note, implausible_parameters, next_measurement, not_excluded, spoilt_note
from vlab.diagnose.data.mains_interference import MainsInterference
from vlab.diagnose.data.quality import assess_quality
from vlab.diagnose.data_findings import DataFindings, look_at_data
from vlab.diagnose.diagnosis import NAMING, Attempt, Diagnosis, Finding, RejectedCase, Verdict, reject_case
from vlab.diagnose.findings import alternatives, by_what_they_explain, findings_of_terms, graded, one_per_law
from vlab.diagnose.frequency_pipeline import FrequencyDiagnosed, diagnose_frequency, is_in_frequency
from vlab.diagnose.inference.model_choice import Choice
from vlab.diagnose.inference.sensor_offset import explained_sensor_offsets, find_sensor_offsets
from vlab.diagnose.parameters.holdout import moves, read_holdout
from vlab.diagnose.parameters.mesh_correction import with_modes_of_fe
from vlab.diagnose.parameters.static_offset import remove_static_offsets
from vlab.diagnose.parameters.terms import Fit
from vlab.diagnose.problem import Problem
from vlab.diagnose.search.alternative_conventions import choose_convention
from vlab.diagnose.search.attempt import Trials, best_attempt
from vlab.diagnose.search.confirmation import Confirmation
from vlab.diagnose.search.deadline import Deadline
from vlab.diagnose.search.model_class import choose_model_class
from vlab.diagnose.search.sampling_convention import said
from vlab.diagnose.search.selection import TimeFound
from vlab.diagnose.validation.gap import explained_share
from vlab.diagnose.validation.simulation import Checked, ExtendedModel, check, coarse_steps, extended, with_finer_steps
from vlab.diagnose.verdict import (
    closes_gap,
    coloured_noise_note,
    decide_verdict,
    is_needed,
    is_partial_explanation,
    is_within_noise,
    residual_note,
)
from vlab.physics.catalogue import EFFECTS
from vlab.physics.effect import Effect


@dataclass(frozen=True, kw_only=True, eq=False)
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
    if is_in_frequency(case):
        return diagnose_frequency(case, effects=effects, progress=progress)
    effects = list(effects) or list(EFFECTS.values())
    deadline = Deadline.after(time_limit)
    return _diagnosed(case, effects, progress or (lambda share, what: None), time.monotonic(), deadline)


def _diagnosed(
    whole_case: Case,
    effects: Sequence[Effect],
    report: Callable[[float, str], None],
    began: float,
    deadline: Deadline,
    told: str = "",
    checked_file: FileCheck | None = None,
) -> Diagnosed | RejectedCase:
    """Diagnose a case of recordings.

    Parameters
    ----------
    whole_case : Case
        Case before preparation.
    effects : sequence of Effect
        Candidate effects.
    report : callable
        Receives the completed share and the current step.
    began : float
        Start time of the diagnosis [s].
    deadline : Deadline
        End of the search.
    told : str
        Note of an earlier pass.
    checked_file : FileCheck or None
        File check of an earlier pass.
    """
    report(0.0, "reading")
    given = whole_case.plant
    case, static_offsets = remove_static_offsets(with_modes_of_fe(whole_case))
    file = check_recordings(case) if checked_file is None else checked_file
    if file.of("fatal"):
        return reject_case(whole_case, file, time.monotonic() - began)
    model_class = choose_model_class(case, effects)
    problem, case = model_class.problem, model_class.problem.case
    holdout = read_holdout(case, problem.names, problem.runs)
    seen = look_at_data(problem, assess_quality([*problem.runs, *holdout.runs], problem.runs, file))
    searched = [] if seen.damage.fatal else effects
    found = model_class.search(searched, lambda share, what: report(0.8 * share, what), deadline)
    limit_notes = deadline.notes
    report(0.8, "fitting whole recordings")
    other = choose_convention(model_class, found) if not (told or seen.damage.fatal) else None
    if other is not None:
        return _diagnosed(other.of(whole_case), effects, report, began, deadline, said([other.words]), file)
    confirmation = Confirmation(
        problem=problem,
        whole=found.whole,
        start=found.before.long_fit,
        seen=seen,
        effects=effects,
        is_linear=model_class.is_linear,
    )
    confirmed = confirmation.confirm(found)
    choice, fit_before, fit_after = confirmed.choice, confirmed.before, confirmed.after
    seen = replace(seen, zeros=find_sensor_offsets(problem, fit_after, [s.channel for s in static_offsets]))
    wrong_offsets = {*(zero.channel for zero in seen.zeros), *explained_sensor_offsets(problem, fit_after)}
    before, after = extended(problem, fit_before, wrong_offsets), seen.on(extended(problem, fit_after))
    without = seen.on(extended(problem, fit_before))
    is_structure = case.structure is not None
    if seen.is_missing and fit_after.terms:
        on_fitted = check(problem.runs, without, after)
        if not (
            closes_gap(on_fitted, is_structure=is_structure) or is_needed(choice, on_fitted, is_structure=is_structure)
        ):
            fit_after, after = fit_before, without  # the findings from the data alone explain the recordings
    report(0.9, "checking in MuJoCo")
    runs = list(holdout.runs) or [run for run in problem.runs if moves(run)]
    trials = Trials(problem=problem, seen=seen, runs=runs, before=before, nominal=ExtendedModel(plant=given))
    terms = findings_of_terms(choice, fit_after, problem)
    tried = trials.of(fit_after, terms)

    def verdict_of(trials: Trials, tried: Attempt) -> Verdict:
        fitted = partial(_on_fit_runs, trials, fit_after, terms)
        return decide_verdict(choice, tried.checked, seen, is_structure=is_structure, fitted=fitted)

    verdict = verdict_of(trials, tried)
    coarse = ""
    if verdict == "none-of-these" and not is_structure:
        coarse = coarse_steps(before, tried.checked, check(runs, with_finer_steps(before), None))
        if coarse:
            finer = replace(trials, change=with_finer_steps)
            again = finer.of(fit_after, terms)
            second = verdict_of(finer, again)
            if second != verdict:
                verdict, tried, trials = second, again, finer
                before, after = with_finer_steps(before), with_finer_steps(after)
                coarse += "; the verdict is on the shorter ones"
            elif not told:  # the fit compensates the coarse steps, so the search repeats
                finer_case = replace(whole_case, plant=with_finer_steps(trials.nominal).plant)
                told = f"{coarse}; all of the search is with the shorter ones"
                return _diagnosed(finer_case, effects, report, began, deadline, told, file)
    attempt = None
    if verdict == "none-of-these":
        others = (h for h in found.hypotheses if h.label != choice.best.label)
        attempt = best_attempt(tried, (trials.of_hypothesis(h, effects) for h in others))
        if attempt is not None and is_partial_explanation(attempt, choice):
            verdict, tried, fit_after, attempt = "partly-explained", attempt, attempt.fit, None
            after = seen.on(extended(problem, fit_after))
            after = after if trials.change is None else trials.change(after)
    checked = list(tried.checked)
    if verdict not in NAMING:
        after, fit_after = before, fit_before  # the extended model holds reported findings only
        checked = [c.without_findings() for c in checked]
    notes = (
        *residual_note(verdict, checked, is_structure=is_structure),
        *coloured_noise_note(verdict, checked, is_structure=is_structure),
        *spoilt_note(checked),
        *idle_note(tried.checked if verdict in NAMING else attempt.checked if attempt else ()),
        *([coarse] if coarse else []),
        *([told] if told else []),
        *(s.line for s in static_offsets),
        *limit_notes,
        *holdout.notes,
        *problem.notes,
        *seen.noise,
        *confirmed.rejected,
        *model_class.notes,
    )
    findings = by_what_they_explain(tried.findings, checked) if verdict in NAMING else ()
    if verdict == "partly-explained":
        findings = graded(findings, choice, explained_share(checked) or 0.0)
    diagnosis = replace(
        _report(verdict, problem, choice, fit_after, checked, seen, one_per_law(findings), notes, attempt),
        alternatives=alternatives(choice, problem, verdict, found.before.normalised_residual),
        residual_is_small=is_within_noise(checked, is_structure=is_structure),
        seconds=time.monotonic() - began,
    )
    report(1.0, "done")
    return Diagnosed(
        diagnosis=diagnosis, problem=problem, found=found, choice=choice, before=before, after=after, fit=fit_after
    )


def _report(
    verdict: Verdict,
    problem: Problem,
    choice: Choice,
    fit: Fit,
    checked: Sequence[Checked],
    seen: DataFindings,
    findings: Sequence[Finding],
    notes: Sequence[str],
    attempt: Attempt | None,
) -> Diagnosis:
    return Diagnosis(
        title=problem.case.table.title,
        verdict=verdict,
        findings=tuple(findings),
        alternatives=(),
        checked=tuple(checked),
        mismatch=_mismatch(checked),
        not_excluded=(*not_excluded(choice, verdict), *implausible_parameters(problem.parameters, fit.theta)),
        next_measurement=next_measurement(choice, verdict, [f.effect for f in findings], attempt),
        attempt=attempt,
        quality=(*seen.damage.lines, *(_interference_note(hum) for hum in seen.benign_interferences)),
        notes=tuple(notes),
        calibration={p.name: float(v) for p, v in zip(problem.parameters, fit.theta, strict=True) if abs(v) > 1e-6},
    )


def _on_fit_runs(trials: Trials, fit: Fit, terms: Sequence[Finding]) -> Sequence[Checked]:
    """Return the errors on the fitted recordings."""
    return replace(trials, runs=trials.problem.runs).of(fit, terms).checked


def _interference_note(hum: MainsInterference) -> str:
    lines = " and ".join(f"{k * hum.frequency:.2f}" for k in hum.harmonics)
    return f"{hum.channel}: mains interference at {lines} Hz, {100 * hum.share:.2g} % of its rms; removed before the search"


def _mismatch(checked: Sequence[Checked]) -> dict[str, Any]:
    """Return the largest residuals by band, channel and time."""
    bands: list[dict[str, float]] = []
    channels: dict[str, float] = {}
    times: list[dict[str, Any]] = []
    for run in checked:
        simulated = run.standing
        if simulated is None:
            continue
        for name, errors in run.channels.items():
            channels[name] = max(channels.get(name, 0.0), errors[1])
            found = misfit(run.measured, simulated, name)
            for low, high, share in zip(
                found.band_edges_hz[:-1], found.band_edges_hz[1:], found.band_share, strict=True
            ):
                bands.append({"low_hz": float(low), "high_hz": float(high), "share": float(share), "nrmse": errors[1]})
            k = int(np.argmax(found.window_nrmse))
            times.append(
                {
                    "recording": run.name,
                    "channel": name,
                    "time_s": float(found.window_time_s[k]),
                    "nrmse": float(found.window_nrmse[k]),
                }
            )
    bands.sort(key=lambda b: -b["share"] * b["nrmse"] ** 2)
    times.sort(key=lambda t: -t["nrmse"])
    order = sorted(channels, key=lambda c: -channels[c])
    return {
        "where_frequency_hz": bands[:4],
        "where_channel": [{"channel": c, "nrmse": channels[c]} for c in order],
        "where_time_s": times[:4],
    }
