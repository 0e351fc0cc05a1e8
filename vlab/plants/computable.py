"""Numerical limits of a model: finite numbers and memory."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import mujoco
import numpy as np

from vlab.errors import BadStructure
from vlab.files.text import one_line
from vlab.signals import LARGEST


@contextmanager
def computable(what: str) -> Iterator[None]:
    """Turn numerical failures on a model into a one-line error.

    Parameters
    ----------
    what : str
        Computed object, for the message.

    Returns
    -------
    context manager
        Context.

    Raises
    ------
    BadStructure
        MuJoCo runs out of the model's memory, or a matrix cannot be solved.
    """
    try:
        yield
    except (mujoco.FatalError, mujoco.UnexpectedError) as error:
        raise BadStructure(f"{what}: MuJoCo cannot compute it: {one_line(error)}") from error
    except np.linalg.LinAlgError as error:
        raise BadStructure(
            f"{what}: its matrices cannot be solved ({one_line(error)}); are masses, stiffnesses and lengths in SI units?"
        ) from error


def check_numbers(numbers: Any, what: str) -> None:
    """Refuse nonfinite or excessive numbers.

    Parameters
    ----------
    numbers : array or float
    what : str
        Name of the numbers in the message.

    Raises
    ------
    BadStructure
        A number is not finite or larger than `vlab.signals.LARGEST`.
    """
    size = np.abs(np.asarray(numbers, dtype=float))
    if not np.all(size <= LARGEST):  # a comparison with NaN is false
        worst = float(size[~(size <= LARGEST)].ravel()[0])
        raise BadStructure(
            f"{what} is {worst:.3g}"
            + ("; it must be finite" if not np.isfinite(worst) else f"; at most {LARGEST:.0e} can be computed with")
        )
