"""Inverse problem of the search in frequency."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from vlab.cases.case import Case
from vlab.cases.channel_map import Run
from vlab.diagnose.data.responses import Measured, Modes, Response, read_measured, thinned
from vlab.diagnose.model_kinds.model_kind import ModelKind
from vlab.diagnose.parameters.locations import Place, places_of
from vlab.diagnose.parameters.mjcf import Uncertain, changes_of, gain_sd
from vlab.diagnose.parameters.reduced_model import ReducedModel
from vlab.diagnose.predictors.frequency import State
from vlab.diagnose.predictors.frequency_model import View, Wires, view_of, wires_of
from vlab.diagnose.problem import model_kind_of
from vlab.errors import BadCase
from vlab.plants.base import Plant
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class FrequencyProblem:
    """Inverse problem of a case of frequency data.

    Parameters
    ----------
    case : Case
        Case.
    plant : Plant
        Nominal plant.
    measured, held_out : tuple of Response or Modes
        Data to fit and hold-out data.
    wires : Wires
        Inputs and outputs of all responses, hold-out data included.
    view : View
        Linearised plant.
    reduced_model : ReducedModel
        Reduced modal model.
    parameters : tuple of Uncertain
        Uncertain parameters; an `actuator` beyond the plant's is a force measured at a port.
    places : tuple of Place
        Locations.
    """

    case: Case
    plant: Plant
    measured: tuple[Measured, ...]
    held_out: tuple[Measured, ...]
    wires: Wires
    view: View
    reduced_model: ReducedModel
    parameters: tuple[Uncertain, ...]
    places: tuple[Place, ...]

    @cached_property
    def model_kind(self) -> ModelKind:
        """Kind of the nominal model."""
        return model_kind_of(self.case)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return self.wires.names

    @property
    def runs(self) -> tuple[Run, ...]:
        """Recordings in time: none."""
        return ()

    @property
    def excited(self) -> tuple[int | None, ...]:
        """Actuators with recorded inputs; None for a force at a port."""
        return self.wires.actuators

    @property
    def prior(self) -> Array:
        """Prior standard deviations (n_parameters,) of the uncertain parameters."""
        return np.array([p.sd for p in self.parameters])

    @property
    def gains(self) -> list[tuple[int | None, int | None]]:
        """Input column or output whose gain each parameter is."""
        return [(p.actuator, p.sensor) for p in self.parameters]

    @property
    def unfitted(self) -> dict[str, float]:
        """Prior standard deviations of unfitted input gains."""
        known = {d.input for d in self.measured if isinstance(d, Response)}
        given = self.case.table.model.uncertain
        return {
            d.input: gain_sd(given, d.input.removeprefix("actuator:"))
            for d in self.held_out
            if isinstance(d, Response) and d.input not in known
        }

    @property
    def measured_hz(self) -> tuple[float, float]:
        """Lowest and highest measured frequency [Hz]."""
        return band(self.measured)

    def adjusted(self, theta: Array) -> Plant:
        """Return the plant at given log factors.

        Parameters
        ----------
        theta : (n_parameters,) array
            Log factors.

        Returns
        -------
        Plant
            Adjusted plant.
        """
        own = [
            (p, v)
            for p, v in zip(self.parameters, theta, strict=True)
            if p.actuator is None or p.actuator < len(self.plant.actuators)
        ]
        parameters, values = [p for p, _ in own], np.array([v for _, v in own])
        return self.model_kind.adjusted(self.plant, parameters, values)

    def state(self, theta: Array) -> State:
        """Return the matrices with derivatives at given log factors."""
        M, C, K, inputs, outputs = self.reduced_model.matrices(theta[None])
        changes = tuple(self.reduced_model.slopes(theta))
        return State(M=M[0], C=C[0], K=K[0], changes=changes, input_gain=inputs[0], output_gain=outputs[0])


def band(measured: Sequence[Measured]) -> tuple[float, float]:
    """Return the lowest and highest frequency of data [Hz]."""
    return min(float(d.freq[0]) for d in measured), max(float(d.freq[-1]) for d in measured)


def prepare_frequency(case: Case) -> FrequencyProblem:
    """Prepare a case's frequency responses and modal tables.

    Parameters
    ----------
    case : Case
        Case.

    Returns
    -------
    FrequencyProblem
        Inverse problem.

    Raises
    ------
    BadCase
        Nothing to fit, or a contradiction between data and model.
    BadRecording
        A file is damaged or contradicts the case.
    """
    measured = read_measured(case, ("fit",))
    if not measured:
        raise BadCase(f"{case.path}: no [[frf]] and no [[modal]] has the role fit; mark at least one")
    held_out = read_measured(case, ("holdout",))
    for held in (d for d in held_out if isinstance(d, Response)):
        same = next((m for m in measured if isinstance(m, Response) and _is_copy(m, held)), None)
        if same is not None:
            raise BadCase(
                f"{case.path}: {held.name} is held out and holds the very lines of {same.name}, which is fitted: it verifies "
                "nothing; hold out another measurement"
            )
    plant = case.plant
    wires = wires_of(case, [*measured, *held_out])
    view = view_of(plant, wires)
    for data in (*measured, *held_out):
        if isinstance(data, Modes) and data.n > int(np.sum(view.omega > 0)):
            raise BadCase(f"{case.path}: {data.name} lists {data.n} modes, the model has {int(np.sum(view.omega > 0))}")
    parameters, reduced_model = _uncertain(case, plant, wires, view, measured)
    driven = sorted({a for a in wires.actuators if a is not None})
    places = places_of(
        plant, replace(reduced_model, forces=reduced_model.forces[:, : len(plant.actuators)]), wires.names, driven
    )
    return FrequencyProblem(
        case=case,
        plant=plant,
        measured=tuple(thinned(measured)),
        held_out=tuple(held_out),
        wires=wires,
        view=view,
        reduced_model=reduced_model,
        parameters=parameters,
        places=tuple(places),
    )


def _uncertain(
    case: Case, plant: Plant, wires: Wires, view: View, measured: Sequence[Measured]
) -> tuple[tuple[Uncertain, ...], ReducedModel]:
    given, model_kind = case.table.model.uncertain, model_kind_of(case)
    responses = [d for d in measured if isinstance(d, Response)]
    inputs = {r.input for r in responses}
    driven = sorted(
        {a for name, a in zip(wires.inputs, wires.actuators, strict=True) if a is not None and name in inputs}
    )
    measures_damping = responses or any(np.isfinite(d.zeta).any() for d in measured if isinstance(d, Modes))
    listed = model_kind.parameters_of_responses(plant, given, wires.names, driven)
    parameters = [p for p in listed if measures_damping or p.kind != "damping"]
    parts = model_kind.parts_of_responses(plant, parameters, view.omega, view.shapes)
    damping = model_kind.damping_of_responses(plant, parameters, view.shapes, view.M, view.K)
    for name, actuator, column in zip(wires.inputs, wires.actuators, view.columns, strict=True):
        if actuator is None and name in inputs:
            parameters.append(Uncertain(name=f"gain:{name}", kind="gain", sd=gain_sd(given, name), actuator=column))
    reduced_model = ReducedModel(
        omega=view.omega,
        shapes=view.shapes,
        M=view.M,
        C=view.C,
        K=view.K,
        forces=view.forces,
        loads=np.zeros((view.m, 0)),
        rows=view.rows,
        changes=changes_of(parameters),
        parts=parts,
        damping=damping,
    )
    return tuple(parameters), reduced_model


def _is_copy(one: Response, other: Response) -> bool:
    return np.array_equal(one.freq, other.freq) and np.array_equal(one.H, other.H)
