"""Tabulated force at a port, for effects without a law."""

from itertools import pairwise
from typing import Any, ClassVar

import numpy as np

from vlab.physics.effect import Parameter, PortEffect, Step, Values

NODES = (0.0, 0.1, 0.4, 1.0)
"""Nodes of the table, in multiples of the reach. The first interval is short, for forces that change with a direction."""


def _increments(signal: str, unit: str) -> tuple[Parameter, ...]:
    """Return one parameter per interval of the nodes and side."""
    return tuple(
        Parameter(
            name=f"{signal}_{side}_{k}",
            unit=unit,
            low=1e-9,
            high=1e9,
            signed=True,
            words=f"increment of the force over interval {k} of the {side} {signal}",
        )
        for side in ("positive", "negative")
        for k in range(1, len(NODES))
    )


class TabulatedForce(PortEffect):
    """A force with a table over displacement and one over velocity.

    The force is linear between nodes and constant beyond the last node, so it does not grow outside the recorded motion.
    The table holds every law without memory whose spring and damping do not interact. Such a law is a restoring-force
    surface without mixed terms (Masri and Caughey, Journal of Applied Mechanics 46, 1979).
    """

    name = "unknown-law"
    family = "unknown-law"
    law = "F = -f(z) - g(v), both piecewise linear"
    words = "a force at this place that no law of the catalogue describes; its table is fitted"
    is_last_resort: ClassVar[bool] = True
    parameters: ClassVar = (
        Parameter(name="reach", unit="m", low=0.5, high=2.0, role="shape", reference="displacement", grid=(1.0,)),
        Parameter(name="speed", unit="m/s", low=0.5, high=2.0, role="shape", reference="velocity", grid=(1.0,)),
        *_increments("displacement", "N"),
        *_increments("velocity", "N"),
    )

    def force(self, z: Any, v: Any, p: Values, step: Step, memory: Any) -> tuple[Any, Any]:
        """See `PortEffect`."""
        return -_table("displacement", z / p["reach"], p) - _table("velocity", v / p["speed"], p), memory


def _table(signal: str, x: Any, p: Values) -> Any:
    """Return the sum of the increments that a signal has passed."""
    total: Any = 0.0
    for side, sign in (("positive", 1.0), ("negative", -1.0)):
        for k, (low, high) in enumerate(pairwise(NODES), start=1):
            passed = np.minimum(np.maximum((sign * x - low) / (high - low), 0.0), 1.0)
            total = total + sign * p[f"{signal}_{side}_{k}"] * passed
    return total
