"""Search in time, from screening to scores."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from vlab.diagnose.inference.evidence import Found, Hypothesis, weighed
from vlab.diagnose.inference.hypothesis_fits import (
    as_meant,
    by_score,
    each_fitted,
    finished,
    floor_of,
    hopeful,
    other_places,
    scored_by,
    with_tolerances,
)
from vlab.diagnose.inference.least_squares import LeastSquares
from vlab.diagnose.inference.score_test import ScoreTest
from vlab.diagnose.inference.whole_run_fits import on_whole_runs
from vlab.diagnose.inference.window_least_squares import WindowLeastSquares
from vlab.diagnose.parameters.terms import Candidate
from vlab.diagnose.problem import Problem
from vlab.diagnose.search.forward_selection import ForwardSelection, best_of_labels
from vlab.diagnose.search.limits import NO_LIMITS, Limits
from vlab.diagnose.search.permanent_change import find_permanent_changes
from vlab.diagnose.search.second_effect import (
    ablate_pairs,
    demands_another_effect,
    in_other_forms,
    pairs,
    violate_priors,
)
from vlab.diagnose.search.shortlist import (
    best_of_effects,
    best_places,
    is_another_start,
    related_candidates,
    shortlisted,
)
from vlab.diagnose.settings import FIT, HYPOTHESIS_FITS, SCORE_TEST, SECOND_EFFECT, SELECTION
from vlab.parallel import side_by_side
from vlab.physics.effect import Effect
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class TimeFound(Found):
    """Result of a search in time.

    Parameters
    ----------
    problem : Problem
        Problem.
    screen : ScoreTest
        Screening.
    windows, whole : LeastSquares
        Fits in windows and to whole runs.
    candidates : tuple of Candidate
        Screening by gain.
    """

    problem: Problem
    screen: ScoreTest
    windows: LeastSquares
    whole: LeastSquares
    candidates: tuple[Candidate, ...] = ()


def search(
    screen: ScoreTest,
    effects: Sequence[Effect],
    progress: Callable[[float, str], None] | None = None,
    limits: Limits = NO_LIMITS,
) -> TimeFound:
    """Search the missing physics in a screening's runs.

    Parameters
    ----------
    screen : ScoreTest
        Screening.
    effects : sequence of Effect
        Candidate effects.
    progress : callable or None
        Receives the completed share and the current step.
    limits : Limits
        Limits of the search.

    Returns
    -------
    TimeFound
        Hypotheses.
    """
    problem = screen.problem
    report = progress or (lambda share, what: None)
    effects = [effect for effect in effects if shows(problem, effect)]
    report(0.05, "screening")
    candidates = _sharpened(screen, screen.candidates(effects))
    narrow, in_windows = _calibrated_error(screen)
    whole = LeastSquares(screen, problem.in_role("fit"), narrow.model_error)
    rough = WindowLeastSquares(screen, every=2, model_error=narrow.model_error)
    starts = [screen.theta, screen.reduced_model.start]
    (before,) = on_whole_runs(whole, narrow, [in_windows], thetas=starts, iterations=FIT.iterations)
    steps = _TimeSearch(
        screen=screen, effects=effects, candidates=candidates, narrow=narrow, rough=rough, whole=whole,
        in_windows=in_windows, before=before, report=report,
    )  # fmt: skip
    shortlist, singles = steps.single_effects()
    screen.forget()
    report(0.4, "fitting whole recordings")
    hypotheses = singles = steps.singles_on_whole_runs(shortlist, singles)
    enough = problem.model_kind.explained_residual(whole.noise_share, whole.error_share)
    is_odd = bool(singles) and violate_priors(
        singles, whole.directions.shape[1], whole.reduced_model.prior, problem.may_vanish
    )
    least = max(enough, HYPOTHESIS_FITS.enough)
    is_demanded = bool(singles) and (is_odd or demands_another_effect(before, singles, enough))
    is_enough = limits.forbid_more(before, singles, least)
    if is_demanded and not is_enough:
        hypotheses = steps.with_pairs(shortlist, singles, is_odd=is_odd)
    report(0.9, "adding effects")
    selection = ForwardSelection(
        before=before, windows=narrow, whole=whole, candidates=candidates, enough=least, deadline=limits.deadline,
        report=partial(report, 0.9),
    )  # fmt: skip
    hypotheses = as_meant(whole, best_of_labels(hypotheses) if is_enough else selection.extend(hypotheses))
    shares = (whole.noise_share, whole.error_share, whole.effective_samples, whole.integration_share)
    before, *hypotheses = weighed([before, *hypotheses], *shares)
    before, *hypotheses = with_tolerances(whole, before, hypotheses, enough, selection.fitted)
    hypotheses = by_score(hypotheses)
    places = other_places(rough, hypotheses[0], candidates, before.fit) if hypotheses else {}
    places = {name: replace(h, effective_samples=before.effective_samples) for name, h in places.items()}
    report(0.95, "choosing")
    return TimeFound(
        problem=problem,
        screen=screen,
        windows=narrow,
        whole=whole,
        before=before,
        hypotheses=tuple(hypotheses),
        places=places,
        candidates=tuple(candidates),
    )


def _best_of_starts(order: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Return the best hypothesis of every label, of hypotheses by score."""
    best: dict[str, Hypothesis] = {}
    for h in order:
        best.setdefault(h.label, h)
    return list(best.values())


