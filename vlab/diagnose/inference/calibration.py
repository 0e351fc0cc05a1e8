"""Calibration of a model along its motion.

Every pass linearises the model about its own parameters."""

import numpy as np

from vlab.diagnose.inference.simulator_least_squares import SimulatorLeastSquares
from vlab.diagnose.inference.trajectory_score_test import TrajectoryScoreTest
from vlab.diagnose.parameters.terms import Fit
from vlab.diagnose.settings import EVIDENCE, MODEL_CHOICE


def calibrate(screen: TrajectoryScoreTest, start: Fit | None = None) -> tuple[TrajectoryScoreTest, Fit | None]:
    """Calibrate the model on whole recordings, with the effects of a fit.

    The linear system errs where the parameters end far from those of its linearisation. The linearisation is renewed while
    the log posterior in MuJoCo grows by more than the difference of indistinguishable hypotheses. Likelihood alone would
    follow missing physics with implausible parameters.

    Parameters
    ----------
    screen : TrajectoryScoreTest
        Screening at other parameters.
    start : Fit or None
        Fit to start from; without effects and prior means by default.

    Returns
    -------
    screen : TrajectoryScoreTest
        Screening linearised at the calibrated parameters, or the given one where a renewal does not help.
    fit : Fit or None
        Fit of the calibrated model, or `start` where a renewal does not help.
    """
    whole = SimulatorLeastSquares(screen)
    terms = start.terms if start else ()
    fit, found = whole.fit(terms, start), start
    residual = whole.residual_in_mujoco(fit)
    while True:
        renewed = screen.at(fit.theta)
        whole = SimulatorLeastSquares(renewed)
        tried = whole.fit(fit.terms, fit)
        now = whole.residual_in_mujoco(tried)
        if not 0.0 < now < residual:
            return screen, found
        gain = EVIDENCE.model_error_samples * np.log(residual / now) if np.isfinite(residual) else np.inf
        if not gain - 0.5 * (tried.prior_cost - fit.prior_cost) > MODEL_CHOICE.alike:
            return screen, found
        screen, found, fit, residual = renewed, tried, tried, now
