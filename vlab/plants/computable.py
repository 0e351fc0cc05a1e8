"""Whether MuJoCo and linear algebra can compute a model: its numbers, its memory."""

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
    """Turn what MuJoCo and linear algebra cannot do with a model into one line.

    Parameters
    ----------
    what : str
        What is computed.

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
    """Refuse numbers that are not finite, or too large to be computed with.

    Parameters
    ----------
    numbers : array or float
    what : str
        What they are.

    Raises
    ------
    BadStructure
        A number is not finite or larger than `vlab.signals.LARGEST`.
    """
    size = np.abs(np.asarray(numbers, dtype=float))
    if not np.all(size <= LARGEST):  # nor where it is no number
        worst = float(size[~(size <= LARGEST)].ravel()[0])
        raise BadStructure(
            f"{what} is {worst:.3g}"
            + ("; it must be finite" if not np.isfinite(worst) else f"; at most {LARGEST:.0e} can be computed with")
        )
