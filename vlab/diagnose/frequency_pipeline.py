"""Pipeline of a diagnosis from frequency data."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from vlab.cases.case import Case
from vlab.diagnose.advice import idle_note, implausible_parameters, next_measurement, not_excluded, spoilt_note
from vlab.diagnose.data.amplitude_dependence import level_notes, level_scale_notes
from vlab.diagnose.data.responses import Measured, Modes, Response
from vlab.diagnose.diagnosis import NAMING, Attempt, Diagnosis, Finding, RejectedCase, Verdict, reject_case
from vlab.diagnose.findings import (
    alternatives,
    by_what_they_explain,
    findings_of_attempt,
    findings_of_terms,
    graded,
    one_per_law,
)
from vlab.diagnose.inference.model_choice import Choice, choose_model
from vlab.diagnose.parameters.terms import Fit
from vlab.diagnose.parameters.unused_entries import unused
from vlab.diagnose.predictors.frequency_problem import FrequencyProblem, prepare_frequency
from vlab.diagnose.search.attempt import best_attempt
from vlab.diagnose.search.cross_validation import LeftOut, cross_validate
from vlab.diagnose.search.frequency_selection import FrequencyFound, search_frequency
from vlab.diagnose.search.level_trials import has_levels
from vlab.diagnose.settings import FREQUENCY_VERDICT, VERDICT
from vlab.diagnose.validation.frequency import (
    CheckedFrequency,
    ExtendedFrequencyModel,
    apart,
    check_frequency,
    extended_by,
    modal_errors,
    nominal_model,
)
from vlab.diagnose.validation.gap import explained_share, gap_closed, total, verifying
from vlab.diagnose.validation.response_checks import check_responses
from vlab.diagnose.validation.simulation import Ablations
from vlab.diagnose.verdict import is_partial_explanation
from vlab.physics.catalogue import CANDIDATES, EFFECTS
from vlab.physics.effect import Effect

FORMS = ("m/N", "m/s/N", "m/s^2/N")
"""Units of a response by its order."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class FrequencyDiagnosed:
    """Diagnosis in frequency with its models.

    Parameters
    ----------
    diagnosis : Diagnosis
        Result.
    problem : FrequencyProblem
        Inverse problem.
    found : FrequencyFound
        Hypotheses of the search.
    choice : Choice
        Chosen hypothesis.
    before, after : ExtendedFrequencyModel
        Calibrated and extended model; equal without findings.
    fit : Fit
        Fit of the chosen hypothesis.
    left_out : LeftOut or None
        Cross-validation without a hold-out set.
    """

    diagnosis: Diagnosis
    problem: FrequencyProblem
    found: FrequencyFound
    choice: Choice
    before: ExtendedFrequencyModel
    after: ExtendedFrequencyModel
    fit: Fit
    left_out: LeftOut | None = None


def is_in_frequency(case: Case) -> bool:
    """Return whether a case has only frequency data to fit."""
    roles = [*(frf.role for frf in case.table.frf), *(modal.role for modal in case.table.modal)]
    return "fit" in roles and not case.recordings(("fit",))


