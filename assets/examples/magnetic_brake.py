"""An effect of one's own: vlab diagnose CASE --effect assets/examples/magnetic_brake.py:MagneticBrake.

It stands beside those of the catalogue in the search. Its law is written once, for numbers and arrays alike. The search starts
from the values of `grid`, in multiples of the largest velocity at the place.
"""

from typing import ClassVar

from vlab.physics.effect import Parameter, PortEffect


class MagneticBrake(PortEffect):
    """Eddy-current brake whose force falls again at high velocity."""

    name = "magnetic-brake"
    family = "eddy-currents"
    law = "F = -2 Fm (v/vm)/(1 + (v/vm)^2)"
    words = "an eddy-current brake whose force has a maximum at a critical velocity"
    parameters: ClassVar = (
        Parameter(name="force", unit="N", low=1e-6, high=1e4),
        Parameter(
            name="speed", unit="m/s", low=0.05, high=5.0, role="shape", reference="velocity", grid=(0.2, 0.5, 1.0)
        ),
    )

    def force(self, z, v, p, step, memory):
        """See `PortEffect`."""
        x = v / p["speed"]
        return -2.0 * p["force"] * x / (1.0 + x * x), memory
