"""Effects of a case's own model, as terms of every hypothesis.

The reduced model holds the elements of MuJoCo and linear port effects. Effects on commands and readings (a slew limit, the
gain of a sensor) act beside MuJoCo. The search takes such effects as present with the values that the case states.
"""

from collections.abc import Sequence

from vlab.diagnose.parameters.locations import Place
from vlab.diagnose.parameters.terms import Term
from vlab.physics.attached import AtActuator, AtPort, AtSensor
from vlab.physics.effect import LinearPortEffect
from vlab.plants.base import Plant


def known_terms(plant: Plant, places: Sequence[Place]) -> tuple[Term, ...]:
    """Return the effects of a plant on commands and readings as terms.

    Parameters
    ----------
    plant : Plant
        Plant with its effects.
    places : sequence of Place
        Locations of the inverse problem.

    Returns
    -------
    tuple of Term
        Terms; without effects on sensors that no recording reads.
    """
    out = []
    for one in plant.physics:
        place = None
        if isinstance(one, AtActuator):
            place = Place(name=f"actuator:{plant.actuators[one.index].name}", kind="actuator", index=one.index)
        elif isinstance(one, AtSensor):
            sensor, other = f"sensor:{one.name.removeprefix('sensor:')}", one.other.rpartition(":")[2]
            name = f"{sensor}/{other}" if other else sensor
            place = next((p for p in places if p.name == name), None)
        if place is not None:
            out.append(Term(effect=one.effect, place=place, values=dict(one.values)))
    return tuple(out)


def unsearched(plant: Plant) -> tuple[str, ...]:
    """Return the names of nonlinear port effects.

    The linear class has the tangent of such an effect alone.

    Parameters
    ----------
    plant : Plant
        Plant with its effects.

    Returns
    -------
    tuple of str
        Names of effects.
    """
    ports = [one for one in plant.physics if isinstance(one, AtPort)]
    return tuple(sorted({one.effect.name for one in ports if not isinstance(one.effect, LinearPortEffect)}))
