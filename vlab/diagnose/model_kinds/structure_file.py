"""Text of structure files."""

import dataclasses
from collections.abc import Mapping
from typing import Any

from vlab.files.toml_writer import Verbatim, toml_text, toml_value
from vlab.structure.model import Structure


def structure_toml(structure: Structure) -> str:
    """Return a structure as the text of its file."""
    return toml_text(_table(structure))


_ORIGIN = {"origin": "identified", "source": "the nominal model, calibrated on the recordings of the diagnosis"}


def _table(part: Any) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for field in dataclasses.fields(part):
        value = getattr(part, field.name)
        if not field.init or value is None or (isinstance(value, (tuple, dict)) and not value):
            continue
        if "si" in field.metadata:
            numbers = list(value) if isinstance(value, tuple) else value
            out[field.name] = Verbatim(toml_value({"value": numbers, "unit": field.metadata["si"], **_ORIGIN}))
        elif dataclasses.is_dataclass(value):
            out[field.name] = _table(value)
        elif isinstance(value, Mapping):
            out[field.name] = {k: _table(v) for k, v in value.items()}
        elif isinstance(value, tuple) and dataclasses.is_dataclass(value[0]):
            out[field.name] = [_table(v) for v in value]
        else:
            out[field.name] = list(value) if isinstance(value, tuple) else value
    return out
