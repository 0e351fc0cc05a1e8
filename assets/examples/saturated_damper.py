"""A control law of one's own: vlab experiment beam --law assets/examples/saturated_damper.py:SaturatedDamper."""

import numpy as np


class SaturatedDamper:
    """A dashpot at the base that never pushes with more than half a newton."""

    sensors = actuators = ("base",)

    def reset(self):
        """Nothing to forget."""

    def step(self, y):
        """Return the force [N] to the velocity [m/s]."""
        return np.clip(-20.0 * y, -0.5, 0.5)
