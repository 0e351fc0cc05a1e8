"""Linearised plant of the search in frequency."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from vlab.cases.case import Case
from vlab.cases.channel_map import Compared
from vlab.diagnose.data.responses import Measured, Modes, Response
from vlab.diagnose.parameters.known_effects import at_actuator, at_sensor
from vlab.diagnose.parameters.locations import Place
from vlab.diagnose.parameters.observation import ChannelRows, channel_rows
from vlab.diagnose.parameters.reduced_model import observable
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.settings import FREQUENCY_MODEL
from vlab.errors import BadCase
from vlab.physics.attached import AtActuator, AtPort, AtSensor
from vlab.physics.describing_function import has_describing_function
from vlab.physics.native_laws import native_laws
from vlab.physics.running import tap_index
from vlab.physics.small_signal import is_linear
from vlab.plants.base import Plant
from vlab.signals import ORDER, Array


@dataclass(frozen=True, kw_only=True)
class Wires:
    """Inputs and outputs of a case's frequency data.

    Parameters
    ----------
    outputs : tuple of Compared
        One output per location of the responses.
    orders : tuple of int
        Time derivatives of displacement in every output.
    inputs : tuple of str
        Names of the inputs.
    actuators : tuple of int or None
        Actuator of every input; None for a force at a port.
    at : tuple of str
        Locations of the mode shapes.
    """

    outputs: tuple[Compared, ...] = ()
    orders: tuple[int, ...] = ()
    inputs: tuple[str, ...] = ()
    actuators: tuple[int | None, ...] = ()
    at: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return tuple(c.channel for c in self.outputs)


def wires_of(case: Case, measured: Sequence[Measured]) -> Wires:
    """Map measured data to a plant by name.

    Actuators precede ports as inputs, sensors precede ports as outputs.

    Parameters
    ----------
    case : Case
        Case.
    measured : sequence of Response or Modes
        Data.

    Returns
    -------
    Wires
        Inputs and outputs.
    """
    plant = case.plant
    responses = [d for d in measured if isinstance(d, Response)]
    inputs = list(dict.fromkeys(r.input for r in responses))
    names = list(dict.fromkeys(o for r in responses for o in r.outputs))
    actuators = []
    for name in inputs:
        index = tap_index(plant.actuators, name)
        if index is None and name not in plant.ports:
            raise BadCase(
                f"{case.path}: the input {name!r} is a sensor; a force acts at an actuator or a port of the model"
            )
        actuators.append(index)
    outputs, orders = [], []
    for name in names:
        compared, order = _output(case, plant, name)
        outputs.append(compared)
        orders.append(order)
    tables = [d for d in measured if isinstance(d, Modes)]
    amplitudes = [d.amplitude_at for d in tables if d.amplitude_at]
    at = tuple(dict.fromkeys([*(place for d in tables for place in d.at), *amplitudes]))
    return Wires(outputs=tuple(outputs), orders=tuple(orders), inputs=tuple(inputs), actuators=tuple(actuators), at=at)


def _output(case: Case, plant: Plant, name: str) -> tuple[Compared, int]:
    index = tap_index(plant.sensors, name)
    if index is not None and plant.sensors[index].kind in ORDER:
        return Compared(channel=name, sensor=index), ORDER[plant.sensors[index].kind]
    if name in plant.ports:
        return Compared(channel=name, port=name), 0
    place = plant.actuators[i].at if (i := tap_index(plant.actuators, name)) is not None else ""
    for port in (place, f"joint:{place}", f"tendon:{place}"):
        if port in plant.ports:
            return Compared(channel=name, port=port), 0
    known = [tap.name for tap in plant.sensors if tap.kind in ORDER]
    raise BadCase(
        f"{case.path}: the output {name!r} measures no motion; accepted: {', '.join([*known, *plant.ports][:20])}"
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class View:
    """Plant in modal coordinates.

    Parameters
    ----------
    omega : (m,) array
        Natural frequencies [rad/s].
    shapes : (nv, m) array
        Mass-normalised mode shapes.
    M, C, K : (m, m) array
        Modal matrices.
    forces : (m, n_actuators + n_inputs) array
        Modal force of unit commands, then of unit forces at input ports.
    columns : tuple of int
        Column of every input.
    rows : ChannelRows
        Outputs per modal coordinate.
    orders : tuple of int
        Time derivatives of displacement in every output.
    at : mapping of str to (m,) array
        Rows of the mode shapes' locations.
    fixed : tuple of Term
        Effects of the plant outside its linearisation; nonlinear ones act in data of known level alone.
    left_out : tuple of str
        Notes on nonlinear effects of the plant.
    """

    omega: Array
    shapes: Array
    M: Array
    C: Array
    K: Array
    forces: Array
    columns: tuple[int, ...]
    rows: ChannelRows
    orders: tuple[int, ...]
    at: Mapping[str, Array]
    fixed: tuple[Term, ...] = ()
    left_out: tuple[str, ...] = field(default=())

    @property
    def m(self) -> int:
        """Number of modes."""
        return len(self.omega)


def view_of(plant: Plant, wires: Wires) -> View:
    """Linearise a plant and select its observable modes.

    Outputs, shape locations or otherwise sensors determine observability.

    Parameters
    ----------
    plant : Plant
        Plant.
    wires : Wires
        Inputs and outputs.

    Returns
    -------
    View
        Plant in modal coordinates.

    Raises
    ------
    BadCase
        The model is unstable at rest, or no mode is observable.
    """
    linear = plant.linearise()
    omega, shapes = linear.eigen
    if omega[0] < -FREQUENCY_MODEL.unstable:
        raise BadCase(
            f"the model is unstable at rest: its first mode has a negative stiffness ({omega[0]:.3g} rad/s); "
            "it has no frequency response"
        )
    rows = _output_rows(plant, wires)
    seen = _seeing(plant, wires, rows)
    kept = observable(seen, shapes, np.maximum(omega, 0.0))
    kept &= np.cumsum(kept) <= FREQUENCY_MODEL.most_modes
    if not kept.any():
        raise BadCase("the places that were measured see no mode of the model")
    basis = shapes[:, kept]
    ports = [name for name, actuator in zip(wires.inputs, wires.actuators, strict=True) if actuator is None]
    loads = plant.port_rows(ports) if ports else np.zeros((0, plant.model.nv))
    forces = basis.T @ np.hstack([plant.actuator_forces(), loads.T])
    columns = tuple(
        actuator if actuator is not None else len(plant.actuators) + ports.index(name)
        for name, actuator in zip(wires.inputs, wires.actuators, strict=True)
    )
    at = {name: row @ basis for name, row in _place_rows(plant, wires.at).items()}
    fixed, left_out = _physics(plant, basis, wires)
    return View(
        omega=omega[kept],
        shapes=basis,
        M=basis.T @ linear.M @ basis,
        C=basis.T @ linear.C @ basis,
        K=basis.T @ linear.K @ basis,
        forces=forces,
        columns=columns,
        rows=rows.onto(basis),
        orders=wires.orders,
        at=at,
        fixed=fixed,
        left_out=left_out,
    )


def _output_rows(plant: Plant, wires: Wires) -> ChannelRows:
    """Return the outputs per joint coordinate.

    Displacements omit the half step of velocity that a plant's sensors correct.
    """
    if not wires.outputs:
        none = np.zeros((0, plant.model.nv))
        return ChannelRows(at_q=none, at_v=none, at_a=none, rest=np.zeros(0))
    rows = channel_rows(plant, wires.outputs)
    still = np.array(wires.orders) == 0
    return ChannelRows(
        at_q=rows.at_q,
        at_v=np.where(still[:, None], 0.0, rows.at_v),
        at_a=np.where(still[:, None], 0.0, rows.at_a),
        rest=rows.rest,
    )


def _place_rows(plant: Plant, names: Sequence[str]) -> dict[str, Array]:
    """Return the deflection rows at the locations of mode shapes."""
    out = {}
    for name in names:
        index = tap_index(plant.sensors, name)
        if name in plant.ports:
            out[name] = plant.port_rows([name])[0]
        elif index is not None:
            rows = channel_rows(plant, [Compared(channel=name, sensor=index)])
            out[name] = (
                (rows.at_q + rows.at_v + rows.at_a)[0] if plant.sensors[index].kind != "displacement" else rows.at_q[0]
            )
        else:
            tap = plant.actuators[plant.actuator_index(name)]
            port = next((p for p in (tap.at, f"joint:{tap.at}", f"tendon:{tap.at}") if p in plant.ports), "")
            if not port:
                raise BadCase(f"no displacement of the model is known at {name!r}; name a sensor or a port")
            out[name] = plant.port_rows([port])[0]
    return out


def _seeing(plant: Plant, wires: Wires, rows: ChannelRows) -> ChannelRows:
    """Return the rows that determine observability."""
    at = list(_place_rows(plant, wires.at).values())
    if not at and not wires.outputs:
        places = [tap.at for tap in plant.sensors if tap.at in plant.ports] or list(plant.ports)
        at = list(plant.port_rows(list(dict.fromkeys(places)))) if places else list(np.eye(plant.model.nv))
    extra = np.array(at).reshape(-1, plant.model.nv)
    none = np.zeros_like(extra)
    return ChannelRows(
        at_q=np.vstack([rows.at_q, extra]),
        at_v=np.vstack([rows.at_v, none]),
        at_a=np.vstack([rows.at_a, none]),
        rest=np.concatenate([rows.rest, np.zeros(len(extra))]),
    )


def _physics(plant: Plant, basis: Array, wires: Wires) -> tuple[tuple[Term, ...], tuple[str, ...]]:
    """Return a plant's effects outside its linearisation."""
    fixed, left_out = [], []
    data = plant.new_data()
    for one in plant.physics:
        if isinstance(one, AtPort) and one.effect.is_linear:
            continue  # part of the linearisation
        if not is_linear(one.effect) and not has_describing_function(one.effect):
            left_out.append(f"{one.effect.name} of the model is not linear: its small motion is taken without it")
            continue
        if not is_linear(one.effect):
            left_out.append(f"{one.effect.name} of the model is not linear: it acts in data of known level alone")
        if isinstance(one, AtPort):
            rows = np.array([port.row(data) for port in (one.port, *one.port.more)]) @ basis
            place = Place(name=one.port.name, kind="port", rows=rows, stiffness=one.stiffness)
            fixed.append(Term(effect=one.effect, place=place, values=one.values))
        elif isinstance(one, AtActuator):
            fixed.append(at_actuator(plant, one))
        elif isinstance(one, AtSensor):
            fixed += at_sensor(plant, one, wires.outputs)
    for law in native_laws(plant):
        if has_describing_function(law.effect):
            place = Place(name=law.place, kind="port", rows=plant.port_rows([law.place]) @ basis)
            fixed.append(Term(effect=law.effect, place=place, values=law.values))
    return tuple(fixed), tuple(left_out)
