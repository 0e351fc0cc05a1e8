"""Effects of the catalogue, attached to a plant."""

from dataclasses import dataclass

from vlab.physics.effect import ActuatorEffect, LinearPortEffect, PortEffect, SensorEffect, Values
from vlab.plants.base import Port


@dataclass(frozen=True, kw_only=True, eq=False)
class AtPort:
    """An effect at a port of a plant.

    Parameters
    ----------
    stiffness : float
        Stiffness of the port's own elastic element [N/m or N m/rad].
    coil : int or None
        Index of the actuator along the port.
    """

    effect: PortEffect | LinearPortEffect
    port: Port
    values: Values
    stiffness: float = 0.0
    coil: int | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class AtActuator:
    """An effect on an actuator."""

    effect: ActuatorEffect
    index: int
    values: Values


@dataclass(frozen=True, kw_only=True, eq=False)
class AtSensor:
    """An effect on a sensor or a compared channel.

    Parameters
    ----------
    name : str
        Name of the sensor or channel.
    other : str
        Name of the actuator or sensor that supplies the picked-up signal.
    """

    effect: SensorEffect
    name: str
    values: Values
    other: str = ""
