"""Discrete linear control law.

x+ = A x + B y, u = C x + D y. Observers, filters and static gains have the same form.
"""

from collections.abc import Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from vlab.controllers.base import Controller, as_gain_matrix

from vlab.errors import BadController

Matrices = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]
"""Matrices A (n, n), B (n, n_sensors), C (n_actuators, n), D (n_actuators, n_sensors) of a discrete law."""


@runtime_checkable
class LinearController(Controller, Protocol):
    """A controller with matrices, for prediction of its loop."""

    @property
    def matrices(self) -> Matrices:
        """A, B, C, D of the law."""


class LinearLaw:
    """A linear law as one matrix product a sample.

    x+ = A x + B y and u = C x + D y (equation 5.1).

    Parameters
    ----------
    A, B, C, D : array
        (n, n), (n, n_sensors), (n_actuators, n), (n_actuators, n_sensors); SI.
    sensors, actuators : sequence of str
        Places of the samples y and of the commands u.
    rate : float or None
        Sample rate of the matrices [Hz]; None for any rate.

    Raises
    ------
    BadController
        The matrices do not fit together or the channels, or are not finite, or the rate is not positive.
    """

    def __init__(
        self,
        A: Any,
        B: Any,
        C: Any,
        D: Any,
        *,
        sensors: Sequence[str],
        actuators: Sequence[str],
        rate: float | None = None,
    ) -> None:
        self.sensors, self.actuators = tuple(sensors), tuple(actuators)
        states = [f"x{i + 1}" for i in range(np.shape(A)[0] if np.ndim(A) == 2 else 0)]
        self.A = as_gain_matrix(A, rows=states, columns=states, name="the law's A")
        self.B = as_gain_matrix(B, rows=states, columns=self.sensors, name="the law's B")
        self.C = as_gain_matrix(C, rows=self.actuators, columns=states, name="the law's C")
        self.D = as_gain_matrix(D, rows=self.actuators, columns=self.sensors, name="the law's D")
        if rate is not None and not (np.isfinite(rate) and rate > 0):
            raise BadController(f"the law's rate {rate} Hz is not a positive number; leave it out for any rate")
        self.rate = rate
        n, n_sensors, n_actuators = len(states), len(self.sensors), len(self.actuators)
        # Two buffers [u | x | y]. One product maps x and y of one buffer to u and x of the other. The new state is
        # then in place for the next sample, without a copy.
        product = np.block([[self.C, self.D], [self.A, self.B]]).dot
        buffers = [np.zeros(n_actuators + n + n_sensors) for _ in range(2)]
        self._sides = tuple(
            (product, this[n_actuators + n :], this[n_actuators:], other[: n_actuators + n], other[:n_actuators])
            for this, other in (buffers, buffers[::-1])
        )
        self._buffers, self._now, self._n_sensors = buffers, 0, n_sensors

    @property
    def matrices(self) -> Matrices:
        """A, B, C, D of the law."""
        return self.A, self.B, self.C, self.D

    @property
    def state(self) -> NDArray[np.float64]:
        """Copy of the present state x, (n,)."""
        return np.array(self._sides[self._now][2][: len(self.A)])

    def reset(self) -> None:
        """Set the state to zero."""
        for buffer in self._buffers:
            buffer[:] = 0.0

    def step(self, y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return u = C x + D y and advance the state.

        Parameters
        ----------
        y : array
            Samples, (n_sensors,).

        Returns
        -------
        array
            Commands, (n_actuators,).

        Raises
        ------
        BadController
            The number of samples is wrong.
        """
        if len(y) != self._n_sensors:
            raise BadController(
                f"{len(y)} samples were given; the law reads {self._n_sensors} ({', '.join(self.sensors)})"
            )
        product, samples, given, result, commands = self._sides[self._now]
        samples[:] = y
        product(given, result)
        self._now = 1 - self._now
        return commands.copy()
