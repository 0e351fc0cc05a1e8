"""Linear couplings of joints as stiff fixed tendons.

A ``joint`` equality of MuJoCo ties two joints, as of gripper fingers, by a soft constraint with the residual

    r = q1 - c1 q2 - const.

With the impedance d, and b and k from `solref`, the constraint force f satisfies [1]_

    R f = -(r'' + b r' + k r),   R = A (1 - d) / d,

where A is the sum of the inverse inertias of both joints in the reference configuration. The static stiffness of the
constraint is therefore k / R, with d at a vanishing residual. A fixed tendon over both joints has this stiffness and
damps the residual. The time step bounds the tendon's natural frequency. A tendon has a linearisation, a constraint has
none.

References
----------
.. [1] MuJoCo documentation, Computation, sections "Constraint model" and "Diagonal approximation".
"""

from typing import Any

import mujoco
import numpy as np

LINEAR = 2
"""LINEAR [1]: number of polynomial coefficients of a linear coupling."""
FASTEST = 0.5
"""FASTEST [rad]: largest natural frequency of a coupling per time step; explicit steps are stable below one."""
IMPLICIT = (mujoco.mjtIntegrator.mjINT_IMPLICIT, mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
"""IMPLICIT [-]: integrators that are implicit in velocity."""
DAMPING, DAMPING_IMPLICIT = 1.0, 0.05
"""DAMPING [1]: damping ratio of a coupling.
DAMPING_IMPLICIT [1]: same for implicit integrators. They neglect the derivative of a damper between two branches, which
adds inertia in proportion to the damping."""


def couple_by_tendons(spec: Any) -> list[str]:
    """Replace linear joint equalities of a spec by fixed tendons, in place.

    Inactive equalities, polynomials of higher order and other kinds of equality stay. The tendons have no name, so that
    no place of the model refers to them.

    Parameters
    ----------
    spec : MjSpec
        Model that compiles.

    Returns
    -------
    list of str
        One note, or none.
    """
    found = [
        e for e in spec.equalities if e.active and e.type == mujoco.mjtEq.mjEQ_JOINT and not np.any(e.data[LINEAR:5])
    ]
    if not found:
        return []
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for equality in found:
        _add_tendon(spec, model, data, equality)
    names = ", ".join(e.name or e.name1 for e in found)
    for equality in found:
        spec.delete(equality)
    return [f"coupled joints ({names}): the equality constraint acts as a stiff fixed tendon"]


def _add_tendon(spec: Any, model: Any, data: Any, equality: Any) -> None:
    """Add the tendon of one equality."""
    slope = float(equality.data[1])
    tendon, row = spec.add_tendon(), np.zeros((1, model.nv))
    length, approximate = float(equality.data[0]), 0.0
    for name, factor in [(equality.name1, 1.0)] + ([(equality.name2, -slope)] if equality.name2 else []):
        joint = model.joint(name)
        row[0, joint.dofadr[0]] += factor
        approximate += float(model.dof_invweight0[joint.dofadr[0]])
        length += factor * float(model.qpos0[joint.qposadr[0]])
        tendon.wrap_joint(name, factor)
    solved = np.zeros_like(row)
    mujoco.mj_solveM(model, data, solved, row)
    mass = 1.0 / float(row[0] @ solved[0])
    impedance, stiffness = _impedance(model, equality)
    frequency = np.sqrt(stiffness * impedance / (1.0 - impedance) / (approximate * mass))
    frequency = min(float(frequency), FASTEST / model.opt.timestep)
    tendon.springlength = [length, np.nextafter(length, np.inf)]  # MuJoCo takes two equal values of -1 as not given
    ratio = DAMPING_IMPLICIT if model.opt.integrator in IMPLICIT else DAMPING
    tendon.stiffness[0], tendon.damping[0] = mass * frequency**2, 2.0 * ratio * mass * frequency


def _impedance(model: Any, equality: Any) -> tuple[float, float]:
    """Return impedance [1] and stiffness [1/s^2] of a constraint without a residual."""
    least, most = float(equality.solimp[0]), float(equality.solimp[1])
    first, second = (float(x) for x in equality.solref)
    if first <= 0:  # direct format
        return least, -first * least / most**2
    is_safe = not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_REFSAFE
    time = max(first, 2.0 * model.opt.timestep) if is_safe else first
    return least, least / (most * time * second) ** 2
