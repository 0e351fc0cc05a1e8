"""Units at the edges: SI inside, everything else is converted here and nowhere else.

Inside vlab every number is SI (m, kg, s, N, V, A, rad). Structure files, cases, published tables and printing use
the units of their trade; `to_si`, `from_si` and `factor` are the only way in and out.
"""

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from vlab.errors import BadUnit

STANDARD_GRAVITY = 9.80665
"""Standard acceleration of gravity [m/s^2]; CGPM 1901, used for the unit `g` of acceleration channels."""

_ALIASES = {"": "dimensionless", "-": "dimensionless", "counts": "dimensionless", "count": "dimensionless"}


@lru_cache(maxsize=1)
def _registry() -> Any:
    import pint  # deferred: reading the unit definitions costs a second that most calls do not need

    return pint.UnitRegistry()


@lru_cache(maxsize=512)
def _parse(unit: str) -> tuple[float, Any]:
    """Return the factor to SI base units and the dimensionality of a unit expression."""
    text = _ALIASES.get(unit.strip(), unit.strip())
    if len(text) > 60:
        raise BadUnit(
            f"unit {unit[:20]!r}... is {len(text)} characters long; a unit is a short expression like 'lbf s/in'"
        )
    if any(sign in text for sign in ("__", "@", "=", "[", "{", "**")):
        raise BadUnit(f"unit {unit!r} is not a unit expression; write it like 'lbf s/in' or 'm/s^2'")
    try:
        quantity = 1.0 * _registry().parse_units(text)
        base = quantity.to_base_units()
    except Exception as error:  # pint raises a dozen kinds, asserts and tokenizer errors among them
        raise BadUnit(f"unknown unit {unit!r}; write it like 'lbf s/in', 'in', 'mm', 'm/s^2', 'V'") from error
    return float(base.magnitude), base.dimensionality


def factor(unit: str, si: str) -> float:
    """Return what a value in `unit` must be multiplied by to be in the SI unit `si`.

    Parameters
    ----------
    unit : str
        The unit as written, for example ``"lbf s/in"``. ``"g"`` is standard gravity where `si` is an acceleration
        and gram where it is a mass.
    si : str
        The SI unit that the number has inside vlab, for example ``"N s/m"``.

    Raises
    ------
    BadUnit
        The unit is unknown, has an offset (degree Celsius) or another dimension than `si`.
    """
    target, target_dimension = _parse(si)
    if unit.strip() == "g" and target_dimension == _parse("m/s^2")[1]:
        return STANDARD_GRAVITY
    value, dimension = _parse(unit)
    if dimension != target_dimension:
        raise BadUnit(
            f"unit {unit!r} cannot be converted to {si!r}: its dimension is {dimension}, not {target_dimension}"
        )
    return value / target


def to_si(value: ArrayLike, unit: str, si: str) -> Any:
    """Convert a value or an array from `unit` to the SI unit `si`; see `factor`."""
    return np.asarray(value, dtype=float) * factor(unit, si) if np.ndim(value) else float(value) * factor(unit, si)  # type: ignore[arg-type]


def from_si(value: ArrayLike, unit: str, si: str) -> Any:
    """Convert a value or an array from the SI unit `si` to `unit`, for printing and published tables."""
    return np.asarray(value, dtype=float) / factor(unit, si) if np.ndim(value) else float(value) / factor(unit, si)  # type: ignore[arg-type]


def same_dimension(unit: str, other: str) -> bool:
    """Say whether two units measure the same thing (``g`` counts as an acceleration beside one)."""
    try:
        factor(unit, other)
    except BadUnit:
        return False
    return True
