"""Loops compiled by numba, cached where the installation allows it."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

from numba import njit

F = TypeVar("F", bound=Callable[..., Any])


def compiled(function: F) -> F:
    """Return a compiled function.

    Without a place for its cache the function is compiled in every process.

    Parameters
    ----------
    function : callable
        Function of arrays and numbers.

    Returns
    -------
    callable
        Compiled function.
    """
    try:
        made: Any = njit(cache=True)(function)
    except RuntimeError:  # numba: "no locator available"
        made = njit(function)
    return cast(F, made)
