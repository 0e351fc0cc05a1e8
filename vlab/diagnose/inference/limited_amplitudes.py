"""Amplitudes of effects behind the limits of an actuator."""

from collections.abc import Callable, Sequence

import numpy as np

from vlab.diagnose.parameters.terms import Candidate
from vlab.diagnose.predictors.unit_causes import Shape
from vlab.diagnose.settings import MODEL_CHOICE
from vlab.physics.effect import Effect
from vlab.signals import Array


def at_found_amplitudes(
    candidates: Sequence[Candidate], regressed: Callable[[list[tuple[Effect, Shape]]], list[Candidate]]
) -> list[Candidate]:
    """Return candidates with the columns of their own amplitudes.

    The force of a limited actuator is nonlinear in the command. A unit change of a gain drives a servo to its limit, where
    a column has another shape than at the true amplitude. A derivative vanishes where the model is at the limit. The column
    is therefore the secant at the amplitude that the regression found last, as in a fixed-point iteration.

    Parameters
    ----------
    candidates : sequence of Candidate
        Candidates by their columns of unit amplitude.
    regressed : callable
        Returns the candidates of plans, whose values may hold the amplitude of the column.

    Returns
    -------
    list of Candidate
        Candidates of the largest gain, in the same order.
    """
    if not candidates:
        return []
    derivatives = [(c.effect, {**c.values, **{p.name: 0.0 for p in c.effect.amplitudes}}) for c in candidates]
    last, best = _gains(candidates) - np.inf, _better(candidates, regressed(derivatives))
    while np.any(_gains(best) > last + MODEL_CHOICE.alike):
        last, best = _gains(best), _better(best, regressed([(c.effect, dict(c.values)) for c in best]))
    return best


def _gains(candidates: Sequence[Candidate]) -> Array:
    return np.array([c.log_likelihood_gain for c in candidates])


def _better(ones: Sequence[Candidate], others: Sequence[Candidate]) -> list[Candidate]:
    """Return the candidate of the larger gain of every pair."""
    return [max(pair, key=lambda c: c.log_likelihood_gain) for pair in zip(ones, others, strict=True)]
