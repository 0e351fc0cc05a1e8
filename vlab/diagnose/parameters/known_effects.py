"""Effects of a case's own model, as terms of every hypothesis.

The reduced model near rest holds the elements of MuJoCo and linear port effects. Effects on commands and readings (a slew
limit, the gain of a sensor) act beside MuJoCo, and along a motion so do effects at ports. The search takes such effects as
present with the values that the case states.
"""

from collections.abc import Sequence
from dataclasses import replace

from vlab.cases.case import Case
from vlab.cases.channel_map import Compared
from vlab.diagnose.parameters.locations import Place
from vlab.diagnose.parameters.terms import Term
from vlab.errors import BadCase
from vlab.physics.attached import AtActuator, AtPort, AtSensor
from vlab.physics.effect import LinearPortEffect
from vlab.physics.running import tap_index
from vlab.physics.servo import ServoEffect
from vlab.plants.base import Plant


def known_terms(plant: Plant, channels: Sequence[Compared]) -> tuple[Term, ...]:
    """Return the effects of a plant on commands and readings as terms.

    Parameters
    ----------
    plant : Plant
        Plant with its effects.
    channels : sequence of Compared
        Compared channels.

    Returns
    -------
    tuple of Term
        Terms; without effects on sensors that no recording reads.
    """
    out = []
    for one in plant.physics:
        if isinstance(one, AtActuator):
            out.append(at_actuator(plant, one))
        elif isinstance(one, AtSensor):
            out += at_sensor(plant, one, channels)
    return tuple(out)


def port_terms(case: Case, places: Sequence[Place]) -> tuple[Term, ...]:
    """Return the effects at ports of a case's model as terms.

    Parameters
    ----------
    case : Case
        Case.
    places : sequence of Place
        Locations of effects.

    Returns
    -------
    tuple of Term
        Terms.

    Raises
    ------
    BadCase
        A port that the search does not know.
    """
    of_name, out = {place.name: place for place in places}, []
    for one in case.plant.physics:
        if isinstance(one, AtPort):
            is_servo = isinstance(one.effect, ServoEffect) and one.coil is not None
            name = f"actuator:{case.plant.actuators[one.coil or 0].name}" if is_servo else one.port.name
            if name not in of_name:
                raise BadCase(
                    f"{case.path}: [[model.effect]] {one.effect.name} acts at {name}, where a search along the motion knows no "
                    f"effects (known: {', '.join(of_name)}); put it into the model file or leave it out"
                )
            out.append(Term(effect=one.effect, place=of_name[name], values=dict(one.values)))
    return tuple(out)


def at_actuator(plant: Plant, one: AtActuator) -> Term:
    """Return the term of an actuator's effect."""
    place = Place(name=f"actuator:{plant.actuators[one.index].name}", kind="actuator", index=one.index)
    return Term(effect=one.effect, place=place, values=dict(one.values))


def at_sensor(plant: Plant, one: AtSensor, channels: Sequence[Compared]) -> list[Term]:
    """Return a sensor's effect on the channels that read it.

    Parameters
    ----------
    plant : Plant
        Plant.
    one : AtSensor
        Effect.
    channels : sequence of Compared
        Compared channels.

    Returns
    -------
    list of Term
        Terms; none for a pick-up from a sensor without a channel.
    """
    own, out = tap_index(plant.sensors, one.name), []
    for k, compared in enumerate(channels):
        if compared.channel != one.name and (own is None or compared.sensor != own):
            continue
        place = Place(name=f"sensor:{compared.channel.removeprefix('sensor:')}", kind="sensor", index=k)
        if one.other:
            is_command = "command" in one.effect.needs
            if is_command:
                other = plant.actuator_index(one.other)
            else:
                sensor = plant.sensor_index(one.other)
                other = next((j for j, c in enumerate(channels) if c.sensor == sensor), -1)
            if other < 0:
                continue
            tag = "command" if is_command else "sensor"
            place = replace(place, name=f"{place.name}/{one.other}", kind="pick-up", other=other, tag=tag)
        out.append(Term(effect=one.effect, place=place, values=dict(one.values)))
    return out


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
