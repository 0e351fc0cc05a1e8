"""FE modes in a plant with a coarser mesh.

A coarse mesh has nearly the same modes. Close modes rotate into each other, frequencies are off by one part in a
thousand, and deflections at coils and sensors by some per cent. An added stiffness corrects rotation and frequencies. A
corrected reading of each place gives the FE model's deflection in its modes, and the mesh's own in every further mode.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, TypeVar

import mujoco
import numpy as np

from vlab.errors import BadStructure
from vlab.fe import build_fe_model
from vlab.fe.assembly import silent_modes
from vlab.fe.damping import SilentModes, driven_modes, measured_modes
from vlab.fe.model import FeModel
from vlab.fe.second_order import SecondOrderModel
from vlab.plants.base import ActuatorTap, Plant, Port, SensorTap, named_sensors
from vlab.plants.element_ports import constant_port
from vlab.plants.tendon_points import fe_element_ports
from vlab.signals import Array
from vlab.structure.discretisation import Tuning
from vlab.structure.model import Structure

CLOSE = 1.15
"""CLOSE [1]: frequency ratio below which a coarse mesh may rotate two modes into each other."""
JOINED = 8
"""JOINED [1]: joints per tendon in a linear combination of coordinates. MuJoCo merges a tendon's joints one by one,
in a time quadratic in their number. For a grid with 118 to 158 joints, single tendons took five sixths of a step."""
RATE = ":rate"
"""Suffix of a rate sensor's name."""
P = TypeVar("P", bound=Plant)
"""Type of a plant."""


def measured_modes_of(plant: Plant, structure: Structure, variant: str, omega: Array, shapes: Array) -> Array:
    """Return the indices of a plant's modes that a test of the structure measures.

    Parameters
    ----------
    plant : Plant
        Plant with its ports.
    structure : Structure
        Structure of the plant.
    variant : str
        Name of the structure's variant.
    omega, shapes : (n_modes,), (nv, n_modes) array
        Natural frequencies [rad/s] and mode shapes.

    Returns
    -------
    (n,) array of int
        Modes in order of frequency.
    """
    at_coils = plant.port_rows(structure.coil_places) @ shapes
    if not structure.span:
        return driven_modes(at_coils)
    points, silent = _silent_at_ports(plant, structure, variant)
    return measured_modes(at_coils, omega, plant.port_rows(points) @ shapes, silent)


def _silent_at_ports(
    plant: Plant, structure: Structure, variant: str, even: FeModel | None = None
) -> tuple[list[str], SilentModes]:
    """Return the points that are ports of a plant, and the silent modes there."""
    silent = silent_modes(structure, variant, even)
    is_port = [point.name in plant.ports for point in structure.point]
    return plant.points_of(structure), SilentModes(silent.omega, silent.at_points[is_port])


