"""The scale of the motions, of which recordings hardly know: of twice the forces they are twice as large, and read the same where
sensors show half of them.

Where a law has edges its slopes chatter by more than that valley slopes, and a descent that has reached its floor does not see
along it.
"""

import re

import numpy as np

from vlab.diagnose.problem import Problem
from vlab.physics.effect import Effect, Parameter
from vlab.signals import Array

_POWER = re.compile(r"(?P<over>/?)\s*\b(?P<unit>N|m)\b(?:\^(?P<power>\d+))?")


def motion_scale(problem: Problem) -> Array:
    """Return the log-factors of the uncertain parameters, (n_changes,), where all motions are larger by a factor of e and readings stay:
    larger gains of the actuators, smaller ones of the sensors."""
    return np.array([float(p.actuator is not None) - float(p.sensor is not None) for p in problem.parameters])


def exponent(effect: Effect, parameter: Parameter) -> float:
    """Return the power of the motions' scale with which a parameter of an effect grows: with forces and lengths as its unit has them,
    masses as they are; of an effect on channels none."""
    if effect.kind != "port" or parameter.unit.startswith("kg"):
        return 0.0
    total, sign = 0.0, 1.0
    for found in _POWER.finditer(parameter.unit):
        sign = -1.0 if found["over"] else sign
        total += sign * float(found["power"] or 1)
    return total
