"""Regressors of the score test from unit effects."""

from typing import Any

import numpy as np

from vlab.diagnose.kernels.expression_graph import driven_series, series
from vlab.diagnose.settings import KERNELS, TRAJECTORY
from vlab.physics.effect import ActuatorEffect, Effect, PortEffect, Step, Values
from vlab.physics.expression import trace_expression
from vlab.signals import Array


def unit_amplitudes(effect: Effect, shape: dict[str, float]) -> list[dict[str, float]]:
    """Return parameter values with one probe amplitude each, usually 1."""
    names = [p.name for p in effect.amplitudes]
    return [{**shape, **{n: effect.probe * (n == name) for n in names}} for name in names] or [dict(shape)]


def commands_changed(
    effect: ActuatorEffect, command: Array, shape: dict[str, float], h: float, before: Any = 0.0
) -> Array:
    """Return the change of commands (n, n_runs, k) by unit amplitudes.

    Parameters
    ----------
    effect : ActuatorEffect
        Effect.
    command : (n, n_runs) array
        Commands.
    shape : dict of str to float
        Values of the shape parameters.
    h : float
        Sample period [s].
    before : float or (n_runs,) array
        Commands before the runs.

    Returns
    -------
    (n, n_runs, k) array
        Changes.
    """
    changed = [effect.follow(command, v, h, before) - command for v in unit_amplitudes(effect, shape)]
    return np.stack(changed, axis=-1)


def port_series(
    effect: PortEffect, z: Array, v: Array, values: Values, h: float, command: Any = 0.0, starts: Any = 0.0
) -> Array:
    """Return an effect's force along a given motion.

    Parameters
    ----------
    effect : PortEffect
        Effect.
    z, v : (n, ...) array
        Displacement and velocity in the middle of the steps [SI].
    values : mapping
        Parameter values.
    h : float
        Length of a step [s].
    command : float or array
        Command at the port.
    starts : float or array
        Start times of the motions [s].

    Returns
    -------
    (n, ...) array
        Force [SI]; zero after divergence.
    """
    memory = effect.memory(z.shape[1:])
    t = (np.arange(len(z)) + 0.5).reshape(-1, *(1,) * (z.ndim - 1)) * h + starts
    if effect.is_fast:
        return fast_series(effect, z, v, np.gradient(v, h, axis=0, edge_order=2), values, h, command)
    if memory is None:
        return np.asarray(effect.force(z, v, values, Step(h=h, t=t, command=command), None)[0])
    graph = trace_expression(effect, h, ("z", "v", "t"))
    with np.errstate(all="ignore"):  # a law too stiff for the samples diverges and is no candidate
        if graph is not None:
            out = series(graph, z, v, t, [values[p.name] for p in effect.parameters], memory)
        else:
            out = np.zeros(z.shape)
            for k in range(len(z)):
                out[k], memory = effect.force(z[k], v[k], values, Step(h=h, t=t[k]), memory)
        return np.asarray(np.where(np.all(np.abs(out) < KERNELS.runaway, axis=0), out, 0.0))


def fast_series(effect: PortEffect, z: Array, v: Array, a: Array, values: Values, h: float, command: Any) -> Array:
    """Return a fast law's mean force over samples along a motion.

    Parameters
    ----------
    effect : PortEffect
        Law that does not depend on time.
    z, v, a : (n, ...) array
        Displacement and velocity in the middle of the samples, and acceleration [SI].
    values : mapping
        Parameter values, and numbers that the law takes beside its parameters.
    h : float
        Sample period [s].
    command : float or array
        Command at the port.

    Returns
    -------
    (n, ...) array
        Force [SI]; zero after divergence.
    """
    out, _ = fast_march(effect, z, v, a, values, h, command)
    mean = out.reshape(len(z), -1, *z.shape[1:]).mean(axis=1)
    return np.asarray(np.where(np.all(np.abs(mean) < KERNELS.runaway, axis=0), mean, 0.0))


def fast_march(
    effect: PortEffect, z: Array, v: Array, a: Array, values: Values, h: float, command: Any
) -> tuple[Array, Any]:
    """Return a fast law's force in fine steps, and its memory.

    Every sample has `TRAJECTORY.fine` steps of constant acceleration. A given motion yields to no force, so the mobility
    is zero.

    Parameters
    ----------
    effect : PortEffect
        Law that does not depend on time.
    z, v, a : (n, ...) array
        Displacement and velocity in the middle of the samples, and acceleration [SI].
    values : mapping
        Parameter values, and numbers that the law takes beside its parameters.
    h : float
        Sample period [s].
    command : float or array
        Command at the port.

    Returns
    -------
    force : (n TRAJECTORY.fine, ...) array
        Force [SI].
    memory : list of (...) array
        Memory after the last step.
    """
    parts = TRAJECTORY.fine
    step = h / parts

    def along(x: Array) -> Array:
        return np.repeat(x, parts, axis=0)

    def at(share: float) -> Array:
        times = ((np.arange(parts) + share) / parts - 0.5) * h  # from the middle of the sample
        return np.tile(times, len(z)).reshape(-1, *(1,) * (z.ndim - 1))

    bent, middle = along(a), at(0.5)
    first, last = along(v) + at(0.0) * bent, along(v) + at(1.0) * bent
    where = along(z) + middle * (along(v) + 0.5 * middle * bent)
    given, none = along(np.broadcast_to(command, z.shape)), np.zeros(where.shape)
    names = [p.name for p in effect.parameters]
    numbers = tuple(name for name in values if name not in names)
    graph, memory = trace_expression(effect, step, numbers=numbers), effect.memory(z.shape[1:])
    with np.errstate(all="ignore"):  # a law too stiff for the steps diverges and is no candidate
        if graph is not None:
            own, others = (
                [values[name] for name in (*names, *numbers)],
                (last, first, given, none),
            )  # order of `SIGNALS`
            return driven_series(graph, where, 0.5 * (first + last), none, own, memory or (), others)
        out = none
        for k in range(len(where)):
            now = Step(h=step, free_velocity=last[k], first_velocity=first[k], command=given[k])
            out[k], memory = effect.force(where[k], 0.5 * (first[k] + last[k]), values, now, memory)
    return out, memory


def forces_on_trajectory(
    effect: PortEffect, z: Array, v: Array, values: dict[str, float], h: Array, t: Array, command: Any = 0.0
) -> Array:
    """Return an effect's force along a motion with individual intervals.

    Parameters
    ----------
    effect : PortEffect
        Effect.
    z, v : (n, n_runs) array
        Displacement and velocity [SI].
    values : dict
        Parameter values.
    h, t : (n, n_runs) array
        Intervals and times [s].
    command : float or array
        Command at the port.

    Returns
    -------
    (n, n_runs) array
        Force [SI].
    """
    memory = effect.memory(z.shape[1:])
    if memory is None:
        return np.asarray(effect.force(z, v, values, Step(h=1.0, t=t, command=command), None)[0]) + 0.0 * z
    graph = trace_expression(effect, None, ("t", "h")) if isinstance(effect, PortEffect) else None
    if graph is not None:
        own, none = [values[p.name] for p in effect.parameters], np.zeros(z.shape)
        others = (none, none, none, none, h)  # order of `SIGNALS`
        return driven_series(graph, z, v, t, own, memory, others)[0]
    out = np.zeros(z.shape)
    for k in range(len(z)):
        step = Step(h=h[k], t=t[k])
        out[k], memory = effect.force(z[k], v[k], values, step, memory)
    return out
