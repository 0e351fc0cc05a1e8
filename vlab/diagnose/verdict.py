"""Verdict of a diagnosis from errors on hold-out recordings."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np

from vlab.diagnose.data.quality import DataQuality
from vlab.diagnose.data_findings import DataFindings
from vlab.diagnose.diagnosis import Attempt, Verdict
from vlab.diagnose.inference.model_choice import Choice
from vlab.diagnose.model_kinds.model_kind import ModelKind
from vlab.diagnose.settings import EVIDENCE, GAP, MODEL_CHOICE, PROBLEM, VERDICT
from vlab.diagnose.validation.checked import Checked
from vlab.diagnose.validation.gap import Distance, gap_closed, predicts_better, total, verifying
from vlab.physics.small_signal import is_linear


def errors_of(checked: Sequence[Checked]) -> dict[str, float]:
    """Return the errors of both models, and the noise."""
    return {key: total(checked, key) for key in ("before", "after", "noise")}


def closes_gap(checked: Sequence[Checked], *, model_kind: ModelKind) -> bool:
    """Return whether the findings close enough of the gap.

    The criterion is the gap over all recordings. Alternatively most recordings must be nearly closed and every
    recording half, since one recording far beyond the fitted motion dominates the sum. Only recordings with an effect
    of a finding count, from the error without findings.

    Parameters
    ----------
    checked : sequence of Checked
        Errors on recordings.
    model_kind : ModelKind
        Kind of the nominal model.

    Returns
    -------
    bool
        Whether the findings explain enough.
    """
    if any(run.after >= run.lost or _has_lost_a_channel(run) for run in checked):
        return False
    tests = verifying(checked)
    if _is_nearly_closed_in_most(tests):
        return True
    errors = {**errors_of(tests), "start": total(tests, "start")}
    gap = gap_closed(errors["start"], errors["after"], errors["noise"])
    reachable = float(np.hypot(errors["noise"], model_kind.holdout_error))
    share = gap_closed(errors["start"], errors["after"], reachable)
    least = VERDICT.least_near_noise if errors["after"] <= VERDICT.near_noise * errors["noise"] else VERDICT.least_gap
    return gap is not None and gap >= VERDICT.least_to_noise and max(gap, share or 0.0) >= least


def _is_nearly_closed_in_most(tests: Sequence[Checked]) -> bool:
    """Return whether the gap is closed in most recordings.

    The gap is nearly closed in most recordings, and half closed in each.
    """
    gaps = [gap for run in tests if (gap := gap_closed(min(run.start, 1.0), run.after, run.noise)) is not None]
    return bool(len(gaps) > 2 and np.median(gaps) >= VERDICT.nearly_all and min(gaps) >= VERDICT.least_to_noise)


def _is_complete(checked: Sequence[Checked], *, model_kind: ModelKind) -> bool:
    """Return whether the residual is allowed or the gap nearly closed.

    A constant errs by the whole signal, so a nominal model that errs by more widens no gap.
    """
    tests = verifying(checked)
    errors = errors_of(tests)
    gap = gap_closed(min(total(tests, "start"), 1.0), errors["after"], errors["noise"])
    is_nearly_closed = (gap is not None and gap >= VERDICT.nearly_all) or _is_nearly_closed_in_most(tests)
    return is_nearly_closed or not model_kind.is_mismatch(errors["after"], errors["noise"])


def _has_lost_a_channel(run: Checked) -> bool:
    """Return whether a model explains nothing of a channel."""
    most = {name: GAP.lost * run.spread_of(name) for name in run.channels}
    return any(after >= most[name] and noise < 0.5 * most[name] for name, (_, _, after, noise) in run.channels.items())


def is_needed(choice: Choice, checked: Sequence[Checked], *, model_kind: ModelKind) -> bool:
    """Return whether a choice without a gap beats calibration.

    The calibrated model then follows with implausible parameters, or within its mesh error.

    Parameters
    ----------
    choice : Choice
        Choice.
    checked : sequence of Checked
        Errors on recordings.
    model_kind : ModelKind
        Kind of the nominal model.

    Returns
    -------
    bool
        Whether the choice is needed.
    """
    errors = errors_of(checked)
    no_gap = gap_closed(errors["before"], errors["after"], errors["noise"]) is None
    least = GAP.no_worse if choice.is_prior_driven else VERDICT.better
    before, after = errors["before"], errors["after"]
    beyond_noise = [float(np.sqrt(max(e**2 - errors["noise"] ** 2, 0.0))) for e in (before, after)]
    if model_kind.has_mesh_error:  # mesh error biases the parameters, so implausible values prove little
        no_gap, least = no_gap or not model_kind.is_mismatch(errors["before"], errors["noise"]), VERDICT.better_of_mesh
        before, after = beyond_noise
    elif choice.is_prior_driven:  # fits cannot tell residuals within the model error of their weights
        before = float(np.hypot(before, PROBLEM.model_error))
        if not model_kind.is_mismatch(beyond_noise[1], 0.0):  # both explain, and one with implausible parameters
            return choice.gained > 0
    return choice.gained > 0 and (choice.is_prior_driven or no_gap) and after <= least * before


def is_needed_beside_data(choice: Choice, checked: Sequence[Checked], *, model_kind: ModelKind) -> bool:
    """Return whether a choice adds to the findings from the data alone.

    Parameters
    ----------
    choice : Choice
        Choice.
    checked : sequence of Checked
        Errors on recordings with those findings, without and with the choice.
    model_kind : ModelKind
        Kind of the nominal model.

    Returns
    -------
    bool
        False where the findings from the data alone explain the recordings, or the choice improves nothing.
    """
    errors = errors_of(checked)
    is_mismatch = model_kind.is_mismatch(errors["before"], errors["noise"])
    improves = is_mismatch and errors["before"] > GAP.no_worse * errors["after"]
    return improves or closes_gap(checked, model_kind=model_kind) or is_needed(choice, checked, model_kind=model_kind)


def is_within_noise(checked: Sequence[Checked], *, model_kind: ModelKind) -> bool:
    """Return whether the residual is within noise and model error."""
    return not model_kind.is_mismatch(total(checked, "after"), total(checked, "noise"))


def is_incoherent(checked: Sequence[Checked]) -> bool:
    """Return whether the residual is incoherent noise.

    Incoherent noise of any colour depends on neither inputs nor motion. No model predicts noise, so the error of the extended
    model on hold-out recordings bounds the noise from above: short recordings show the coherence of a residual poorly.
    """
    noise = total(checked, "incoherent")
    if all(run.role == "holdout" for run in checked):  # a model follows the noise to which it was fitted
        noise = min(noise, total(checked, "after"))
    return total(checked, "before") <= VERDICT.above_noise * noise


def is_of_the_fit_alone(
    checked: Sequence[Checked], fitted: Callable[[], Sequence[Checked]], *, model_kind: ModelKind
) -> bool:
    """Return whether findings act in the fitted recordings only.

    Parameters
    ----------
    checked : sequence of Checked
        Errors on hold-out recordings.
    fitted : callable
        Returns the errors on fitted recordings.
    model_kind : ModelKind
        Kind of the nominal model.

    Returns
    -------
    bool
        Whether hold-out recordings cannot verify the findings.
    """
    return bool(checked) and all(run.is_idle for run in checked) and closes_gap(fitted(), model_kind=model_kind)


def explains_part(checked: Sequence[Distance]) -> bool:
    """Return whether findings explain a part of the mismatch.

    The findings must predict every hold-out recording better than the best model without findings, and all of them together
    significantly better. Their log-likelihood ratio on hold-out data must exceed that of indistinguishable hypotheses, at the
    effective sample size of model error. Findings that explain most may predict a recording worse that they still predict at
    least as well as the recordings on average: friction and damping of a rig differ from day to day.

    Parameters
    ----------
    checked : sequence of Distance
        Errors on hold-out data.

    Returns
    -------
    bool
        Whether the findings generalise.
    """
    tests, rate = verifying(checked), VERDICT.false_alarm_rate
    if not tests or any(c.is_idle for c in tests):
        return False
    start, after = total(tests, "start"), total(tests, "after")
    worse = [c for c in tests if not c.after < c.start or predicts_better(-c.log_ratios, rate)]
    if worse and not (_leaves_less_than_half(tests) and all(c.after <= after for c in worse)):
        return False
    gain = EVIDENCE.model_error_samples * np.log(start / max(after, np.finfo(float).tiny))
    return bool(after < total(tests, "lost") and gain > MODEL_CHOICE.alike and _predicts_better(tests))


def _predicts_better(checked: Sequence[Distance]) -> bool:
    """Return whether the extended model predicts significantly better over all data."""
    ratios = [ratio for c in checked for ratio in c.log_ratios]
    return predicts_better(np.array(ratios), VERDICT.false_alarm_rate)


def explains_most(checked: Sequence[Distance]) -> bool:
    """Return whether findings explain more of the mismatch than remains.

    Parameters
    ----------
    checked : sequence of Distance
        Errors on hold-out data.

    Returns
    -------
    bool
        Whether the findings generalise and leave less than half of the mean-square mismatch.
    """
    tests = verifying(checked)
    return explains_part(checked) and _leaves_less_than_half(tests)


def _leaves_less_than_half(checked: Sequence[Distance]) -> bool:
    """Return whether less than half of the mean-square mismatch remains."""
    return 2.0 * total(checked, "after") ** 2 <= total(checked, "start") ** 2


def unproven_note(verdict: Verdict, checked: Sequence[Distance]) -> tuple[str, ...]:
    """Return a note on an attempt whose success may be chance.

    Parameters
    ----------
    verdict : Verdict
        Verdict.
    checked : sequence of Distance
        Errors of the best attempt.

    Returns
    -------
    tuple of str
        One note, or none.
    """
    tests = verifying(checked)
    is_held_out = bool(tests) and all(c.role == "holdout" and c.after < c.start < np.inf for c in tests)
    if verdict != "none-of-these" or not is_held_out or not _leaves_less_than_half(tests) or _predicts_better(tests):
        return ()
    return (
        "the best attempt leaves less than half of the mean-square error on the hold-out recordings, but not beyond chance: "
        "hold out more or longer recordings",
    )


def is_partial_explanation(
    attempt: Attempt,
    choice: Choice,
    *,
    errors: Mapping[frozenset[str], float] | None = None,
    model_kind: ModelKind | None = None,
) -> bool:
    """Return whether an attempt is a partial explanation.

    Its effects are determined and generalise, and their families have more than half of the posterior of all fitted
    effects. Beside mesh error they must explain more than they leave, since any effect absorbs a part of the errors of mesh,
    masses and stiffnesses.

    Parameters
    ----------
    attempt : Attempt
        Attempt with errors on hold-out data.
    choice : Choice
        Choice with its ranking.
    errors : mapping of frozenset of str to float or None
        Errors on hold-out data, by the labels of each tried hypothesis.
    model_kind : ModelKind or None
        Kind of the nominal model of recordings in time. Effects that close their gap need no further proof, except beside
        mesh error, which effects absorb.

    Returns
    -------
    bool
        Whether the attempt may be reported.
    """
    families = {finding.family for finding in attempt.findings}
    is_held_out = all(c.role == "holdout" for c in attempt.checked)
    if model_kind is not None and model_kind.has_mesh_error:
        explains = explains_most(attempt.checked)
    else:
        is_closed = model_kind is not None and closes_gap(attempt.checked, model_kind=model_kind)
        explains = is_closed or explains_part(attempt.checked)
    return (
        attempt.holds and is_held_out and explains and choice.given_predictions(errors or {}).share_of(families) > 0.5
    )


def _is_like_mesh_error(choice: Choice) -> bool:
    """Return whether all effects are linear elements of the structure."""
    effects = [term.effect for term in choice.best.terms]
    return bool(effects) and all(effect.kind == "port" and is_linear(effect) for effect in effects)


def follows(checked: Sequence[Checked], *, model_kind: ModelKind, is_plausible: bool) -> bool:
    """Return whether the model without findings explains recordings but for noise.

    Parameters
    ----------
    checked : sequence of Checked
        Errors on recordings.
    model_kind : ModelKind
        Kind of the nominal model.
    is_plausible : bool
        Whether the parameters of the calibrated model are plausible beside noise.

    Returns
    -------
    bool
        Whether the residual is within noise and model error, or incoherent beside plausible parameters.
    """
    if not model_kind.is_mismatch(total(checked, "before"), total(checked, "noise")):
        return True
    return is_plausible and is_incoherent(checked)


def _is_shown_within_model_error(choice: Choice, checked: Sequence[Checked], *, model_kind: ModelKind) -> bool:
    """Return whether an effect stands out within the model error.

    Evidence beyond chance and every hold-out recording must show the effect. Beside mesh error any effect gains. A linear
    effect of that size absorbs the error of a linear model, as a mode with a slightly wrong frequency.
    """
    is_mismatch = model_kind.is_mismatch(total(checked, "before"), total(checked, "noise"))
    is_held_out = all(run.role == "holdout" for run in checked)
    is_sought = is_held_out and not is_mismatch and not model_kind.has_mesh_error
    is_nonlinear = any(not is_linear(term.effect) for term in choice.best.terms)
    return is_sought and is_nonlinear and choice.gained > 0 and explains_part(checked)


def decide_verdict(
    choice: Choice,
    checked: Sequence[Checked],
    seen: DataFindings,
    *,
    model_kind: ModelKind,
    is_plausible: bool = True,
    fitted: Callable[[], Sequence[Checked]] = list,
) -> Verdict:
    """Return the verdict on the checked recordings.

    An explanation that closes the gap is complete where the residual is within noise and model error, or the gap nearly
    closed. Otherwise the explanation is partial.

    A residual counts as coloured noise only beside a calibrated model with plausible parameters. Implausible parameters
    show that the model lacks something, and short recordings show the coherence of a residual poorly. A residual within noise
    and mesh error shows no linear element: wrong masses and stiffnesses of a mesh act like one. A nonlinear effect within
    the model error of other kinds is a partial explanation if the evidence shows it. Nothing is missing only if the fitted recordings are
    explained as well, since a hold-out recording may not excite what is missing.

    Parameters
    ----------
    choice : Choice
        Choice.
    checked : sequence of Checked
        Errors on recordings.
    seen : DataFindings
        Findings from the data alone.
    model_kind : ModelKind
        Kind of the nominal model.
    is_plausible : bool
        Whether the parameters of the calibrated model are plausible beside noise.
    fitted : callable
        Returns the errors on fitted recordings.

    Returns
    -------
    Verdict
        Verdict.
    """
    if seen.damage.fatal:
        return "bad-recording"
    errors = errors_of(checked)
    unexplained = model_kind.is_mismatch(errors["before"], errors["noise"])
    if model_kind.has_mesh_error and not unexplained and not seen.is_missing and _is_like_mesh_error(choice):
        return "nothing-missing"
    if not seen.is_missing and is_of_the_fit_alone(checked, fitted, model_kind=model_kind):
        return "none-of-these"
    if (choice.best.terms or seen.is_missing) and closes_gap(checked, model_kind=model_kind):
        return "missing-physics" if _is_complete(checked, model_kind=model_kind) else "partly-explained"
    is_followed = errors["before"] <= VERDICT.above_noise * errors["noise"] or (
        model_kind.has_mesh_error and not unexplained
    )
    # with implausible parameters; where the effect leaves more than noise, another one may make them plausible
    is_left = choice.best.normalised_residual > MODEL_CHOICE.above_noise
    is_followed = is_followed or (choice.is_prior_driven and not unexplained and not is_left)
    # no gap remains where quantisation counts as noise, or no hold-out recording reaches a limit
    shows = bool(seen.stops) and errors["after"] <= GAP.no_worse * errors["before"]
    shows = shows or (bool(seen.steps) and _predicts_better(checked))
    tests = not all(run.is_idle for run in checked)
    if is_followed and (shows or (tests and is_needed(choice, checked, model_kind=model_kind))):
        return "missing-physics"
    if _is_shown_within_model_error(choice, checked, model_kind=model_kind):
        return "partly-explained"
    follow = partial(follows, model_kind=model_kind, is_plausible=is_plausible)
    if follow(checked) and follow(fitted()):
        return "nothing-missing"
    if not seen.damage.warnings:
        return "none-of-these"
    may_be_damage = _may_be_damage(seen.damage, [*checked, *fitted()], model_kind=model_kind)
    return "bad-recording" if may_be_damage else "none-of-these"


def _may_be_damage(damage: DataQuality, checked: Sequence[Checked], *, model_kind: ModelKind) -> bool:
    """Return whether damage may explain the mismatch.

    Damage explains no mismatch that a recording shows before its first damage.
    """

    def is_shown(run: Checked) -> bool:
        sound = run.error_until(damage.since.get(run.name, np.inf))
        return model_kind.is_mismatch(sound, run.noise)

    return not any(is_shown(run) for run in checked)
