"""An effect of one's own: vlab diagnose CASE --effect assets/examples/cogging.py:Cogging.

It stands beside those of the catalogue in the search. Its law is written once, for numbers and arrays alike. The search starts
from the values of `grid`, in multiples of the largest displacement at the place: a law that repeats has many nearly right
pitches, so they lie closer than for most laws.
"""

from typing import ClassVar

import numpy as np

from vlab.physics.effect import Parameter, PortEffect


class Cogging(PortEffect):
    """The pull of a motor's magnets towards its teeth."""

    name = "cogging"
    family = "cogging"
    law = "F = -f sin(2 pi z/pitch)"
    words = "the magnets of a motor are pulled towards its teeth: a force that repeats with the position"
    parameters: ClassVar = (
        Parameter(name="force", unit="N", low=1e-6, high=1e4, signed=True),
        Parameter(
            name="pitch",
            unit="m",
            low=0.02,
            high=2.0,
            role="shape",
            reference="displacement",
            grid=(0.1, 0.14, 0.2, 0.28, 0.4, 0.56, 0.8, 1.1),
        ),
    )

    def force(self, z, v, p, step, memory):
        """See `PortEffect`."""
        return -p["force"] * np.sin(2 * np.pi * z / p["pitch"]), memory
