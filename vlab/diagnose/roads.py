"""The two roads of a search in recordings: near rest, where a model is linear, and along a motion that leaves that range."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

from vlab.cases.case import Case
from vlab.diagnose.nonlinear.prepare import prepare_moving
from vlab.diagnose.nonlinear.scope import check_contacts, check_scope, linear_problem
from vlab.diagnose.nonlinear.screen import MovingScreen
from vlab.diagnose.nonlinear.search import search_moving
from vlab.diagnose.problem import Problem
from vlab.diagnose.screen import Screen
from vlab.diagnose.search import TimeFound, search
from vlab.diagnose.timing import skew_asked_for, timed
from vlab.physics.effect import Effect

Report = Callable[[float, str], None]


@dataclass(frozen=True, kw_only=True, eq=False)
class NearRest:
    """A case prepared for a search on its linear twin.

    Parameters
    ----------
    screen : Screen or None
        The screening, where it was needed already.
    """

    is_linear: ClassVar[bool] = True
    notes: ClassVar[tuple[str, ...]] = ()
    problem: Problem
    screen: Screen | None = None

    def search(self, effects: Sequence[Effect], report: Report) -> TimeFound:
        """Search what is missing; see `vlab.diagnose.search.search`."""
        return search(self.problem, effects, report, self.screen)


@dataclass(frozen=True, kw_only=True, eq=False)
class AlongMotion:
    """A case whose recorded motion is far from linear, prepared for a search along that motion."""

    is_linear: ClassVar[bool] = False
    notes: ClassVar[tuple[str, ...]] = (
        "the recorded motion leaves the range in which the model is linear, so the search went along that motion",
    )
    screen: MovingScreen

    @property
    def problem(self) -> Problem:
        """What is searched."""
        return self.screen.problem

    def search(self, effects: Sequence[Effect], report: Report) -> TimeFound:
        """Search what is missing; see `vlab.diagnose.search.search`."""
        return search_moving(self.screen, effects, report)


def road_of(case: Case) -> NearRest | AlongMotion:
    """Prepare a case, for a search along its recorded motion where that is far from linear.

    Raises
    ------
    BadCase
        No recording to fit, recordings that do not fit the model, or motion far from linear of a kind that cannot be handled.
    """
    problem = linear_problem(case)
    if problem is not None:
        problem, near = timed(problem, linear_problem)
        return NearRest(problem=problem, screen=near)
    check_scope(case)
    problem, moving = prepare_moving(case)
    check_contacts(case, moving.motions)
    screen = MovingScreen(problem, moving)
    skew = skew_asked_for(screen)
    if skew is not None:
        problem, moving = prepare_moving(skew[0])
        screen = MovingScreen(replace(problem, timing=skew[1]), moving)
    return AlongMotion(screen=screen)
