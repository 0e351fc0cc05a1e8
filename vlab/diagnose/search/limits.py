"""Limits of a search: time, number of effects, noise."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from vlab.diagnose.inference.evidence import Hypothesis
from vlab.diagnose.inference.model_choice import gain_beyond
from vlab.diagnose.parameters.terms import Fit
from vlab.diagnose.search.deadline import NO_DEADLINE, Deadline


def _never(fit: Fit) -> bool:
    return False


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Limits of a search.

    Parameters
    ----------
    deadline : Deadline
        End of the time for further effects.
    is_single : bool
        Whether hypotheses have one effect only.
    is_noise : callable
        Whether the recordings less a fit of the calibrated model are noise of any colour.
    """

    deadline: Deadline = NO_DEADLINE
    is_single: bool = False
    is_noise: Callable[[Fit], bool] = _never

    def forbid_more(self, before: Hypothesis, singles: Sequence[Hypothesis], enough: float) -> bool:
        """Return whether no effects are added to single ones.

        Beside a residual of noise, nothing is missing but perhaps one effect within the model error. No effect explains
        noise, so an effect beyond chance shows that the residual is more.

        Parameters
        ----------
        before : Hypothesis
            Calibrated model.
        singles : sequence of Hypothesis
            Single effects, best first; none of them forbids nothing.
        enough : float
            Normalised residual that needs no further effect.

        Returns
        -------
        bool
            Whether the search ends with single effects.
        """
        if self.is_single or not singles:
            return self.is_single
        if self.deadline.is_past:
            return True
        may_be_noise = before.normalised_residual > enough and gain_beyond(singles[0], before) <= 0.0
        return may_be_noise and self.is_noise(before.long_fit)


NO_LIMITS = Limits()
"""Limits of an unlimited search."""