@dataclass(frozen=True, kw_only=True, eq=False)
class _TimeSearch:
    """Screening, fits and calibrated model of a search in time.

    Parameters
    ----------
    screen : ScoreTest
        Screening.
    effects, candidates : sequence
        Candidate effects, and the screening's candidates by gain.
    narrow, rough, whole : LeastSquares
        Fits in all windows, in every second window and to whole runs.
    in_windows, before : Hypothesis
        Model calibrated in windows, and on whole runs.
    report : callable
        Receives the completed share and the current step.
    """

    screen: ScoreTest
    effects: Sequence[Effect]
    candidates: Sequence[Candidate]
    narrow: LeastSquares
    rough: LeastSquares
    whole: LeastSquares
    in_windows: Hypothesis
    before: Hypothesis
    report: Callable[[float, str], None]

    @property
    def adds_up(self) -> bool:
        """Whether missing physics shows in whole runs alone, as with light damping."""
        return self.in_windows.normalised_residual <= HYPOTHESIS_FITS.enough < self.before.normalised_residual

    @property
    def calibrated(self) -> list[Array]:
        """Calibrated parameters as starts of a fit.

        At a large residual the parameters absorb missing physics and are no start for a law.
        """
        return [self.before.long_fit.theta] if self.before.normalised_residual < SECOND_EFFECT.much else []

    def single_effects(self) -> tuple[list[Candidate], list[Hypothesis]]:
        """Return the shortlist and fits of single effects, best first.

        Slow observers and laws related to the best one follow where the screening explains too little.
        """
        screen, candidates = self.screen, self.candidates
        self.report(0.2, "fitting single effects")

        def singles(some: Sequence[Candidate]) -> list[Hypothesis]:
            return finished(self.narrow, each_fitted(self.rough, some, self.before.fit))

        shortlist = side_by_side(screen.zoomed, shortlisted(candidates))
        found = singles(shortlist)
        if self.before.normalised_residual <= HYPOTHESIS_FITS.enough:
            return shortlist, found
        if self.adds_up or not (found and found[0].normalised_residual < SELECTION.explains * floor_of(self.narrow)):
            self.report(0.25, "screening with slower observers")
            screen.slower = tuple(
                ScoreTest(screen.problem, screen.runs, trust=t, like=screen)
                for t in (SCORE_TEST.slow, SELECTION.slowest)
            )
            # a fast observer absorbs permanent forces, which a slow one locates elsewhere
            all_places = {c.label for c in candidates if not c.effect.shapes}
            among = best_places(candidates, HYPOTHESIS_FITS.places) | all_places
            for slow in screen.slower:
                slowly = shortlisted(slow.candidates(self.effects, among=among))[: SELECTION.slow_shortlist]
                shortlist += side_by_side(slow.zoomed, [c for c in slowly if is_another_start(c, shortlist)])
                slow.forget()
            found = _best_of_starts(by_score(found, singles(shortlist[len(found) :])))
        return shortlist, by_score(found, singles(side_by_side(screen.zoomed, related_candidates(candidates, found))))

    def singles_on_whole_runs(self, shortlist: Sequence[Candidate], singles: list[Hypothesis]) -> list[Hypothesis]:
        """Return permanent changes and the best single effects, fitted to whole runs."""
        events = (
            find_permanent_changes(self.whole, self.narrow, self.in_windows.fit, self.candidates)
            if self.adds_up
            else []
        )
        known = {h.label for h in events}
        singles = [h for h in singles if h.label not in known]
        return on_whole_runs(
            self.whole,
            self.narrow,
            [*events, *_reward_long_runs(singles, adds_up=self.adds_up)],
            min(SELECTION.whole_singles, hopeful(singles)) + len(events),
            self.calibrated,
            screened=[*shortlist, *self.candidates],
            start=self.before.long_fit,
        )

    def with_pairs(
        self, shortlist: Sequence[Candidate], singles: list[Hypothesis], *, is_odd: bool
    ) -> list[Hypothesis]:
        """Return single effects and pairs by score, all fitted to whole runs.

        Parameters
        ----------
        shortlist : sequence of Candidate
            Fitted candidates.
        singles : list of Hypothesis
            Single effects, best first.
        is_odd : bool
            Whether the single effects violate the priors.
        """
        screen, narrow, candidates = self.screen, self.narrow, self.candidates
        among = best_places(candidates, SECOND_EFFECT.second_places)
        is_clear = not is_odd and singles[0].normalised_residual <= HYPOTHESIS_FITS.enough
        found = pairs(
            screen, self.rough, singles, shortlist, candidates, self.effects, among, self.report, is_clear=is_clear
        )
        doubles = finished(narrow, found)
        doubles = by_score(doubles, in_other_forms(narrow, doubles[: SELECTION.reformed], candidates))
        self.report(0.85, "fitting whole recordings")
        doubles = on_whole_runs(self.whole, narrow, doubles, SELECTION.whole_pairs, self.calibrated)
        alone = ablate_pairs(narrow, doubles[: SELECTION.reformed], singles)
        return by_score(
            [h for h in singles if h.label not in {a.label for a in alone}],
            on_whole_runs(self.whole, narrow, alone, len(alone), self.calibrated),
            doubles,
        )


