"""Direct rate feedback u = -D y (equation 4.30).

The law acts as an electric dashpot between collocated coils [1]_ [2]_. With a positive definite D and without delay the
loop only dissipates energy and is stable.

References
----------
.. [1] M. J. Balas, Direct velocity feedback control of large space structures, Journal of Guidance and Control 2 (1979)
       252-253.
.. [2] A. Preumont, Vibration Control of Active Structures: An Introduction, 3rd ed., Springer, 2011.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from vlab.controllers.base import as_gain_matrix
from vlab.controllers.linear import Matrices


class DirectRateFeedback:
    """The law u = -D y.

    Parameters
    ----------
    gains : (n_actuators, n_sensors) array
        D [N s/m].
    sensors, actuators : sequence of str
        Places of the velocities y and of the forces u.

    Raises
    ------
    BadController
        D does not fit the channels or is not finite.
    """

    def __init__(self, gains: Any, *, sensors: Sequence[str], actuators: Sequence[str]) -> None:
        self.sensors, self.actuators = tuple(sensors), tuple(actuators)
        self.gains = as_gain_matrix(gains, rows=self.actuators, columns=self.sensors, name="the gain matrix D")
        self._negative = -self.gains

    @property
    def matrices(self) -> Matrices:
        """A, B, C, D without states: the last is -D of (4.30)."""
        rows, columns = self.gains.shape
        return np.zeros((0, 0)), np.zeros((0, columns)), np.zeros((rows, 0)), self._negative

    def reset(self) -> None:
        """Do nothing, because the law has no memory."""

    def step(self, y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return -D y."""
        return self._negative.dot(y)
