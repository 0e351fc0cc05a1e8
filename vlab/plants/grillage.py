"""Physical plant of a hanging grid: small rigid bodies joined by struts.

`vlab.plants.grillage_spec` describes bodies and struts. The struts are prestretched so that the drawing is the
equilibrium. The influence of weight on the motion is native in MuJoCo: no geometric stiffness, no boundary factor.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vlab.errors import BadStructure
from vlab.fe.second_order import SecondOrderModel
from vlab.plants.base import ActuatorTap, Plant, Port, sensor_taps, travel_name
from vlab.plants.element_ports import constant_port, element_ports
from vlab.plants.grillage_spec import GrillageBuilder, GrillageOptions, in_plane_mask
from vlab.plants.linearise import linearise
from vlab.plants.mode_by_mode import with_prescribed
from vlab.signals import Array
from vlab.structure.model import Structure

SAMPLE = 5e-4
"""SAMPLE [s]: sample period of the laboratory, a multiple of the step."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Grillage(Plant):
    """Plant of a hanging grid."""

    def linearise(self) -> SecondOrderModel:
        """Return M, C and K about the equilibrium.

        The drawing is a plane of symmetry, so only rounding couples motion in the plane and across. The coupling is
        removed, because close modes would mix.
        """
        return _uncoupled(super().linearise())


def build_grillage(
    structure: Structure, variant: str = "physical", *, options: GrillageOptions | None = None, damped: bool = True
) -> Plant:
    """Build the three-dimensional plant of a hanging grid.

    Parameters
    ----------
    structure : Structure
        Structure with its points, bars and transducers.
    variant : str
        Name checked against the structure's variants. The plant is always the physical one.
    options : GrillageOptions or None
        Resolution and in-plane stiffness.
    damped : bool
        Whether to prescribe the structure's modal damping.

    Returns
    -------
    Plant
        Plant at equilibrium.

    Raises
    ------
    BadStructure
        The structure is no grid of bars under one level carrying bar.
    """
    choice = structure.variant_named(variant)
    builder = GrillageBuilder(structure, options or GrillageOptions())
    spec = builder.build()
    model = spec.compile()
    linear = _uncoupled(linearise(model))
    spec.option.timestep = model.opt.timestep = _timestep(builder.options, 2 / linear.eigen[0][-1])
    ports = {
        p.name: _port(model, p.name, builder.readings[p.name]) for p in structure.point if p.name in builder.readings
    }
    ports |= _element_ports(model, structure, variant, builder, ports)
    calibrated = not choice.in_plane_moments or choice.moment_boundary_factor != 0.5
    first = int(model.sensor(travel_name(structure.sensor[0])).adr[0]) if structure.sensor else model.nsensordata
    plant = Grillage(
        name="composite",
        model=model,
        spec=spec,
        actuators=tuple(
            ActuatorTap(name=f"coil:{c.name}", at=c.name, controls=(i,)) for i, c in enumerate(structure.coil)
        ),
        sensors=sensor_taps(structure, lambda name: (int(model.sensor(name).adr[0]),)),
        ports=ports,
        travel=slice(first, model.nsensordata),
        left_out=(
            "motion of the top beam in the plane",
            "warping of the bars and shear in them",
            *(
                (f"the moment boundary factor that variant {variant!r} calibrates: gravity has 0.5",)
                if calibrated
                else ()
            ),
        ),
    )
    return with_prescribed(plant, structure, variant, damped=damped)


def _uncoupled(linear: SecondOrderModel) -> SecondOrderModel:
    inside = in_plane_mask(linear.coordinates)
    alike = inside[:, None] == inside
    return replace(linear, M=linear.M * alike, C=linear.C * alike, K=linear.K * alike)


def _port(model: Any, name: str, reading: dict[str, float]) -> Port:
    """Return the deflection at a point as a port.

    Every joint has one coordinate, zero in the drawing.
    """
    fixed = np.zeros(model.nv)
    for joint, factor in reading.items():
        fixed[model.joint(joint).dofadr[0]] = factor
    return constant_port(name, fixed)


def _element_ports(
    model: Any, structure: Structure, variant: str, builder: GrillageBuilder, ports: dict[str, Port]
) -> dict[str, Port]:
    points = {name: port.row(None) for name, port in ports.items()}
    for plate in structure.plate:
        points[plate.name] = _port(model, plate.name, builder.readings[plate.name]).row(None)

    def slope(point: str, along: tuple[float, float]) -> Array | None:
        if point not in builder.bodies:
            return None
        turns = {f"{point}:rz": along[0], f"{point}:rx": -along[1]}
        return _port(model, point, {j: c for j, c in turns.items() if j in builder.joints}).row(None)

    return element_ports(structure, variant, points, slope)


def _timestep(options: GrillageOptions, limit: float) -> float:
    """Return the integration step [s]."""
    if options.timestep is None:
        return SAMPLE / int(np.ceil(SAMPLE / (0.8 * limit)))
    if not 0 < options.timestep < limit:
        raise BadStructure(
            f"a step of {options.timestep:g} s is unstable: the limit of this grillage is {limit:.3g} s; leave timestep out, "
            "or lower axial_share and in_plane_share"
        )
    return options.timestep
