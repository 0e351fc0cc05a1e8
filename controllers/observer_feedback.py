"""State feedback on a discrete observer, with optional saturation."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from vlab.controllers.base import as_gain_matrix
from vlab.controllers.linear import Matrices

from vlab.errors import BadController


class ObserverFeedback:
    """State feedback on an observer.

    u = -K x, x+ = A x + B u + M (y - C x).

    Parameters
    ----------
    A, B, C : array
        Discrete model of the plant at the sampling rate of the loop.
    K : (n_actuators, n_states) array
        State feedback.
    M : (n_states, n_sensors) array
        Observer gain.
    limit : float or None
        Largest magnitude of a command; the observer uses the limited command. None for no limit.

    Raises
    ------
    BadController
        The matrices do not fit together or the channels, or are not finite.
    """

    def __init__(
        self,
        A: Any,
        B: Any,
        C: Any,
        *,
        K: Any,
        M: Any,
        sensors: Sequence[str],
        actuators: Sequence[str],
        limit: float | None = None,
    ) -> None:
        self.sensors, self.actuators = tuple(sensors), tuple(actuators)
        states = [f"x{i + 1}" for i in range(np.shape(A)[0] if np.ndim(A) == 2 else 0)]
        self.A = as_gain_matrix(A, rows=states, columns=states, name="the observer's A")
        self.B = as_gain_matrix(B, rows=states, columns=self.actuators, name="the observer's B")
        self.C = as_gain_matrix(C, rows=self.sensors, columns=states, name="the observer's C")
        self.K = as_gain_matrix(K, rows=self.actuators, columns=states, name="the state feedback K")
        self.M = as_gain_matrix(M, rows=states, columns=self.sensors, name="the observer gain M")
        if limit is not None and not (np.isfinite(limit) and limit > 0):
            raise BadController(f"the limit {limit} is not a positive number; leave it out for none")
        self.limit = limit
        self.reset()

    @property
    def matrices(self) -> Matrices:
        """A, B, C, D of the unsaturated law."""
        return self.A - self.B @ self.K - self.M @ self.C, self.M, -self.K, np.zeros((len(self.K), len(self.C)))

    def reset(self) -> None:
        """Set the estimate to zero."""
        self._x = np.zeros(len(self.A))

    def step(self, y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the limited -K x and advance the estimate.

        Parameters
        ----------
        y : array
            Samples, (n_sensors,).

        Returns
        -------
        array
            Commands, (n_actuators,).
        """
        u = -(self.K @ self._x)
        if self.limit is not None:
            u = np.clip(u, -self.limit, self.limit)
        self._x = self.A @ self._x + self.B @ u + self.M @ (y - self.C @ self._x)
        return u
