"""Alternative sampling conventions, tested together with the found effects."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from vlab.cases.case import Case
from vlab.diagnose.inference.least_squares import LeastSquares
from vlab.diagnose.inference.model_choice import choose_model
from vlab.diagnose.parameters.terms import Fit, Term
from vlab.diagnose.problem import Problem
from vlab.diagnose.search.model_class import LinearTimeInvariant, TrajectoryLinearised
from vlab.diagnose.search.sampling_convention import (
    decided_holds,
    describe_hold,
    open_holds,
    with_decided_hold,
    with_hold,
)
from vlab.diagnose.search.selection import TimeFound
from vlab.diagnose.settings import ALTERNATIVE_CONVENTIONS, HYPOTHESIS_FITS, SAMPLING_CONVENTION
from vlab.parallel import side_by_side


@dataclass(frozen=True, kw_only=True)
class AlternativeConvention:
    """Alternative convention for a case.

    Parameters
    ----------
    words : str
        Description.
    of : callable
        Returns a case with the convention.
    """

    words: str
    of: Callable[[Case], Case]


def list_conventions(problem: Problem, stated: Case | None = None) -> list[AlternativeConvention]:
    """Return the undecided conventions of a case.

    These are linear inputs or a zero-order hold, whichever is not assumed, and recordings that start in motion.

    Parameters
    ----------
    problem : Problem
        Problem.
    stated : Case, optional
        Case as it is stated, which also opens a hold that the data decided.

    Returns
    -------
    list of AlternativeConvention
        Conventions.
    """
    if not problem.model_kind.has_open_conventions:
        return []
    out = [
        AlternativeConvention(words=describe_hold(hold), of=partial(with_hold, hold=hold))
        for hold in open_holds(problem)
    ]
    if stated is not None:
        out += [
            AlternativeConvention(words=describe_hold(hold), of=partial(with_decided_hold, hold=hold, stated=stated))
            for hold in decided_holds(problem, stated)
        ]
    starts = {table.initial for table in problem.case.table.recording if not table.qpos}
    if "auto" in starts and any(run.at_rest for run in problem.signals):
        out.append(
            AlternativeConvention(words='recordings begin in motion (initial = "estimated")', of=_begun_in_motion)
        )
    return out


def _begun_in_motion(case: Case) -> Case:
    return case.with_recordings(
        replace(t, initial="estimated") if t.initial == "auto" and not t.qpos else t for t in case.table.recording
    )


def choose_convention(
    model_class: LinearTimeInvariant | TrajectoryLinearised, found: TimeFound, stated: Case
) -> AlternativeConvention | None:
    """Return a convention that fits better with the effects.

    A strong effect hides a convention, and a delay, lag or hold effect can imitate one. Such an effect therefore opens
    the hold again, since the data decided on it without the effects.

    Parameters
    ----------
    model_class : LinearTimeInvariant or TrajectoryLinearised
        Model class of the case.
    found : TimeFound
        Result of the search.
    stated : Case
        Case as it is stated.

    Returns
    -------
    AlternativeConvention or None
        Better convention, or None.
    """
    best = choose_model(found).best.long_fit
    left = best.cost / found.whole.n_values
    of_clock = any(_is_of_clock(t) for t in best.terms)
    if left <= HYPOTHESIS_FITS.enough**2 and not of_clock:
        return None
    chosen, least = None, np.inf
    for other in list_conventions(model_class.problem, stated if of_clock else None):
        refiner = model_class.whole_runs_of(other.of(model_class.problem.case), found.whole.model_error)
        if refiner is None:
            continue
        costs = _costs(refiner, best)
        now, timeless = min(costs) / refiner.n_values, costs[-1] / refiner.n_values
        is_likelier = of_clock and gains_more_than_chance(found, left, now)
        if now < least and (
            now < SAMPLING_CONVENTION.much_less * left
            or is_likelier
            or (of_clock and timeless < ALTERNATIVE_CONVENTIONS.no_more * left)
        ):
            chosen, least = other, now
    return chosen


def gains_more_than_chance(found: TimeFound, left: float, now: float) -> bool:
    """Return whether another case of the model is likelier than by chance.

    Parameters
    ----------
    found : TimeFound
        Result of the search.
    left, now : float
        Normalised mean squares of the case and of the other case, above 0.

    Returns
    -------
    bool
        Whether the log-likelihood gain exceeds the chance gain of all refitted directions.
    """
    gain = 0.5 * found.whole.effective_samples * float(np.log(left / now))
    return gain > SAMPLING_CONVENTION.gain


def _costs(refiner: LeastSquares, best: Fit) -> list[float]:
    """Return a fit's costs, with and without clock effects."""
    timeless = tuple(t for t in best.terms if not _is_of_clock(t))
    options = [best.terms] if len(timeless) == len(best.terms) else [best.terms, timeless]
    fits = side_by_side(
        lambda own: refiner.fit(own, replace(best, terms=own), HYPOTHESIS_FITS.whole_iterations), options
    )
    return [fit.cost for fit in fits]


def _is_of_clock(term: Term) -> bool:
    """Return whether a term shifts commands in time.

    Such a term can imitate half a sample of a file's convention.
    """
    return term.effect.kind == "actuator" and term.effect.family == "timing"
