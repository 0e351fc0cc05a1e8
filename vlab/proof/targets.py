"""Targets of a campaign, set down in its manifest before any answer.

Campaigns whose manifest has none keep the targets of `vlab.proof.score`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from types import NoneType
from typing import Any

from vlab.proof.document_schema import NUMBER
from vlab.proof.servo_scoring import ON_ARMS


@dataclass(frozen=True, kw_only=True)
class Target:
    """Bounds of a measure.

    Parameters
    ----------
    at_least, at_most : float or None
        Bounds of the value.
    lower_end : float or None
        Least lower end of the 95 % interval.
    """

    at_least: float | None = None
    at_most: float | None = None
    lower_end: float | None = None

    @property
    def words(self) -> str:
        """The bounds as a table shows them."""
        if self.at_least is not None and self.at_most is not None:
            return f"{self.at_least:g} to {self.at_most:g}"
        bounds = {">=": self.at_least, "<=": self.at_most, "lower end >=": self.lower_end}
        return ", ".join(f"{sign} {bound:g}" for sign, bound in bounds.items() if bound is not None)

    def holds(self, value: float) -> bool:
        """Return whether a value is within the bounds.

        Parameters
        ----------
        value : float
            Value, or an end of its interval.

        Returns
        -------
        bool
            Whether both bounds hold.
        """
        return (self.at_least is None or value >= self.at_least) and (self.at_most is None or value <= self.at_most)


TARGETS = {
    "right equivalence class, first answer": Target(at_least=0.95, lower_end=0.90),
    "right class on the beam and the grid": Target(at_least=0.85),
    ON_ARMS: Target(at_least=0.85),
    "right place, exact, of what was named": Target(at_least=0.95),
    "coverage of 90 % parameter intervals, of effects named right": Target(at_least=0.85, at_most=0.95),
    "null: anything but nothing-missing (false alarms)": Target(at_most=0.03),
    "out of library: physics named": Target(at_most=0.05),
    "Brier score": Target(at_most=0.05),
}
"""TARGETS: bounds of new campaigns by measure; the others keep those of `vlab.proof.score`."""
BOUNDS = ("at_least", "at_most", "lower_end")
SHAPE = {"*": dict.fromkeys(BOUNDS, (*NUMBER, NoneType))}
"""BOUNDS, SHAPE: targets in a manifest; see `vlab.proof.document_schema.has_shape`."""


def targets_to_json() -> dict[str, Any]:
    """Return `TARGETS` as plain values for a manifest."""
    return {measure: asdict(target) for measure, target in TARGETS.items()}


def with_targets(measures: Sequence[Mapping[str, Any]], set_down: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the measures beside the targets of a manifest.

    Parameters
    ----------
    measures : sequence of mapping
        Rows of `vlab.proof.score.measures`.
    set_down : mapping
        Targets of `targets_to_json`; measures without one stay as they are.

    Returns
    -------
    list of dict
        Rows with target, whether the value meets it, and of rates whether the whole interval does.
    """
    targets = {name: Target(**{key: bounds[key] for key in BOUNDS}) for name, bounds in set_down.items()}
    return [_beside(row, targets[row["measure"]]) if row["measure"] in targets else dict(row) for row in measures]


def _beside(row: Mapping[str, Any], target: Target) -> dict[str, Any]:
    out = {**row, "target": target.words, "met": None}
    if row["value"] is not None:
        low = row.get("ci95", [row["value"]])[0]
        out["met"] = target.holds(row["value"]) and (target.lower_end is None or low >= target.lower_end)
    if "shown" in row:
        out["shown"] = None if row["value"] is None else all(map(target.holds, row["ci95"]))
    return out
