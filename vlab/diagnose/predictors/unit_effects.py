"""Regressors of the score test from unit effects."""

from typing import Any

import numpy as np

from vlab.diagnose.kernels.expression_graph import series
from vlab.diagnose.settings import KERNELS
from vlab.physics.effect import ActuatorEffect, Effect, PortEffect, Step, Values
from vlab.physics.expression import trace_expression
from vlab.signals import Array


def unit_amplitudes(effect: Effect, shape: dict[str, float]) -> list[dict[str, float]]:
    """Return parameter values with one amplitude of the effect's probe each, usually 1."""
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
