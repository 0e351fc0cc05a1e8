"""Units at the edges: SI inside, everything else is converted here and nowhere else.

Inside vlab every number is SI (m, kg, s, N, V, A, rad). Structure files, cases, published tables and printing use
the units of their trade; `to_si`, `from_si` and `factor` are the only way in and out.
"""

import re
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from vlab.errors import BadUnit

_G = re.compile(r"(?<![\w.])g(?!\w)")
"""The letter g where it stands for a unit of its own."""

_ALIASES = {"": "dimensionless", "-": "dimensionless", "counts": "dimensionless", "count": "dimensionless"}

ANGULAR = {"kg": "kg m^2", "N": "N m", "m": "rad", "N/m": "N m/rad", "N s/m": "N m s/rad", "m/s": "rad/s"}
"""Units at a rotation by those at a translation."""


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
        base, zero = (
            _registry().Quantity(value, _registry().parse_units(text)).to_base_units() for value in (1.0, 0.0)
        )
    except Exception as error:  # pint raises a dozen kinds, asserts and tokenizer errors among them
        raise BadUnit(f"unknown unit {unit!r}; write it like 'lbf s/in', 'in', 'mm', 'm/s^2', 'V'") from error
    if zero.magnitude != 0:
        raise BadUnit(f"unit {unit!r} has an offset: no factor leads to {base.units}; convert the values beforehand")
    return float(base.magnitude), base.dimensionality


def factor(unit: str, si: str) -> float:
    """Return what a value in `unit` must be multiplied by to be in the SI unit `si`.

    Parameters
    ----------
    unit : str
        The unit as written, for example ``"lbf s/in"``. ``g`` is gram where that suits `si` and standard gravity
        where only that does, alone or in an expression like ``"g/N"``.
    si : str
        The SI unit that the number has inside vlab, for example ``"N s/m"``.

    Raises
    ------
    BadUnit
        The unit is unknown, has an offset (degree Celsius) or another dimension than `si`.
    """
    target, target_dimension = _parse(si)
    value, dimension = _parse(unit)
    if dimension != target_dimension and _G.search(unit):
        gravity, as_gravity = _parse(_G.sub("standard_gravity", unit))
        if as_gravity == target_dimension:
            return gravity / target
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
