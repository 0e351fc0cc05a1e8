"""Final fit of a linear time-invariant search, in MuJoCo.

A strong local law may deform a structure beyond the reduced model's modes, or a model may be weakly nonlinear.
Levenberg-Marquardt iterations on MuJoCo's simulation then move the law's and the model's parameters.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vlab.cases.channel_map import Run
from vlab.diagnose.data.command_limit import CommandLimit
from vlab.diagnose.data.mains_interference import remove_mains_interference
from vlab.diagnose.data.noise import noise_levels
from vlab.diagnose.data.quality import is_informative
from vlab.diagnose.inference.jacobian import update_broyden
from vlab.diagnose.inference.least_squares import LeastSquares
from vlab.diagnose.inference.parameter_vector import from_unbounded, is_logarithm, to_unbounded
from vlab.diagnose.parameters.terms import Fit
from vlab.diagnose.problem import Problem
from vlab.diagnose.settings import EVIDENCE, FINAL_FIT
from vlab.diagnose.validation.simulation import extended
from vlab.errors import VlabError
from vlab.parallel import side_by_side
from vlab.signals import Array, Recording


@dataclass(frozen=True, kw_only=True, eq=False)
class _Target:
    """Recording to fit, with its simulated part, mask and weights."""

    whole: Recording
    run: Run
    columns: tuple[int, ...]
    measured: Array
    counts: Array
    sigma: Array

    def left(self, difference: Array) -> float:
        """Return the rms residual over the channels' rms."""
        scale = np.maximum(np.std(self.measured, axis=0), 1e-300)
        shares = np.broadcast_to(self.sigma / scale, self.measured.shape)[self.counts]
        return float(np.sqrt(np.mean((difference * shares) ** 2)))


def final_fit(problem: Problem, refiner: LeastSquares, fit: Fit, limit: CommandLimit | None = None) -> Fit:
    """Return a fit whose law holds in MuJoCo.

    The fit is unchanged where both agree, or where MuJoCo can simulate the first moments only.

    Parameters
    ----------
    problem : Problem
        Problem.
    refiner : LeastSquares
        Fits to whole runs, with the identifiable directions.
    fit : Fit
        Fit on the reduced model.
    limit : CommandLimit or None
        Limit on a law's commands.

    Returns
    -------
    Fit
        Final fit.
    """
    targets = _targets(problem, limit)
    if any(len(target.measured) < FINAL_FIT.least_part * len(target.whole) for target in targets):
        return fit
    first = _difference(problem, fit, targets[0])
    agreed = max(FINAL_FIT.worse * float(np.sqrt(np.mean(fit.error**2))), FINAL_FIT.least_excess)
    if targets[0].left(first) <= agreed:
        return fit
    moves = _Moves(fit, refiner.directions[:, : FINAL_FIT.most_directions])
    x = np.zeros(moves.count)
    prior = np.zeros(moves.count)
    prior[: moves.r] = refiner.vector(fit.terms).project_prior(fit.theta)[: moves.r]
    is_prior = np.arange(moves.count) < moves.r
    base = np.concatenate([first, *(_difference(problem, fit, target) for target in targets[1:])])
    slopes, age = np.zeros((len(base), moves.count)), -1
    for _ in range(FINAL_FIT.steps):
        if age < 0:
            moved = _residuals(problem, targets, [moves.at(x + FINAL_FIT.step * unit) for unit in np.eye(moves.count)])
            slopes, age = np.stack([(m - base) / FINAL_FIT.step for m in moved], axis=1), 0
        scale = min(refiner.effective_samples, EVIDENCE.model_error_samples * len(targets)) / max(
            float(base @ base), base.size
        )
        normal = scale * slopes.T @ slopes + np.diag(is_prior.astype(float))
        gradient = scale * slopes.T @ base + np.where(is_prior, prior + x, 0.0)
        size = np.diag(np.diag(normal) + 1e-12)
        trials = [x - np.clip(np.linalg.solve(normal + lam * size, gradient), -1.0, 1.0) for lam in FINAL_FIT.dampings]
        tried = _residuals(problem, targets, [moves.at(t) for t in trials])
        costs = [
            scale * float(r @ r) + float(np.sum((prior + t)[is_prior] ** 2)) for r, t in zip(tried, trials, strict=True)
        ]
        before = scale * float(base @ base) + float(np.sum((prior + x)[is_prior] ** 2))
        pick = int(np.argmin(costs))
        is_old, age = age > 0, age + 1
        if costs[pick] < before:
            slopes = update_broyden(slopes, trials[pick] - x, tried[pick] - base)
            x, base = trials[pick], tried[pick]
            if targets[0].left(base[: len(first)]) <= agreed:
                break
        if not costs[pick] < FINAL_FIT.worthwhile * before:
            if not is_old:
                break
            age = -1  # an old Jacobian is renewed before the end
    return moves.at(x)


