"""Fits in MuJoCo, with derivatives of the trajectory-linearised system."""

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property

import numpy as np

from vlab.cases.initial_state import InitialState
from vlab.diagnose.inference.direct_least_squares import (
    DirectLeastSquares,
    is_affordable,
    run_in_mujoco,
    state_at,
)
from vlab.diagnose.inference.trajectory_least_squares import TrajectoryLeastSquares
from vlab.diagnose.inference.trajectory_score_test import TrajectoryScoreTest
from vlab.diagnose.parameters.terms import Fit, Term, with_effects
from vlab.diagnose.settings import FIT, HYPOTHESIS_FITS, SIMULATOR_FIT
from vlab.errors import VlabError
from vlab.parallel import side_by_side
from vlab.signals import Array


class SimulatorLeastSquares(TrajectoryLeastSquares):
    """Fits to whole runs by defect correction with MuJoCo's simulation.

    The linear system along the motion is fitted to the recordings minus its difference from MuJoCo's run. Its
    derivatives are accurate where its values err slightly. Where the recordings stay unexplained, MuJoCo is the predictor
    of a final fit, as far as the number of steps allows.

    Parameters
    ----------
    screen : TrajectoryScoreTest
        Screening along the motion.
    is_final : bool
        Whether MuJoCo may be the predictor of a fit.
    model_error : float or None
        See `LeastSquares`.
    """

    def __init__(
        self, screen: TrajectoryScoreTest, *, is_final: bool = False, model_error: float | None = None
    ) -> None:
        super().__init__(screen, whole=True, model_error=model_error)
        self.is_final = is_final
        self.recorded = [run.y for run in self.runs]

    def fit(
        self,
        terms: Sequence[Term] = (),
        start: Fit | None = None,
        iterations: int = FIT.iterations,
        thetas: Sequence[Array] = (),
        tolerance: float = FIT.near_enough,
    ) -> Fit:
        """See `LeastSquares`; the cost is that of MuJoCo's run."""
        self._compare_with(self.recorded)
        best = super().fit(terms, start, iterations, thetas, tolerance)
        left, bias = self._missed(best)
        for _ in range(SIMULATOR_FIT.corrections):
            if bias is None:
                break
            self._compare_with([y - b for y, b in zip(self.recorded, bias, strict=True)])
            tried = super().fit(best.terms, best, SIMULATOR_FIT.steps, tolerance=tolerance)
            missed, more = self._missed(tried)
            if not missed < left:
                break
            is_enough = missed > SIMULATOR_FIT.enough * left
            best, left, bias = tried, missed, more
            if is_enough:
                break
        self._compare_with(self.recorded)
        left = min(left, self._diverged)
        best = replace(best, cost=left, chi2=best.prior_cost + left)
        if self._explains(left) or not self._may_be_direct(terms):
            return best
        return self._directly(best, self._direct.fit(terms, start, 0), iterations, tolerance)

    @property
    def _diverged(self) -> float:
        """Cost of a diverged run, above that of all others."""
        return SIMULATOR_FIT.diverged**2 * self.n_values

    def _may_be_direct(self, terms: Sequence[Term]) -> bool:
        """Return whether MuJoCo may be the predictor of effects."""
        return self.is_final and is_affordable(self, terms)

    def _explains(self, cost: float) -> bool:
        """Return whether a residual is that of noise and allowed model error."""
        return cost <= HYPOTHESIS_FITS.enough**2 * self.n_values

    def _directly(self, best: Fit, start: Fit, iterations: int, tolerance: float) -> Fit:
        """Return the direct fit from the better of two fits."""
        first = min(start, self._direct.fit(best.terms, best, 0), key=self.negative_log_posterior)
        found = self._direct.fit(first.terms, first, min(iterations, SIMULATOR_FIT.steps), tolerance=tolerance)
        return min(best, found, key=self.negative_log_posterior)

    @cached_property
    def _direct(self) -> DirectLeastSquares:
        """Fits with MuJoCo as predictor."""
        return DirectLeastSquares(self.moving, self.model_error)

    def about(self, fit: Fit) -> "SimulatorLeastSquares":
        """See `LeastSquares`; the linear system with its defect at a fit removed.

        Residuals are then those of MuJoCo at the fit, and to first order about the fit. Where MuJoCo does not follow the
        recordings, the defect stays.
        """
        _, bias = self._missed(fit)
        if bias is None:
            return self
        own = copy(self)
        own._compare_with([y - b for y, b in zip(self.recorded, bias, strict=True)])
        return own

    def residual_in_mujoco(self, fit: Fit) -> float:
        """Return the normalised residual of a fit in MuJoCo.

        The rms residual is over noise and allowed model error.

        Parameters
        ----------
        fit : Fit
            Fit.

        Returns
        -------
        float
            Normalised residual, infinite after divergence.
        """
        left, _ = self._missed(fit)
        if not self._explains(left) and self._may_be_direct(fit.terms):
            direct = self._direct.fit(fit.terms, fit, 0).cost
            left = direct if direct < min(left, self._diverged) else left
        return float(np.sqrt(left / self.n_values))

    def _compare_with(self, recorded: Sequence[Array]) -> None:
        self.runs = [replace(run, y=y) for run, y in zip(self.runs, recorded, strict=True)]

    def _missed(self, fit: Fit) -> tuple[float, list[Array] | None]:
        """Return MuJoCo's normalised residual of a fit, and the system's defect."""
        system, states = self._along(fit)
        plant = self.problem.adjusted(fit.theta)
        try:
            plant = with_effects(plant, fit.terms, self.problem.names)
            found = side_by_side(lambda i: run_in_mujoco(self, plant, i, states[i]), range(len(states)))
        except VlabError:
            return np.inf, None
        _, (gains,) = self.reduced_model.gains(fit.theta[None])
        bias, left, worst = [], 0.0, 0.0
        for i, (values, run) in enumerate(zip(found, self.runs, strict=True)):
            y = values * gains + fit.offsets
            missed = (y - self.recorded[i]) * run.usable
            left += float(np.sum((missed / self.sigma[i]) ** 2))
            worst = max(worst, float(np.max(np.sqrt(np.mean(missed**2, axis=0)) / run.scale)))
            bias.append(y - system[i])
        return left, bias if worst < SIMULATOR_FIT.follows else None

    def _along(self, fit: Fit) -> tuple[list[Array], list[InitialState]]:
        """Return the linear system's channels of a fit, and the initial states."""
        y = self.move_starts(fit.terms, fit.theta, [dict(t.values) for t in fit.terms], fit.offsets)
        out, states = [], []
        for i, run in enumerate(self.runs):
            assert run.start is not None
            states.append(state_at(self, i, run.start))
            out.append(y[: len(run), i] + fit.offsets)
        return out, states
