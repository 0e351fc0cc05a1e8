"""A diagnosis: the verdict, what was found, where, with which law, how much better it fits, and what was not excluded."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from vlab.cases.case import Case
from vlab.cases.checks import FileCheck
from vlab.diagnose.parameters.terms import Fit
from vlab.diagnose.settings import GAP
from vlab.diagnose.validation.gap import Distance, total, verifying, whole_gap

ERRORS = {"nominal": "nominal", "refitted": "calibrated", "before": "before", "after": "after", "noise": "noise"}
"""Errors of a document by key, and the attribute of `Distance` with the value."""
MEND_AND_REPEAT = "none yet: mend the case as its quality says, and diagnose it again"
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
    verified_by : tuple of str
        Recordings kept aside in which it does anything: no other one can verify it.
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
    verified_by: tuple[str, ...] = ()

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
            "verified_by": list(self.verified_by),
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class Attempt:
    """The best attempt where nothing explains enough to be reported; it has no probability.

    Parameters
    ----------
    findings : tuple of Finding
        What was added to the model, as it was fitted.
    checked : tuple of Distance
        As those of a `Diagnosis`, with it for the amended model.
    fit : Fit
        The same as it is simulated.
    """

    findings: tuple[Finding, ...]
    checked: tuple[Any, ...]
    fit: Fit

    @property
    def name(self) -> str:
        """Its effects and places."""
        return " + ".join(f"{f.name} at {f.place}" for f in self.findings)

    @property
    def holds(self) -> bool:
        """Whether it is one: a fit that ran away, or leaves no less than the model without it, is none."""
        tests = verifying(self.checked)
        before, after = total(tests, "before"), total(tests, "after")
        return bool(after < GAP.lost and (after < before or all(c.is_idle for c in tests)))

    @property
    def is_of_the_fit_alone(self) -> bool:
        """Whether it does nothing in any recording kept aside."""
        return bool(self.checked) and all(c.is_idle for c in self.checked)

    def to_json(self) -> dict[str, Any]:
        """Return plain values for a JSON document: those of a finding, and what it closes; further effects stand under ``also``."""
        first, *more = (
            {key: value for key, value in f.to_json().items() if key not in ("probability", "places_90")}
            for f in self.findings
        )
        return {**first, "also": more, **errors_to_json(self.checked)}


@dataclass(frozen=True, kw_only=True, eq=False)
class Diagnosis:
    """What a diagnosis says.

    Parameters
    ----------
    checked : tuple of Distance
        Every hold-out recording under the nominal, the refitted and the amended model; fit recordings where there is no
        hold-out. Of responses and tables of modes `vlab.diagnose.validation.frequency.CheckedFrequency`.
    attempt : Attempt or None
        Beside ``"none-of-these"``.
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
    attempt: Attempt | None = None
    calibration: dict[str, float] = field(default_factory=dict)
    seconds: float = 0.0

    @property
    def tried(self) -> tuple[Any, ...]:
        """As `checked`, with the best attempt for the amended model where nothing is reported."""
        return self.checked if self.attempt is None else self.attempt.checked

    @property
    def is_held_out(self) -> bool:
        """Whether the recordings in `checked` were kept from the search."""
        return all(c.role == "holdout" for c in self.checked) and bool(self.checked)

    @property
    def is_verified(self) -> bool:
        """Whether recordings kept from the search can verify what is said."""
        return self.is_held_out and not all(c.is_idle for c in self.checked)

    @property
    def heldout(self) -> dict[str, Any]:
        """Errors before and after on the hold-out recordings, in all and one by one."""
        return {**errors_to_json(self.checked), "verified": self.is_verified}

    def to_json(self) -> dict[str, Any]:
        """Return plain values for a JSON document."""
        return {
            "title": self.title,
            "verdict": self.verdict,
            "findings": [f.to_json() for f in self.findings],
            "alternatives": list(self.alternatives),
            "attempt": None if self.attempt is None else self.attempt.to_json(),
            "heldout": self.heldout,
            "mismatch": self.mismatch,
            "not_excluded": list(self.not_excluded),
            "next_measurement": self.next_measurement,
            "quality": list(self.quality),
            "notes": list(self.notes),
            "calibration": self.calibration,
            "seconds": self.seconds,
        }


def errors_to_json(checked: Sequence[Distance]) -> dict[str, Any]:
    """Return errors on checked recordings, in all and one by one, as plain values."""
    each = [
        {
            "name": c.name,
            "role": c.role,
            **{f"nrmse_{key}": _finite(getattr(c, name)) for key, name in ERRORS.items()},
            "gap_closed": _finite(c.gap_closed),
            "can_verify": not c.is_idle,
            "channels": {
                name: dict(zip(("nominal", "before", "after", "noise"), map(_finite, v), strict=True))
                for name, v in c.channels.items()
            },
        }
        for c in checked
    ]
    return {
        **{f"nrmse_{key}": _finite(total(checked, name)) for key, name in ERRORS.items()},
        "gap_closed": _finite(whole_gap(checked)),
        "per_recording": each,
    }


def _finite(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else float(value)


@dataclass(frozen=True, kw_only=True, eq=False)
class RejectedCase:
    """A diagnosis that ends before its search: the case misstates its files.

    Parameters
    ----------
    diagnosis : Diagnosis
        Whose verdict is ``bad-recording``, and whose quality says why.
    case : Case
        As given.
    """

    diagnosis: Diagnosis
    case: Case


def reject_case(case: Case, check: FileCheck, seconds: float) -> RejectedCase:
    """Return the diagnosis ``bad-recording`` of a case whose files contradict its description.

    Parameters
    ----------
    seconds : float
        Duration of the checks.
    """
    diagnosis = Diagnosis(
        title=case.table.title,
        verdict="bad-recording",
        findings=(),
        alternatives=(),
        checked=(),
        mismatch={"where_frequency_hz": [], "where_channel": [], "where_time_s": []},
        not_excluded=(),
        next_measurement=MEND_AND_REPEAT,
        quality=check.lines,
        seconds=seconds,
    )
    return RejectedCase(diagnosis=diagnosis, case=case)
