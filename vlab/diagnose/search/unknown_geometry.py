"""Geometry that a case does not state."""

from collections.abc import Sequence

import numpy as np

from vlab.cases.case import Case
from vlab.diagnose.diagnosis import NAMING, Diagnosis, Finding
from vlab.diagnose.parameters.geometry import stated_kinds
from vlab.diagnose.problem import Problem
from vlab.diagnose.search.alternative_conventions import gains_more_than_chance
from vlab.diagnose.search.model_class import LinearTimeInvariant, TrajectoryLinearised
from vlab.diagnose.search.selection import TimeFound
from vlab.diagnose.search.stages import Judged
from vlab.diagnose.settings import GAP, GEOMETRY, HYPOTHESIS_FITS
from vlab.diagnose.validation.gap import total


def unstated_geometry(problem: Problem, stated: Case) -> dict[str, float]:
    """Return the kinds of geometry that a case does not state.

    Parameters
    ----------
    problem : Problem
        Inverse problem.
    stated : Case
        Case as it is stated, by kind or by element.

    Returns
    -------
    dict of str to float
        Standard deviations of a sketch by kind, of the kinds among the uncertain parameters.
    """
    named = stated_kinds(stated.table.model.uncertain)
    free = {p.kind for p in problem.parameters}
    return {kind: sd for kind, sd in GEOMETRY.unknown.items() if kind in free and kind not in named}


def is_geometry_contradicted(
    model_class: LinearTimeInvariant | TrajectoryLinearised, found: TimeFound, kinds: dict[str, float]
) -> bool:
    """Return whether recordings along a motion contradict the tolerance of a drawing.

    Inertia and length are known to the tolerance of a drawing where a case states nothing. Models of real machines are
    often sketches. The likelihood of the calibrated model suggests a sketch: the gain of a wide prior exceeds the chance gain
    of all parameters. Missing physics can have that gain, too, so hold-out recordings decide afterwards. Near rest, springs
    and masses stand for a wrong geometry.

    Parameters
    ----------
    model_class : LinearTimeInvariant or TrajectoryLinearised
        Model class of the case.
    found : TimeFound
        Result of the search.
    kinds : dict of str to float
        Standard deviations of a sketch by kind.

    Returns
    -------
    bool
        Whether a wide prior explains clearly more.
    """
    if not kinds or not isinstance(model_class, TrajectoryLinearised):
        return False
    refiner = model_class.whole_runs_of(model_class.problem.case.with_uncertain(kinds), found.whole.model_error)
    before = found.before.long_fit
    now = refiner.fit((), before, HYPOTHESIS_FITS.whole_iterations).cost / refiner.n_values
    return gains_more_than_chance(found, before.cost / found.whole.n_values, max(now, np.finfo(float).tiny))


def may_be_simpler(judged: Judged, freed: int) -> bool:
    """Return whether a diagnosis with freed kinds of geometry can replace a judgement.

    Parameters
    ----------
    judged : Judged
        Judgement with the geometry of a drawing.
    freed : int
        Kinds of geometry left to the recordings.

    Returns
    -------
    bool
        False for a verdict that is no answer, and for a complete one with as few parameters.
    """
    if judged.verdict == "missing-physics":
        assert judged.tried is not None
        return freed < _count(judged.tried.findings)
    return judged.verdict in (*NAMING, "none-of-these")


def is_better_with_geometry(again: Diagnosis, judged: Judged, freed: int) -> bool:
    """Return whether the diagnosis with unknown geometry replaces that with a drawing.

    A partial explanation must predict hold-out recordings worse. Of two complete explanations that predict equally well, the
    one with fewer parameters is better, where a freed kind of geometry is one.

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
    now, before = total(again.checked, "after"), total(judged.tried.checked, "after")
    if judged.verdict == "missing-physics":
        is_complete = again.verdict in ("missing-physics", "nothing-missing")
        is_simpler = _count(again.findings) + freed < _count(judged.tried.findings)
        return is_complete and is_simpler and now <= GAP.no_worse * before
    is_answer = again.verdict in (*NAMING, "nothing-missing")
    return now < before and (is_answer or judged.verdict == again.verdict == "none-of-these")


def unknown_geometry_note(kinds: Sequence[str]) -> str:
    """Return the note on a search with unknown geometry.

    Parameters
    ----------
    kinds : sequence of str
        Kinds of geometry left to the recordings.

    Returns
    -------
    str
        Note.
    """
    each = " and ".join(kinds)
    return (
        f"the case states no uncertainty of {each}, and the recordings contradict the tolerance of a drawing: {each} of the "
        "bodies follow from the recordings"
    )


def _count(findings: Sequence[Finding]) -> int:
    """Return the number of parameters of findings, at all their places."""
    return sum(len(parameters) for finding in findings for _, parameters in finding.places)
