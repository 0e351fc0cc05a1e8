"""A diagnosis: the verdict, what was found, where, with which law, how much better it fits, and what was not excluded."""

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from vlab.diagnose.verify import gap_closed, total

Verdict = Literal["missing-physics", "nothing-missing", "none-of-these", "bad-recording"]


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One effect that the model lacks.

    Parameters
    ----------
    form : str
        The effect of the catalogue whose law and parameters these are: `effect` or another form of it.
    places_90 : tuple of str
        Places that together hold at least 90 % of the probability.
    alike : tuple of str
        Effects that these recordings cannot tell from it, itself first.
    parameters : dict
        By name: value, unit and 90 % interval, SI.
    """

    effect: str
    form: str
    family: str
    place: str
    places_90: tuple[str, ...]
    probability: float
    alike: tuple[str, ...]
    parameters: dict[str, dict[str, Any]]
    law: str
    words: str

    @property
    def name(self) -> str:
        """Its effect, and in which form where there are several."""
        return self.effect if self.form == self.effect else f"{self.effect} ({self.form})"

    def to_json(self) -> dict[str, Any]:
        """Return plain values for a JSON document."""
        return {
            "effect": self.effect,
            "form": self.form,
            "family": self.family,
            "place": self.place,
            "places_90": list(self.places_90),
            "probability": self.probability,
            "class": list(dict.fromkeys([self.effect, self.form, *self.alike])),
            "parameters": self.parameters,
            "law": self.law,
            "words": self.words,
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class Diagnosis:
    """What a diagnosis says.

    Parameters
    ----------
    checked : tuple of Distance
        Every hold-out recording under the nominal, the refitted and the amended model; fit recordings where there is no
        hold-out. Of responses and tables of modes `vlab.diagnose.frequency.verify.CheckedFrequency`.
    calibration : dict
        Log-factors of the uncertain parameters in the amended model, by name; of places the distance [m].
    """

    title: str
    verdict: Verdict
    findings: tuple[Finding, ...]
    alternatives: tuple[dict[str, Any], ...]
    checked: tuple[Any, ...]
    mismatch: dict[str, Any]
    not_excluded: tuple[str, ...]
    next_measurement: str
    quality: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    calibration: dict[str, float] = field(default_factory=dict)
    seconds: float = 0.0

    @property
    def is_verified(self) -> bool:
        """Whether the recordings in `checked` were kept from the search."""
        return all(c.role == "holdout" for c in self.checked) and bool(self.checked)

    @property
    def heldout(self) -> dict[str, Any]:
        """Errors before and after on the hold-out recordings, in all and one by one."""
        values = {key: total(self.checked, key) for key in ("nominal", "before", "after", "noise")}
        each = [
            {
                "name": c.name,
                "role": c.role,
                **{f"nrmse_{k}": _finite(getattr(c, k)) for k in ("nominal", "before", "after", "noise")},
                "gap_closed": _finite(c.gap_closed),
                "channels": {
                    name: dict(zip(("nominal", "before", "after", "noise"), map(_finite, v), strict=True))
                    for name, v in c.channels.items()
                },
            }
            for c in self.checked
        ]
        return {
            **{f"nrmse_{k}": _finite(v) for k, v in values.items()},
            "gap_closed": _finite(gap_closed(values["before"], values["after"], values["noise"])) if each else None,
            "per_recording": each,
            "verified": self.is_verified,
        }

    def to_json(self) -> dict[str, Any]:
        """Return plain values for a JSON document."""
        return {
            "title": self.title,
            "verdict": self.verdict,
            "findings": [f.to_json() for f in self.findings],
            "alternatives": list(self.alternatives),
            "heldout": self.heldout,
            "mismatch": self.mismatch,
            "not_excluded": list(self.not_excluded),
            "next_measurement": self.next_measurement,
            "quality": list(self.quality),
            "notes": list(self.notes),
            "calibration": self.calibration,
            "seconds": self.seconds,
        }


def _finite(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else float(value)
