"""The modal plant: the FE model's first modes as unit-mass slides in MuJoCo, physical points as fixed tendons.

Exact by construction for the modes it keeps, and fast: it serves long runs and searches over many candidates. Gravity
and tension are inside the frequencies. The slides share bodies of negligible mass and take their unit mass as joint
armature, which keeps MuJoCo's inertia matrix diagonal to one part in 1e9 with half as many bodies to move.
"""

from typing import Any

import mujoco
import numpy as np

from vlab.errors import BadStructure
from vlab.fe.model import FeModel
from vlab.plants.base import SENSOR_UNITS, ActuatorTap, Plant, Port, SensorTap, named_sensors
from vlab.signals import Array
from vlab.structure.model import Structure

SLIDES_PER_BODY = 3
"""MuJoCo accepts up to six degrees of freedom a body; three orthogonal slides do not couple at all."""
CARRIER_MASS = 1e-9
"""Mass of a body that carries slides [kg], against a unit mass a slide."""


def build_modal(fe: FeModel, *, modes: int = 12, timestep: float = 5e-4) -> Plant:
    """Build the modal plant of an FE model.

    Parameters
    ----------
    modes : int
        How many modes to keep, from the lowest.
    timestep : float
        Integration step [s].

    Raises
    ------
    BadStructure
        More modes than the FE model has, or a mode too fast for the step.
    """
    structure = fe.structure
    omega, shapes = fe.linear.eigen
    if not 1 <= modes <= fe.linear.n:
        raise BadStructure(f"{modes} modes were asked of an FE model with {fe.linear.n} degrees of freedom")
    if omega[modes - 1] * timestep >= 2.0:
        raise BadStructure(
            f"mode {modes} at {omega[modes - 1] / 2 / np.pi:.4g} Hz needs a step below {2 / omega[modes - 1]:.3g} s, {timestep:g} s was given"
        )
    spec = mujoco.MjSpec()
    spec.modelname = f"{structure.name} modal ({fe.variant})"
    spec.option.timestep = timestep
    spec.option.gravity = [0.0, 0.0, 0.0]
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT) | int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    names = [f"mode:{j + 1}" for j in range(modes)]
    body: Any = None
    for j, name in enumerate(names):
        if j % SLIDES_PER_BODY == 0:
            body = spec.worldbody.add_body(name=f"modes:{j + 1}")
            body.explicitinertial = True
            body.mass, body.ipos, body.inertia = CARRIER_MASS, [0, 0, 0], [CARRIER_MASS] * 3
        joint = body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=np.eye(3)[j % SLIDES_PER_BODY])
        joint.armature = 1.0
        joint.stiffness[0] = omega[j] ** 2
        joint.damping[0] = 2 * fe.linear.zeta[j] * omega[j]
    for place in structure.transducer_places:
        tendon = spec.add_tendon(name=place)
        for name, coefficient in zip(names, fe.deflection(place) @ shapes[:, :modes], strict=True):
            tendon.wrap_joint(name, coefficient)
    _transducers(spec, structure)
    model = spec.compile()
    return Plant(
        name="modal",
        model=model,
        spec=spec,
        actuators=tuple(
            ActuatorTap(name=f"coil:{c.name}", at=c.name, controls=(model.actuator(f"coil:{c.name}").id,))
            for c in structure.coil
        ),
        sensors=tuple(
            SensorTap(
                name=name,
                at=sensor.name,
                kind=sensor.kind,
                unit=SENSOR_UNITS[sensor.kind],
                addresses=(int(model.sensor(name).adr[0]),),
                rates=(int(model.sensor(f"{name}:rate").adr[0]),) if sensor.kind == "displacement" else (),
            )
            for name, sensor in named_sensors(structure)
        ),
        travel=slice(model.nsensordata - len(structure.sensor), model.nsensordata),
        ports={p.name: _port(p.name, fe.deflection(p.name) @ shapes[:, :modes]) for p in structure.point},
        left_out=(
            f"modes above the first {modes}",
            "large motion: the modes are those of small motion about equilibrium",
        ),
    )


def _transducers(spec: Any, structure: Structure) -> None:
    for coil in structure.coil:
        spec.add_actuator(name=f"coil:{coil.name}", target=coil.at, trntype=mujoco.mjtTrn.mjTRN_TENDON)
    for name, sensor in named_sensors(structure):
        kinds = {"velocity": {name: "TENDONVEL"}, "displacement": {name: "TENDONPOS", f"{name}:rate": "TENDONVEL"}}[
            sensor.kind
        ]
        for full, kind in kinds.items():
            spec.add_sensor(
                name=full,
                type=getattr(mujoco.mjtSensor, f"mjSENS_{kind}"),
                objtype=mujoco.mjtObj.mjOBJ_TENDON,
                objname=sensor.at,
            )
    for sensor in structure.sensor:  # last, so that their values stand together
        spec.add_sensor(
            name=f"sensor:{sensor.name}:travel",
            type=mujoco.mjtSensor.mjSENS_TENDONPOS,
            objtype=mujoco.mjtObj.mjOBJ_TENDON,
            objname=sensor.at,
        )


def _port(name: str, row: Array) -> Port:
    return Port(name=name, unit="m", row=lambda data: row.copy(), position=lambda data: float(row @ data.qpos))
