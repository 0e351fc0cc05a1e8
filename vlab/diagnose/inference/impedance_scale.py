"""Common scale of motion, nearly unidentifiable from recordings.

Doubled forces double the motion, and halved sensor gains hide the difference. Nonsmooth laws scatter the derivative
more than the prior slopes along that scale, so a descent needs an explicit step.
"""

import re

import numpy as np

from vlab.diagnose.problem import Problem
from vlab.physics.effect import Effect, Parameter
from vlab.signals import Array

_POWER = re.compile(r"(?P<over>/?)\s*\b(?P<unit>N|m)\b(?:\^(?P<power>\d+))?")


def motion_scale(problem: Problem) -> Array:
    """Return the log factors (n_changes,) that scale all motions by e.

    Actuator gains grow and sensor gains shrink; the recorded channels stay equal.
    """
    return np.array([float(p.actuator is not None) - float(p.sensor is not None) for p in problem.parameters])


def exponent(effect: Effect, parameter: Parameter) -> float:
    """Return the exponent of an effect parameter under the motion scale.

    Forces and lengths scale as the unit states, masses stay. Effects on channels have exponent zero.

    Parameters
    ----------
    effect : Effect
        Effect.
    parameter : Parameter
        Parameter.

    Returns
    -------
    float
        Exponent.
    """
    if effect.kind != "port" or parameter.unit.startswith("kg"):
        return 0.0
    total, sign = 0.0, 1.0
    for found in _POWER.finditer(parameter.unit):
        sign = -1.0 if found["over"] else sign
        total += sign * float(found["power"] or 1)
    return total
