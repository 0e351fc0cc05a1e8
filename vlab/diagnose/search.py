"""The search: hypotheses from the screening, fitted in windows, scored, and the best ones fitted over whole runs."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from vlab.diagnose.hypothesis import Found, Hypothesis, scored, weighed
from vlab.diagnose.parallel import side_by_side
from vlab.diagnose.prepare import Problem
from vlab.diagnose.refine import ITERATIONS, Refiner
from vlab.diagnose.screen import Screen
from vlab.diagnose.second import besides, best_of_families
from vlab.diagnose.signals import windows
from vlab.diagnose.terms import Candidate, Fit, Term
from vlab.physics.effect import Effect, PortEffect, SensorEffect
from vlab.signals import Array

SHORTLIST = 6
"""Effects that are fitted because they gained most in the screening."""
FAMILIES = 4
"""Effects of other families that are fitted besides."""
LEAST_GAIN = 3.0
"""Log-likelihood that a candidate must gain in the screening to be fitted for its family's sake."""
WHOLE = 3000
"""Runs up to this many samples are not cut into windows: what changes slowly with the amplitude shows in whole runs only."""
WHOLE_ITERATIONS, WHOLE_SINGLES, WHOLE_PAIRS, WHOLE_FINISHED = 5, 7, 4, 3
SLOW, SLOWEST, SLOW_SHORTLIST = 1e-3, 1e-6, 5
"""Where something is to be explained, observers that trust the model more, by these factors in the unknown forces, look as well: they
forget slowly and see what only adds up over many cycles; the slowest sees stiffness and damping of a ring-down change with its size."""
KINDRED = (
    {"friction", "hysteresis"},
    {"nonlinear-stiffness", "contact", "clearance"},
    {"timing", "sensor-dynamics"},
    {"saturation", "clearance"},
)
"""Families whose laws look alike in a linear regression."""
EXPLAINS = 1.05
"""A single effect that leaves no more than this multiple of what noise leaves needs neither slower observers nor a second effect."""
CLEAR = 60.0
"""Gain in the screening above which an effect stands out."""
SECONDS, MOST_SECONDS = 3, 60
SIBLINGS = 3
SEEDS = 2
"""Second effects, of a family each, tried on top of each of the best single ones."""
ENOUGH, ENOUGH_OF_MESH = 1.3, 1.6
"""A refitted model that leaves no more than this multiple of the noise lacks nothing that is worth much time; nor does a hypothesis
of one of the two structures, whose meshes err by as much as a small second effect does."""
PART, MUCH = 0.2, 3.0
"""...and something is left that one effect explains this share of, or that is more than this multiple of the noise..."""
SECOND_PLACES, MOST_PAIRS = 10, 14
"""Places of every effect, as the first screening ranks them, at which it is sought as a second one; pairs that are fitted."""
FAR_FETCHED = 20.0
"""...unless it takes uncertain parameters that are less likely than their priors' means by e to this power."""
HOPELESS = 12.0
"""Once something explains the recordings, what scores less by this much after a quick fit is not fitted any further."""
FINER = 0.5
"""Share of the simulation's allowed error that is allowed where a refit alone stays within it."""
QUICK, FINISHED = 5, 4
"""Iterations of the first fit of every hypothesis, and how many of the best are fitted to the end."""
PLACES = 5
"""Places at which the chosen effect is fitted again."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TimeFound(Found):
    """What the search in recordings found.

    Parameters
    ----------
    windows, whole : Refiner
        Fits in windows and over whole runs.
    candidates : tuple of Candidate
        The screening's table, best first.
    """

    problem: Problem
    screen: Screen
    windows: Refiner
    whole: Refiner
    candidates: tuple[Candidate, ...] = ()


def search(
    problem: Problem, effects: Sequence[Effect], progress: Callable[[float, str], None] | None = None
) -> TimeFound:
    """Search what is missing on a problem's fit runs.

    Parameters
    ----------
    effects : sequence of Effect
        What may be missing.
    progress : callable or None
        Called with the share done and what is being done.
    """
    report = progress or (lambda share, what: None)
    effects = [effect for effect in effects if shows(problem, effect)]
    report(0.05, "screening")
    screen = Screen(problem)
    candidates = _sharpened(screen, screen.candidates(effects))
    narrow, before = _refitted(screen)
    whole = Refiner(screen, problem.in_role("fit"), narrow.model_error)
    rough = in_windows(screen, every=2, model_error=narrow.model_error)
    shortlist, fitted = _single_effects(screen, narrow, rough, before, candidates, effects, report)
    screen.forget()
    report(0.4, "fitting whole recordings")
    (before,) = on_whole_runs(whole, narrow, [before], thetas=[np.zeros_like(screen.theta)])
    # far from the recordings the refitted parameters make up for missing physics: nothing to start a law from
    plain = [before.long_fit.theta] if before.level < MUCH else []
    fitted = on_whole_runs(whole, narrow, _worth_long_runs(fitted), min(WHOLE_SINGLES, _hopeful(fitted)), plain)
    enough = EXPLAINS * _floor(whole) if problem.case.structure is None else ENOUGH_OF_MESH
    if fitted and _wants_a_second(before, fitted, enough, whole.directions.shape[1]):
        among = _best_places(candidates, SECOND_PLACES)
        pairs = _finished(narrow, _pairs(screen, rough, fitted, shortlist, effects, among, report))
        report(0.85, "fitting whole recordings")
        fitted += on_whole_runs(whole, narrow, pairs, WHOLE_PAIRS, plain)
        fitted.sort(key=lambda h: -h.score)
    fitted = [h for h in fitted if _is_meant(h)]
    before, *fitted = weighed([before, *fitted], whole.noise_share, whole.error_share, whole.worth)
    fitted.sort(key=lambda h: -h.score)
    places = other_places(lambda terms: _for(rough, terms, 2), fitted[0], candidates, before.fit) if fitted else {}
    places = {name: replace(h, worth=before.worth) for name, h in places.items()}
    report(0.95, "choosing")
    return TimeFound(
        problem=problem,
        screen=screen,
        windows=narrow,
        whole=whole,
        before=before,
        hypotheses=tuple(fitted),
        places=places,
        candidates=tuple(candidates),
    )


def _refitted(screen: Screen) -> tuple[Refiner, Hypothesis]:
    """Return the fits in windows, and the first of them: the same physics with its uncertain parameters refitted.

    Where that leaves no more than the error that the simulation is allowed, the allowance is what hides the rest, so a smaller
    one is tried: the verdict in MuJoCo has the last word on what is found within it.
    """
    narrow = in_windows(screen)
    before = scored_by(narrow, narrow.fit(thetas=[np.zeros_like(screen.theta)]))
    if (
        before.level > ENOUGH or screen.problem.case.structure is not None
    ):  # of a mesh it is known that it errs by as much
        return narrow, before
    finer = in_windows(screen, model_error=FINER * narrow.model_error)
    return finer, scored_by(finer, finer.fit((), before.fit))


def _finished(refiner: Refiner, hypotheses: list[Hypothesis]) -> list[Hypothesis]:
    """Return hypotheses by score, the best of them fitted to the end."""
    order = sorted(hypotheses, key=lambda h: -h.score)
    hopeful = _hopeful(order)

    def finished(item: tuple[int, Hypothesis]) -> Hypothesis:
        own = _for(refiner, item[1].terms)
        iterations = ITERATIONS if item[0] < min(FINISHED, hopeful) else 0
        return scored_by(own, own.fit(item[1].terms, item[1].fit, iterations), item[1].gain)

    done = side_by_side(finished, list(enumerate(order)))
    return sorted(done, key=lambda h: -h.score)


def _hopeful(order: Sequence[Hypothesis]) -> int:
    """Return how many hypotheses, by score, are worth more time: all of them as long as none explains the recordings."""
    if not order or min(h.level for h in order) > ENOUGH:
        return len(order)
    return sum(h.score > order[0].score - HOPELESS for h in order)


def shows(problem: Problem, effect: Effect) -> bool:
    """Return whether an effect leaves any trace in a problem's recordings.

    Of a release seen by one sensor, the sensor's own gain, delay or low-pass only changes what the first state seems to be.
    """
    loaded = any(drive.port for run in problem.runs for drive in run.drives)
    driven = loaded or any(np.any(s.u) for s in problem.signals)
    if driven or len(problem.channels) > 1 or not isinstance(effect, SensorEffect):
        return True
    return effect.family in ("bias", "disturbance", "saturation", "resolution")


def _wants_a_second(before: Hypothesis, fitted: Sequence[Hypothesis], enough: float, usual: int) -> bool:
    """Return whether single effects leave more than enough, and one of them explains a part of it or there is much of it.

    Parameters
    ----------
    usual : int
        Directions of the uncertain parameters: their squares' sum where they are as likely as can be.
    """
    least = min(h.level for h in fitted)
    if fitted[0].calibration > FAR_FETCHED + 0.5 * usual:
        return True
    explained = 1.0 - (max(least, 1.0) ** 2 - 1.0) / max(before.level**2 - 1.0, 1e-12)
    return least > enough and (explained > PART or before.level > MUCH)


def _worth_long_runs(fitted: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Return hypotheses, those first that are worth a fit to whole runs: the best in windows, and where these explain too little
    the forces that gained most in the screening, for a window knows nothing of what a law remembers from before it."""
    if not fitted or fitted[0].level <= ENOUGH:
        return list(fitted)
    known = {h.label for h in fitted[:WHOLE_FINISHED]}
    forces = [h for h in fitted if not isinstance(h.terms[0].effect, SensorEffect)]
    gained = [h for h in sorted(forces, key=lambda h: -h.gain) if h.label not in known]
    first = [*fitted[:WHOLE_FINISHED], *gained[: WHOLE_SINGLES - WHOLE_FINISHED]]
    chosen = {h.label for h in first}
    return [*first, *(h for h in fitted if h.label not in chosen)]


