"""Cross-validation in frequency, without hold-out data."""

from dataclasses import dataclass, replace

import numpy as np

from vlab.diagnose.data.responses import Measured, Response
from vlab.diagnose.inference.frequency_least_squares import Fitter, Point
from vlab.diagnose.parameters.terms import Fit
from vlab.diagnose.predictors.frequency_problem import FrequencyProblem
from vlab.diagnose.predictors.level_answer import answer_at_level
from vlab.diagnose.settings import CROSS_VALIDATION
from vlab.diagnose.validation.frequency import apart, modal_answer, modal_errors, noise_apart
from vlab.diagnose.validation.gap import gap_closed


@dataclass(frozen=True, kw_only=True)
class LeftOut:
    """Prediction errors of left-out parts of the data.

    Parameters
    ----------
    parts : int
        Number of left-out parts: responses of one output, or modes.
    before, after, noise : float
        Rms errors of calibrated and extended model, and noise.
    """

    parts: int
    before: float
    after: float
    noise: float

    @property
    def gap_closed(self) -> float | None:
        """Closed share of the gap; None within the noise."""
        return gap_closed(self.before, self.after, self.noise)


def cross_validate(problem: FrequencyProblem, fitter: Fitter, before: Fit, after: Fit) -> LeftOut | None:
    """Refit without single parts of the data, and predict them.

    Parameters
    ----------
    problem : FrequencyProblem
        Problem.
    fitter : Fitter
        Fits to all data.
    before, after : Fit
        Fits of calibrated and extended model.

    Returns
    -------
    LeftOut or None
        Prediction errors; None for fewer than three parts.
    """
    parts: list[tuple[int, int]] = []
    for i, data in enumerate(problem.measured):
        count = len(data.outputs) if isinstance(data, Response) else data.n
        parts += [(i, k) for k in range(count)]
    if len(parts) < 3:
        return None
    chosen = [parts[i] for i in np.unique(np.linspace(0, len(parts) - 1, CROSS_VALIDATION.left_out).astype(int))]
    squares = []
    for i, k in chosen:
        data = problem.measured[i]
        rest = [d for j, d in enumerate(problem.measured) if j != i]
        if isinstance(data, Response):
            rest += [data.of_output(o) for o in range(len(data.outputs)) if o != k]
        else:
            rest.append(data.without(k))
        part = Fitter(problem, rest)
        row = []
        for fit in (before, after):
            again = part.fit(fit.terms, fit.theta, iterations=CROSS_VALIDATION.refitted)
            row.append(_predicted(fitter, again, data, k))
        squares.append((*row, _noise(data, k)))
    means = np.sqrt(np.mean(np.array(squares), axis=0))
    return LeftOut(parts=len(chosen), before=float(means[0]), after=float(means[1]), noise=float(means[2]))


def _predicted(fitter: Fitter, fit: Fit, data: Measured, k: int) -> float:
    """Return the mean squared error of one part of the data."""
    problem = fitter.problem
    point = Point(theta=fit.theta, terms=fit.terms)
    state = problem.state(point.theta)
    if isinstance(data, Response):
        H = answer_at_level(problem.view, state, data, problem.wires, point.terms).H
        return float(np.nanmean(apart(data, H)[:, k]))
    view = replace(problem.view, fixed=(*problem.view.fixed, *point.terms))
    errors = modal_errors(data, modal_answer(view, state, data))
    unit = float(np.sqrt(np.mean(data.freq_sd**2)))
    return (unit * errors["frequency"][k] / data.freq_sd[k]) ** 2


def _noise(data: Measured, k: int) -> float:
    if isinstance(data, Response):
        return float(np.nanmean(noise_apart(data)[:, k]))
    return float(np.mean(data.freq_sd**2))
