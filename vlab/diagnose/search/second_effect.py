"""Screening of second effects, and fits of pairs.

A wrong sensor or a strong force distorts the first filter and its innovations. The fitted effect therefore enters the
matrices, commands, recordings or known forces, and the screening is repeated.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace

import numpy as np

from vlab.cases.replay_inputs import before
from vlab.diagnose.data.runs import Signals
from vlab.diagnose.inference.evidence import Hypothesis
from vlab.diagnose.inference.hypothesis_fits import fitted, pairs_fitted, terms_of
from vlab.diagnose.inference.least_squares import LeastSquares
from vlab.diagnose.inference.score_test import ScoreTest
from vlab.diagnose.parameters.mjcf import prior_deviations
from vlab.diagnose.parameters.reduced_model import ReducedModel
from vlab.diagnose.parameters.terms import Candidate, Fit, Term
from vlab.diagnose.predictors.innovations import Group
from vlab.diagnose.predictors.unit_effects import port_series
from vlab.diagnose.problem import Problem
from vlab.diagnose.search.shortlist import completing, plain_form, rivals_of
from vlab.diagnose.settings import FIT, SCORE_TEST, SECOND_EFFECT, SHORTLIST
from vlab.parallel import side_by_side
from vlab.physics.effect import ActuatorEffect, Effect, LinearPortEffect, PickUp, PortEffect, SensorEffect
from vlab.signals import Array


def violate_priors(fitted: Sequence[Hypothesis], usual: int, prior: Array, may_vanish: Array | bool = False) -> bool:
    """Return whether the best single effects need implausible parameters.

    Parameters
    ----------
    fitted : sequence of Hypothesis
        Single effects, best first.
    usual : int
        Number of identifiable directions, the expected squared prior distance.
    prior : (n_changes,) array
        Prior standard deviations of the uncertain parameters.
    may_vanish : (n_changes,) array of bool
        Parameters whose relative decrease has the prior.

    Returns
    -------
    bool
        Whether priors are violated.
    """
    return any(
        h.prior_departure > SECOND_EFFECT.prior_violation + 0.5 * usual
        or bool(np.any(np.abs(prior_deviations(h.long_fit.theta, may_vanish)) > SECOND_EFFECT.outlying * prior))
        for h in _of_interest(fitted)
    )


def demands_another_effect(before: Hypothesis, fitted: Sequence[Hypothesis], enough: float) -> bool:
    """Return whether the residual demands a second effect.

    Parameters
    ----------
    before : Hypothesis
        Calibrated model.
    fitted : sequence of Hypothesis
        Single effects.
    enough : float
        Normalised residual that needs no further effect.

    Returns
    -------
    bool
        Whether single effects leave too much, and the excess is explained in part or large.
    """
    least = min(h.normalised_residual for h in fitted)
    explained = 1.0 - (max(least, 1.0) ** 2 - 1.0) / max(before.normalised_residual**2 - 1.0, 1e-12)
    return least > enough and (explained > SECOND_EFFECT.part or before.normalised_residual > SECOND_EFFECT.much)


def _of_interest(fitted: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Return the hypotheses of best score and of least residual."""
    best, closest = fitted[0], min(fitted, key=lambda h: h.normalised_residual)
    return [best, closest] if closest.normalised_residual < SECOND_EFFECT.closer * best.normalised_residual else [best]


def pairs(
    screen: ScoreTest,
    refiner: LeastSquares,
    singles: Sequence[Hypothesis],
    shortlist: Sequence[Candidate],
    candidates: Sequence[Candidate],
    effects: Sequence[Effect],
    among: set[str],
    report: Callable[[float, str], None],
    *,
    is_clear: bool,
) -> list[Hypothesis]:
    """Return fits of second effects with the best single ones.

    Parameters
    ----------
    screen : ScoreTest
        Screening.
    refiner : LeastSquares
        Fits in windows.
    singles : sequence of Hypothesis
        Single effects, best first.
    shortlist, candidates : sequence of Candidate
        Shortlist, and the whole screening.
    effects : sequence of Effect
        Candidate effects.
    among : set of str
        Labels of the candidates to test.
    report : callable
        Receives the completed share and the current step.
    is_clear : bool
        Whether the best single effect is certain.

    Returns
    -------
    list of Hypothesis
        Pairs.
    """
    report(0.55, "screening for a second effect")
    seeds = _seeds(screen, singles, shortlist, is_clear=is_clear)
    tables = side_by_side(
        lambda item: besides(screen, item[0].long_fit, list(effects), item[1], among)[: SECOND_EFFECT.most_seconds],
        [(seed, trust) for seed in seeds for trust in (1.0, SCORE_TEST.slow)],
    )
    owners = [seed for seed in seeds for _ in range(2)]
    found = {frozenset((s.label, c.label)): (s, c) for s in seeds for c in completing(s.terms[0], candidates)}
    for seed, table in zip(owners, tables, strict=True):
        for second in best_of_families(table, seed.terms[0])[: SECOND_EFFECT.seconds]:
            if second.log_likelihood_gain > SHORTLIST.least_gain:
                found.setdefault(frozenset((seed.label, second.label)), (seed, second))
    report(0.65, "fitting pairs of effects")
    tried = list(found.values())[: SECOND_EFFECT.most_pairs]
    fits = pairs_fitted(refiner, tried)
    if not fits:
        return []
    chosen, (seed, second) = min(zip(fits, tried, strict=True), key=lambda item: item[0].normalised_residual)
    rows = [c for owner, table in zip(owners, tables, strict=True) if owner is seed for c in table]
    known = set(list(found)[: SECOND_EFFECT.most_pairs])
    alternatives = [c for c in rivals_of(second, rows) if c.effect.name not in chosen.label]
    return fits + pairs_fitted(
        refiner, [(seed, c) for c in alternatives if frozenset((seed.label, c.label)) not in known]
    )