def diagnose_frequency(
    case: Case, *, effects: Sequence[Effect] = (), progress: Callable[[float, str], None] | None = None
) -> FrequencyDiagnosed | RejectedCase:
    """Diagnose a case of frequency responses and modal tables.

    Contradictory files are rejected before any search.

    Parameters
    ----------
    case : Case
        Case.
    effects : sequence of Effect
        Candidate effects; the catalogue by default. Nonlinear effects need data at several known levels.
    progress : callable or None
        Receives the completed share and the current step.

    Returns
    -------
    FrequencyDiagnosed or RejectedCase
        Diagnosis.

    Raises
    ------
    BadCase
        Nothing to fit, an unstable model, or a contradiction between data and model.
    """
    began = time.monotonic()
    report = progress or (lambda share, what: None)
    report(0.0, "reading")
    problem = prepare_frequency(case)
    file = check_responses(problem)
    if file.of("fatal"):
        return reject_case(case, file, time.monotonic() - began)
    found = search_frequency(problem, list(effects) or list(CANDIDATES), lambda s, what: report(0.85 * s, what))
    choice = _chosen(found)
    fit_before = found.before.fit
    fit = choice.best.fit
    report(0.85, "checking in MuJoCo")
    before = extended_by(problem, fit_before)
    after = extended_by(problem, fit) if choice.best.terms else before
    trials = partial(_tried, problem, before)
    terms = findings_of_terms(choice, fit, problem)
    tried = trials(fit, terms)
    left_out = None
    if not problem.held_out:
        report(0.9, "predicting parts left out")
        left_out = cross_validate(problem, found.fitter, fit_before, fit)
    fitted = partial(trials, fit, terms, problem.measured)
    verdict, attempt = _verdict(choice, tried.checked, left_out, lambda: fitted().checked), None
    if verdict == "none-of-these":
        others = (h for h in found.hypotheses if h.label != choice.best.label)
        is_partial = partial(is_partial_explanation, choice=choice)
        fits = (trials(h.fit, findings_of_attempt(h, h.fit, problem)) for h in others)
        attempt = best_attempt(tried, fits, is_partial)
        if attempt is not None and is_partial(attempt):
            verdict, tried, attempt = "partly-explained", attempt, None
            fit, after = tried.fit, extended_by(problem, tried.fit)
    if verdict == "none-of-these" and file.of("warning"):
        verdict = "bad-recording"
    diagnosis = _report(problem, found, choice, verdict, tried, attempt, left_out)
    diagnosis = replace(diagnosis, quality=file.lines, seconds=time.monotonic() - began)
    report(1.0, "done")
    return FrequencyDiagnosed(
        diagnosis=diagnosis,
        problem=problem,
        found=found,
        choice=choice,
        before=before,
        after=after,
        fit=fit,
        left_out=left_out,
    )


def _tried(
    problem: FrequencyProblem,
    before: ExtendedFrequencyModel,
    fit: Fit,
    terms: Sequence[Finding],
    data: Sequence[Measured] = (),
) -> Attempt:
    """Return the errors of a fit on hold-out or fitted data.

    Parameters
    ----------
    problem : FrequencyProblem
        Problem.
    before : ExtendedFrequencyModel
        Calibrated model.
    fit : Fit
        Fit.
    terms : sequence of Finding
        Reported effects of the fit.
    data : sequence of Response or Modes
        Other data to check.
    """
    data = data or problem.held_out or problem.measured
    rests = [replace(fit, terms=tuple(t for t in fit.terms if t is not term)) for term in fit.terms]
    rests += [replace(fit, terms=())] if len(rests) > 1 else []
    ablations = Ablations(
        names=tuple(f"{f.name} at {f.place}" for f in terms), models=tuple(extended_by(problem, rest) for rest in rests)
    )
    after = extended_by(problem, fit) if terms else before
    models = [nominal_model(problem.plant, problem.wires), before, after]
    checked = check_frequency(models, data, problem.unfitted, ablations)
    return Attempt(findings=tuple(_in_form(problem, f) for f in terms), fit=fit, checked=tuple(checked))


def _chosen(found: FrequencyFound) -> Choice:
    """Return the choice, rejected where the gain is small."""
    choice = choose_model(found)
    if not choice.best.terms or choice.best.score - found.before.score >= FREQUENCY_VERDICT.least_score:
        return choice
    best = found.before
    return replace(choice, best=best, alike=(), probability=_of_nothing(found), places={})


def _of_nothing(found: FrequencyFound) -> float:
    scores = np.array([found.before.score, *(h.score for h in found.hypotheses)])
    weights = np.exp(scores - scores.max())
    return float(weights[0] / weights.sum())