@dataclass(frozen=True, kw_only=True, eq=False)
class FeModes:
    """First coil-driven FE modes in a plant's coordinates.

    Parameters
    ----------
    structure : Structure
    fe : FeModel
        FE model of the untuned structure.
    fe_shapes : (n, count) array
        Mass-normalised shapes per FE coordinate.
    shapes, momenta : (nv, count) array
        Shapes per coordinate of the plant, and the plant's mass matrix times the shapes.
    stiffness : (nv, nv) array
        Added stiffness for the FE model's frequencies and mode rotation.
    """

    structure: Structure
    fe: FeModel
    fe_shapes: Array
    shapes: Array
    momenta: Array
    stiffness: Array

    @classmethod
    def of(cls, plant: Plant, linear: SecondOrderModel, structure: Structure, variant: str) -> "FeModes":
        """Return the FE modes of a structure's tuning.

        Among close modes a rotation Q takes the plant's shapes at points and plates nearest to the FE model's. Q solves
        the orthogonal Procrustes problem [1]_. Among the plant's own modes the stiffness becomes Q diag(omega_fe^2) Q^T
        in place of its own.

        Parameters
        ----------
        plant : Plant
            Plant with its ports and transducers.
        linear : SecondOrderModel
            Linear model.
        structure : Structure
            Structure with its points, bars and transducers.
        variant : str
            Name of the structure's variant.

        Returns
        -------
        FeModes
            Modes and added stiffness.

        Raises
        ------
        BadStructure
            Too few coil-driven modes, or a frequency too high for the step.

        References
        ----------
        .. [1] P. H. Schoenemann, A generalized solution of the orthogonal Procrustes problem, Psychometrika 31 (1966)
               1-10.
        """
        assert structure.tuning is not None
        fe = build_fe_model(replace(structure, tuning=None), variant)
        count = structure.tuning.of_fe
        named = [*(point.name for point in structure.point), *(plate.name for plate in structure.plate)]
        places = [name for name in named if name in plant.ports and np.any(fe.deflection(name))]
        points, silent = _silent_at_ports(plant, structure, variant, None if structure.span else fe)
        sets = []
        for model, deflections, at_coils in (
            (linear, plant.port_rows, plant.port_rows(structure.coil_places)),
            (fe.linear, fe.deflections, fe.coils.T),
        ):
            omega, shapes = model.eigen
            at_points = deflections(points) @ shapes
            driven = measured_modes(at_coils @ shapes, omega, at_points, silent)[:count]
            if len(driven) < count:
                raise BadStructure(f"tuning.of_fe = {count}: there are {len(driven)} modes that the coils drive")
            if silent.omega.size:  # a deviation would couple these to driven modes
                driven = np.union1d(driven, silent.among(omega, at_points))
            sets.append((omega[driven], shapes[:, driven], deflections(places) @ shapes[:, driven]))
        (own, shapes, here), (omega, fe_shapes, there) = sets
        alike = there / np.sum(there**2, axis=1, keepdims=True)  # equal weight for every place, whatever its deflection
        turned = np.zeros((len(omega), len(omega)))
        for group in _close(omega):
            left, _, right = np.linalg.svd(here[:, group].T @ alike[:, group])
            turned[group, group] = left @ right
        wanted = _shown_in_steps(omega, structure.tuning.at_step)
        rows = linear.M @ shapes
        return cls(
            structure=structure,
            fe=fe,
            fe_shapes=fe_shapes,
            shapes=shapes @ turned,
            momenta=rows @ turned,
            stiffness=np.asarray(rows @ (turned * wanted**2 @ turned.T - np.diag(own**2)) @ rows.T),
        )

    def lacking(self, row: Array, fe_row: Array) -> Array:
        """Return the correction of a row to FE deflections, (nv,)."""
        return np.asarray(self.momenta @ (fe_row @ self.fe_shapes - row @ self.shapes))

    def seen_at_places(self, plant: P) -> P:
        """Return a plant with FE deflections at its transducers.

        Ports, coils and sensors then have the FE model's mode shapes.

        Parameters
        ----------
        plant : P
            Plant with its ports and transducers.

        Returns
        -------
        P
            Corrected plant.
        """
        structure = self.structure
        places = plant.points_of(structure)
        at_points = {name: self.fe.deflection(name) for name in places}
        wanted = {name: constant_port(name, row) for name, row in at_points.items()}
        wanted |= fe_element_ports(self.fe, at_points, lambda row: row)
        rest, ports = plant.new_data(), dict(plant.ports)
        for name in ports.keys() & wanted.keys():
            own, fe = (ports[name], *ports[name].more), (wanted[name], *wanted[name].more)
            if len(own) == len(fe):
                lacking = [self.lacking(p.row(rest), q.row(None)) for p, q in zip(own, fe, strict=True)]
                first, *more = (_with(p, d, rest.qpos) for p, d in zip(own, lacking, strict=True))
                ports[name] = replace(first, more=tuple(more))
        tuning = structure.tuning or Tuning()
        named = named_sensors(structure)
        coils_beside = _filled(tuning.coils_beside, len(structure.coil), "coils_beside", "coils")
        beside = _filled(tuning.beside, len(named), "beside", "sensors and probes")
        of_coils = {
            f"coil:{coil.name}": self._lacking_at(plant, coil.at, off)
            for coil, off in zip(structure.coil, coils_beside, strict=True)
        }
        of_sensors = {
            name: self._lacking_at(plant, sensor.at, off) for (name, sensor), off in zip(named, beside, strict=True)
        }
        return _with_transducers(replace(plant, ports=ports), of_coils, of_sensors)

    def _lacking_at(self, plant: Plant, place: str, beside: float = 0.0) -> Array:
        fe_row = self.fe.deflection(place)
        slope = self.fe.slope(place) if beside else None
        if beside and slope is None:
            raise BadStructure(f"tuning: at {place!r} there is no bar for a sensor or coil to stand beside on")
        return self.lacking(plant.port_rows([place])[0], fe_row if slope is None else fe_row + beside * slope)


def _filled(stated: Sequence[float], count: int, key: str, what: str) -> tuple[float, ...]:
    """Return offsets from the points [m], zero where none is stated."""
    if len(stated) > count:
        raise BadStructure(f"tuning.{key} has {len(stated)} entries; there are {count} {what}")
    return (*stated, *(0.0 for _ in range(count - len(stated))))