def ablate_pairs(
    refiner: LeastSquares, doubles: Sequence[Hypothesis], singles: Sequence[Hypothesis]
) -> list[Hypothesis]:
    """Return fits of the single effects of pairs.

    The second effect may suffice alone with other uncertain parameters.

    Parameters
    ----------
    refiner : LeastSquares
        Fits in windows.
    doubles, singles : sequence of Hypothesis
        Pairs and known single effects.

    Returns
    -------
    list of Hypothesis
        Single effects without a whole-run fit before.
    """
    known = {h.label for h in singles if h.whole is not None}
    alone: dict[str, tuple[Hypothesis, Term]] = {}
    for pair in doubles:
        for term in pair.long_fit.terms:
            if term.label not in known:
                alone.setdefault(term.label, (pair, term))
    return side_by_side(
        lambda item: fitted(refiner, [item[1]], item[0].long_fit, FIT.iterations, item[0].log_likelihood_gain),
        list(alone.values()),
    )


def in_other_forms(
    refiner: LeastSquares, hypotheses: Sequence[Hypothesis], candidates: Sequence[Candidate]
) -> list[Hypothesis]:
    """Return fits of hypotheses with one effect in another form.

    The correct form is identifiable once nothing else is missing.

    Parameters
    ----------
    refiner : LeastSquares
        Fits in windows.
    hypotheses : sequence of Hypothesis
        Hypotheses.
    candidates : sequence of Candidate
        Screening, with the other forms.

    Returns
    -------
    list of Hypothesis
        Hypotheses.
    """
    found: dict[frozenset[str], tuple[Hypothesis, list[Term]]] = {}
    for h in hypotheses:
        for i, term in enumerate(h.terms):
            for form in candidates:
                if _is_form_of(form, term):
                    values = {name: term.values.get(name, value) for name, value in form.values.items()}
                    other = Term(effect=form.effect, place=form.place, values=values)
                    terms = [*h.terms[:i], other, *h.terms[i + 1 :]]
                    found.setdefault(frozenset(t.label for t in terms), (h, terms))
    for h in hypotheses:
        found.pop(frozenset(t.label for t in h.terms), None)
    return side_by_side(
        lambda item: fitted(refiner, item[1], item[0].fit, log_likelihood_gain=item[0].log_likelihood_gain),
        list(found.values()),
    )


def _is_form_of(one: Term, other: Term) -> bool:
    return one.place.name == other.place.name and (
        one.effect.physics == other.effect.physics and one.effect.name != other.effect.name
    )


def _seeds(
    screen: ScoreTest, singles: Sequence[Hypothesis], shortlist: Sequence[Candidate], *, is_clear: bool
) -> list[Hypothesis]:
    """Return the hypotheses to which second effects are added.

    One of two effects alone may fit nothing in simulation, however clear its innovations: friction next to a constant
    force on a free mass.
    """
    out = _of_interest(singles)
    if is_clear:
        return out
    known = {h.label: h for h in singles}
    for candidate in shortlist:
        alone = known.get(candidate.label)
        if len(out) > SECOND_EFFECT.seeds or alone is None or alone in out or candidate.effect.kind == "sensor":
            continue
        fit = replace(alone.fit, terms=tuple(terms_of([candidate])), theta=screen.theta)
        out.append(replace(alone, fit=fit, whole=None))
    return out