def _verdict(
    choice: Choice,
    checked: Sequence[CheckedFrequency],
    left_out: LeftOut | None,
    fitted: Callable[[], Sequence[CheckedFrequency]],
) -> Verdict:
    """Return the verdict on checked data.

    An explanation is complete where the residual is within noise and model error, or the gap nearly closed. Otherwise
    the explanation is partial.

    Parameters
    ----------
    choice : Choice
        Choice.
    checked : sequence of CheckedFrequency
        Errors on checked data.
    left_out : LeftOut or None
        Cross-validation.
    fitted : callable
        Returns the errors on fitted data.
    """
    errors = {key: total(checked, key) for key in ("before", "after", "noise")}
    gap = _gap(checked)
    if left_out is not None and left_out.parts >= FREQUENCY_VERDICT.least_parts:
        gap = left_out.gap_closed
    is_held_out = all(c.role == "holdout" for c in checked)
    explained = is_held_out or errors["after"] <= _allowed(FREQUENCY_VERDICT.unverified, checked)
    if choice.best.terms and all(c.is_idle for c in checked):  # no hold-out data can verify the choice
        own = fitted()
        if (
            total(own, "before") > _allowed(FREQUENCY_VERDICT.above_noise, own)
            and (_gap(own) or 0.0) >= FREQUENCY_VERDICT.least_gap
        ):
            return "none-of-these"
    elif choice.best.terms and explained and (gap is None or gap >= FREQUENCY_VERDICT.least_gap):
        is_complete = errors["after"] <= _allowed(FREQUENCY_VERDICT.above_noise, checked)
        return "missing-physics" if is_complete or gap is None or gap >= VERDICT.nearly_all else "partly-explained"
    return "none-of-these" if errors["before"] > _allowed(FREQUENCY_VERDICT.above_noise, checked) else "nothing-missing"


def _allowed(times: float, checked: Sequence[CheckedFrequency]) -> float:
    """Return the residual allowed by noise and model error."""
    floor = FREQUENCY_VERDICT.least_misfit if any(isinstance(c.measured, Response) for c in checked) else 0.0
    return max(times * total(checked, "noise"), floor)


def _gap(checked: Sequence[CheckedFrequency]) -> float | None:
    """Return the closed share over verifying data, or None."""
    tests = verifying(checked)
    before, start, after, noise = (total(tests, key) for key in ("before", "start", "after", "noise"))
    gap = gap_closed(before, after, noise)
    return None if gap is None else min(gap, gap_closed(start, after, noise) or 0.0)


def _report(
    problem: FrequencyProblem,
    found: FrequencyFound,
    choice: Choice,
    verdict: Verdict,
    tried: Attempt,
    attempt: Attempt | None,
    left_out: LeftOut | None,
) -> Diagnosis:
    fit = tried.fit if verdict in NAMING else choice.best.fit
    is_found = verdict in NAMING
    shown = tried if is_found else attempt
    checked = tried.checked if is_found else tuple(c.without_findings() for c in tried.checked)
    findings = by_what_they_explain(tried.findings, checked) if is_found else ()
    if verdict == "partly-explained":
        findings = graded(findings, choice, explained_share(checked) or 0.0)
    return Diagnosis(
        title=problem.case.table.title,
        verdict=verdict,
        findings=one_per_law(findings),
        alternatives=alternatives(choice, problem, verdict, found.before.normalised_residual),
        checked=checked,
        mismatch=_mismatch(checked),
        not_excluded=not_excluded(choice, verdict, choice.best.terms),
        next_measurement=_next(choice, verdict, problem, attempt),
        quality=(),
        notes=(
            *spoilt_note(checked),
            *idle_note(shown.checked if shown else ()),
            *_notes(problem, found, choice, left_out),
        ),
        attempt=attempt,
        residual_is_small=total(checked, "after") <= _allowed(FREQUENCY_VERDICT.above_noise, checked),
        calibration={p.name: float(v) for p, v in zip(problem.parameters, fit.theta, strict=True) if abs(v) > 1e-6},
    )


def _in_form(problem: FrequencyProblem, finding: Finding) -> Finding:
    """Return a finding in the unit of the responses."""
    effect = EFFECTS.get(finding.effect)
    orders = {d.order for d in problem.measured if isinstance(d, Response)}
    if effect is None or not effect.picks_up or "command" not in effect.needs or len(orders) != 1:
        return finding
    unit = FORMS[orders.pop()]
    return replace(finding, parameters={k: {**p, "unit": unit} for k, p in finding.parameters.items()})


def _next(choice: Choice, verdict: Verdict, problem: FrequencyProblem, attempt: Attempt | None) -> str:
    """Return the next measurement for frequency data."""
    has_shapes = any(isinstance(d, Response) or d.shapes.shape[1] > 2 for d in problem.measured)
    if verdict == "nothing-missing":
        return "responses at a level several times higher, which bring out what goes with the amplitude"
    if not has_shapes:
        return (
            "mode shapes, or responses at as many points as there are places left, with the force at two of them: "
            "frequencies and damping ratios alone do not say where"
        )
    return next_measurement(choice, verdict, (), attempt)


