"""Stages of a diagnosis from recordings: search and judgement."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from vlab.cases.channel_map import Run
from vlab.cases.checks import FileCheck
from vlab.diagnose.data_findings import DataFindings
from vlab.diagnose.diagnosis import Attempt, Verdict
from vlab.diagnose.inference.model_choice import Choice
from vlab.diagnose.parameters.holdout import HoldOut, moves
from vlab.diagnose.parameters.static_offset import StaticOffset
from vlab.diagnose.parameters.terms import Fit
from vlab.diagnose.problem import Problem
from vlab.diagnose.search.confirmation import Confirmed
from vlab.diagnose.search.model_class import LinearTimeInvariant, TrajectoryLinearised
from vlab.diagnose.search.selection import TimeFound
from vlab.diagnose.validation.simulation import ExtendedModel


@dataclass(frozen=True, kw_only=True, eq=False)
class Searched:
    """Prepared case with the result of the search."""

    file: FileCheck
    static_offsets: Sequence[StaticOffset]
    model_class: LinearTimeInvariant | TrajectoryLinearised
    holdout: HoldOut
    seen: DataFindings
    found: TimeFound
    notes: tuple[str, ...]

    @property
    def problem(self) -> Problem:
        """Inverse problem of the search."""
        return self.model_class.problem

    @property
    def runs(self) -> list[Run]:
        """Recordings of the verdict."""
        return list(self.holdout.runs) or [run for run in self.problem.runs if moves(run)]


@dataclass(frozen=True, kw_only=True, eq=False)
class Judged:
    """Models of a confirmed choice, and the verdict on them."""

    confirmed: Confirmed
    seen: DataFindings
    before: ExtendedModel
    after: ExtendedModel
    fit: Fit
    verdict: Verdict = "none-of-these"
    tried: Attempt | None = None
    attempt: Attempt | None = None
    errors: Mapping[frozenset[str], float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def choice(self) -> Choice:
        """Chosen hypothesis."""
        return self.confirmed.choice
