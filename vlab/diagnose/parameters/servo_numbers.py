"""Numbers of a servo at calibrated parameters of the model."""

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from vlab.diagnose.parameters.locations import Place
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.problem import Problem
from vlab.physics.effect import Effect
from vlab.physics.servo import ServoEffect, servo_of
from vlab.signals import Array


def servo_numbers(problem: Problem, effect: Effect, place: Place, theta: Array) -> dict[str, Any]:
    """Return the servo's numbers that a law takes beside its parameters.

    A number is the nominal one times a power of every factor of the calibration.

    Parameters
    ----------
    problem : Problem
        Problem.
    effect : Effect
        Effect.
    place : Place
        Location.
    theta : (..., n_changes) array
        Log factors.

    Returns
    -------
    dict of str to (...) array
        Numbers by name ``servo.NAME``; empty for a law without such numbers.
    """
    if not isinstance(effect, ServoEffect) or not effect.numbers or place.servo is None:
        return {}
    powers = _powers(problem, place.indices[0], effect.numbers)
    return {
        f"servo.{name}": getattr(place.servo, name) * np.exp(theta @ power) for name, power in powers.items()
    }


@lru_cache(maxsize=64)
def _powers(problem: Problem, actuator: int, names: tuple[str, ...]) -> dict[str, Array]:
    """Return the exponents (n_changes,) of every calibrated factor in a servo's numbers."""
    nominal, count = servo_of(problem.plant, actuator), len(problem.reduced_model.changes)
    out = {name: np.zeros(count) for name in names}
    for i in range(count):
        if problem.reduced_model.changes[i].sensor is not None:
            continue
        changed = servo_of(problem.adjusted(np.eye(count)[i]), actuator)
        for name in names:
            before, after = getattr(nominal, name), getattr(changed, name, 0.0)
            if before > 0 and after > 0:
                out[name][i] = np.log(after / before)
    return out


def of_term(problem: Problem, term: Term, own: Mapping[str, Array], theta: Array) -> Mapping[str, Array]:
    """Return a term's parameter values with the servo's numbers.

    Parameters
    ----------
    problem : Problem
        Problem.
    term : Term
        Effect and location.
    own : mapping of str to (n_sets,) array
        Parameter values.
    theta : (n_sets, n_changes) array
        Log factors.
    """
    return {**own, **servo_numbers(problem, term.effect, term.place, theta)}
