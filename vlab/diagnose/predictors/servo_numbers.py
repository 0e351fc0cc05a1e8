"""Numbers of a servo at calibrated parameters of the model."""

from functools import lru_cache
from typing import Any

import numpy as np

from vlab.diagnose.parameters.locations import Place
from vlab.diagnose.problem import Problem
from vlab.physics.effect import Effect
from vlab.physics.servo import servo_of
from vlab.signals import Array


def servo_numbers(problem: Problem, effect: Effect, place: Place, theta: Array, about: Array) -> dict[str, Any]:
    """Return the servo's numbers that a law takes beside its parameters.

    A number is the nominal one times a power of every factor of the calibration. The law itself carries the calibration
    of these numbers, see `carried`.

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
    about : (n_changes,) array
        Log factors of the simulated model to which the law's force is added.

    Returns
    -------
    dict of str to (...) array
        Numbers by name ``servo.NAME`` and ``model.NAME``; empty for a law without such numbers.
    """
    if not effect.numbers or place.servo is None:
        return {}
    powers = _powers(problem, place.indices[0], effect.numbers)
    at = {"servo": theta, "model": np.broadcast_to(about, np.shape(theta))}
    return {
        f"{which}.{name}": getattr(place.servo, name) * np.exp(x @ power)
        for which, x in at.items()
        for name, power in powers.items()
    }


def carried(problem: Problem, effect: Effect, place: Place) -> Array:
    """Return which calibrated factors a law carries along its place's direction.

    Parameters
    ----------
    problem : Problem
        Problem.
    effect : Effect
        Effect.
    place : Place
        Location.

    Returns
    -------
    (n_changes,) array of bool
        Mask of the factors.
    """
    out = np.zeros(len(problem.reduced_model.changes), dtype=bool)
    if effect.numbers and place.servo is not None:
        for power in _powers(problem, place.indices[0], effect.numbers).values():
            out |= power != 0.0
    return out


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
