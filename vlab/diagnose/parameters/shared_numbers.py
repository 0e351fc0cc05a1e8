"""Numbers that an effect and an uncertain parameter both multiply."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from vlab.diagnose.parameters.mjcf import VELOCITY_GAIN, Uncertain
from vlab.diagnose.parameters.terms import Fit, Term
from vlab.physics.servo import ServoEffect
from vlab.plants.base import Plant


def with_whole_gains(fit: Fit, parameters: Sequence[Uncertain], plant: Plant) -> Fit:
    """Return a fit whose effects hold the gains' whole change.

    The recordings show the product of an effect's factor and of the calibrated one. The division between both follows
    from their priors, and no reader needs the division.

    Parameters
    ----------
    fit : Fit
        Fit.
    parameters : sequence of Uncertain
        Uncertain parameters of the fit.
    plant : Plant
        Nominal plant.

    Returns
    -------
    Fit
        Fit of the same model; the calibrated gains under such effects are those of the case.
    """
    theta, terms = np.array(fit.theta), []
    for term in fit.terms:
        for i, parameter in enumerate(parameters):
            if theta[i] != 0.0 and _is_same_gain(term, parameter, plant):
                term = replace(
                    term, values={**term.values, "gain": (1.0 + term.values["gain"]) * float(np.exp(theta[i])) - 1.0}
                )
                theta[i] = 0.0
        terms.append(term)
    return replace(fit, terms=tuple(terms), theta=theta)


def _is_same_gain(term: Term, parameter: Uncertain, plant: Plant) -> bool:
    """Return whether an effect and a parameter multiply the same gain."""
    if len(term.place.indices) != 1 or term.effect.kind == "sensor":
        return False
    index = term.place.indices[0]
    if isinstance(term.effect, ServoEffect):
        numbers = set(term.effect.factors(term.values) or ())
        is_braked = parameter.name == f"{VELOCITY_GAIN}:{plant.actuators[index].name}"
        return (numbers == {"damping"} and is_braked) or (numbers == {"gain"} and _is_gain(parameter, index, True))
    return term.effect.name == "actuator-gain" and _is_gain(parameter, index, False)


def _is_gain(parameter: Uncertain, actuator: int, is_servo: bool) -> bool:
    """Return whether a parameter is an actuator's or servo's gain."""
    return parameter.actuator == actuator and bool(parameter.fields) == is_servo
