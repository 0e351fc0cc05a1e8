"""Reference quantities of relative parameter ranges, from recordings and filtered motion."""

from collections.abc import Callable, Sequence

import numpy as np

from vlab.diagnose.parameters.locations import Place
from vlab.diagnose.predictors.innovations import Group
from vlab.signals import Array

Motion = Callable[[Group, Place], tuple[Array, Array]]
"""Function of filtered runs and a port that returns displacement and velocity (n, n_runs)."""


def reference_quantity(name: str, place: Place, groups: Sequence[Group], motion: Motion) -> float:
    """Return the reference quantity of a relative parameter range.

    Parameters
    ----------
    name : str
        Name of the quantity.
    place : Place
        Location.
    groups : sequence of Group
        Filtered runs.
    motion : callable
        Displacement and velocity at a port.

    Returns
    -------
    float
        Quantity [SI]; 1 for an unknown name.
    """
    if name in ("displacement", "velocity"):
        which = 0 if name == "displacement" else 1
        return max(max(_largest(g, motion(g, place)[which]) for g in groups), 1e-300)
    if name == "travel":
        parts = [_counted(g, motion(g, place)[0]) for g in groups]
        counted = np.concatenate(parts)
        low, high = float(counted.min(initial=np.inf)), float(counted.max(initial=-np.inf))
        half = max(0.5 * (high - low), 1e-300)
        return min(half, np.pi) if place.angular else half
    if name in ("error", "servo-force"):
        return max(max(_largest(g, _of_servo(g, place, motion, name)) for g in groups), 1e-300)
    if name == "servo-gain":
        assert place.servo is not None
        return place.servo.gain
    if name == "input":
        return max(max(float(np.abs(g.u[..., list(place.indices)]).max()) for g in groups), 1e-300)
    if name == "input-slope":
        own = list(place.indices)
        return max(max(float(np.abs(np.diff(g.u[..., own], axis=0)).max() / g.h) for g in groups), 1e-300)
    if name == "output":
        return max(max(float(np.abs(g.y[..., place.index]).max()) for g in groups), 1e-300)
    if name == "duration":
        return max(float(g.lengths.max() * g.h) for g in groups)
    if name == "step":
        return max(g.h for g in groups)
    return 1.0


def _largest(group: Group, x: Array) -> float:
    """Return a signal's (n, n_runs) largest magnitude over counted samples."""
    return max(float(np.abs(x[group.first : n, i]).max(initial=0.0)) for i, n in enumerate(group.lengths))


def _counted(group: Group, x: Array) -> Array:
    """Return the counted samples of a signal (n, n_runs)."""
    return np.concatenate([x[group.first : n, i] for i, n in enumerate(group.lengths)])


def _of_servo(group: Group, place: Place, motion: Motion, name: str) -> Array:
    """Return a servo's position error, or its force, (n, n_runs)."""
    servo, (z, v) = place.servo, motion(group, place)
    assert servo is not None
    error = group.u[..., place.indices[0]] - servo.rest - z
    return np.asarray(error if name == "error" else servo.limited(servo.gain * error - servo.damping * v))
