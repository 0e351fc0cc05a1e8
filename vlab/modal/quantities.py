"""Quantities of a frequency response, from its unit."""

import re

from vlab import units
from vlab.errors import BadUnit
from vlab.signals import KIND_UNITS, ORDER

DRIVES = ("force", "moment", "voltage", "current")
"""Kinds of channels that drive a structure; a shaken base drives by its motion."""


def split_unit(unit: str) -> tuple[str, str]:
    """Return the units of output and input.

    Parameters
    ----------
    unit : str
        Unit of a response, such as ``"g/N"``, ``"m/s^2/N"`` or ``"(m/s)/(N m)"``.

    Returns
    -------
    tuple of (str, str)
        Numerator and denominator; the denominator is empty if the unit has none that drives a structure.
    """
    text = _bare(unit)
    above, slash, below = text.rpartition("/")
    if "(" in below or ")" in below:
        match = re.fullmatch(r"(.*)/(\([^()]*\))", text)
        above, slash, below = (match[1], "/", match[2]) if match else (text, "", "")
    if slash and kind_of_unit(_bare(below), (*DRIVES, *ORDER)):
        return _bare(above), _bare(below)
    return text, ""


def kind_of_unit(unit: str, kinds: tuple[str, ...]) -> str:
    """Return the first kind with a unit's dimension.

    Parameters
    ----------
    unit : str
        Unit as written.
    kinds : tuple of str
        Kinds of `vlab.signals.KIND_UNITS`, each with an SI unit.

    Returns
    -------
    str
        Kind; empty without one, and for a unit that is unknown or dimensionless.
    """
    if not unit or units.spelled(unit) == "dimensionless":
        return ""
    for kind in kinds:
        try:
            units.factor(unit, KIND_UNITS[kind] or "")
        except BadUnit:
            continue
        return kind
    return ""


def response_unit_of(output: str, drive: str) -> str:
    """Return the SI unit of a response.

    Parameters
    ----------
    output, drive : str
        SI units of output and input.

    Returns
    -------
    str
        Unit such as ``"(m/s^2)/N"``.
    """
    above, below = (f"({unit})" if re.search(r"[ /*]", unit) else unit or "1" for unit in (output, drive))
    return f"{above}/{below}"


def _bare(unit: str) -> str:
    """Return a unit without parentheses around the whole."""
    text = unit.strip()
    while re.fullmatch(r"\([^()]*\)", text) or re.fullmatch(r"\(\([^()]*\)\)", text):
        text = text[1:-1].strip()
    return text
