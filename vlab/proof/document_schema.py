"""Shapes of the documents of a proof, which others may have changed."""

from types import NoneType
from typing import Any

NUMBER = (int, float)
_NUMBER_OR_NONE = (int, float, NoneType)

COMMITMENTS = {
    "format": str,
    "plan": str,
    "cases": {"*": {"truth": str, "recordings": str}},
}
FROZEN = {"answers": {"*": str}, "manifest": str, "commitments": str}
FINDING = {
    "effect": str,
    "place": str,
    "class?": [str],
    "places_90?": [str],
    "probability?": _NUMBER_OR_NONE,
    "parameters?": {"*": {"value?": _NUMBER_OR_NONE, "ci90?": ([_NUMBER_OR_NONE], NoneType)}},
}
HELDOUT = {f"{key}?": _NUMBER_OR_NONE for key in ("gap_closed", "nrmse_before", "nrmse_noise", "nrmse_after")}
BASELINE = {
    "note?": str,
    "names?": [str],
    "named?": [{"effect": str}],
    "nrmse?": _NUMBER_OR_NONE,
    "cpu_seconds?": _NUMBER_OR_NONE,
}
ANSWER = {
    "verdict": str,
    "findings?": [FINDING],
    "heldout?": (HELDOUT, NoneType),
    "baselines?": {"*": (BASELINE, NoneType)},
    "seconds?": NUMBER,
    "cpu_seconds?": _NUMBER_OR_NONE,
    "error?": str,
}
"""ANSWER: counted parts of an answer; see `has_shape`."""


def has_shape(value: Any, shape: Any) -> bool:
    """Return whether plain values have a shape.

    Parameters
    ----------
    value : object
        Plain value.
    shape : Any
        Type, tuple of alternative shapes, ``[shape]`` for a list, or table of shapes by key. Keys that end in ``?``
        may be missing. The shape of ``"*"`` holds for all other keys. Without ``"*"`` other keys have any value.

    Returns
    -------
    bool
        Whether the value has the shape.
    """
    if isinstance(shape, tuple):
        return any(has_shape(value, part) for part in shape)
    if isinstance(shape, list):
        return isinstance(value, list) and all(has_shape(part, shape[0]) for part in value)
    if isinstance(shape, dict):
        return isinstance(value, dict) and _has_parts(value, shape)
    return isinstance(value, shape) and (shape is bool or not isinstance(value, bool))


def _has_parts(value: dict[str, Any], shape: dict[str, Any]) -> bool:
    named = {key.removesuffix("?"): part for key, part in shape.items() if key != "*"}
    for key, part in named.items():
        if key not in value:
            if f"{key}?" not in shape:
                return False
        elif not has_shape(value[key], part):
            return False
    return "*" not in shape or all(has_shape(part, shape["*"]) for key, part in value.items() if key not in named)
