"""Unit conversion at the interfaces; vlab is SI inside.

Inside vlab every number is SI (m, kg, s, N, V, A, rad). Structure files, cases, published tables and printing use the
units of their field. `to_si`, `from_si` and `factor` are the only conversions.
"""

import difflib
import re
from functools import lru_cache
from importlib import metadata
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from vlab.errors import BadUnit

_G = re.compile(r"(?<![\w.])(m?)g(?!\w)")
"""The letter g (or mg) as a unit of its own."""

_ALIASES = {"": "dimensionless", "-": "dimensionless", "counts": "dimensionless", "count": "dimensionless"}

SIGNS = str.maketrans({"²": "^2", "³": "^3", "·": " ", "µ": "u", "μ": "u", "°": "deg"})
"""Unit signs of other programs, with their spelling in vlab."""
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
"""Laboratory spellings of units with another name in the registry."""

_BAD_POWER = re.compile(
    r"\^(?!\s*(?:[-+]?\d{1,2}|\(\s*[-+]?\d{1,2}(?:\s*/\s*\d{1,2})?\s*\))(?!\s*\^|\d))|\)\s*\^.*\)\s*\^"
)
"""Powers that are refused: long numbers, and powers of powers, which would take hours to compute."""

MOST_NAMED = 8
"""MOST_NAMED [1]: largest number of units that a message names."""
_QUANTITIES = {
    "1": "a number or an angle",
    "m": "a length",
    "s": "a time",
    "kg": "a mass",
    "N": "a force",
    "N m": "a moment",
    "m/s": "a velocity",
    "m/s^2": "an acceleration",
    "1/s": "a rate of turning or a frequency",
    "1/s^2": "an angular acceleration",
    "N/m": "a stiffness",
    "N s/m": "a damping constant",
    "kg m^2": "an inertia",
    "V": "a voltage",
    "A": "a current",
    "W": "a power",
    "Pa": "a pressure",
    "K": "a temperature",
}
_TURNS = re.compile(r"rad|deg|grad|turn|cycle|revolution|rpm")
_PER_SECOND = re.compile(r"Hz|hertz|cps")
ANGLES = ("rad", "rad/s", "rad/s^2")
"""SI units of rotational motion. Cycles and dimensionless numbers do not count as radians."""

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
"""Units that laboratories write into files, by SI unit of the quantity."""
WRITTEN["m/s^2"] += ("g", "mg")
WRITTEN["rad/s"] += ("rpm",)

ANGULAR = {"kg": "kg m^2", "N": "N m", "m": "rad", "N/m": "N m/rad", "N s/m": "N m s/rad", "m/s": "rad/s"}
"""Units at a rotation by units at a translation."""


def quantity(value: float, unit: str) -> str:
    """Return a value with its unit as text; a dimensionless value alone."""
    return f"{value:.4g} {unit}" if unit not in ("", "1") else f"{value:.4g}"


def at_rotation(unit: str) -> str:
    """Return a unit at a rotation, with moments and angles.

    Parameters
    ----------
    unit : str
        Unit at a translation.

    Returns
    -------
    str
        Unit at a rotation.
    """
    if unit in ANGULAR:
        return ANGULAR[unit]
    if unit == "kg m^2":  # a rotary inertia exists at a rotation only
        return unit
    return unit.replace("N", "N m", 1).replace("/m", "/rad") if unit.startswith("N") else unit.replace("m", "rad")


@lru_cache(maxsize=1)
def _registry() -> Any:
    """Return the tested registry of units.

    Raises
    ------
    ImportError
        The library cannot be loaded or fails at a plain unit; no unit is then judged.
    """
    try:
        import pint  # deferred, because reading the unit definitions takes a second that most calls can save

        registry: Any = pint.UnitRegistry()
        registry.Quantity(1.0, registry.parse_units("kg m/s^2")).to_base_units()
    except Exception as error:
        version = metadata.version("pint")
        raise ImportError(
            f"pint {version}, which reads units, fails on this installation ({type(error).__name__}: {error}); install "
            "another version of it"
        ) from error
    return registry


def spelled(unit: str) -> str:
    """Return a unit in the registry's spelling.

    An unknown unit stays unchanged.
    """
    text = unit.strip().translate(SIGNS)
    for pattern, name in _SPELLINGS if len(text) <= 60 else ():
        text = pattern.sub(name, text)
    return _ALIASES.get(text, text)


