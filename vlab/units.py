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

_G = re.compile(r"(?<![\w.])(m?)g(?!\w)")
"""The letter g where it stands for a unit of its own, or its thousandth."""

_ALIASES = {"": "dimensionless", "-": "dimensionless", "counts": "dimensionless", "count": "dimensionless"}

SIGNS = str.maketrans({"²": "^2", "³": "^3", "·": " ", "µ": "u", "μ": "u", "°": "deg"})
"""Signs of other programs, as they are read here."""
_SPELLINGS = tuple(
    (re.compile(rf"(?<![\w^]){pattern}(?![\w^])"), spelled)
    for pattern, spelled in (
        (r"(k|m|)N(mm|cm|m)", r"\1N \2"),
        (r"(in|ft)[-_ ]?lbf?", r"lbf \1"),
        (r"lbf?[-_](in|ft)", r"lbf \1"),
        (r"(s|min|h)([234])", r"\1^\2"),
        ("(?:RPM|U/min|rev/min|1/min|min\\^-1)", "rpm"),
        ("revs?", "revolution"),
        ("dps", "deg/s"),
        ("ips", "in/s"),
        ("kp", "kgf"),
        ("mils?", "thou"),
        ("[Vv]olts?", "V"),
        ("[Aa]mps?", "A"),
    )
)
"""How laboratories write units that have another name in the registry."""

_TURNS = re.compile(r"rad|deg|grad|turn|cycle|revolution|rpm")
_PER_SECOND = re.compile(r"Hz|hertz|cps")
ANGLES = ("rad", "rad/s", "rad/s^2")
"""Units of motion at a rotation: what is counted in cycles or in nothing is no radian."""

_LENGTHS = ("m", "cm", "mm", "um", "in", "ft", "mil")
_ANGLES = ("rad", "mrad", "deg", "rev")
_BASE = {
    "m": _LENGTHS,
    "rad": _ANGLES,
    "N": ("N", "kN", "mN", "lbf", "kgf"),
    "N m": ("N m", "N cm", "N mm", "kN m", "lbf in", "lbf ft", "kgf cm"),
    "V": ("V", "mV", "uV"),
    "A": ("A", "mA", "uA"),
    "1": ("1", "percent", "um/m"),
    "s": ("s", "ms", "us", "ns", "min"),
}
WRITTEN = {
    **_BASE,
    **{f"m/{s}": tuple(f"{unit}/{s}" for unit in _LENGTHS) for s in ("s", "s^2")},
    **{f"rad/{s}": tuple(f"{unit}/{s}" for unit in _ANGLES) for s in ("s", "s^2")},
}
"""Units that laboratories write into files, by the SI unit of what they measure."""
WRITTEN["m/s^2"] += ("g", "mg")
WRITTEN["rad/s"] += ("rpm",)

ANGULAR = {"kg": "kg m^2", "N": "N m", "m": "rad", "N/m": "N m/rad", "N s/m": "N m s/rad", "m/s": "rad/s"}
"""Units at a rotation by those at a translation."""


@lru_cache(maxsize=1)
def _registry() -> Any:
    import pint  # deferred: reading the unit definitions costs a second that most calls do not need

    return pint.UnitRegistry()


def spelled(unit: str) -> str:
    """Return a unit as the registry of units spells it; unknown ones as they are."""
    text = unit.strip().translate(SIGNS)
    for pattern, name in _SPELLINGS if len(text) <= 60 else ():
        text = pattern.sub(name, text)
    return _ALIASES.get(text, text)


@lru_cache(maxsize=512)
def _parse(unit: str) -> tuple[float, Any]:
    """Return the factor to SI base units and the dimensionality of a unit expression."""
    text = spelled(unit)
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
        where only that does, alone or in an expression like ``"g/N"``. Hertz are turns a second where `si` counts radians.
    si : str
        The SI unit that the number has inside vlab, for example ``"N s/m"``.

    Raises
    ------
    BadUnit
        The unit is unknown, has an offset (degree Celsius) or another dimension than `si`; or it is to be an angle and does
        not say of what.
    """
    target, target_dimension = _parse(si)
    value, dimension = _parse(unit)
    value *= _turns(unit, si)
    if dimension != target_dimension and _G.search(unit):
        gravity, as_gravity = _parse(_G.sub(lambda m: f"{'milli' if m[1] else ''}standard_gravity", unit))
        if as_gravity == target_dimension:
            return gravity / target
    if dimension != target_dimension:
        raise BadUnit(
            f"unit {unit!r} cannot be converted to {si!r}: its dimension is {dimension}, not {target_dimension}"
        )
    return value / target


def _turns(unit: str, si: str) -> float:
    """Return what makes radians of turns, or turns of radians, which the dimensions do not tell apart."""
    text = spelled(unit)
    has_angle = bool(_TURNS.search(text))
    if si == "Hz":
        return 1.0 / (2.0 * np.pi) if has_angle else 1.0
    if si not in ANGLES or has_angle or unit.strip() in ("", "-", "1"):
        return 1.0
    if _PER_SECOND.search(text):
        return 2.0 * np.pi
    raise BadUnit(
        f"unit {unit!r} does not say what is counted, and {si!r} is wanted; write rad, deg or rev, as in 'rev/s', "
        f"or give a scale in {si} per count"
    )


def mistaken(unit: str, si: str) -> dict[str, float]:
    """Return the units that numbers may be in where they are said to be in another one.

    Parameters
    ----------
    unit : str
        What is said; `si` itself where a scale stands in its place.
    si : str
        The SI unit inside vlab; a ratio of two of `WRITTEN`, as of a frequency response, is one, too.

    Returns
    -------
    dict
        By unit: what the numbers then are over what is said of them, in SI. The unit itself is not among them.
    """
    above, _, below = si.rpartition("/")
    written = WRITTEN.get(si, ())
    if not written and above in WRITTEN and below in WRITTEN:
        written = tuple(
            f"({a})/{b}" if "/" in a else f"{a}/{b}"
            for a in WRITTEN[above]
            for b in WRITTEN[below]
            if a == above or b == below
        )
    own = factor(unit, si) if written else 1.0
    ratios = {other: factor(other, si) / own for other in written}
    return {other: ratio for other, ratio in ratios.items() if abs(ratio - 1.0) > 1e-9}


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
