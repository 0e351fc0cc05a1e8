"""Modal plant: first FE modes as unit-mass slides in MuJoCo.

Physical points are fixed tendons. The plant is exact for the retained modes and fast, for long runs and searches over
many candidates. The frequencies include gravity and tension. The slides share bodies of negligible mass and have their
unit mass as joint armature. MuJoCo's inertia matrix is then diagonal to one part in 1e9, with half as many bodies.
"""

from typing import Any

import mujoco
import numpy as np

from vlab.errors import BadStructure
from vlab.fe.model import FeModel
from vlab.plants.base import Plant
from vlab.plants.tendon_points import LINEAR, add_carrier, add_points, fe_element_ports, linear_spec, point_plant

SLIDES_PER_BODY = 3
"""SLIDES_PER_BODY [1]: slide joints per body. MuJoCo accepts up to six degrees of freedom a body; three orthogonal
slides are uncoupled."""


def build_modal(fe: FeModel, *, modes: int = 12, timestep: float = 5e-4) -> Plant:
    """Build the modal plant of an FE model.

    Parameters
    ----------
    fe : FeModel
        FE model.
    modes : int
        Number of retained modes, from the lowest.
    timestep : float
        Integration step [s].

    Returns
    -------
    Plant
        Plant at equilibrium.

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
    spec = linear_spec(f"{structure.name} modal ({fe.variant})", timestep)
    names = [f"mode:{j + 1}" for j in range(modes)]
    body: Any = None
    for j, name in enumerate(names):
        if j % SLIDES_PER_BODY == 0:
            body = add_carrier(spec.worldbody, f"modes:{j + 1}")
        joint = body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=np.eye(3)[j % SLIDES_PER_BODY])
        joint.armature = 1.0
        joint.stiffness[0] = omega[j] ** 2
        joint.damping[0] = 2 * fe.linear.zeta[j] * omega[j]
    places = dict.fromkeys([p.name for p in structure.point] + structure.transducer_places)
    rows = {place: fe.deflection(place) @ shapes[:, :modes] for place in places}
    add_points(spec, structure, rows, names)
    left_out = (f"modes above the first {modes}", LINEAR)
    elements = fe_element_ports(fe, rows, lambda row: row @ shapes[:, :modes])
    return point_plant("modal", spec, structure, rows, left_out=left_out, elements=elements)
