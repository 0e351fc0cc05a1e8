"""Inverse problem of the trajectory-linearised model class."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from vlab.cases.case import Case
from vlab.cases.channel_map import Compared
from vlab.cases.replay_bench import Bench
from vlab.diagnose.data.mains_interference import MainsInterference, find_mains_interference, remove_mains_interference
from vlab.diagnose.data.runs import Signals, thinning
from vlab.diagnose.parameters.geometry import geometry_parameters
from vlab.diagnose.parameters.known_effects import port_terms
from vlab.diagnose.parameters.locations import places_of
from vlab.diagnose.parameters.mjcf import Uncertain, changes_of, uncertain_parameters
from vlab.diagnose.parameters.observation import ChannelRows
from vlab.diagnose.parameters.recorded_runs import RecordedRuns, read_runs, recorded_commands
from vlab.diagnose.parameters.reduced_model import ReducedModel
from vlab.diagnose.predictors.step_jacobian import Stepper, Substeps
from vlab.diagnose.predictors.trajectory_data import Motion, TrajectoryData, first_motion, read_trajectory_data
from vlab.diagnose.problem import Problem
from vlab.diagnose.settings import LOCATIONS, STEP_JACOBIAN, TRAJECTORY_DATA
from vlab.errors import BadStructure
from vlab.parallel import side_by_side
from vlab.plants.base import Plant
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Trajectories:
    """Trajectory data of a problem with large motion.

    Parameters
    ----------
    trajectories : tuple of TrajectoryData
        Runs at their own sample times.
    motions : tuple of Motion
        First estimates of the motion.
    load_ports : tuple of str
        Directly driven ports.
    driven : tuple of int
        Actuators driven by recordings or laws.
    substeps : Substeps
        Integration of a sample interval.
    """

    trajectories: tuple[TrajectoryData, ...]
    motions: tuple[Motion, ...]
    load_ports: tuple[str, ...]
    driven: tuple[int, ...]
    substeps: Substeps

    def stepper(self, plant: Plant, channels: Sequence[Compared]) -> Stepper:
        """Return the stepper of a plant for these runs."""
        out = Stepper(plant, channels, self.load_ports)
        out.take(self.substeps)
        return out


def trajectory_parameters(
    plant: Plant, given: Mapping[str, float], channels: Sequence[str], driven: Sequence[int]
) -> list[Uncertain]:
    """Return the uncertain parameters, with inertias, centres of mass and lengths.

    Parameters
    ----------
    plant : Plant
        Plant.
    given : mapping
        ``[model.uncertain]`` of the case.
    channels : sequence of str
        Names of the compared channels.
    driven : sequence of int
        Driven actuators.

    Returns
    -------
    list of Uncertain
        Parameters.
    """
    return [*uncertain_parameters(plant, given, channels, driven), *geometry_parameters(plant, given)]


def read_trajectory_signals(case: Case) -> tuple[Signals, ...]:
    """Return a case's fit recordings as signals, without their motion."""
    recorded = read_runs(case, ("fit",))
    stepper = Stepper(case.plant, recorded.channels, recorded.load_ports)
    return _signals(_trajectories(case, recorded, stepper, _interference(recorded)))


