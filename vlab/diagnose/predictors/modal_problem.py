"""Inverse problem of the linear time-invariant model class."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from vlab.cases.case import Case
from vlab.diagnose.data.mains_interference import find_mains_interference, remove_mains_interference
from vlab.diagnose.data.runs import Feedthrough, signals_of, thinning
from vlab.diagnose.parameters.effort_channels import EffortChange, EffortChannels
from vlab.diagnose.parameters.locations import Place, places_of
from vlab.diagnose.parameters.mjcf import Uncertain, adjusted, changes_of, stiffness_of
from vlab.diagnose.parameters.mode_selection import KeptModes, as_stepped, kept_modes
from vlab.diagnose.parameters.observation import channel_rows, command_feedthrough
from vlab.diagnose.parameters.recorded_runs import RecordedRuns, limited, read_runs, recorded_commands
from vlab.diagnose.parameters.reduced_model import Part, ReducedModel, TruncatedModes
from vlab.diagnose.problem import Problem, model_kind_of
from vlab.diagnose.settings import LOCATIONS, MODE_SELECTION, REDUCED_MODEL
from vlab.errors import BadCase
from vlab.plants.base import Plant
from vlab.plants.effort_sensors import effort_rows
from vlab.signals import Array, sample_period


def prepare(case: Case, roles: Sequence[str] = ("fit",)) -> Problem:
    """Prepare a case's recordings for the linear time-invariant search.

    Parameters
    ----------
    case : Case
        Case.
    roles : sequence of str
        Roles of the recordings.

    Returns
    -------
    Problem
        Inverse problem.

    Raises
    ------
    BadCase
        No recording, different channels, or no observable mode.
    """
    recorded, plant = read_runs(case, roles), case.plant
    rows = channel_rows(plant, recorded.channels)
    rate = min(1 / run.measured.sample_period for run in recorded.runs)
    modes = kept_modes(plant.linearise(), rows, recorded.highest_hz, rate)
    if not modes.kept.any():
        raise BadCase(
            f"{case.path}: the recorded channels see no mode of the model below {MODE_SELECTION.seen * rate:.3g} Hz"
        )
    model_kind = model_kind_of(case)
    modes = model_kind.with_coupled_modes(plant, modes)
    uncertainty = model_kind.uncertainty_about_rest(case, recorded, modes)
    parameters = uncertainty.parameters
    pushes = np.hstack([plant.actuator_forces(), plant.port_rows(recorded.load_ports).T.reshape(plant.model.nv, -1)])
    reduced_model = _reduced_model(case, recorded, modes, pushes, parameters, uncertainty.parts)
    damping = model_kind.damping_about_rest(plant, modes, reduced_model, parameters)
    reduced_model = replace(
        reduced_model,
        shifts=uncertainty.shifts,
        coil_shifts=uncertainty.coil_shifts,
        damping=damping,
        efforts=_effort_channels(plant, recorded, parameters, reduced_model.shapes),
    )
    feedthrough = _feedthrough(case, recorded, modes, pushes, reduced_model)
    interferences, found = (
        find_mains_interference(recorded.runs),
        places_of(plant, reduced_model, recorded.names, recorded.driven),
    )
    signals = tuple(
        signals_of(
            limited(plant, remove_mains_interference(run, interferences)),
            plant,
            recorded.channels,
            rows.rest,
            recorded.load_ports,
            orders=recorded.orders,
            commands=recorded_commands(plant, run),
            highest_hz=recorded.highest_hz,
            feedthrough=feedthrough,
        )
        for run in recorded.runs
    )
    return Problem(
        case=case,
        plant=plant,
        reduced_model=reduced_model,
        parameters=parameters,
        channels=recorded.channels,
        names=recorded.names,
        runs=recorded.runs,
        orders=recorded.orders,
        about=np.where([c.from_rest for c in recorded.channels], 0.0, rows.rest),
        signals=signals,
        places=tuple(_with_factors(plant, place, parameters) for place in found),
        interferences=interferences,
        highest_hz=recorded.highest_hz,
    )


def _reduced_model(
    case: Case,
    recorded: RecordedRuns,
    modes: KeptModes,
    pushes: Array,
    parameters: Sequence[Uncertain],
    parts: tuple[Part, ...],
) -> ReducedModel:
    """Return the reduced model for generalised forces (nv, n)."""
    plant, basis, linear = case.plant, modes.basis, modes.linear
    mass, damping, stiffness = as_stepped(plant, linear, basis, recorded.step(plant))
    count = len(plant.actuators)
    M, rows = basis.T @ linear.M @ basis + mass, modes.rows.onto(basis)
    return ReducedModel(
        omega=modes.omega[modes.kept],
        shapes=basis,
        M=M,
        C=basis.T @ linear.C @ basis + damping,
        K=basis.T @ linear.K @ basis + stiffness,
        forces=basis.T @ pushes[:, :count],
        loads=basis.T @ pushes[:, count:],
        rows=replace(rows, at_a=rows.at_a @ M),  # MuJoCo's accelerations are those of its own mass matrix
        changes=changes_of(parameters),
        parts=parts,
        outside=_truncated(modes, pushes[:, :count], pushes[:, count:]),
    )


def _truncated(modes: KeptModes, forces: Array, loads: Array) -> TruncatedModes:
    """Return the elastic modes outside, for generalised forces (nv, n)."""
    outside = ~modes.kept & (modes.omega > LOCATIONS.free)
    shapes = modes.shapes[:, outside]
    return TruncatedModes(
        omega=modes.omega[outside],
        shapes=shapes,
        C=shapes.T @ modes.linear.C @ shapes,
        rows=modes.rows.onto(shapes),
        forces=shapes.T @ forces,
        loads=shapes.T @ loads,
    )


def _with_factors(plant: Plant, place: Place, parameters: Sequence[Uncertain]) -> Place:
    """Return a location with its element's stiffness parameters.

    A relative loss of stiffness refers to the adjusted stiffness.
    """
    if not place.stiffness > 0.0:
        return place
    own = set(stiffness_of(plant.model, (place.name, *place.aliases)))
    return replace(place, stiffened_by=tuple(i for i, p in enumerate(parameters) if own & set(p.fields)))


def _feedthrough(
    case: Case, recorded: RecordedRuns, modes: KeptModes, pushes: Array, reduced_model: ReducedModel
) -> Feedthrough:
    into = np.linalg.solve(reduced_model.M, np.hstack([reduced_model.forces, reduced_model.loads]))
    still, moving = modes.compliance(pushes)
    still[:, : len(case.plant.actuators)] += command_feedthrough(case.plant, recorded.channels)
    return Feedthrough(direct=reduced_model.rows.at_a @ into, still=still, moving=moving)


def _effort_channels(
    plant: Plant, recorded: RecordedRuns, parameters: Sequence[Uncertain], shapes: Array
) -> EffortChannels | None:
    """Return the channels that read forces of actuators, or None without one."""
    channels = recorded.channels
    rows = effort_rows(plant.model)
    addresses = [() if c.sensor is None else plant.sensors[c.sensor].addresses for c in channels]
    is_effort = np.array([bool(np.any(rows[list(own)])) for own in addresses])
    if not np.any(is_effort):
        return None
    nominal, per_command = channel_rows(plant, channels), command_feedthrough(plant, channels)
    seen = np.zeros(len(plant.actuators))
    for run in recorded.runs:
        time = run.measured.time - run.measured.time[0]
        thin = thinning(len(time), sample_period(time), recorded.highest_hz)
        for drive in (drive for drive in run.drives if drive.actuator is not None):
            # half a recorded sample beside the sample, between the middles of two thinned intervals
            aside = (0.0 if not drive.is_held else 0.5 if drive.is_first else -0.5) / thin
            seen[drive.actuator] = 0.5 + aside
    step, found = REDUCED_MODEL.slope, []
    for i, parameter in enumerate(parameters):
        if parameter.is_of_actuator:
            other = adjusted(plant, [parameter], np.array([np.log1p(step)]))  # readings are proportional to the factor
            moved, driven = channel_rows(other, channels), command_feedthrough(other, channels)
            at_q, at_v, commanded = (
                is_effort[:, None] * change / step
                for change in (moved.at_q - nominal.at_q, moved.at_v - nominal.at_v, driven - per_command)
            )
            found.append(EffortChange(by=i, at_q=at_q @ shapes, at_v=at_v @ shapes, per_command=commanded))
    return EffortChannels(per_command=is_effort[:, None] * per_command, seen=seen, changes=tuple(found))
