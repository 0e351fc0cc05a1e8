"""Bayesian information criterion [1]_ over the catalogue, with white noise.

Every effect of the catalogue at every place is fitted once to the whole fit recordings, beside the uncertain parameters.
The fit is the least squares of vlab with its stated deviations. Noise is white with unknown variance, and all samples
count: BIC = n log(S/n) + P + k log n, with n samples, weighted sum of squares S, squared stated deviations P and k
parameters of the effect. The least criterion is taken, and nothing is named where the calibrated model has it.

What the diagnosis adds is left out: windows, several starts by slower observers, discrepancy of the model, prior odds,
cost of the search, second effects, confirmation, and the judgement on hold-out recordings.

Candidates are fitted in the order of vlab's screening, whose estimates are the starts. CPU time is capped at
`MOST_CPU_S`; the remark of the result counts the fitted candidates.

References
----------
.. [1] G. Schwarz, "Estimating the dimension of a model", *Ann. Statist.* 6 (1978) 461-464.
"""

import numpy as np

from vlab.cases.case import Case
from vlab.diagnose.frequency_pipeline import is_in_frequency
from vlab.diagnose.inference.hypothesis_fits import terms_of
from vlab.diagnose.inference.least_squares import LeastSquares
from vlab.diagnose.inference.trajectory_least_squares import TrajectoryLeastSquares
from vlab.diagnose.parameters.terms import Fit
from vlab.diagnose.problem import Problem
from vlab.diagnose.search.model_class import LinearTimeInvariant, choose_model_class
from vlab.diagnose.search.selection import shows
from vlab.diagnose.validation.simulation import extended
from vlab.errors import VlabError
from vlab.physics.catalogue import CANDIDATES
from vlab.proof.peers.result import (
    MOST_ERROR,
    Deadline,
    Named,
    NotUsable,
    PeerResult,
    compared_names,
    error_of,
    mean_error,
)

MOST_CPU_S = 400.0
"""MOST_CPU_S [s]: CPU time of a case after which no further candidate is fitted."""
ITERATIONS = 12
"""ITERATIONS [-]: most iterations of a fit."""
NAMES = tuple(effect.name for effect in CANDIDATES)
"""NAMES: effects that the peer can name."""


def bic_over_catalogue(case: Case) -> PeerResult:
    """Choose an effect of the catalogue by the criterion.

    Parameters
    ----------
    case : Case
        Case.

    Returns
    -------
    PeerResult
        Effect of least criterion, and the error of its model on the hold-out recordings.

    Raises
    ------
    NotUsable
        The case has responses in frequency, or nothing to fit.
    """
    if is_in_frequency(case):
        raise NotUsable("for recordings in time")
    deadline = Deadline.after(MOST_CPU_S)
    model_class = choose_model_class(case)
    problem = model_class.problem
    fits = _with_white_noise(model_class)
    effects = [effect for effect in CANDIDATES if shows(problem, effect)]
    candidates = model_class.screen.candidates(effects)
    model_class.screen.forget()
    calibrated = fits.fit((), None, ITERATIONS)
    best, least, count = calibrated, criterion(calibrated, fits.n_values), 0
    for candidate in candidates:
        if deadline.is_past:
            break
        count += 1
        try:
            fit = fits.fit(terms_of([candidate]), calibrated, ITERATIONS)
        except (ArithmeticError, ValueError, np.linalg.LinAlgError):  # no fit is no candidate
            continue
        value = criterion(fit, fits.n_values)
        if value < least:
            best, least = fit, value
    cap = "" if count == len(candidates) else f" in {MOST_CPU_S:g} s of CPU time"
    return PeerResult(
        named=_named(best, criterion(calibrated, fits.n_values) - least),
        names=NAMES,
        nrmse=_held_out_error(problem, best),
        remark=f"{count} of {len(candidates)} candidates fitted{cap}",
    )


def criterion(fit: Fit, samples: int) -> float:
    """Return the Bayesian information criterion of a fit.

    Parameters
    ----------
    fit : Fit
        Fit.
    samples : int
        Samples of the recordings.

    Returns
    -------
    float
        Criterion; smaller is better.
    """
    parameters = sum(len(term.effect.parameters) for term in fit.terms)
    spread = max(fit.cost, 1e-300) / samples
    return float(samples * np.log(spread) + fit.prior_cost + parameters * np.log(samples))


def _with_white_noise(model_class: object) -> LeastSquares:
    """Return whole-run fits in which every sample counts."""
    if isinstance(model_class, LinearTimeInvariant):
        fits = LeastSquares(model_class.screen, model_class.problem.in_role("fit"), model_error=0.0)
    else:
        fits = TrajectoryLeastSquares(model_class.screen, whole=True)  # type: ignore[attr-defined]
    fits.effective_samples = fits.effective_share = float(fits.n_values)
    return fits


def _named(best: Fit, gain: float) -> Named | None:
    if not best.terms:
        return None
    term = best.terms[0]
    return Named(effect=term.effect.name, place=term.place.name, share=gain)


def _held_out_error(problem: Problem, fit: Fit) -> float:
    """Return the relative held-out error of a fit in MuJoCo."""
    model, errors = extended(problem, fit), []
    for run in problem.case.runs(("holdout",)):
        try:
            recording = model.simulated(run)
        except VlabError:
            errors.append(MOST_ERROR)
            continue
        errors.append(error_of(run, np.column_stack([recording[name] for name in compared_names(run)])))
    return mean_error(errors) if errors else float("nan")
