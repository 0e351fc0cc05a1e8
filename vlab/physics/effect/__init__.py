"""Interface of a physical effect: law, parameters, kind of place.

A *port effect* is a force along a named scalar coordinate of the structure (a displacement, a rotation, a relative
motion). A *linear port effect* adds mass, damping or stiffness at a port and can enter the matrices. An *actuator
effect* changes the command on its way to the force. A *sensor effect* changes the motion on its way to the recorded
sample.

A law is written once, for arrays of any shape. The reduced model of the search evaluates a law for many parameter sets
at once, MuJoCo for one value at a time. The screening turns a law into regression columns.
"""

from vlab.physics.effect.actuator import ActuatorEffect, ActuatorStep
from vlab.physics.effect.base import OWN_SHARE, Effect, Kind
from vlab.physics.effect.channel import ChannelEffect
from vlab.physics.effect.limits import limited, positive, smooth_sign, softly_limited
from vlab.physics.effect.parameter import TIMES, Parameter, Reference, Scan, Values
from vlab.physics.effect.port import LinearPortEffect, PortEffect, Step
from vlab.physics.effect.sensor import SETTLING, PickUp, SensorEffect, SensorStep

__all__ = [
    "OWN_SHARE",
    "SETTLING",
    "TIMES",
    "ActuatorEffect",
    "ActuatorStep",
    "ChannelEffect",
    "Effect",
    "Kind",
    "LinearPortEffect",
    "Parameter",
    "PickUp",
    "PortEffect",
    "Reference",
    "Scan",
    "SensorEffect",
    "SensorStep",
    "Step",
    "Values",
    "limited",
    "positive",
    "smooth_sign",
    "softly_limited",
]