def besides(
    screen: ScoreTest, fit: Fit, effects: list[Effect], trust: float = 1.0, among: Collection[str] | None = None
) -> list[Candidate]:
    """Return the screening of second effects with a fitted hypothesis.

    Parameters
    ----------
    screen : ScoreTest
        First screening.
    fit : Fit
        Fit of the hypothesis.
    effects : list of Effect
        Candidate effects.
    trust : float
        Factor on the unknown-force intensity; below 1 a slower observer.
    among : collection of str or None
        Labels of the candidates to test; all by default.

    Returns
    -------
    list of Candidate
        Candidates by gain.
    """
    problem = with_effects(screen, fit)
    most = max(int(SECOND_EFFECT.rows * len(run)) for run in screen.runs)
    runs = [run.first(most) for run in problem.in_role("fit")]
    second = ScoreTest(problem, runs, like=screen, theta=fit.theta, trust=trust)
    table = second.candidates(effects, among=among)
    sharp = {c.label: second.zoomed(c) for c in best_of_families(table, fit.terms[0])[: SECOND_EFFECT.zoomed]}
    return [sharp.get(c.label, c) for c in table]


def best_of_families(table: Sequence[Candidate], first: Term) -> list[Candidate]:
    """Return the best second candidates by family.

    Equal physics at two locations is one misplaced effect, and two slip laws at one location are one friction.

    Parameters
    ----------
    table : sequence of Candidate
        Candidates by gain.
    first : Term
        First effect.

    Returns
    -------
    list of Candidate
        Candidates in their plain form.
    """
    best: dict[str, Candidate] = {}
    for candidate in table:
        if candidate.effect.physics != first.effect.physics and not _are_one_friction(candidate, first):
            best.setdefault(candidate.effect.family, candidate)
    return [plain_form(candidate, table) for candidate in best.values()]


def _are_one_friction(one: Term, other: Term) -> bool:
    return one.place.name == other.place.name and one.effect.traits.is_slip and other.effect.traits.is_slip


def with_effects(screen: ScoreTest, fit: Fit) -> Problem:
    """Return a problem with a fitted hypothesis built in.

    Parameters
    ----------
    screen : ScoreTest
        Screening with the runs.
    fit : Fit
        Fit of the hypothesis.

    Returns
    -------
    Problem
        Problem whose signals are the screening's runs.
    """
    problem, reduced_model, runs = screen.problem, screen.reduced_model, list(screen.runs)
    for term in fit.terms:
        if isinstance(term.effect, LinearPortEffect):
            reduced_model = _stiffened(reduced_model, term, term.effect)
        elif isinstance(term.effect, ActuatorEffect):
            runs = [_actuated(run, term, term.effect) for run in runs]
        elif isinstance(term.effect, SensorEffect):
            runs = [_corrected(run, term, term.effect) for run in runs]
        else:
            reduced_model = reduced_model.with_loads(term.place.rows[:1].T, term.place.truncated[:1].T)
            forces = {id(run): f for group in screen.groups for run, f in _forces(screen, group, term)}
            runs = [
                replace(now, load=np.hstack([now.load, forces[id(run)][: len(now), None]]))
                for now, run in zip(runs, screen.runs, strict=True)
            ]
    return replace(problem, reduced_model=reduced_model, signals=tuple(runs))


def _stiffened(reduced_model: ReducedModel, term: Term, effect: LinearPortEffect) -> ReducedModel:
    parts = effect.impedance({k: np.asarray(v) for k, v in term.values.items()}, term.place.stiffness)
    M, C, K = reduced_model.M, reduced_model.C, reduced_model.K
    for row in term.place.rows:
        M, C, K = (x + float(part) * np.outer(row, row) for x, part in zip((M, C, K), parts, strict=True))
    return replace(reduced_model, M=M, C=C, K=K)


def _actuated(run: Signals, term: Term, effect: ActuatorEffect) -> Signals:
    u = run.u.copy()
    for i in term.place.indices:
        u[:, i] = effect.follow(u[:, i], dict(term.values), run.h, float(run.command_before[i]))
    return replace(run, u=u)


def _corrected(run: Signals, term: Term, effect: SensorEffect) -> Signals:
    y, i, k = run.y.copy(), term.place.index, term.place.other
    noise = run.noise.copy()
    if isinstance(effect, PickUp):
        other = before(run.u[:, k]) if term.place.tag == "command" else run.y[:, k]
        y[:, i] = 2 * y[:, i] - effect.mix(y[:, i], other, dict(term.values))  # to first order
    else:
        y[:, i] = effect.correct(y[:, i], dict(term.values), run.h, run.t)
        noise[i] *= effect.growth(dict(term.values), run.h)
    return replace(run, y=y, noise=noise)


def _forces(screen: ScoreTest, group: Group, term: Term) -> list[tuple[Signals, Array]]:
    """Return the law's force (n,) along every run of a group."""
    assert isinstance(term.effect, PortEffect)
    m, h, row = screen.reduced_model.m, group.h, term.place.rows[0]
    z, v = group.smoothed.x[..., :m] @ row, group.smoothed.x[..., m:] @ row
    after = np.vstack([v[1:], v[-1:]])
    command = group.u[..., term.place.coil] if term.place.coil is not None else 0.0
    force = port_series(term.effect, z + 0.5 * h * v, 0.5 * (v + after), dict(term.values), h, command, group.starts)
    return [(run, force[:, i]) for i, run in enumerate(group.runs)]
