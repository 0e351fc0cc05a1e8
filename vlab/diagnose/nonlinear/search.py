"""The search far from rest: that of `vlab.diagnose.search`, on the system along the motion."""

from collections.abc import Callable, Sequence

from vlab.diagnose.hypothesis import Hypothesis
from vlab.diagnose.nonlinear.polish import SimulatedRefiner
from vlab.diagnose.nonlinear.prepare import Moving
from vlab.diagnose.nonlinear.refine import MovingRefiner
from vlab.diagnose.nonlinear.screen import MovingScreen
from vlab.diagnose.parallel import side_by_side
from vlab.diagnose.prepare import Problem
from vlab.diagnose.refine import ITERATIONS
from vlab.diagnose.search import (
    ENOUGH,
    FINISHED,
    LEAST_GAIN,
    QUICK,
    SECONDS,
    SEEDS,
    SLOW,
    SLOW_SHORTLIST,
    TimeFound,
    on_whole_runs,
    other_places,
    scored_by,
    shortlisted,
    shows,
    terms_of,
)
from vlab.diagnose.terms import Candidate, Fit, Term
from vlab.physics.effect import Effect, SensorEffect


def search_moving(
    problem: Problem, moving: Moving, effects: Sequence[Effect], report: Callable[[float, str], None]
) -> TimeFound:
    """Search what is missing on a problem's fit runs, along their motion; see `vlab.diagnose.search.search`."""
    effects = [effect for effect in effects if shows(problem, effect)]
    report(0.05, "finding the motion")
    screen = MovingScreen(problem, moving)
    report(0.3, "screening")
    candidates = screen.candidates(effects)
    narrow, whole = MovingRefiner(screen), MovingRefiner(screen, whole=True)
    before = scored_by(narrow, narrow.fit())
    shortlist = shortlisted(candidates)
    if before.level > ENOUGH:
        report(0.45, "screening with a slower observer")
        known = {c.label for c in shortlist}
        slow = shortlisted(screen.trusting(SLOW).candidates(effects))[:SLOW_SHORTLIST]
        shortlist += [c for c in slow if c.label not in known]
    screen.forget()
    report(0.5, "fitting single effects")
    fitted = side_by_side(lambda c: _fitted(narrow, [c], before.fit), shortlist)
    fitted = _finished(narrow, fitted)
    if fitted and min(h.level for h in fitted) > ENOUGH:
        report(0.65, "fitting pairs of effects")
        fitted += _finished(narrow, _pairs(screen, narrow, shortlist, fitted, effects))
        fitted.sort(key=lambda h: -h.score)
    report(0.85, "fitting whole recordings")
    if fitted:  # once more about the refitted plant of the best hypothesis: what is uncertain then changes by little
        screen = screen.at(fitted[0].fit.theta)
        narrow, whole = MovingRefiner(screen), MovingRefiner(screen, whole=True)
        fitted = _finished(narrow, fitted)
        before = scored_by(narrow, narrow.fit((), before.fit))
    (before,) = on_whole_runs(whole, narrow, [before])
    fitted = [h for n in (1, 2) for h in on_whole_runs(whole, narrow, [h for h in fitted if len(h.terms) == n])]
    fitted.sort(key=lambda h: -h.score)
    places = other_places(lambda terms: _for(narrow, terms), fitted[0], candidates, before.fit) if fitted else {}
    return TimeFound(
        problem=problem,
        screen=screen,
        windows=narrow,
        whole=SimulatedRefiner(screen),
        before=before,
        hypotheses=tuple(fitted),
        places=places,
        candidates=tuple(candidates),
    )


def _for(refiner: MovingRefiner, terms: Sequence[Term]) -> MovingRefiner:
    """Return the refiner of a hypothesis: windows of its own where it says that a sensor is wrong."""
    wrong = [(t.effect, t.place, dict(t.values)) for t in terms if isinstance(t.effect, SensorEffect)]
    return MovingRefiner(refiner.moving, without=wrong) if wrong else refiner


def _fitted(refiner: MovingRefiner, candidates: Sequence[Candidate], start: Fit) -> Hypothesis:
    terms = terms_of(candidates)
    own = _for(refiner, terms)
    return scored_by(own, own.fit(terms, start, QUICK), sum(c.gain for c in candidates))


def _finished(refiner: MovingRefiner, hypotheses: list[Hypothesis]) -> list[Hypothesis]:
    """Return hypotheses by score, the best of them fitted to the end."""
    order = sorted(hypotheses, key=lambda h: -h.score)

    def finished(h: Hypothesis) -> Hypothesis:
        own = _for(refiner, h.terms)
        return scored_by(own, own.fit(h.terms, h.fit, ITERATIONS), h.gain)

    done = side_by_side(finished, order[:FINISHED])
    return sorted([*done, *order[FINISHED:]], key=lambda h: -h.score)


def _pairs(
    screen: MovingScreen,
    refiner: MovingRefiner,
    shortlist: Sequence[Candidate],
    fitted: Sequence[Hypothesis],
    effects: Sequence[Effect],
) -> list[Hypothesis]:
    """Return fits of a second effect on top of the best single ones, by what it gains beside them in the screening."""
    by_label = {c.label: c for c in shortlist}
    pairs: dict[frozenset[str], tuple[Hypothesis, Candidate]] = {}
    for seed in fitted[:SEEDS]:
        best: dict[str, Candidate] = {}
        for candidate in screen.given([by_label[seed.label]]).candidates(effects):
            if candidate.effect.name != seed.terms[0].effect.name:  # at two places it is one effect, placed badly
                best.setdefault(candidate.effect.name, candidate)
        for second in list(best.values())[:SECONDS]:
            if second.gain > LEAST_GAIN:
                pairs.setdefault(frozenset((seed.label, second.label)), (seed, second))

    def fit(pair: tuple[Hypothesis, Candidate]) -> Hypothesis:
        seed, second = pair
        terms = [*seed.terms, *terms_of([second])]
        own = _for(refiner, terms)
        return scored_by(own, own.fit(terms, seed.fit, QUICK), seed.gain + second.gain)

    return side_by_side(fit, list(pairs.values()))