def on_whole_runs(
    whole: Refiner,
    narrow: Refiner,
    hypotheses: Sequence[Hypothesis],
    most: int = WHOLE_FINISHED,
    thetas: Sequence[Array] = (),
) -> list[Hypothesis]:
    """Return hypotheses of equally many effects with what windows and whole runs say of them, half and half, by score.

    Windows say how well a law describes the motion at hand; whole runs how well it holds on in the long run, and what a law
    that remembers makes of all that came before. Only the first `most` are fitted again; to the others happens
    what happened to the worst of these.

    Parameters
    ----------
    thetas : sequence of (n_changes,) arrays
        Uncertain parameters to start from besides: short windows leave frequencies open by more than whole runs forgive, for
        half a cycle further on a fit is lost.
    """
    if narrow.runs == whole.runs:
        return list(hypotheses)
    chosen = list(hypotheses)[:most]
    fits = side_by_side(lambda h: whole.fit(h.terms, h.fit, WHOLE_ITERATIONS, thetas), chosen)
    both = []
    for h, fit in zip(chosen, fits, strict=True):
        other = scored_by(whole, fit)
        level = float(np.sqrt(0.5 * (h.level**2 + other.level**2)))
        misfit, price = 0.5 * (h.misfit + other.misfit), 0.5 * (h.price + other.price)
        both.append(replace(h, misfit=misfit, price=price, level=level, whole=fit))
    misfit = max((b.misfit - h.misfit for b, h in zip(both, chosen, strict=True)), default=0.0)
    price = max((b.price - h.price for b, h in zip(both, chosen, strict=True)), default=0.0)
    more = max((b.level**2 - h.level**2 for b, h in zip(both, chosen, strict=True)), default=0.0)
    rest = [
        replace(h, misfit=h.misfit + misfit, price=h.price + price, level=float(np.sqrt(max(h.level**2 + more, 0.0))))
        for h in list(hypotheses)[most:]
    ]
    return sorted([*both, *rest], key=lambda h: -h.score)


