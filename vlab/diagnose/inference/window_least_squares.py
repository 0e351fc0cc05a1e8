"""Maximum a posteriori fits in windows that start from smoothed states.

Windows test a law within a few cycles, without long-term phase.
"""

from collections.abc import Sequence

import numpy as np

from vlab.diagnose.data.runs import Signals, windows
from vlab.diagnose.inference.least_squares import LeastSquares
from vlab.diagnose.inference.score_test import ScoreTest
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.predictors.filtered_runs import smoothed_without
from vlab.diagnose.settings import WINDOW_FIT
from vlab.physics.effect import SensorEffect

GOLDEN = 0.6180339887
"""GOLDEN [1]: golden ratio conjugate; its multiples are equidistributed without a period."""


class WindowLeastSquares(LeastSquares):
    """Fits of hypotheses in windows.

    Parameters
    ----------
    screen : ScoreTest
        Screening with smoothed states.
    every : int
        Use one window in n, at irregular spacing since motion may repeat; above 1 with coarser steps.
    model_error : float or None
        Allowed simulation error over a channel's rms.
    without : sequence of Term
        Sensor effects to remove from the recordings before smoothing.
    """

    def __init__(
        self, screen: ScoreTest, *, every: int = 1, model_error: float | None = None, without: Sequence[Term] = ()
    ) -> None:
        self.every = every
        super().__init__(screen, _cut(screen, every, without), model_error, is_rough=every > 1)

    def beside(self, terms: Sequence[Term]) -> LeastSquares:
        """See `LeastSquares`."""
        if not any(t.effect.kind == "sensor" for t in terms):
            return self
        return WindowLeastSquares(self.screen, every=self.every, model_error=self.model_error, without=terms)


def _cut(screen: ScoreTest, every: int, without: Sequence[Term]) -> Sequence[Signals]:
    if max(len(run) for run in screen.runs) <= WINDOW_FIT.whole:
        return screen.runs
    omega = np.abs(screen.reduced_model.omega)
    moving = omega[omega > WINDOW_FIT.least_omega]
    slowest = float(moving.min() / (2 * np.pi)) if moving.size else 0.0
    wrong = [(t.effect, t.place, t.values) for t in without if isinstance(t.effect, SensorEffect)]
    parts = [
        w for run, states, shown in smoothed_without(screen.groups, wrong) for w in windows(run, states, shown, slowest)
    ]
    return [w for i, w in enumerate(parts) if every == 1 or (i * GOLDEN) % 1.0 < 1.0 / every]
