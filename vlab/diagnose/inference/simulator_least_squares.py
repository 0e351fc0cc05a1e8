"""Final fit in MuJoCo, with derivatives of the trajectory-linearised system."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from vlab.cases.initial_state import InitialState
from vlab.cases.simulate import simulate
from vlab.diagnose.inference.trajectory_least_squares import TrajectoryLeastSquares
from vlab.diagnose.inference.trajectory_score_test import TrajectoryScoreTest
from vlab.diagnose.parameters.terms import Fit, Term, with_effects
from vlab.diagnose.settings import FIT, SIMULATOR_FIT
from vlab.errors import VlabError
from vlab.parallel import side_by_side
from vlab.plants.base import Plant
from vlab.signals import Array


class SimulatorLeastSquares(TrajectoryLeastSquares):
    """Fits to whole runs by defect correction with MuJoCo's simulation.

    The linear system along the motion is fitted to the recordings minus its difference from MuJoCo's run. Its
    derivatives are accurate where its values err slightly.

    Parameters
    ----------
    screen : TrajectoryScoreTest
        Screening along the motion.
    """

    def __init__(self, screen: TrajectoryScoreTest) -> None:
        super().__init__(screen, whole=True)
        self.recorded = [run.y for run in self.runs]

    def fit(
        self,
        terms: Sequence[Term] = (),
        start: Fit | None = None,
        iterations: int = FIT.iterations,
        thetas: Sequence[Array] = (),
        tolerance: float = FIT.near_enough,
    ) -> Fit:
        """See `LeastSquares`."""
        self._compare_with(self.recorded)
        best = super().fit(terms, start, iterations, thetas, tolerance)
        left, bias = self._missed(best)
        for _ in range(SIMULATOR_FIT.corrections):
            if bias is None:
                break
            self._compare_with([y - b for y, b in zip(self.recorded, bias, strict=True)])
            tried = super().fit(best.terms, best, SIMULATOR_FIT.steps, tolerance=tolerance)
            missed, more = self._missed(tried)
            if not missed < left:
                break
            is_enough = missed > SIMULATOR_FIT.enough * left
            best, left, bias = tried, missed, more
            if is_enough:
                break
        self._compare_with(self.recorded)
        return best

    def residual_in_mujoco(self, fit: Fit) -> float:
        """Return the normalised residual of a fit in MuJoCo.

        The rms residual is over noise and allowed model error.

        Parameters
        ----------
        fit : Fit
            Fit.

        Returns
        -------
        float
            Normalised residual, infinite after divergence.
        """
        return float(np.sqrt(self._missed(fit)[0] / sum(run.y.size for run in self.runs)))

    def _compare_with(self, recorded: Sequence[Array]) -> None:
        self.runs = [replace(run, y=y) for run, y in zip(self.runs, recorded, strict=True)]

    def _missed(self, fit: Fit) -> tuple[float, list[Array] | None]:
        """Return MuJoCo's normalised residual of a fit, and the system's defect."""
        system, states = self._along(fit)
        plant = self.problem.adjusted(fit.theta)
        try:
            plant = with_effects(plant, fit.terms, self.problem.names)
            found = side_by_side(lambda i: self._run(plant, i, states[i]), range(len(states)))
        except VlabError:
            return np.inf, None
        gains = np.array([self._gain(fit, j) for j in range(len(self.problem.channels))])
        bias, left, worst = [], 0.0, 0.0
        for i, (values, run) in enumerate(zip(found, self.runs, strict=True)):
            y = values * gains + fit.offsets
            missed = (y - self.recorded[i]) * run.usable
            left += float(np.sum((missed / self.sigma[i]) ** 2))
            worst = max(worst, float(np.max(np.sqrt(np.mean(missed**2, axis=0)) / run.scale)))
            bias.append(y - system[i])
        return left, bias if worst < SIMULATOR_FIT.follows else None

    def _run(self, plant: Plant, index: int, start: InitialState) -> Array:
        """Return MuJoCo's simulation at the samples of a run or part."""
        part = self.parts[index]
        trajectory, whole = self.moving.moving.trajectories[part.run], self.problem.runs[part.run]
        times = trajectory.time[part.first : part.end]
        end = np.inf if part.end == len(trajectory) else whole.measured.time[0] + trajectory.time[part.end] - 1e-9
        measured = whole.measured.between(whole.measured.time[0] + times[0] - 1e-9, end)  # the search may start later
        recording = simulate(plant, replace(whole, measured=measured), initial=start).recording
        rest = self.reduced_model.rows.rest
        time, at = recording.time - recording.time[0], times - times[0]
        columns = [
            np.interp(at, time, recording[c.channel] + (rest[j] if c.from_rest else 0.0))
            for j, c in enumerate(self.problem.channels)
        ]
        return np.column_stack(columns)

    def _gain(self, fit: Fit, channel: int) -> float:
        for change, value in zip(self.reduced_model.changes, fit.theta, strict=True):
            if change.sensor == channel:
                return float(np.exp(value))
        return 1.0

    def _along(self, fit: Fit) -> tuple[list[Array], list[InitialState]]:
        """Return the linear system's channels of a fit, and the initial states."""
        y = self.move_starts(fit.terms, fit.theta, [dict(t.values) for t in fit.terms], fit.offsets)
        out, states, nv = [], [], self.reduced_model.m
        for i, (run, part) in enumerate(zip(self.runs, self.parts, strict=True)):
            motion = self.moving.systems[part.run].motion
            assert run.start is not None
            q = self.moving.stepper.moved(motion.q[part.first], run.start[:nv])
            how = "rest" if part.first == 0 and self.moving.moving.trajectories[part.run].at_rest else "estimated"
            states.append(InitialState(qpos=q, qvel=motion.v[part.first] + run.start[nv:], how=how))
            out.append(y[: len(run), i] + fit.offsets)
        return out, states
