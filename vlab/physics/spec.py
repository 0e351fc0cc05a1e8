"""Text form of effects: ``NAME@PLACE:param=value,param=value``.

Values are in SI or carry a unit.
"""

import re
from collections.abc import Collection

from vlab import units
from vlab.errors import BadExperiment, BadUnit, unknown_name
from vlab.physics.attach import Attached
from vlab.physics.catalogue import effect_named
from vlab.physics.effect import Parameter
from vlab.recordings.assemble import own_si

FORM = "NAME@PLACE:param=value,param=value, for example coulomb-friction@20in:force=0.05lbf"
"""Form of an effect's text, for messages."""
_VALUE = re.compile(r"^\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*)$")


def parse_effect(text: str, *, code: Collection[str] | None = None) -> Attached:
    """Parse one effect.

    Parameters
    ----------
    text : str
        Text in the form `FORM`.
    code : collection of str, optional
        Permitted Python files, if the text comes from a data file; see `effect_named`.

    Returns
    -------
    Attached
        Effect, place and values in SI.

    Raises
    ------
    BadExperiment
        The text does not have the form, or a value is no number.
    UnknownName
        No such effect or parameter.
    BadUnit
        A unit does not fit the parameter.
    """
    name, at, rest = text.partition("@")
    place, colon, first = rest.partition("=")[0].rpartition(":")
    if not (at and colon and place and "=" in rest):
        raise BadExperiment(f"the effect {text!r} has not the form {FORM}")
    effect = effect_named(name.strip(), code=code)
    values = {}
    for part in (first + rest[len(place) + 1 + len(first) :]).split(","):
        key, equals, value = part.partition("=")
        match, key = _VALUE.match(value), key.strip()
        if not equals or match is None:
            raise BadExperiment(f"the effect {text!r}: {part.strip()!r} is no param=value; write {FORM}")
        names = [p.name for p in effect.parameters]
        if key not in names:
            raise unknown_name("parameter", key, names, where=f"effect {effect.name!r}")
        values[key] = float(match[1]) * _factor(match[2].strip(), effect.parameter(key))
    return Attached(effect, place, values)


def _factor(unit: str, parameter: Parameter) -> float:
    """Return the SI value of a unit for a parameter.

    The parameter's own unit depends on the place: rotations and kinds of sensor differ.
    """
    if not unit:
        return 1.0
    try:
        return units.factor(unit, parameter.unit)
    except BadUnit:
        if parameter.reference in ("input", "input-slope", "output"):
            return units.factor(unit, own_si(unit))
        if parameter.unit in units.ANGULAR and units.same_dimension(unit, units.ANGULAR[parameter.unit]):
            return units.factor(unit, units.ANGULAR[parameter.unit])
        raise
