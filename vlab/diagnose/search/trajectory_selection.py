"""Search in time on the trajectory-linearised model class."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial

from vlab.diagnose.inference.calibration import calibrate
from vlab.diagnose.inference.evidence import Found, Hypothesis
from vlab.diagnose.inference.hypothesis_fits import (
    by_score,
    each_fitted,
    finished,
    fitted,
    floor_of,
    near_best,
    other_places,
    pairs_fitted,
    scored_by,
)
from vlab.diagnose.inference.model_choice import choose_model
from vlab.diagnose.inference.prior_check import has_plausible_parameters
from vlab.diagnose.inference.simulator_least_squares import SimulatorLeastSquares
from vlab.diagnose.inference.trajectory_least_squares import TrajectoryLeastSquares
from vlab.diagnose.inference.trajectory_score_test import TrajectoryScoreTest
from vlab.diagnose.inference.whole_run_fits import changed_alike, fitted_on_both, on_whole_runs
from vlab.diagnose.parameters.terms import Candidate, Fit
from vlab.diagnose.search.deadline import Deadline
from vlab.diagnose.search.forward_selection import ForwardSelection, best_of_labels, in_all_joints
from vlab.diagnose.search.limits import NO_LIMITS, Limits
from vlab.diagnose.search.selection import TimeFound, shows
from vlab.diagnose.search.shortlist import best_of_effects, completing, shortlisted
from vlab.diagnose.settings import HYPOTHESIS_FITS, PROBLEM, SCORE_TEST, SECOND_EFFECT, SELECTION, SHORTLIST
from vlab.parallel import side_by_side
from vlab.physics.effect import Effect


def search_moving(
    screen: TrajectoryScoreTest,
    effects: Sequence[Effect],
    report: Callable[[float, str], None],
    limits: Limits = NO_LIMITS,
) -> TimeFound:
    """Search the missing physics along the motion.

    The procedure is that of `vlab.diagnose.search.selection.search`.

    Parameters
    ----------
    screen : TrajectoryScoreTest
        Screening along the motion.
    effects : sequence of Effect
        Candidate effects.
    report : callable
        Receives the completed share and the current step.
    limits : Limits
        Limits of the search.

    Returns
    -------
    TimeFound
        Hypotheses.
    """
    problem, deadline = screen.problem, limits.deadline
    effects = [effect for effect in effects if shows(problem, effect)]
    report(0.2, "calibrating")
    renewed, start = calibrate(screen)
    # implausible parameters absorb missing physics, which the screening about them would not see
    if start is not None and has_plausible_parameters(start):
        screen = renewed
    else:
        start = None
    report(0.3, "screening")
    candidates = screen.candidates(effects)
    narrow, whole = TrajectoryLeastSquares(screen), TrajectoryLeastSquares(screen, whole=True)
    before = scored_by(narrow, narrow.fit((), start))
    shortlist = side_by_side(screen.zoomed, shortlisted(candidates))
    if before.normalised_residual > HYPOTHESIS_FITS.enough:
        report(0.45, "screening with a slower observer")
        shortlist += _seen_by_slow_observer(screen, effects, shortlist)
    screen.forget()
    report(0.5, "fitting single effects")
    hypotheses = singles = finished(narrow, each_fitted(narrow, shortlist, before.fit))
    is_enough = limits.forbid_more(before, singles, HYPOTHESIS_FITS.enough)
    if _leave_much(hypotheses) and not is_enough:
        report(0.6, "fitting laws in all joints")
        everywhere = in_all_joints(candidates, lambda terms, start: fitted(narrow, terms, start), before.fit)
        hypotheses = by_score(hypotheses, finished(narrow, everywhere))
    if _leave_much(hypotheses) and not (is_enough or deadline.is_past):
        report(0.65, "fitting pairs of effects")
        pairs = _pairs(screen, narrow, shortlist, candidates, singles, effects, before.fit)
        hypotheses = by_score(hypotheses, finished(narrow, pairs))
    report(0.85, "fitting whole recordings")
    if hypotheses:  # again about the best hypothesis' calibrated plant, where the uncertain parameters change little
        screen = screen.at(hypotheses[0].fit.theta)
        narrow, whole = TrajectoryLeastSquares(screen), TrajectoryLeastSquares(screen, whole=True)
        hypotheses = finished(narrow, hypotheses)
        before = scored_by(narrow, narrow.fit((), before.fit))
    (before,) = on_whole_runs(whole, narrow, [before])
    of_count = [[h for h in hypotheses if len(h.terms) == n] for n in sorted({len(h.terms) for h in hypotheses})]
    hypotheses = by_score(*(on_whole_runs(whole, narrow, some) for some in of_count))
    if not deadline.is_past:
        report(0.88, "fitting about the best hypothesis")
    windows, whole, before, hypotheses = _about_the_best(narrow, whole, before, hypotheses, deadline)
    report(0.9, "adding effects")
    enough = SELECTION.explains * floor_of(whole)
    selection = ForwardSelection(
        before=before, windows=windows, whole=whole, candidates=candidates, enough=enough, deadline=deadline,
        report=partial(report, 0.9),
    )  # fmt: skip
    hypotheses = best_of_labels(hypotheses) if is_enough else selection.extend(hypotheses)
    places = other_places(narrow, hypotheses[0], candidates, before.fit) if hypotheses else {}
    error = _estimated_error(whole, choose_model(Found(before=before, hypotheses=tuple(hypotheses))).best, deadline)
    return TimeFound(
        problem=problem,
        screen=whole.moving,
        windows=narrow,
        whole=SimulatorLeastSquares(whole.moving, is_final=True, model_error=error),
        before=before,
        hypotheses=tuple(hypotheses),
        places=places,
        candidates=tuple(candidates),
    )


def _estimated_error(whole: TrajectoryLeastSquares, best: Hypothesis, deadline: Deadline) -> float:
    """Return the model error that the best hypothesis leaves in MuJoCo.

    The allowed model error is an upper bound, and the likelihood of a smaller one is larger while the normalised residual
    is below one. Under too large an error the prior of the uncertain parameters weighs too much.
    """
    fit, found = best.long_fit, whole.model_error
    if best.normalised_residual > 1.0:
        return found
    for model_error in _smaller_errors(found, deadline):
        finer = SimulatorLeastSquares(whole.moving, model_error=model_error)
        fit = finer.fit(best.terms, fit)
        if finer.residual_in_mujoco(fit) > 1.0:
            break
        found = model_error
    return found


def _smaller_errors(model_error: float, deadline: Deadline) -> Iterator[float]:
    """Return smaller model errors, down to the error of integration."""
    while not deadline.is_past and SELECTION.finer * model_error >= PROBLEM.integration_error:
        model_error *= SELECTION.finer
        yield model_error


def _about_the_best(
    windows: TrajectoryLeastSquares,
    whole: TrajectoryLeastSquares,
    before: Hypothesis,
    hypotheses: list[Hypothesis],
    deadline: Deadline,
) -> tuple[TrajectoryLeastSquares, TrajectoryLeastSquares, Hypothesis, list[Hypothesis]]:
    """Return fits and hypotheses in MuJoCo, or with a smaller error.

    MuJoCo counts where every hypothesis leaves more than the linear system's noise and error, the smaller error where one
    explains what calibration leaves.
    """
    if deadline.is_past or not hypotheses:
        return windows, whole, before, hypotheses
    if _leave_much(hypotheses):
        exact, bare, others = _in_mujoco(whole.moving, before, hypotheses)
        linear = scored_by(whole, hypotheses[0].long_fit)
        if others[0].normalised_residual < linear.normalised_residual:  # elsewhere the corrections do not converge
            return exact, exact, bare, others
    elif _leave_much([before]):
        return _with_smaller_error(windows, whole, before, hypotheses, deadline)
    return windows, whole, before, hypotheses


def _with_smaller_error(
    windows: TrajectoryLeastSquares,
    whole: TrajectoryLeastSquares,
    before: Hypothesis,
    hypotheses: list[Hypothesis],
    deadline: Deadline,
) -> tuple[TrajectoryLeastSquares, TrajectoryLeastSquares, Hypothesis, list[Hypothesis]]:
    """Return fits and hypotheses with a smaller model error.

    The allowed model error is an upper bound. An effect that explains the recordings shows that the model errs less. Under
    too large an error small effects hide, and the prior of the uncertain parameters weighs too much.

    Parameters
    ----------
    windows, whole : TrajectoryLeastSquares
        Fits in windows and to whole runs.
    before : Hypothesis
        Calibrated model, which does not explain the recordings.
    hypotheses : list of Hypothesis
        Hypotheses by score; the best one explains the recordings.
    deadline : Deadline
        End of the time for further fits.

    Returns
    -------
    tuple
        The first four arguments, with the smallest error at which a hypothesis explains the recordings.
    """
    for model_error in _smaller_errors(whole.model_error, deadline):
        finer, fine = (
            TrajectoryLeastSquares(whole.moving, whole=is_whole, model_error=model_error) for is_whole in (False, True)
        )
        leading = near_best(hypotheses)
        bare, *fits = side_by_side(partial(_refitted, fine, finer), [before, *leading])
        if _leave_much(fits):
            break  # the model errs by more than this
        windows, whole, before = finer, fine, bare
        hypotheses = by_score(fits, changed_alike(hypotheses[len(leading) :], leading, fits))
    return windows, whole, before, hypotheses


def _refitted(whole: TrajectoryLeastSquares, windows: TrajectoryLeastSquares, h: Hypothesis) -> Hypothesis:
    """Return a hypothesis fitted again."""
    return replace(fitted_on_both(whole, windows, h.terms, h.long_fit), log_likelihood_gain=h.log_likelihood_gain)


def _in_mujoco(
    screen: TrajectoryScoreTest, before: Hypothesis, hypotheses: Sequence[Hypothesis]
) -> tuple[SimulatorLeastSquares, Hypothesis, list[Hypothesis]]:
    """Return fits in MuJoCo about the best hypothesis.

    A large effect changes the motion beyond first order. The residual of the linear system is then its own error, in which
    further effects hide.

    Parameters
    ----------
    screen : TrajectoryScoreTest
        Screening along the motion.
    before : Hypothesis
        Calibrated model.
    hypotheses : sequence of Hypothesis
        Hypotheses by score, fitted on the linear system.

    Returns
    -------
    whole : SimulatorLeastSquares
        Fits to whole runs, linearised at the best hypothesis' parameters.
    before : Hypothesis
        Calibrated model, scored in MuJoCo.
    hypotheses : list of Hypothesis
        Hypotheses by score, the leading ones fitted and scored in MuJoCo.
    """
    screen, _ = calibrate(screen, hypotheses[0].long_fit)
    whole = SimulatorLeastSquares(screen)

    def again(h: Hypothesis) -> Hypothesis:
        fit = whole.fit(h.terms, h.long_fit)
        return replace(scored_by(whole, fit, h.log_likelihood_gain), whole=fit)

    leading = near_best(hypotheses)
    before, *scored = side_by_side(again, [before, *leading])
    rest = changed_alike(hypotheses[len(leading) :], leading, scored)
    return whole, before, by_score(scored, rest)


def _seen_by_slow_observer(
    screen: TrajectoryScoreTest, effects: Sequence[Effect], shortlist: Sequence[Candidate]
) -> list[Candidate]:
    """Return the further candidates that a slow observer shortlists."""
    known = {c.label for c in shortlist}
    slower = screen.trusting(SCORE_TEST.slow)
    slow = shortlisted(slower.candidates(effects))[: SELECTION.slow_shortlist]
    return side_by_side(slower.zoomed, [c for c in slow if c.label not in known])


def _leave_much(hypotheses: Sequence[Hypothesis]) -> bool:
    """Return whether every hypothesis leaves more than noise and allowed model error."""
    return bool(hypotheses) and min(h.normalised_residual for h in hypotheses) > HYPOTHESIS_FITS.enough


def _pairs(
    screen: TrajectoryScoreTest,
    refiner: TrajectoryLeastSquares,
    shortlist: Sequence[Candidate],
    candidates: Sequence[Candidate],
    singles: Sequence[Hypothesis],
    effects: Sequence[Effect],
    start: Fit,
) -> list[Hypothesis]:
    """Return fits of second effects with the best single ones.

    The first effect of the best pair may stand in for another one that shows beside the second only. The second alone is
    therefore a seed, too, as in sequential replacement (Miller, Selection of subsets of regression variables, J. R. Stat.
    Soc. A 147 (1984) 389-425).
    """
    by_label = {c.label: c for c in shortlist}
    of_family: dict[str, Hypothesis] = {}  # forms of one law, as of friction, lead to the same pairs
    for h in singles:
        of_family.setdefault(h.terms[0].effect.family, h)
    seeds = list(of_family.values())[: SECOND_EFFECT.seeds]

    def beside(first: Candidate) -> list[Candidate]:
        table = screen.given([first]).candidates(effects)
        others = [c for c in table if c.effect.name != first.effect.name]  # one effect at two places is misplaced
        return [
            c for c in best_of_effects(others)[: SECOND_EFFECT.seconds] if c.log_likelihood_gain > SHORTLIST.least_gain
        ]

    found = {frozenset((s.label, c.label)): (s, c) for s in seeds for c in completing(s.terms[0], candidates)}
    for seed in seeds:
        for second in beside(by_label[seed.label]):
            found.setdefault(frozenset((seed.label, second.label)), (seed, second))
    fits = pairs_fitted(refiner, list(found.values()))
    if not fits or not _leave_much(fits):
        return fits
    second = min(zip(fits, found.values(), strict=True), key=lambda pair: -pair[0].score)[1][1]
    (alone,) = each_fitted(refiner, [second], start)
    replaced = {frozenset((second.label, c.label)): (alone, c) for c in beside(second)}
    return fits + pairs_fitted(refiner, [pair for labels, pair in replaced.items() if labels not in found])