@lru_cache(maxsize=512)
def _parse(unit: str) -> tuple[float, Any]:
    """Return a unit's factor to SI base units, and its dimensionality."""
    text = spelled(unit)
    if len(text) > 60:
        raise BadUnit(
            f"unit {unit[:20]!r}... is {len(text)} characters long; a unit is a short expression like 'lbf s/in'"
        )
    if any(sign in text for sign in ("__", "@", "=", "[", "{", "**")) or _BAD_POWER.search(text):
        raise BadUnit(f"unit {unit!r} is not a unit expression; write it like 'lbf s/in' or 'm/s^2'")
    registry = _registry()
    try:
        base, zero = (registry.Quantity(value, registry.parse_units(text)).to_base_units() for value in (1.0, 0.0))
    except Exception as error:  # a working registry raises a dozen kinds of error on bad text, TypeError among them
        near = difflib.get_close_matches(text, {name for names in _BASE.values() for name in names}, n=1, cutoff=0.7)
        hint = f"did you mean {near[0]!r}?" if near else "write it like 'lbf s/in', 'deg', 'mm', 'm/s^2', 'V'"
        raise BadUnit(f"unknown unit {unit!r}; {hint}") from error
    if zero.magnitude != 0:
        raise BadUnit(f"unit {unit!r} has an offset: no factor leads to {base.units}; convert the values beforehand")
    return float(base.magnitude), base.dimensionality


def factor(unit: str, si: str) -> float:
    """Return the factor from a unit to an SI unit.

    Parameters
    ----------
    unit : str
        Unit as written, such as ``"lbf s/in"``. ``g`` is gram if that fits `si`, else standard gravity, alone or in an
        expression like ``"g/N"``. Hertz are turns a second if `si` has radians.
    si : str
        SI unit inside vlab, such as ``"N s/m"``.

    Returns
    -------
    float
        Factor on a value in `unit`.

    Raises
    ------
    BadUnit
        The unit is unknown, has an offset (degree Celsius), has another dimension than `si`, or leaves an angle
        undefined.
    """
    target, target_dimension = _parse(si)
    value, dimension = _parse(unit)
    value *= _turns(unit, si)
    if dimension != target_dimension and _G.search(unit):
        gravity, as_gravity = _parse(_G.sub(lambda m: f"{'milli' if m[1] else ''}standard_gravity", unit))
        if as_gravity == target_dimension:
            return gravity / target
    if dimension != target_dimension:
        words = [_quantity(own) for own in (dimension, target_dimension)]
        one, other = words if all(words) else map(str, (dimension, target_dimension))
        said = f"that of {one}, not of {other}" if all(words) else f"{one}, not {other}"
        raise BadUnit(f"unit {unit!r} cannot be converted to {si!r}: its dimension is {said}{_accepted(si)}")
    return value / target


def _quantity(dimension: Any) -> str:
    """Return the name of the quantity of a dimension, or an empty text."""
    return next((name for unit, name in _QUANTITIES.items() if _parse(unit)[1] == dimension), "")


def _accepted(si: str) -> str:
    """Return the usual units of a quantity, for messages."""
    units = WRITTEN.get(si, ())
    return f" (accepted: {', '.join(units[:MOST_NAMED])})" if len(units) > 1 else ""


def _turns(unit: str, si: str) -> float:
    """Return the factor between turns and radians.

    The dimensions do not distinguish both.
    """
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
    """Return the units that a wrong unit label may hide.

    Parameters
    ----------
    unit : str
        Stated unit; `si` itself if a scale replaces the unit.
    si : str
        SI unit inside vlab, or a ratio of two units of `WRITTEN`, as for a frequency response.

    Returns
    -------
    dict
        Ratio of true to stated value in SI, by candidate unit. The stated unit is excluded.
    """
    above, _, below = si.rpartition("/")
    written = WRITTEN.get(si, ())
    if not written and above in WRITTEN and below in WRITTEN:
        pairs = [*((a, below) for a in WRITTEN[above]), *((above, b) for b in WRITTEN[below])]  # mm/N before m/kN
        written = tuple(f"({a})/{b}" if "/" in a else f"{a}/{b}" for a, b in dict.fromkeys(pairs))
    own = factor(unit, si) if written else 1.0
    ratios = {other: factor(other, si) / own for other in written}
    return {other: ratio for other, ratio in ratios.items() if abs(ratio - 1.0) > 1e-9}


def to_si(value: ArrayLike, unit: str, si: str) -> Any:
    """Convert values from a unit to SI, see `factor`."""
    return np.asarray(value, dtype=float) * factor(unit, si) if np.ndim(value) else float(value) * factor(unit, si)  # type: ignore[arg-type]


def from_si(value: ArrayLike, unit: str, si: str) -> Any:
    """Convert values from SI to a unit.

    The function serves printing and published tables.
    """
    return np.asarray(value, dtype=float) / factor(unit, si) if np.ndim(value) else float(value) / factor(unit, si)  # type: ignore[arg-type]


def same_dimension(unit: str, other: str) -> bool:
    """Return whether two units measure the same quantity.

    ``g`` counts as an acceleration beside another acceleration.

    Parameters
    ----------
    unit, other : str
        Units as written.

    Returns
    -------
    bool
        True for equal dimensions.
    """
    try:
        factor(unit, other)
    except BadUnit:
        return False
    return True
