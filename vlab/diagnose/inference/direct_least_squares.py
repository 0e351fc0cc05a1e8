"""Fits to whole runs with MuJoCo's own simulation as predictor."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from vlab.cases.initial_state import InitialState
from vlab.cases.simulate import simulate
from vlab.diagnose.data.runs import Signals
from vlab.diagnose.inference.trajectory_least_squares import TrajectoryLeastSquares
from vlab.diagnose.inference.trajectory_score_test import TrajectoryScoreTest
from vlab.diagnose.parameters.terms import Term, with_effects
from vlab.diagnose.settings import SIMULATOR_FIT, TRAJECTORY_INTEGRATION
from vlab.errors import VlabError
from vlab.plants.base import Plant
from vlab.signals import Array


class DirectLeastSquares(TrajectoryLeastSquares):
    """Fits to whole runs by simulations in MuJoCo.

    The derivatives are forward differences of simulations. They hold where the system along the recorded motion does
    not: a clipped servo whose model is far off, or a stop that the recorded motion does not reach.

    Parameters
    ----------
    screen : TrajectoryScoreTest
        Screening along the motion.
    model_error : float or None
        See `LeastSquares`.
    """

    def __init__(self, screen: TrajectoryScoreTest, model_error: float | None = None) -> None:
        super().__init__(screen, whole=True, model_error=model_error)

    def simulate(
        self,
        runs: list[Signals],
        terms: Sequence[Term],
        theta: Array,
        values: Sequence[Mapping[str, Array]],
        starts: Array,
    ) -> Array:
        """See `LeastSquares`; `starts` are deviations from the motion."""
        out = np.full(
            (self.length, len(theta), len(self.parts), len(self.problem.channels)), TRAJECTORY_INTEGRATION.far
        )
        _, gains = self.reduced_model.gains(theta)
        for s, own in enumerate(theta):
            acting = [
                replace(term, values={name: float(value[s]) for name, value in given.items()})
                for term, given in zip(terms, values, strict=True)
            ]
            try:
                plant = with_effects(self.problem.adjusted(own), acting, self.problem.names)
            except VlabError:
                continue
            for w, run in enumerate(runs):
                try:
                    y = run_in_mujoco(self, plant, w, state_at(self, w, starts[s, w]))
                except VlabError:
                    continue
                out[: len(run), s, w] = y * gains[s]
        return np.clip(out, -TRAJECTORY_INTEGRATION.far, TRAJECTORY_INTEGRATION.far)


def is_affordable(of: TrajectoryLeastSquares, terms: Sequence[Term]) -> bool:
    """Return whether a Jacobian by simulations in MuJoCo takes few enough steps."""
    numbers = of.directions.shape[1] + sum(len(term.effect.parameters) for term in terms) + 2 * of.reduced_model.m
    steps = sum(len(run) * run.h for run in of.runs) / of.problem.plant.timestep
    return numbers * steps * of.reduced_model.m <= SIMULATOR_FIT.most_steps


def state_at(of: TrajectoryLeastSquares, index: int, start: Array) -> InitialState:
    """Return the initial state of a run or part.

    Parameters
    ----------
    of : TrajectoryLeastSquares
        Runs and parts.
    index : int
        Index of the run or part.
    start : (2 nv,) array
        Deviation from the motion.

    Returns
    -------
    InitialState
        Initial state.
    """
    part, nv = of.parts[index], of.reduced_model.m
    motion = of.moving.systems[part.run].motion
    q = of.moving.stepper.moved(motion.q[part.first], start[:nv])
    how = "rest" if part.first == 0 and of.moving.moving.trajectories[part.run].at_rest else "estimated"
    return InitialState(qpos=q, qvel=motion.v[part.first] + start[nv:], how=how)


def run_in_mujoco(of: TrajectoryLeastSquares, plant: Plant, index: int, start: InitialState) -> Array:
    """Return MuJoCo's channels at a run's or part's samples.

    Parameters
    ----------
    of : TrajectoryLeastSquares
        Runs and parts.
    plant : Plant
        Plant with its effects.
    index : int
        Index of the run or part.
    start : InitialState
        Initial state.

    Returns
    -------
    (n, n_channels) array
        Channels, without gains and offsets of the sensors.

    Raises
    ------
    Diverged
        The simulation diverges.
    """
    part = of.parts[index]
    trajectory, whole = of.moving.moving.trajectories[part.run], of.problem.runs[part.run]
    times = trajectory.time[part.first : part.end]
    end = np.inf if part.end == len(trajectory) else whole.measured.time[0] + trajectory.time[part.end] - 1e-9
    measured = whole.measured.between(whole.measured.time[0] + times[0] - 1e-9, end)  # the search may start later
    recording = simulate(plant, replace(whole, measured=measured), initial=start).recording
    rest = of.reduced_model.rows.rest
    time, at = recording.time - recording.time[0], times - times[0]
    columns = [
        np.interp(at, time, recording[c.channel] + (rest[j] if c.from_rest else 0.0))
        for j, c in enumerate(of.problem.channels)
    ]
    return np.column_stack(columns)