def prepare_trajectory(case: Case) -> tuple[Problem, Trajectories]:
    """Prepare a case's fit recordings for the trajectory-linearised search.

    Parameters
    ----------
    case : Case
        Case.

    Returns
    -------
    problem : Problem
        Inverse problem.
    trajectories : Trajectories
        Trajectory data.

    Raises
    ------
    BadCase
        No recording, or different channels.
    """
    recorded = read_runs(case, ("fit",))
    plant, channels, names = case.plant, recorded.channels, recorded.names
    load_ports, driven = recorded.load_ports, recorded.driven
    stepper, interferences = Stepper(plant, channels, load_ports), _interference(recorded)
    trajectories = _trajectories(case, recorded, stepper, interferences)
    at_rest = plant.new_data().qpos.copy()
    still = np.zeros(stepper.nv)
    stepper.find_substeps([(at_rest, still, c.u[0], c.load[0], float(np.max(c.h))) for c in trajectories])
    motions = side_by_side(lambda trajectory: first_motion(trajectory, stepper, at_rest), trajectories)
    substeps = stepper.find_substeps(
        [
            (m.q[k], m.v[k], c.u[k], c.load[k], float(c.h[k]))
            for c, m in zip(trajectories, motions, strict=True)
            for k in range(0, len(c), max(1, len(c) // STEP_JACOBIAN.compared))
        ]
    )
    parameters = tuple(trajectory_parameters(plant, case.table.model.uncertain, names, driven))
    reduced_model = _reduced_model(plant, len(channels), Bench(plant).rest_values(channels), parameters, load_ports)
    problem = Problem(
        case=case,
        plant=plant,
        reduced_model=reduced_model,
        parameters=parameters,
        channels=channels,
        names=names,
        runs=recorded.runs,
        orders=recorded.orders,
        about=np.zeros(len(channels)),  # gains act on the whole motion, far from rest
        signals=_signals(trajectories),
        places=tuple(places_of(plant, reduced_model, names, driven, _free_motion(plant), is_near_rest=False)),
        interferences=interferences,
        highest_hz=recorded.highest_hz,
    )
    problem = replace(problem, port_laws=port_terms(case, problem.places))
    return problem, Trajectories(
        trajectories=tuple(trajectories),
        motions=tuple(motions),
        load_ports=load_ports,
        driven=driven,
        substeps=substeps,
    )


def _free_motion(plant: Plant) -> Array:
    """Return the directions (nv, k) without restoring force.

    Without an equilibrium these are the coordinates of joints without a spring.
    """
    try:
        omega, shapes = plant.linearise().eigen
    except BadStructure:
        stiff = [plant.own_stiffness(name) for name in plant.ports]
        held = plant.port_rows([name for name, k in zip(plant.ports, stiff, strict=True) if k > 0])
        return np.eye(plant.model.nv)[:, ~np.any(held.reshape(-1, plant.model.nv), axis=0)]
    return np.asarray(shapes[:, np.abs(omega) < LOCATIONS.free])


def _interference(recorded: RecordedRuns) -> tuple[MainsInterference, ...]:
    return find_mains_interference([run for run in recorded.runs if run.measured.is_uniform])


def _trajectories(
    case: Case, recorded: RecordedRuns, stepper: Stepper, interferences: Sequence[MainsInterference]
) -> list[TrajectoryData]:
    """Return the runs at their samples, without mains interference."""
    plant, rest = case.plant, Bench(case.plant).rest_values(recorded.channels)
    longest = max(len(run.measured) for run in recorded.runs)  # laws have one sample period
    return [
        read_trajectory_data(
            remove_mains_interference(run, interferences),
            stepper,
            rest,
            len(plant.actuators),
            recorded.load_ports,
            thinning(longest, run.measured.sample_period, recorded.highest_hz, TRAJECTORY_DATA.most_samples),
            recorded_commands(plant, run),
        )
        for run in recorded.runs
    ]


def _signals(trajectories: Sequence[TrajectoryData]) -> tuple[Signals, ...]:
    """Return trajectory data as signals, whose deviations start at zero."""
    h = float(np.median([np.median(c.h) for c in trajectories]))
    return tuple(
        Signals(
            name=trajectory.name,
            role=trajectory.role,
            h=h,
            u=trajectory.u,
            load=trajectory.load,
            y=trajectory.y,
            noise=trajectory.noise,
            scale=trajectory.scale,
            at_rest=trajectory.at_rest,
            t0=float(trajectory.time[0]),
            end=float(trajectory.time[-1]),
            valid=trajectory.valid,
        )
        for trajectory in trajectories
    )


def _reduced_model(
    plant: Plant, p: int, rest: np.ndarray, parameters: Sequence[Uncertain], load_ports: Sequence[str]
) -> ReducedModel:
    """Return a placeholder model in the plant's coordinates."""
    nv = plant.model.nv
    zero = np.zeros((p, nv))
    return ReducedModel(
        omega=np.zeros(nv),
        shapes=np.eye(nv),
        M=np.eye(nv),
        C=np.zeros((nv, nv)),
        K=np.zeros((nv, nv)),
        forces=plant.actuator_forces(),
        loads=plant.port_rows(load_ports).T if load_ports else np.zeros((nv, 0)),
        rows=ChannelRows(at_q=zero, at_v=zero, at_a=zero, rest=rest),
        changes=changes_of(parameters),
    )
