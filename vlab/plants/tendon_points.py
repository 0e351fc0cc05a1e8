"""Points as fixed tendons, for plants in generalised coordinates.

Coils and sensors act on the tendons.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from vlab.fe.model import FeModel
from vlab.plants.base import ActuatorTap, Plant, Port, named_sensors, sensor_taps, set_options, travel_name
from vlab.plants.element_ports import constant_port, element_ports
from vlab.signals import Array
from vlab.structure.model import Structure

CARRIER_MASS = 1e-9
"""CARRIER_MASS [kg]: mass of a body that only carries coordinates. The structure's masses are grams to kilograms."""
LINEAR = "large motion: the coordinates are those of small motion about equilibrium"
"""Note on a plant for small motion."""


def linear_spec(title: str, timestep: float) -> Any:
    """Return an empty spec for small motion.

    The options are semi-implicit Euler without gravity, contacts or constraints.
    """
    spec = mujoco.MjSpec()
    set_options(spec, title)
    spec.option.timestep = timestep
    return spec


def add_carrier(parent: Any, name: str) -> Any:
    """Add a body of negligible mass for coordinates."""
    body = parent.add_body(name=name)
    body.explicitinertial = True
    body.mass, body.ipos, body.inertia = CARRIER_MASS, [0, 0, 0], [CARRIER_MASS] * 3
    return body


def add_points(spec: Any, structure: Structure, rows: Mapping[str, Array], joints: Sequence[str]) -> None:
    """Add tendons at transducer points, with the transducers.

    Parameters
    ----------
    spec : object
        MjSpec of the plant.
    structure : Structure
        Structure with its points, bars and transducers.
    rows : mapping of str to (n_joints,) array
        Deflection of each point per joint coordinate.
    joints : sequence of str
        Names of the joints in row order.
    """
    for place in structure.transducer_places:
        tendon = spec.add_tendon(name=place)
        largest = np.abs(rows[place]).max()
        for name, coefficient in zip(joints, rows[place], strict=True):
            if abs(coefficient) > 1e-14 * largest:
                tendon.wrap_joint(name, coefficient)
    for coil in structure.coil:
        spec.add_actuator(name=f"coil:{coil.name}", target=coil.at, trntype=mujoco.mjtTrn.mjTRN_TENDON)
    for name, sensor in named_sensors(structure):
        if sensor.kind == "velocity":
            _sensor(spec, name, "TENDONVEL", sensor.at)
        else:
            _sensor(spec, name, "TENDONPOS", sensor.at)
            _sensor(spec, f"{name}:rate", "TENDONVEL", sensor.at)
    for sensor in structure.sensor:  # last, so that their values are contiguous
        _sensor(spec, travel_name(sensor), "TENDONPOS", sensor.at)


def _sensor(spec: Any, name: str, kind: str, place: str) -> None:
    kind_code = getattr(mujoco.mjtSensor, f"mjSENS_{kind}")
    spec.add_sensor(name=name, type=kind_code, objtype=mujoco.mjtObj.mjOBJ_TENDON, objname=place)


def point_plant(
    name: str,
    spec: Any,
    structure: Structure,
    rows: Mapping[str, Array],
    *,
    left_out: tuple[str, ...],
    written: Any = None,
    dissipation: Array | None = None,
    restoring: Array | None = None,
    elements: Mapping[str, Port] | None = None,
) -> Plant:
    """Compile a spec with points into a plant.

    Parameters
    ----------
    name : str
        Name of the plant.
    spec : object
        MjSpec of the plant.
    structure : Structure
        Structure with its points, bars and transducers.
    rows : mapping of str to (n_joints,) array
        Deflection of every point of the drawing per joint coordinate.
    left_out : tuple of str
        Properties of the structure that the plant lacks.
    written : mujoco.MjSpec or None
        Spec for export, if more complete than the running model (dampers).
    dissipation, restoring : (nv, nv) array or None
        Matrices of the force -C qvel - K qpos while the plant runs.
    elements : mapping of str to Port, optional
        Ports of elastic elements.

    Returns
    -------
    Plant
        Compiled plant.
    """
    model = spec.compile()

    def address(sensor: str) -> tuple[int, ...]:
        return (int(model.sensor(sensor).adr[0]),)

    return Plant(
        name=name,
        model=model,
        spec=spec if written is None else written,
        dissipation=dissipation,
        restoring=restoring,
        actuators=tuple(
            ActuatorTap(name=f"coil:{c.name}", at=c.name, controls=(model.actuator(f"coil:{c.name}").id,))
            for c in structure.coil
        ),
        sensors=sensor_taps(structure, address),
        travel=slice(model.nsensordata - len(structure.sensor), model.nsensordata),
        ports={point: constant_port(point, row) for point, row in rows.items()} | dict(elements or {}),
        left_out=left_out,
    )


def fe_element_ports(fe: FeModel, rows: Mapping[str, Array], onto: Callable[[Array], Array]) -> dict[str, Port]:
    """Return the ports of an FE model's elastic elements.

    Parameters
    ----------
    fe : FeModel
        FE model.
    rows : mapping of str to (nv,) array
        Deflection of every point per joint coordinate.
    onto : callable
        Row per FE coordinate to row per joint coordinate.

    Returns
    -------
    dict of str to Port
        Ports by name.
    """
    points = dict(rows) | {plate.name: onto(fe.deflection(plate.name)) for plate in fe.structure.plate}

    def slope(point: str, along: tuple[float, float]) -> Array | None:
        row = fe.slope(point, along)
        return None if row is None else onto(row)

    together = np.ones(len(fe.expand))  # the floor moves all deflections and no rotation
    nodes = 3 * len(fe.mesh.nodes)
    together[1:nodes:3] = together[2:nodes:3] = 0.0
    carried = -fe.linear.M @ np.linalg.lstsq(fe.expand, together, rcond=1e-9)[0]
    floor = {"floor": constant_port("floor", onto(carried), tag="floor")}
    return element_ports(fe.structure, fe.variant, points, slope) | floor