class _Moves:
    """Fit moved along identifiable directions and laws' parameters."""

    def __init__(self, fit: Fit, directions: Array) -> None:
        self.fit, self.directions, self.r = fit, directions, directions.shape[1]
        self.count = self.r + sum(len(t.effect.parameters) for t in fit.terms)

    def at(self, x: Array) -> Fit:
        vector, terms = iter(x[self.r :]), []
        for term in self.fit.terms:
            values = {}
            for parameter in term.effect.parameters:
                centre = to_unbounded(parameter, term.values[parameter.name])
                size = 1.0 if is_logarithm(parameter) else max(abs(centre), 1e-12)
                values[parameter.name] = float(from_unbounded(parameter, np.asarray(centre + size * next(vector))))
            terms.append(replace(term, values=values))
        return replace(self.fit, theta=self.fit.theta + self.directions @ x[: self.r], terms=tuple(terms))


def loudest_and_quietest(problem: Problem) -> list[Run]:
    """Return the fitted recordings of largest and smallest motion.

    Parameters
    ----------
    problem : Problem
        Problem.

    Returns
    -------
    list of Run
        Two recordings, or one.
    """
    fit = [run for run in problem.runs if run.role == "fit"]
    size = [max(float(np.std(run.measured[name])) for name in problem.names) for run in fit]
    order = np.argsort(size)
    return [fit[order[-1]], fit[order[0]]][: len(fit)]


def _targets(problem: Problem, limit: CommandLimit | None) -> list[_Target]:
    chosen = loudest_and_quietest(problem)
    most = min(FINAL_FIT.longest, FINAL_FIT.most_work // problem.plant.model.nv)
    wholes = [run if limit is None else limit.on(run) for run in chosen]
    return [_target(problem, whole.measured, _shortened(whole, most)) for whole in wholes]


def _shortened(run: Run, most: int) -> Run:
    measured = run.measured
    if len(measured) <= most:
        return run
    return replace(run, measured=measured.rows(slice(most)))


def _target(problem: Problem, whole: Recording, run: Run) -> _Target:
    clean = remove_mains_interference(run, problem.interferences)
    measured = np.column_stack([clean.measured[name] for name in problem.names])
    noise = noise_levels(clean, problem.names)
    return _Target(
        whole=whole,
        run=run,
        columns=tuple(run.measured.index(name) for name in problem.names),
        measured=measured,
        counts=is_informative(run, problem.channels),
        sigma=np.hypot(noise, problem.model_error * np.std(measured, axis=0)),
    )


def _residuals(problem: Problem, targets: Sequence[_Target], fits: Sequence[Fit]) -> list[Array]:
    """Return the concatenated normalised residuals of MuJoCo's simulations."""
    work = [(fit, target) for fit in fits for target in targets]
    parts = side_by_side(lambda item: _difference(problem, *item), work)
    return [np.concatenate(parts[i * len(targets) : (i + 1) * len(targets)]) for i in range(len(fits))]


def _difference(problem: Problem, fit: Fit, target: _Target) -> Array:
    try:
        simulated = extended(problem, fit).simulated(target.run).data[:, list(target.columns)]
    except VlabError:  # divergence, or no initial state
        return np.full(int(target.counts.sum()), FINAL_FIT.far)
    out = ((simulated - target.measured) / target.sigma)[target.counts]
    return np.asarray(np.clip(np.where(np.isfinite(out), out, FINAL_FIT.far), -FINAL_FIT.far, FINAL_FIT.far))
