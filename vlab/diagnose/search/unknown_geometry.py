"""Geometry that a case does not state."""

from collections.abc import Sequence

import numpy as np

from vlab.cases.case import Case
from vlab.diagnose.diagnosis import NAMING, Diagnosis, Finding
from vlab.diagnose.problem import Problem
from vlab.diagnose.search.model_class import LinearTimeInvariant, TrajectoryLinearised
from vlab.diagnose.search.selection import TimeFound
from vlab.diagnose.search.stages import Judged
from vlab.diagnose.settings import GEOMETRY, HYPOTHESIS_FITS, SAMPLING_CONVENTION
from vlab.diagnose.validation.gap import total

UNKNOWN_GEOMETRY = (
    "the case states no uncertainty of the geometry, and the recordings contradict that of a drawing: inertia and length "
    "were left to the recordings"
)
"""Note on a search with unknown geometry."""


def with_unknown_geometry(
    model_class: LinearTimeInvariant | TrajectoryLinearised, found: TimeFound, stated: Case
) -> Case | None:
    """Return the case with unknown geometry where the recordings ask for it.

    Inertia and length are known to the tolerance of a drawing where a case states nothing. Models of real machines are
    often sketches. The likelihood of the calibrated model shows a sketch: the gain of a wide prior exceeds the chance gain
    of all parameters.

    Parameters
    ----------
    model_class : LinearTimeInvariant or TrajectoryLinearised
        Model class of the case.
    found : TimeFound
        Result of the search.
    stated : Case
        Case as it is stated.

    Returns
    -------
    Case or None
        Case with a wide prior; None where the case states the geometry or the gain is small.
    """
    kinds = _unstated_kinds(model_class.problem, stated)
    if not kinds:
        return None
    refiner = model_class.whole_runs_of(model_class.problem.case.with_uncertain(kinds), found.whole.model_error)
    if refiner is None:
        return None
    before = found.before.long_fit
    left = before.cost / found.whole.n_values
    now = refiner.fit((), before, HYPOTHESIS_FITS.whole_iterations).cost / refiner.n_values
    gain = 0.5 * found.whole.effective_samples * float(np.log(left / now))
    return stated.with_uncertain(kinds) if gain > SAMPLING_CONVENTION.gain else None


def is_better_with_geometry(again: Diagnosis, judged: Judged, freed: int) -> bool:
    """Return whether the diagnosis with unknown geometry replaces that with a drawing.

    Of two complete explanations the one with fewer parameters is better, where a freed kind of geometry is one. A partial
    explanation must predict hold-out recordings worse.

    Parameters
    ----------
    again : Diagnosis
        Diagnosis with unknown geometry.
    judged : Judged
        Judgement with the geometry of a drawing.
    freed : int
        Kinds of geometry left to the recordings.

    Returns
    -------
    bool
        Whether the diagnosis replaces the judgement.
    """
    assert judged.tried is not None
    if judged.verdict == "none-of-these":
        return True
    if judged.verdict == "missing-physics":
        is_complete = again.verdict in ("missing-physics", "nothing-missing")
        return is_complete and _count(again.findings) + freed < _count(judged.tried.findings)
    is_answer = again.verdict in (*NAMING, "nothing-missing")
    return is_answer and total(again.checked, "after") < total(judged.tried.checked, "after")


def _count(findings: Sequence[Finding]) -> int:
    """Return the number of parameters of findings."""
    return sum(len(finding.parameters) for finding in findings)


def _unstated_kinds(problem: Problem, stated: Case) -> dict[str, float]:
    """Return the unstated kinds of geometry among a problem's parameters, with wide standard deviations."""
    named = {name.rpartition(":")[2] for name in stated.table.model.uncertain}
    free = {p.kind for p in problem.parameters}
    return {kind: sd for kind, sd in GEOMETRY.unknown.items() if kind in free and kind not in named}
