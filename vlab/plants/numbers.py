"""Numbers of a compiled model in its spec."""

from typing import Any

import mujoco
import numpy as np


def numbers_into_spec(spec: Any, model: Any) -> None:
    """Give a spec the numbers of a compiled model.

    Inertias that geoms or a total mass determine become the bodies' own. Springs keep their length where positions of the
    model differ from those of the spec.

    Parameters
    ----------
    spec : mujoco.MjSpec
        Spec of the same elements, changed in place.
    model : mujoco.MjModel
        Compiled model with changed numbers.
    """
    if spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE:
        spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO
    spec.compiler.settotalmass = -1.0  # MuJoCo's sign for no total mass
    mean_inertia = spec.stat.meaninertia
    spec.compile()
    spec.copy_back(model)
    spec.stat.meaninertia = mean_inertia  # MuJoCo derives the value, and warns of a stated one
    for tendon in spec.tendons:
        if np.any(np.asarray(tendon.springlength) < 0.0):
            _keep_spring(tendon, model)


def _keep_spring(tendon: Any, model: Any) -> None:
    """State the length of a spatial tendon's spring."""
    first = int(model.tendon_adr[tendon.id])
    if model.wrap_type[first] != mujoco.mjtWrap.mjWRAP_JOINT:
        tendon.springlength = model.tendon_lengthspring[tendon.id]