def _notes(problem: FrequencyProblem, found: FrequencyFound, choice: Choice, left_out: LeftOut | None) -> list[str]:
    out = list(problem.view.left_out)
    aside = [name for name, _ in problem.case.recordings()]
    if aside:
        out.append(f"[[recording]] {', '.join(aside)} not used: the case has responses and tables of modes to fit")
    out += unused(problem.case.table.model.uncertain, problem.parameters)
    out += [
        f"{name} drives held-out data alone: its gain, known to {100 * sd:.2g} %, has its likeliest value there"
        for name, sd in problem.unfitted.items()
    ]
    if not problem.held_out:
        out.append("no hold-out data: nothing can be verified on data that the search did not use")
    if left_out is not None:
        text = (
            f"left out one after the other, {left_out.parts} parts of the data are predicted within {100 * left_out.before:.2g} % by the "
            "calibrated model"
        )
        if choice.best.terms:
            text += f" and within {100 * left_out.after:.2g} % with {choice.best.label}"
        out.append(f"{text} (noise {100 * left_out.noise:.2g} %)")
    out.append(
        f"{found.tried} effects at places were tried; an effect pays for that in its score, which gains "
        f"{choice.best.score - found.before.score:.3g} here"
        if choice.best.terms
        else f"{found.tried} effects at places were tried"
    )
    far = implausible_parameters(problem.parameters, choice.best.fit.theta)
    out += far
    best = found.hypotheses[0] if found.hypotheses else None
    if not choice.best.terms and far and best is not None and best.score > found.before.score:
        odds = np.exp(min(best.score - found.before.score, FREQUENCY_VERDICT.most_log_odds))
        out.append(
            f"{best.label} is {odds:.2g} times as likely as parameters so far off, which is too little to report it as found: "
            "state in [model.uncertain] what is known of them"
        )
    out += level_notes(problem.measured, found.trends)
    if has_levels(problem):
        out += level_scale_notes(problem.measured)
    elif any(isinstance(d, Response) and d.level is None for d in (*problem.measured, *problem.held_out)):
        out.append("nonlinear effects were not tried: state level in each [[frf]], for at least two levels to fit")
    return out


def _mismatch(checked: Sequence[CheckedFrequency]) -> dict[str, Any]:
    """Return the largest residuals by band and channel."""
    bands: list[dict[str, Any]] = []
    channels: dict[str, float] = {}
    for c in checked:
        for name, errors in c.channels.items():
            channels[name] = max(channels.get(name, 0.0), errors[1])
        if isinstance(c.measured, Response):
            bands += _bands(c.measured, c)
        else:
            bands += _modes(c.measured, c)
    bands.sort(key=lambda b: -b["share"] * b["nrmse"] ** 2)
    return {
        "where_frequency_hz": bands[:4],
        "where_channel": [{"channel": n, "nrmse": channels[n]} for n in sorted(channels, key=lambda c: -channels[c])],
        "where_time_s": [],
    }


def _bands(data: Response, c: CheckedFrequency) -> list[dict[str, Any]]:
    own = c.standing
    assert isinstance(own, np.ndarray)
    error = np.nan_to_num(apart(data, own)).mean(axis=1)
    edges = np.geomspace(data.freq[0], data.freq[-1] * (1 + 1e-9), FREQUENCY_VERDICT.bands + 1)
    out = []
    for low, high in pairwise(edges):
        inside = (data.freq >= low) & (data.freq < high)
        if inside.any():
            share = float(error[inside].sum() / max(error.sum(), 1e-300))
            out.append({"low_hz": float(low), "high_hz": float(high), "share": share, "nrmse": c.before})
    return out


def _modes(data: Modes, c: CheckedFrequency) -> list[dict[str, Any]]:
    own = c.standing
    assert not isinstance(own, np.ndarray)
    error = (modal_errors(data, own)["frequency"] / data.freq_sd) ** 2
    return [
        {"low_hz": float(f), "high_hz": float(f), "share": float(e / max(error.sum(), 1e-300)), "nrmse": c.before}
        for f, e in zip(data.freq, error, strict=True)
    ]
