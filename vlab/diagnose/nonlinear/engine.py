"""The road of a case whose recorded motion leaves the range in which its model is linear."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from vlab.cases.case import Case
from vlab.diagnose.nonlinear.prepare import prepare_moving
from vlab.diagnose.nonlinear.scope import check_contacts, check_scope, linear_problem
from vlab.diagnose.nonlinear.screen import MovingScreen
from vlab.diagnose.nonlinear.search import search_moving
from vlab.diagnose.problem import Problem
from vlab.diagnose.search import TimeFound
from vlab.diagnose.timing import skew_asked_for
from vlab.physics.effect import Effect


@dataclass(frozen=True, kw_only=True, eq=False)
class AlongMotion:
    """A case whose recorded motion is far from linear, prepared for a search along that motion."""

    problem: Problem
    screen: MovingScreen

    @property
    def note(self) -> str:
        """What a diagnosis says of the road that it took."""
        return "the recorded motion leaves the range in which the model is linear, so the search went along that motion"

    def search(self, effects: Sequence[Effect], report: Callable[[float, str], None]) -> TimeFound:
        """Search what is missing; see `vlab.diagnose.search.search`."""
        return search_moving(self.screen, effects, report)


def prepared(case: Case) -> tuple[Problem, AlongMotion | None]:
    """Prepare a case, for a search along its recorded motion where that is far from linear.

    Raises
    ------
    BadCase
        No recording to fit, recordings that do not fit the model, or motion far from linear of a kind that cannot be handled.
    """
    problem = linear_problem(case)
    if problem is not None:
        return problem, None
    check_scope(case)
    problem, moving = prepare_moving(case)
    check_contacts(case, moving.motions)
    screen = MovingScreen(problem, moving)
    skew = skew_asked_for(screen)
    if skew is not None:
        problem, moving = prepare_moving(skew[0])
        problem = replace(problem, timing=skew[1])
        screen = MovingScreen(problem, moving)
    return problem, AlongMotion(problem=problem, screen=screen)