def in_windows(screen: Screen, terms: Sequence[Term] = (), every: int = 1, model_error: float | None = None) -> Refiner:
    """Return the refiner of a screening's runs in windows, which start from smoothed states.

    Parameters
    ----------
    terms : sequence of Term
        A hypothesis; what its sensor effects do to the recordings is taken off before smoothing.
    every : int
        Only one window in n, spread irregularly: motion may repeat itself.
    model_error : float or None
        See `Refiner`.
    """
    if max(len(run) for run in screen.runs) <= WHOLE:
        return Refiner(screen, screen.runs, model_error, is_rough=every > 1)
    omega = np.abs(screen.twin.omega)
    moving = omega[omega > 0.1]
    slowest = float(moving.min() / (2 * np.pi)) if moving.size else 0.0
    wrong = [(t.effect, t.place, t.values) for t in terms if isinstance(t.effect, SensorEffect)]
    parts = [w for run, states in screen.states(wrong) for w in windows(run, states, slowest)]
    chosen = [
        w for i, w in enumerate(parts) if every == 1 or (i * 0.6180339887) % 1.0 < 1.0 / every
    ]  # no regular pattern
    return Refiner(screen, chosen, model_error, is_rough=every > 1)


def shortlisted(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return the best place of the effects that gained most, and of the best of other families."""
    best: dict[str, Candidate] = {}
    for candidate in candidates:
        best.setdefault(candidate.effect.name, candidate)
    order = _without_embellishments([c for c in best.values() if c.gain > 0])
    stands_out = bool(order) and order[0].gain > CLEAR
    share = 1.0 if stands_out else 0.0
    most = SHORTLIST + (FAMILIES if stands_out else 2 * FAMILIES)  # where nothing stands out, every family is tried
    out = order[:SHORTLIST]
    families = {c.effect.family for c in out}
    for candidate in order[SHORTLIST:]:
        if len(out) >= most:
            break
        if candidate.effect.family not in families and candidate.gain > LEAST_GAIN * share:
            families.add(candidate.effect.family)
            out.append(candidate)
    return out


def _single_effects(
    screen: Screen,
    narrow: Refiner,
    rough: Refiner,
    before: Hypothesis,
    candidates: Sequence[Candidate],
    effects: Sequence[Effect],
    report: Callable[[float, str], None],
) -> tuple[list[Candidate], list[Hypothesis]]:
    """Return the shortlist and the fits of single effects, best first: what the screening found, where that explains too little what
    slower observers do, and the laws most like the best one."""
    report(0.2, "fitting single effects")
    shortlist = side_by_side(screen.zoomed, shortlisted(candidates))
    fitted = _singles(narrow, rough, shortlist, before)
    if before.level <= ENOUGH:
        return shortlist, fitted
    if not (fitted and fitted[0].level < EXPLAINS * _floor(narrow)):
        report(0.25, "screening with slower observers")
        screen.slower = tuple(Screen(screen.problem, screen.runs, trust=t, like=screen) for t in (SLOW, SLOWEST))
        among = _best_places(candidates, PLACES)
        for slow in screen.slower:
            known = {c.label for c in shortlist}
            slowly = shortlisted(slow.candidates(effects, among=among))[:SLOW_SHORTLIST]
            shortlist += side_by_side(slow.zoomed, [c for c in slowly if c.label not in known])
            slow.forget()
        fitted = _merged(fitted, _singles(narrow, rough, shortlist[len(fitted) :], before))
    akin = side_by_side(screen.zoomed, _akin(candidates, fitted))
    return shortlist, _merged(fitted, _singles(narrow, rough, akin, before))


def _singles(narrow: Refiner, rough: Refiner, candidates: Sequence[Candidate], before: Hypothesis) -> list[Hypothesis]:
    """Return fits of single effects, best first."""
    return _finished(narrow, side_by_side(lambda c: _fitted(rough, [c], before.fit, QUICK), candidates))


def _merged(*hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
    return sorted((h for some in hypotheses for h in some), key=lambda h: -h.score)


def _akin(candidates: Sequence[Candidate], fitted: Sequence[Hypothesis]) -> list[Candidate]:
    """Return the effects of kindred families at the place of the best fit that are not fitted yet: only fits tell them apart."""
    if not fitted or len(fitted[0].terms) != 1:
        return []
    best, known = fitted[0].terms[0], {h.label for h in fitted}
    families = next((group for group in KINDRED if best.effect.family in group), {best.effect.family})
    return [
        c
        for c in candidates
        if c.place.name == best.place.name
        and c.effect.family in families
        and c.effect.kind == best.effect.kind
        and c.label not in known
        and (c.gain > 0 or not c.effect.amplitudes)
    ]


def _sharpened(screen: Screen, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return candidates by gain, the best of every effect that is all shape (a limit, a step, a delay) between its grid's values."""
    best: dict[str, Candidate] = {}
    for c in candidates:
        if c.effect.shapes and not c.effect.amplitudes and c.gain > 0:
            best.setdefault(c.effect.name, c)
    sharp = {c.label: c for c in side_by_side(screen.zoomed, list(best.values()))}
    return sorted((sharp.get(c.label, c) for c in candidates), key=lambda c: (-c.gain, c.label))


def _is_meant(hypothesis: Hypothesis) -> bool:
    """Return whether the laws of a hypothesis have values that their words fit."""
    return all(
        t.effect.is_meant(t.values, t.place.stiffness)
        for t in hypothesis.long_fit.terms
        if isinstance(t.effect, PortEffect)
    )


def _best_places(candidates: Sequence[Candidate], most: int) -> set[str]:
    """Return the labels of every effect at the places where it gained most."""
    count: dict[str, int] = {}
    out = set()
    for candidate in candidates:
        count[candidate.effect.name] = count.get(candidate.effect.name, 0) + 1
        if count[candidate.effect.name] <= most:
            out.add(candidate.label)
    return out


def _without_embellishments(candidates: list[Candidate]) -> list[Candidate]:
    """Drop candidates that gain no more than a simpler one of their family does, at the same place."""
    out: list[Candidate] = []
    for c in candidates:
        simpler = [
            d
            for d in candidates
            if d.effect.family == c.effect.family
            and d.place.name == c.place.name
            and len(d.effect.parameters) < len(c.effect.parameters)
            and d.gain >= c.gain - LEAST_GAIN
        ]
        if not simpler:
            out.append(c)
    return out


def terms_of(candidates: Sequence[Candidate]) -> list[Term]:
    """Return candidates as terms of a hypothesis."""
    return [Term(effect=c.effect, place=c.place, values=c.values) for c in candidates]


def _fitted(refiner: Refiner, candidates: Sequence[Candidate], before: Fit, iterations: int = ITERATIONS) -> Hypothesis:
    terms = terms_of(candidates)
    own = _for(refiner, terms, 2)
    return scored_by(own, own.fit(terms, before, iterations), sum(c.gain for c in candidates))


def _for(refiner: Refiner, terms: Sequence[Term], every: int = 1) -> Refiner:
    """Return the refiner of a hypothesis: windows of its own where it says that a sensor is wrong."""
    if not any(isinstance(t.effect, SensorEffect) for t in terms):
        return refiner
    return in_windows(refiner.screen, terms, every, refiner.model_error)


def scored_by(refiner: Refiner, fit: Fit, gain: float = 0.0) -> Hypothesis:
    """Return a refiner's fit as a hypothesis with its score."""
    return scored(fit, sum(run.y.size for run in refiner.runs), refiner.worth, gain, floor=_floor(refiner))


def _floor(refiner: Refiner) -> float:
    """Return the level that noise alone leaves."""
    return float(np.sqrt(refiner.noise_share))


def _pairs(
    screen: Screen,
    refiner: Refiner,
    fitted: Sequence[Hypothesis],
    shortlist: Sequence[Candidate],
    effects: Sequence[Effect],
    among: set[str],
    report: Callable[[float, str], None],
) -> list[Hypothesis]:
    """Return fits of a second effect on top of the best single ones, by what it gains beside them."""
    report(0.55, "screening for a second effect")
    seeds = _seeds(screen, fitted, shortlist)
    tables = side_by_side(
        lambda item: besides(screen, item[0].long_fit, list(effects), item[1], among)[:MOST_SECONDS],
        [(seed, trust) for seed in seeds for trust in (1.0, SLOW)],
    )
    pairs: dict[frozenset[str], tuple[Hypothesis, Candidate]] = {}
    owners = [seed for seed in seeds for _ in range(2)]
    for seed, table in zip(owners, tables, strict=True):
        for second in best_of_families(table, seed.terms[0].effect.name)[:SECONDS]:
            if second.gain > LEAST_GAIN:
                pairs.setdefault(frozenset((seed.label, second.label)), (seed, second))
    report(0.65, "fitting pairs of effects")

    def fit(pair: tuple[Hypothesis, Candidate]) -> Hypothesis:
        seed, second = pair
        terms = [*seed.terms, *terms_of([second])]
        own = _for(refiner, terms, 2)
        return scored_by(own, own.fit(terms, seed.long_fit, QUICK), seed.gain + second.gain)

    tried = list(pairs.values())[:MOST_PAIRS]
    fits = side_by_side(fit, tried)
    if not fits:
        return []
    chosen, (seed, second) = min(zip(fits, tried, strict=True), key=lambda item: item[0].level)
    rows = [c for other, table in zip(owners, tables, strict=True) if other is seed for c in table]
    known = set(list(pairs)[:MOST_PAIRS])
    siblings = [c for c in _siblings(rows, second) if c.effect.name not in chosen.label]
    return fits + side_by_side(fit, [(seed, c) for c in siblings if frozenset((seed.label, c.label)) not in known])


def _siblings(table: Sequence[Candidate], second: Candidate) -> list[Candidate]:
    """Return other effects of a candidate's family at its place, which only a fit can tell apart."""
    out: dict[str, Candidate] = {}
    for c in table:
        if c.effect.family == second.effect.family and c.place.name == second.place.name and c.gain > LEAST_GAIN:
            out.setdefault(c.effect.name, c)
    return list(out.values())[:SIBLINGS]


def _seeds(screen: Screen, fitted: Sequence[Hypothesis], shortlist: Sequence[Candidate]) -> list[Hypothesis]:
    """Return what a second effect is sought beside: the best fit, the one that leaves least, and as screened the forces that
    stood out there.

    Of two effects one alone may fit nothing in simulation, however clearly it shows in the innovations: friction beside a
    constant force that carries a free mass away.
    """
    least = min(fitted, key=lambda h: h.level)
    out = [fitted[0]] if least is fitted[0] else [fitted[0], least]
    known = {h.label: h for h in fitted}
    for candidate in shortlist:
        alone = known.get(candidate.label)
        if len(out) > SEEDS or alone is None or alone in out or isinstance(candidate.effect, SensorEffect):
            continue
        fit = replace(alone.fit, terms=tuple(terms_of([candidate])), theta=screen.theta)
        out.append(replace(alone, fit=fit, whole=None))
    return out


def other_places(
    own_of: Callable[[Sequence[Term]], Refiner],
    best: Hypothesis,
    candidates: Sequence[Candidate],
    start: Fit,
    iterations: int = QUICK + 2,
) -> dict[str, Hypothesis]:
    """Fit the best hypothesis again with its first effect at the other places where the screening gained most.

    Parameters
    ----------
    own_of : callable
        Gives the refiner of some terms.
    """
    first, others = best.terms[0], best.terms[1:]
    elsewhere = [c for c in candidates if c.effect.name == first.effect.name and c.place.name != first.place.name]
    chosen = elsewhere[: PLACES - 1]

    def fitted(candidate: Candidate) -> Hypothesis:
        terms = [*terms_of([candidate]), *others]
        own = own_of(terms)
        return scored_by(own, own.fit(terms, start, iterations), candidate.gain)

    found = side_by_side(fitted, chosen)
    own = own_of(best.terms)
    here = scored_by(own, own.fit(best.terms, best.fit, iterations), best.gain)  # as the others: in windows only
    return {first.place.name: here, **{c.place.name: h for c, h in zip(chosen, found, strict=True)}}
