"""Search in frequency: screening, single effects, pairs, locations."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np

from vlab.diagnose.data.amplitude_dependence import Trend
from vlab.diagnose.data.responses import Response
from vlab.diagnose.inference.evidence import Found, Hypothesis, scored
from vlab.diagnose.inference.frequency_least_squares import Fitter, Point
from vlab.diagnose.parameters.locations import Place
from vlab.diagnose.parameters.terms import Fit, Term
from vlab.diagnose.predictors.frequency_problem import FrequencyProblem
from vlab.diagnose.search.frequency_screening import ScoreTest, Trial, screened
from vlab.diagnose.search.level_trials import Levels, calibrate_levels, has_levels
from vlab.diagnose.search.trial_values import candidates
from vlab.diagnose.settings import FREQUENCY_SELECTION, HYPOTHESIS_FITS
from vlab.parallel import side_by_side
from vlab.physics.effect import Effect
from vlab.physics.small_signal import is_linear
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class FrequencyFound(Found):
    """Result of the search in frequency.

    Parameters
    ----------
    problem : FrequencyProblem
        Problem.
    fitter : Fitter
        Fits to the data.
    tried : int
        Number of tried effects at locations.
    trends : tuple of Trend
        Modes over the levels; empty without several known levels.
    """

    problem: FrequencyProblem
    fitter: Fitter
    tried: int = 0
    trends: tuple[Trend, ...] = ()


def search_frequency(
    problem: FrequencyProblem, effects: Sequence[Effect], progress: Callable[[float, str], None]
) -> FrequencyFound:
    """Search the missing physics in frequency data.

    Parameters
    ----------
    problem : FrequencyProblem
        Problem.
    effects : sequence of Effect
        Candidate effects; nonlinear ones need data at several known levels.
    progress : callable
        Receives the completed share and the current step.

    Returns
    -------
    FrequencyFound
        Hypotheses.
    """
    fitter = Fitter(problem)
    zero = np.zeros(len(fitter.sd))
    effective_samples, floor = fitter.effective_samples, fitter.floor
    before_fit = min(fitter.fit(), fitter.fit((), zero), key=lambda fit: fit.chi2)
    with_levels = has_levels(problem)
    pairs = candidates(problem, effects, with_levels=with_levels)

    def penalised(fit: Fit, log_likelihood_gain: float = 0.0) -> Hypothesis:
        return scored(fit, effective_samples, effective_samples, log_likelihood_gain, tried=len(pairs), floor=floor)

    before = penalised(before_fit)
    progress(0.1, "screening")
    levels = calibrate_levels(fitter, before_fit.theta) if with_levels else None
    first = ScoreTest(fitter, Point(theta=before_fit.theta, terms=()), levels=levels)
    by_lines = screened(first, pairs)
    if levels is not None:  # a law that acts at one end of the levels leaves the calibration of the other end
        nonlinear = [pair for pair in pairs if not is_linear(pair[0])]
        for theta in levels.theta:
            about = ScoreTest(fitter, Point(theta=theta, terms=()), levels=levels, start=first.cost)
            by_lines += screened(about, nonlinear)
        by_lines.sort(key=lambda t: -t.log_likelihood_gain)
    by_bands: list[Trial] = []
    if any(isinstance(d, Response) for d in problem.measured):
        linear = [pair for pair in pairs if is_linear(pair[0])]
        by_bands = screened(ScoreTest(fitter, Point(theta=zero, terms=()), FREQUENCY_SELECTION.coarse), linear)
    shortlist = _shortlist(by_lines, by_bands)
    progress(0.35, "fitting single effects")
    from_afar = {t.label for t in by_bands[: FREQUENCY_SELECTION.far]}
    fits = side_by_side(lambda item: _quick_fit(fitter, item, before_fit.theta, from_afar), shortlist)
    singles = sorted(
        (penalised(fit, t[0].log_likelihood_gain) for fit, t in zip(fits, shortlist, strict=True)),
        key=lambda h: -h.score,
    )
    fits = side_by_side(lambda h: fitter.fit(h.terms, h.fit.theta), singles[: FREQUENCY_SELECTION.finished])
    singles = [penalised(fit, h.log_likelihood_gain) for fit, h in zip(fits, singles, strict=False)] + singles[
        FREQUENCY_SELECTION.finished :
    ]
    singles.sort(key=lambda h: -h.score)
    hypotheses = list(singles)
    if singles and singles[0].normalised_residual > HYPOTHESIS_FITS.enough:
        progress(0.55, "fitting pairs of effects")
        hypotheses += [penalised(fit) for fit in _pairs(fitter, singles, pairs, levels)]
        hypotheses.sort(key=lambda h: -h.score)
    progress(0.85, "comparing places")
    places = _places(fitter, hypotheses, [*by_lines, *by_bands], before_fit.theta, penalised)
    return FrequencyFound(
        problem=problem,
        fitter=fitter,
        before=before,
        hypotheses=tuple(hypotheses),
        places=places,
        tried=len(pairs),
        trends=() if levels is None else levels.trends,
    )


def _shortlist(by_lines: Sequence[Trial], by_bands: Sequence[Trial]) -> list[list[Trial]]:
    """Return the trials of largest gain in either screening.

    Trials are grouped by effect and location. The best of every family is included.
    """
    chosen: dict[str, list[Trial]] = {}
    for ranked in (by_lines, by_bands):
        families: set[str] = set()
        for i, tried in enumerate(ranked):
            family = tried.term.effect.family
            if tried.log_likelihood_gain > 0 and (i < FREQUENCY_SELECTION.shortlist or family not in families):
                chosen.setdefault(tried.label, [])
            families.add(family)
    for tried in (*by_lines, *by_bands):
        if tried.label in chosen:
            chosen[tried.label].append(tried)
    return list(chosen.values())


def _quick_fit(fitter: Fitter, trials: Sequence[Trial], theta: Array, from_afar: Collection[str]) -> Fit:
    """Fit an effect briefly from its trials and starts."""
    first = trials[0]
    if first.theta is not None:  # a nonlinear effect: its best trial about each calibration
        starts = [(t.term, t.theta) for t in trials[: FREQUENCY_SELECTION.calibrations]]
    else:
        starts = [(term, None) for term in (first.term, *first.others)]
    fits = [
        fitter.fit([term], theta if own is None else own, iterations=FREQUENCY_SELECTION.quick) for term, own in starts
    ]
    if trials[0].label in from_afar:
        fits.append(fitter.fit([trials[-1].term], None, iterations=FREQUENCY_SELECTION.quick))
    return min(fits, key=lambda fit: fit.chi2)


def _pairs(
    fitter: Fitter,
    singles: Sequence[Hypothesis],
    pairs: Sequence[tuple[Effect, Place]],
    levels: Levels | None = None,
) -> list[Fit]:
    """Fit a second effect with the best single ones."""
    seeds = list(singles[:1])
    for h in singles[1:]:  # of other families
        if len(seeds) < FREQUENCY_SELECTION.seeds and all(
            h.terms[0].effect.family != s.terms[0].effect.family for s in seeds
        ):
            seeds.append(h)
    work: dict[frozenset[str], tuple[Hypothesis, Term]] = {}
    for seed in seeds:
        rest = screened(ScoreTest(fitter, Point(theta=seed.fit.theta, terms=seed.terms), levels=levels), pairs)
        own = seed.terms[0]
        count = 0
        for tried in rest:
            if tried.label == own.label or tried.log_likelihood_gain <= 0 or count >= FREQUENCY_SELECTION.seconds:
                continue
            key = frozenset((own.label, tried.label))
            if key not in work:
                work[key] = (seed, tried.term)
                count += 1
    items = list(work.values())
    fits = side_by_side(
        lambda item: fitter.fit([*item[0].terms, item[1]], item[0].fit.theta, iterations=FREQUENCY_SELECTION.quick),
        items,
    )
    fits.sort(key=lambda fit: fit.chi2)
    return side_by_side(lambda fit: fitter.fit(fit.terms, fit.theta), fits[: FREQUENCY_SELECTION.finished])


def _places(
    fitter: Fitter,
    hypotheses: Sequence[Hypothesis],
    tried: Sequence[Trial],
    theta: Array,
    penalised: Callable[[Fit], Hypothesis],
) -> dict[str, Hypothesis]:
    """Fit the best hypothesis with its first effect at other locations."""
    if not hypotheses:
        return {}
    best = hypotheses[0]
    first, others = best.terms[0], best.terms[1:]
    known: dict[str, Hypothesis] = {}
    if not others:
        same = [h for h in hypotheses if len(h.terms) == 1 and h.terms[0].effect.name == first.effect.name]
        known = {h.terms[0].place.name: h for h in same}
    elsewhere: dict[str, list[Trial]] = {}
    for t in tried:
        if t.term.effect.name == first.effect.name and t.term.place.name != first.place.name:
            elsewhere.setdefault(t.term.place.name, []).append(t)
    order = sorted(elsewhere, key=lambda name: -max(t.log_likelihood_gain for t in elsewhere[name]))[
        : FREQUENCY_SELECTION.places
    ]
    todo = [name for name in order if name not in known]

    def fitted(name: str) -> Fit:
        start = best.fit.theta if others else theta
        fits = [
            fitter.fit(
                [t.term, *others],
                start if t.theta is None or others else t.theta,
                iterations=2 * FREQUENCY_SELECTION.quick,
            )
            for t in elsewhere[name]
        ]
        return min(fits, key=lambda fit: fit.chi2)

    fits = side_by_side(fitted, todo)
    out = {first.place.name: best, **{n: h for n, h in known.items() if n != first.place.name}}
    return {**out, **{name: penalised(fit) for name, fit in zip(todo, fits, strict=True)}}
