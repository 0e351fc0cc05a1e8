"""The form of a control law."""

from collections.abc import Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from vlab.errors import BadController


@runtime_checkable
class Controller(Protocol):
    """A discrete control law: samples in, commands out, once a sample.

    A user's own law has this form, too (`vlab.controllers.user_law`): two attributes and two methods. A law that was made for
    one sampling rate says so with a further attribute `rate` [Hz] and is refused in a loop of another; one that is linear
    may say its matrices (`vlab.controllers.linear.LinearController`), so that theory can predict its loop.

    Parameters
    ----------
    sensors, actuators : sequence of str
        The places it is wired to, in the order of y and u: names of coils and sensors, such as ``("40in", "base")``.
    """

    sensors: tuple[str, ...]
    actuators: tuple[str, ...]

    def reset(self) -> None:
        """Forget the past."""

    def step(self, y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the commands u, (n_actuators,), to the samples y, (n_sensors,); SI."""


def as_gain_matrix(values: Any, *, rows: Sequence[str], columns: Sequence[str], name: str) -> NDArray[np.float64]:
    """Return a finite (rows x columns) matrix, or refuse it.

    Raises
    ------
    BadController
        The wrong shape for the channels, or a number that is not finite.
    """
    try:
        matrix = np.array(values, dtype=float)
    except (TypeError, ValueError) as error:
        raise BadController(f"{name} is not a matrix of numbers: {error}") from error
    if matrix.shape != (len(rows), len(columns)):
        raise BadController(
            f"{name} has shape {matrix.shape}; {len(rows)} x {len(columns)} is needed for ({', '.join(rows)}) from ({', '.join(columns)})"
        )
    if not np.all(np.isfinite(matrix)):
        raise BadController(f"{name} holds a number that is not finite")
    matrix.setflags(write=False)
    return matrix
