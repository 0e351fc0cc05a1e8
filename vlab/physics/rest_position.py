"""Laws about a position of rest, such as springs and stops."""

from functools import cache

import numpy as np

from vlab.physics.effect import Effect, LinearPortEffect, PortEffect, Step

FAR = 1e3
"""FAR [rad or m]: displacement beyond any gap of unit size."""


@cache
def has_rest_position(effect: Effect) -> bool:
    """Return whether an effect is a force of the displacement alone.

    A shaft that turns on and on passes the same position again and again, and has no such force. A force that repeats with
    the position has no position of rest.

    Parameters
    ----------
    effect : Effect
        Effect.

    Returns
    -------
    bool
        Whether the force at unit parameters depends on the displacement, not on the velocity; false for laws with memory.
    """
    values = {parameter.name: 1.0 for parameter in effect.parameters}
    if isinstance(effect, LinearPortEffect):
        mass, damping, stiffness = effect.impedance(values, 1.0)
        return bool(stiffness) and not (mass or damping)
    if not isinstance(effect, PortEffect) or effect.memory((1,)) is not None:
        return False
    if any(parameter.scan == "pitch" for parameter in effect.parameters):
        return False
    z, v = np.array([-FAR, 0.0, FAR]), np.array([-1.0, 0.0, 1.0])
    at_rest, moving = (
        effect.force(displacement, velocity, values, Step(h=1e-3, t=np.ones(())), None)[0]
        for displacement, velocity in ((z, 0.0 * v), (0.0 * z, v))
    )
    return bool(np.ptp(np.broadcast_to(at_rest, z.shape))) and not np.ptp(np.broadcast_to(moving, v.shape))