def _calibrated_error(screen: ScoreTest) -> tuple[LeastSquares, Hypothesis]:
    """Return the window fits, and the calibrated model.

    Where calibration alone reaches the allowed model error, a smaller allowance is taken. MuJoCo's verdict decides on
    effects within the allowance.
    """
    narrow = WindowLeastSquares(screen)
    before = scored_by(narrow, narrow.fit(thetas=[np.zeros_like(screen.theta)]))
    has_mesh_error = screen.problem.model_kind.has_mesh_error  # of the size of the allowance
    if before.normalised_residual > HYPOTHESIS_FITS.enough or has_mesh_error:
        return narrow, before
    finer = WindowLeastSquares(screen, model_error=SELECTION.finer * narrow.model_error)
    return finer, scored_by(finer, finer.fit((), before.fit))


def shows(problem: Problem, effect: Effect) -> bool:
    """Return whether an effect is identifiable from a problem's recordings.

    In a release seen by one sensor, its gain, delay and low-pass only change the apparent initial state.

    Parameters
    ----------
    problem : Problem
        Problem.
    effect : Effect
        Effect.

    Returns
    -------
    bool
        Whether the recordings can show the effect.
    """
    loaded = any(drive.port for run in problem.runs for drive in run.drives)
    driven = loaded or any(np.any(s.u) for s in problem.signals)
    if driven or len(problem.channels) > 1 or effect.kind != "sensor":
        return True
    return effect.traits.shows_without_drive


def _reward_long_runs(order: Sequence[Hypothesis], *, adds_up: bool) -> list[Hypothesis]:
    """Return hypotheses in order of merit for whole-run fits.

    Where windows explain too little, forces of large screening gain follow the best, since windows ignore earlier
    motion.
    """
    if not order or (order[0].normalised_residual <= HYPOTHESIS_FITS.enough and not adds_up):
        return list(order)
    known = {h.label for h in order[: HYPOTHESIS_FITS.whole_finished]}
    forces = [h for h in order if h.terms[0].effect.kind != "sensor"]
    gained = [h for h in sorted(forces, key=lambda h: -h.log_likelihood_gain) if h.label not in known]
    first = [
        *order[: HYPOTHESIS_FITS.whole_finished],
        *gained[: SELECTION.whole_singles - HYPOTHESIS_FITS.whole_finished],
    ]
    chosen = {h.label for h in first}
    return [*first, *(h for h in order if h.label not in chosen)]


def _sharpened(screen: ScoreTest, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return candidates by gain, with refined shapes."""
    all_shape = [c for c in candidates if c.effect.shapes and not c.effect.amplitudes and c.log_likelihood_gain > 0]
    sharp = {c.label: c for c in side_by_side(screen.zoomed, best_of_effects(all_shape))}
    return sorted((sharp.get(c.label, c) for c in candidates), key=lambda c: (-c.log_likelihood_gain, c.label))
