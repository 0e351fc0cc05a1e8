"""Interface of a control law."""

from collections.abc import Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from vlab.errors import BadController


@runtime_checkable
class Controller(Protocol):
    """A discrete control law from samples to commands.

    A user's own law has the same interface (`vlab.controllers.user_law`): two attributes and two methods. A law for a
    single sampling rate has the further attribute `rate` [Hz] and is refused in a loop of another rate. A linear law
    may provide its matrices (`vlab.controllers.linear.LinearController`), from which theory predicts the loop.

    Parameters
    ----------
    sensors, actuators : sequence of str
        Places of y and u in order: names of coils and sensors, such as ``("40in", "base")``.
    """

    sensors: tuple[str, ...]
    actuators: tuple[str, ...]

    def reset(self) -> None:
        """Clear the memory of the law."""

    def step(self, y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the commands u, (n_actuators,), in SI.

        `y` holds the samples, (n_sensors,), in SI.
        """


def as_gain_matrix(values: Any, *, rows: Sequence[str], columns: Sequence[str], name: str) -> NDArray[np.float64]:
    """Return a finite (rows x columns) matrix.

    Parameters
    ----------
    values : object
        Numbers.
    rows, columns : sequence of str
        Channel names.
    name : str
        Name of the matrix in messages.

    Returns
    -------
    array
        Matrix, (n_rows, n_columns).

    Raises
    ------
    BadController
        The shape does not fit the channels, or a number is not finite.
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
