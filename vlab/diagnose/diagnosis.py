"""Result of a diagnosis: verdict, findings, errors, alternatives and notes."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from vlab.cases.case import Case
from vlab.cases.checks import FileCheck
from vlab.diagnose.parameters.terms import Fit
from vlab.diagnose.validation.gap import Distance, explained_share, total, verifying, whole_gap

ERRORS = {"nominal": "nominal", "refitted": "calibrated", "before": "before", "after": "after", "noise": "noise"}
"""Attribute of `Distance` by error key of the JSON document."""
SCHEMA = "vlab-diagnosis/1"
"""Name and version of the JSON document; the number grows when a key changes its meaning or goes."""
MEND_AND_REPEAT = "none yet: mend the case as its quality says, and diagnose it again"
"""Next measurement after a rejected case."""
Verdict = Literal[
    "missing-physics", "partly-explained", "unknown-law", "nothing-missing", "none-of-these", "bad-recording"
]
"""Verdicts of a diagnosis."""
NAMING: frozenset[Verdict] = frozenset({"missing-physics", "partly-explained", "unknown-law"})
"""Verdicts with findings."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """Effect missing in the model.

    Parameters
    ----------
    effect : str
        Name of the effect.
    form : str
        Effect of the catalogue that has the law and parameters: `effect` or another form.
    family : str
        Family of the effect.
    place : str
        Location.
    places_90 : tuple of str
        90 % credible set of locations.
    probability : float
        Posterior probability of the effect [1].
    alike : tuple of str
        Indistinguishable effects, the finding first.
    parameters : dict
        Value, unit and 90 % interval by name, SI.
    law : str
        Law as a formula.
    words : str
        Description.
    verified_by : tuple of str
        Hold-out recordings with a detectable effect; no other recording can verify the finding.
    explained : float
        Share of the mismatch that returns without the finding [1]; NaN where unknown.
    elsewhere : tuple of (str, dict)
        Further places of the same law, with their parameters.
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
    explained: float = float("nan")
    elsewhere: tuple[tuple[str, dict[str, dict[str, Any]]], ...] = ()

    @property
    def places(self) -> tuple[tuple[str, dict[str, dict[str, Any]]], ...]:
        """All places of the law with their parameters, the main place first."""
        return ((self.place, self.parameters), *self.elsewhere)

    @property
    def site(self) -> str:
        """All places in one string."""
        return ", ".join(place for place, _ in self.places)

    @property
    def name(self) -> str:
        """Effect, with its form where different."""
        return self.effect if self.form == self.effect else f"{self.effect} ({self.form})"

    def __repr__(self) -> str:
        """Return effect, places, probability and parameters in one line."""
        values = [
            f"{name} = {p['value']:.4g} {p['unit']} (90 %: {p['ci90'][0]:.4g} to {p['ci90'][1]:.4g})"
            for name, p in self.parameters.items()
        ]
        return f"{self.name} at {self.site} (probability {self.probability:.2f}): {', '.join(values)}"

    def to_json(self) -> dict[str, Any]:
        """Return plain values for a JSON document."""
        return {
            "effect": self.effect,
            "form": self.form,
            "family": self.family,
            "place": self.place,
            "places": [{"place": place, "parameters": values} for place, values in self.places],
            "places_90": list(self.places_90),
            "probability": self.probability,
            "class": list(dict.fromkeys([self.effect, self.form, *self.alike])),
            "parameters": self.parameters,
            "law": self.law,
            "words": self.words,
            "verified_by": list(self.verified_by),
            "explained": _finite(self.explained),
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class Attempt:
    """Best attempt without a sufficient explanation, without probability.

    Parameters
    ----------
    findings : tuple of Finding
        Fitted effects.
    checked : tuple of Distance
        Errors with the attempt as extended model.
    fit : Fit
        Fit of the attempt.
    explains_fitted : bool
        Whether the attempt closes the gap on the fitted recordings, which counts where no hold-out recording shows it.
    hypothesis : frozenset of str
        Labels of the tried hypothesis, of which the fit may be a nested model; empty for those of the fit.
    """

    findings: tuple[Finding, ...]
    checked: tuple[Any, ...]
    fit: Fit
    explains_fitted: bool = True
    hypothesis: frozenset[str] = frozenset()

    @property
    def name(self) -> str:
        """Effects and locations."""
        return " + ".join(f"{f.name} at {f.site}" for f in self.findings)

    @property
    def holds(self) -> bool:
        """Whether the attempt is finite, determined, and an improvement."""
        tests = verifying(self.checked)
        before, after = total(tests, "before"), total(tests, "after")
        labels = {term.label for term in self.fit.terms}
        is_inert = bool(labels) and labels <= set(self.fit.unidentified)  # as a limit that nothing reaches
        return bool(after < total(tests, "lost") and not is_inert and (after < before or all(c.is_idle for c in tests)))

    @property
    def is_of_the_fit_alone(self) -> bool:
        """Whether the attempt explains fitted recordings, and no hold-out shows it."""
        return self.explains_fitted and bool(self.checked) and all(c.is_idle for c in self.checked)

    def to_json(self) -> dict[str, Any]:
        """Return plain values for a JSON document, further effects under ``also``."""
        first, *more = (
            {key: value for key, value in f.to_json().items() if key not in ("probability", "places_90", "explained")}
            for f in self.findings
        )
        return {**first, "also": more, **errors_to_json(self.checked)}


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Diagnosis:
    """Result of a diagnosis.

    Parameters
    ----------
    title : str
        Title of the case.
    verdict : Verdict
        Verdict.
    findings : tuple of Finding
        Findings.
    alternatives : tuple of dict
        Other hypotheses.
    checked : tuple of Distance
        Errors on hold-out recordings, or on fitted recordings without a hold-out set. Responses and modal tables give
        `vlab.diagnose.validation.frequency.CheckedFrequency`.
    mismatch : dict
        Largest residuals by frequency, channel and time.
    not_excluded : tuple of str
        Open possibilities.
    next_measurement : str
        Recommended measurement.
    quality, notes : tuple of str
        Data quality and further notes.
    attempt : Attempt or None
        Best attempt with the verdict ``"none-of-these"``.
    calibration : dict
        Log factors of the uncertain parameters by name; of positions the distance [m].
    seconds : float
        Duration [s].
    residual_is_small : bool
        Whether the residual of the reported model is within noise and stated model error.
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
    residual_is_small: bool = True

    @property
    def is_naming(self) -> bool:
        """Whether the diagnosis reports findings."""
        return self.verdict in NAMING

    @property
    def explained(self) -> float | None:
        """Explained share of the mismatch; None without findings or mismatch."""
        return explained_share(self.checked) if self.is_naming else None

    @property
    def calibrated(self) -> float | None:
        """Share of the nominal model's mean-square error that calibration removes.

        None where it removes nothing.
        """
        nominal, before = total(self.checked, "nominal"), total(self.checked, "before")
        if not before < nominal:
            return None
        return 1.0 - (before / nominal) ** 2 if np.isfinite(nominal) else 1.0

    @property
    def is_complete(self) -> bool:
        """Whether the residual is within noise and stated model error."""
        return self.verdict in ("missing-physics", "nothing-missing") and self.residual_is_small

    @property
    def tried(self) -> tuple[Any, ...]:
        """Errors with the best attempt as extended model, where nothing is reported."""
        return self.checked if self.attempt is None else self.attempt.checked

    @property
    def is_held_out(self) -> bool:
        """Whether all checked recordings are hold-out data."""
        return all(c.role == "holdout" for c in self.checked) and bool(self.checked)

    @property
    def is_verified(self) -> bool:
        """Whether hold-out recordings can verify the result."""
        return self.is_held_out and not all(c.is_idle for c in self.checked)

    @property
    def heldout(self) -> dict[str, Any]:
        """Errors on hold-out recordings, overall and by recording."""
        return {**errors_to_json(self.checked), "verified": self.is_verified}

    def to_json(self) -> dict[str, Any]:
        """Return plain values for a JSON document."""
        return {
            "schema": SCHEMA,
            "title": self.title,
            "verdict": self.verdict,
            "explained": _finite(self.explained),
            "remaining": None if self.explained is None else _finite(1.0 - self.explained),
            "complete": self.is_complete,
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
    """Return the errors of checked recordings as plain values.

    Parameters
    ----------
    checked : sequence of Distance
        Errors.

    Returns
    -------
    dict
        Errors overall and by recording.
    """
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


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class RejectedCase:
    """Diagnosis of a case whose files contradict its description.

    Parameters
    ----------
    diagnosis : Diagnosis
        Diagnosis with the verdict ``bad-recording`` and the reason as quality.
    case : Case
        Case.
    """

    diagnosis: Diagnosis
    case: Case


def reject_case(case: Case, check: FileCheck, seconds: float) -> RejectedCase:
    """Return the diagnosis ``bad-recording`` of a contradictory case.

    Parameters
    ----------
    case : Case
        Case.
    check : FileCheck
        Contradictions.
    seconds : float
        Duration of the checks [s].

    Returns
    -------
    RejectedCase
        Diagnosis without a search.
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
