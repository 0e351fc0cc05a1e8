"""Causes of innovations: signals of unit effects, with their entrances."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from vlab.cases.replay_inputs import before
from vlab.diagnose.parameters.locations import Place
from vlab.diagnose.predictors.innovations import Cause, Group
from vlab.diagnose.predictors.unit_effects import commands_changed, port_series, unit_amplitudes
from vlab.physics.effect import ActuatorEffect, Effect, LinearPortEffect, PickUp, PortEffect, SensorEffect
from vlab.signals import Array

Shape = dict[str, float]
"""Values of an effect's shape parameters."""
ForceSeries = Callable[[Group, Place, PortEffect, dict[str, float]], Array]
"""Function of filtered runs, port, law and parameter values that returns the force (n, n_runs)."""


def unit_causes(
    effect: Effect, shape: Shape, group: Group, place: Place, forces: Array, series: ForceSeries
) -> list[Cause]:
    """Return the causes of an effect's unit amplitudes.

    Parameters
    ----------
    effect : Effect
        Effect.
    shape : dict
        Values of the shape parameters.
    group : Group
        Filtered runs.
    place : Place
        Location.
    forces : (m, n_actuators) array
        Modal forces per unit command.
    series : callable
        Force of a law along the motion at a port.

    Returns
    -------
    list of Cause
        Causes by entrance.
    """
    if isinstance(effect, SensorEffect):
        return causes_in_channel(effect, shape, group, place)
    if isinstance(effect, ActuatorEffect):
        return causes_of_commands(effect, shape, group, place, forces)
    if isinstance(effect, LinearPortEffect):
        return causes_of_impedance(effect, group, place)
    assert isinstance(effect, PortEffect)
    parts = [series(group, place, effect, values) for values in unit_amplitudes(effect, shape)]
    force = np.stack(parts, axis=-1) / effect.probe
    readings = place.effort_in_drive if effect.acts_in_drive else None
    causes = [Cause(series=force, force=place.rows[0])]
    return causes if readings is None else [*causes, *_read(_at_samples(force, place.seen), readings)]


def causes_in_channel(effect: SensorEffect, shape: Shape, group: Group, place: Place) -> list[Cause]:
    """Return the causes of a sensor effect.

    Parameters
    ----------
    effect : SensorEffect
        Effect.
    shape : dict
        Values of the shape parameters.
    group : Group
        Filtered runs.
    place : Place
        Sensor, or pair of a sensor and a picked-up signal.

    Returns
    -------
    list of Cause
        One cause, added to the sensor's channel.
    """
    recorded = group.y[..., place.index]
    if isinstance(effect, PickUp):
        other = before(group.u[..., place.other]) if place.tag == "command" else group.y[..., place.other]
        (values,) = unit_amplitudes(effect, shape)
        return [Cause(series=(effect.mix(recorded, other, values) - recorded)[..., None], channel=place.index)]
    parts = [recorded - effect.correct(recorded, v, group.h, group.times) for v in unit_amplitudes(effect, shape)]
    return [Cause(series=np.stack(parts, axis=-1), channel=place.index)]


def subtract_own_innovations(columns: Array, effect: PickUp, shape: Shape, group: Group, place: Place) -> None:
    """Subtract the innovations from a pick-up's columns (n, n_runs, p, k).

    Of their own sample only the predicted part of signals counts. Otherwise one sensor's innovation would explain
    another's.
    """
    other = 0.0 if place.tag == "command" else group.e[..., place.other]
    (unit,) = unit_amplitudes(effect, dict(shape))
    columns[..., place.index, 0] -= effect.mix(group.e[..., place.index], other, unit) - group.e[..., place.index]


def causes_of_commands(effect: ActuatorEffect, shape: Shape, group: Group, place: Place, forces: Array) -> list[Cause]:
    """Return the causes of an actuator effect.

    Parameters
    ----------
    effect : ActuatorEffect
        Effect.
    shape : dict
        Values of the shape parameters.
    group : Group
        Filtered runs.
    place : Place
        Actuators.
    forces : (m, n_actuators) array
        Modal forces per unit command.

    Returns
    -------
    list of Cause
        One cause per actuator, and one per force sensor that reads the actuator.
    """
    out = []
    for k, i in enumerate(place.indices):
        changed = commands_changed(effect, group.u[..., i], shape, group.h, group.commands_before[:, i])
        out.append(Cause(series=changed, force=forces[:, i]))
        if place.efforts.size:
            out += _read(_at_samples(changed, place.seen), place.efforts[:, k])
    return out


def _at_samples(series: Array, seen: float) -> Array:
    """Return forces over intervals as readings see them."""
    return np.asarray((1.0 - seen) * before(series, stood=True) + seen * series)


def _read(series: Array, readings: Array) -> list[Cause]:
    """Return what force sensors read of a force or command, by channel."""
    return [
        Cause(series=reading * series, channel=int(channel))
        for channel, reading in zip(np.flatnonzero(readings), readings[readings != 0.0], strict=True)
    ]


def causes_of_impedance(effect: LinearPortEffect, group: Group, place: Place) -> list[Cause]:
    """Return the causes of a linear effect at a port.

    Parameters
    ----------
    effect : LinearPortEffect
        Effect with one amplitude.
    group : Group
        Filtered runs.
    place : Place
        Port.

    Returns
    -------
    list of Cause
        One cause per row of the port.
    """
    p, v, a = group.motion
    (values,) = unit_amplitudes(effect, {})
    mass, damping, stiffness = effect.impedance(values, place.stiffness)
    return [
        Cause(series=-(mass * (a @ row) + damping * (v @ row) + stiffness * (p @ row))[..., None], force=row)
        for row in place.rows
    ]


def series_at_ports(
    effect: PortEffect,
    motions: Sequence[tuple[Array, Array]],
    shapes: Sequence[Sequence[Shape]],
    amplitudes: Mapping[str, float],
    group: Group,
) -> Array:
    """Return a law's force at several ports.

    One batch integrates all ports and shapes, since the loop over samples dominates.

    Parameters
    ----------
    effect : PortEffect
        Law with a state.
    motions : sequence of (array, array)
        Displacement and velocity (n, n_runs) of every port.
    shapes : sequence of sequence of dict
        Shapes of every port, equally many.
    amplitudes : mapping
        Values of the amplitudes.
    group : Group
        Filtered runs.

    Returns
    -------
    (n, n_runs, n_ports, n_shapes) array
        Force [SI].
    """
    both = [np.stack([m[i] for m in motions], axis=-1)[..., None] for i in range(2)]
    own = {p.name: np.array([[s[p.name] for s in of_port] for of_port in shapes]) for p in effect.shapes}
    wide = np.zeros((1, 1, 1, len(shapes[0])))
    starts = group.starts[:, None, None]
    return port_series(effect, both[0] + wide, both[1] + wide, {**own, **amplitudes}, group.h, starts=starts)
