"""JSON schema of the documents that vlab writes."""

import json
from importlib.resources import files
from typing import Any

DIAGNOSIS = "diagnosis.schema.json"
"""File of the schema beside this module, JSON Schema draft 2020-12."""


def diagnosis_schema() -> dict[str, Any]:
    """Return the JSON schema of ``diagnosis.json`` and `Diagnosis.to_dict`."""
    schema: dict[str, Any] = json.loads(files("vlab.api").joinpath(DIAGNOSIS).read_text(encoding="utf-8"))
    return schema