def _with(port: Port, more: Array, rest: Array) -> Port:
    """Return a port with an additional linear reading.

    The addition is zero at rest.
    """
    row, position, rest = port.row, port.position, rest.copy()
    return replace(
        port,
        row=lambda data: row(data) + more,
        position=lambda data: position(data) + float(more @ (data.qpos - rest)),
    )


def _with_transducers(plant: P, of_coils: Mapping[str, Array], of_sensors: Mapping[str, Array]) -> P:
    """Return a plant with additional rows of coils and sensors.

    Each addition acts through fixed tendons of its own.

    Parameters
    ----------
    of_coils, of_sensors : mapping of str to (nv,) array
        Additional row per joint coordinate, by channel.
    """
    spec = plant.spec.copy()
    joints = [plant.model.joint(k).name for k in range(plant.model.njnt)]
    tendons = {name: _tendons(spec, name, joints, row) for name, row in {**of_coils, **of_sensors}.items()}
    for tendon in (tendon for name in of_coils for tendon in tendons[name]):
        spec.add_actuator(name=tendon, target=tendon, trntype=mujoco.mjtTrn.mjTRN_TENDON)
    kinds = {tap.name: tap.kind for tap in plant.sensors}
    for name in of_sensors:
        own = {"": "TENDONVEL"} if kinds[name] == "velocity" else {"": "TENDONPOS", RATE: "TENDONVEL"}
        for what, kind in own.items():
            for tendon in tendons[name]:
                spec.add_sensor(
                    name=tendon + what,
                    type=getattr(mujoco.mjtSensor, f"mjSENS_{kind}"),
                    objtype=mujoco.mjtObj.mjOBJ_TENDON,
                    objname=tendon,
                )
    model = spec.compile()
    return replace(
        plant,
        spec=spec,
        model=model,
        actuators=tuple(_pushing(tap, model, tendons[tap.name]) for tap in plant.actuators),
        sensors=tuple(_reading(tap, model, tendons[tap.name]) for tap in plant.sensors),
    )


def _tendons(spec: Any, name: str, joints: Sequence[str], row: Array) -> list[str]:
    """Add the correction tendons of a coil or sensor.

    Return their names.
    """
    telling = np.flatnonzero(np.abs(row) > 1e-12 * np.abs(row).max())
    names = []
    for first in range(0, len(telling), JOINED):
        names.append(f"{name}:fe{first // JOINED + 1}")
        tendon = spec.add_tendon(name=names[-1])
        for k in telling[first : first + JOINED]:
            tendon.wrap_joint(joints[k], row[k])
    return names


def _pushing(tap: ActuatorTap, model: Any, tendons: Sequence[str]) -> ActuatorTap:
    return replace(tap, controls=(*tap.controls, *(model.actuator(name).id for name in tendons)))


def _reading(tap: SensorTap, model: Any, tendons: Sequence[str]) -> SensorTap:
    def addresses(what: str) -> tuple[int, ...]:
        return tuple(int(model.sensor(name + what).adr[0]) for name in tendons)

    rates = (*tap.rates, *addresses(RATE)) if tap.rates else ()
    return replace(tap, addresses=(*tap.addresses, *addresses("")), rates=rates)


def _shown_in_steps(omega: Array, step: float) -> Array:
    """Return the frequencies of modes that appear as given in discrete time.

    A semi-implicit step turns x'' = -a^2 x by the angle 2 arcsin(a h/2) [1]_. At step 0 the frequencies are equal.

    Parameters
    ----------
    omega : (n,) array
        Apparent frequencies [rad/s].
    step : float
        Step [s].

    Returns
    -------
    array
        Frequencies a = (2/h) sin(omega h/2) [rad/s].

    Raises
    ------
    BadStructure
        No step of that length shows so high a frequency.

    References
    ----------
    .. [1] E. Hairer, C. Lubich and G. Wanner, Geometric numerical integration illustrated by the Stormer-Verlet method,
           Acta Numerica 12 (2003) 399-450.
    """
    if step == 0.0:
        return omega
    if omega.max() * step >= np.pi:
        raise BadStructure(
            f"tuning.at_step = {step:g} s: {omega.max() / (2 * np.pi):.4g} Hz cannot be seen in such steps"
        )
    return np.asarray(2.0 / step * np.sin(0.5 * omega * step))


def _close(omega: Array) -> list[slice]:
    """Return groups of close ascending frequencies."""
    edges = [0, *(i for i in range(1, len(omega)) if omega[i] > CLOSE * omega[i - 1]), len(omega)]
    return [slice(a, b) for a, b in pairwise(edges)]
