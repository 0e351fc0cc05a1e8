"""Model classes of a search in time."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

from vlab.cases.case import Case
from vlab.diagnose.data.runs import Signals
from vlab.diagnose.inference.least_squares import LeastSquares
from vlab.diagnose.inference.score_test import ScoreTest
from vlab.diagnose.inference.trajectory_least_squares import TrajectoryLeastSquares
from vlab.diagnose.inference.trajectory_score_test import TrajectoryScoreTest
from vlab.diagnose.predictors.modal_problem import prepare
from vlab.diagnose.predictors.scope import check_contacts, check_scope, linear_problem
from vlab.diagnose.predictors.trajectory_problem import prepare_trajectory, read_trajectory_signals
from vlab.diagnose.problem import Problem
from vlab.diagnose.search.limits import NO_LIMITS, Limits
from vlab.diagnose.search.sampling_convention import score_by_timing
from vlab.diagnose.search.selection import TimeFound, search
from vlab.diagnose.search.trajectory_selection import search_moving
from vlab.diagnose.settings import HYPOTHESIS_FITS, MODEL_CLASS
from vlab.parallel import side_by_side
from vlab.physics.catalogue import CANDIDATES
from vlab.physics.effect import Effect
from vlab.signals import Array

Report = Callable[[float, str], None]
"""Receiver of the completed share and the current step."""
UNSTRETCHED = (
    "the recordings do not show that swinging tightens the cables: they are taken for softer along their length"
)
"""Note on cables without identifiable stretch stiffening."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearTimeInvariant:
    """Case screened on the linear time-invariant reduced model."""

    is_linear: ClassVar[bool] = True
    screen: ScoreTest
    notes: tuple[str, ...] = ()

    @property
    def problem(self) -> Problem:
        """Inverse problem of the search."""
        return self.screen.problem

    def search(self, effects: Sequence[Effect], report: Report, limits: Limits = NO_LIMITS) -> TimeFound:
        """Search the missing physics, by `vlab.diagnose.search.selection.search`."""
        return search(self.screen, effects, report, limits)

    def whole_runs_of(self, case: Case, model_error: float) -> LeastSquares | None:
        """Return the whole-run fits of a case with another convention.

        Parameters
        ----------
        case : Case
            Case.
        model_error : float
            Allowed simulation error over a channel's rms.

        Returns
        -------
        LeastSquares or None
            Fits; None outside the linear range.
        """
        screen = _linearise_at_rest(case, "")
        return None if screen is None else LeastSquares(screen, screen.problem.in_role("fit"), model_error)


@dataclass(frozen=True, kw_only=True, eq=False)
class TrajectoryLinearised:
    """Case screened on the system linearised along its motion."""

    is_linear: ClassVar[bool] = False
    notes: ClassVar[tuple[str, ...]] = (
        "the recorded motion leaves the range in which the model is linear, so the search went along that motion",
    )
    screen: TrajectoryScoreTest

    @property
    def problem(self) -> Problem:
        """Inverse problem of the search."""
        return self.screen.problem

    def search(self, effects: Sequence[Effect], report: Report, limits: Limits = NO_LIMITS) -> TimeFound:
        """Search the missing physics along the motion."""
        return search_moving(self.screen, effects, report, limits)

    def whole_runs_of(self, case: Case, model_error: float) -> LeastSquares:
        """Return the whole-run fits of a case with another convention.

        The model error is that of the screening.
        """
        return TrajectoryLeastSquares(_linearise_trajectory(case), whole=True)


def choose_model_class(
    case: Case, effects: Sequence[Effect] = CANDIDATES
) -> LinearTimeInvariant | TrajectoryLinearised:
    """Choose the model class of a case and screen it.

    Parameters
    ----------
    case : Case
        Case.
    effects : sequence of Effect
        Candidate effects.

    Returns
    -------
    LinearTimeInvariant or TrajectoryLinearised
        Screened model class.

    Raises
    ------
    BadCase
        No recording to fit, a contradiction to the model, or unsupported large motion.
    """
    problem = linear_problem(case)
    if problem is not None:
        model_class = _as_nonlinear_as_recorded(problem)
        return replace(
            model_class,
            screen=score_by_timing(model_class.screen, _signals, _linearise_at_rest, _residual_at_rest, effects),
        )
    check_scope(case)
    screen = _linearise_trajectory(case)
    check_contacts(case, screen.moving.motions)
    return TrajectoryLinearised(
        screen=score_by_timing(screen, read_trajectory_signals, _linearise_trajectory, _residual_on_trajectory, effects)
    )


def _as_nonlinear_as_recorded(problem: Problem) -> LinearTimeInvariant:
    """Screen a problem with identifiable own nonlinearity.

    Cables stiffen a swinging beam by 1e-5 at a quarter of a millimetre. Light damping makes that visible, and the real
    structure may differ. An unidentified nonlinearity would extrapolate to louder recordings.
    """
    if problem.bare is None or not problem.model_kind.has_doubtful_nonlinearity:
        return LinearTimeInvariant(screen=ScoreTest(problem))
    (with_cables, theta), (without, theta_without) = side_by_side(_left_by_a_refit, (problem, problem.bare))
    if with_cables <= MODEL_CLASS.less * without:
        return LinearTimeInvariant(screen=ScoreTest(problem, theta=theta))
    soft = problem.model_kind.with_soft_cables(problem.case)
    if soft is None:
        return LinearTimeInvariant(screen=ScoreTest(problem.bare, theta=theta_without))
    return LinearTimeInvariant(screen=ScoreTest(prepare(soft), theta=theta_without), notes=(UNSTRETCHED,))


def _left_by_a_refit(problem: Problem) -> tuple[float, Array]:
    """Return a refit's mean square and starting parameters."""
    screen = ScoreTest(problem)
    return _residual_at_rest(screen), screen.theta


def _signals(case: Case) -> Sequence[Signals]:
    return prepare(case).signals


def _linearise_at_rest(case: Case, timing: str) -> ScoreTest | None:
    problem = linear_problem(case)
    return None if problem is None else ScoreTest(replace(problem, timing=timing))


def _residual_at_rest(screen: ScoreTest) -> float:
    return _left(LeastSquares(screen, screen.problem.in_role("fit")))


def _residual_on_trajectory(screen: TrajectoryScoreTest) -> float:
    return _left(TrajectoryLeastSquares(screen, whole=True))


def _left(refiner: LeastSquares) -> float:
    """Return the normalised mean square of a refit."""
    return refiner.fit((), None, HYPOTHESIS_FITS.whole_iterations).cost / refiner.n_values


def _linearise_trajectory(case: Case, timing: str = "") -> TrajectoryScoreTest:
    problem, moving = prepare_trajectory(case)
    return TrajectoryScoreTest(replace(problem, timing=timing), moving)
