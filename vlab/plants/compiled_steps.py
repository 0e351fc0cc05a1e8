"""Steps of MuJoCo from compiled code.

numba functions call the C functions of MuJoCo's library by name, without Python between steps.
`mj_step1` and `mj_step2` with the controls set between them do what `mj_step` does, for every integrator but Runge-Kutta.
"""

from pathlib import Path
from typing import Any

import mujoco
from llvmlite import binding
from numba import types

NAMES = ("libmujoco.so*", "libmujoco*.dylib", "mujoco.dll")
"""NAMES [-]: file names of MuJoCo's library on Linux, macOS and Windows, as patterns."""
ADDRESS, NUMBER = types.intp, types.float64
FUNCTIONS = {
    "mj_step1": (ADDRESS, ADDRESS),
    "mj_step2": (ADDRESS, ADDRESS),
    "mj_forward": (ADDRESS, ADDRESS),
    "mj_forwardSkip": (ADDRESS, ADDRESS, types.int32, types.int32),
    "mj_fwdPosition": (ADDRESS, ADDRESS),
    "mj_fwdVelocity": (ADDRESS, ADDRESS),
    "mj_fwdActuation": (ADDRESS, ADDRESS),
    "mj_fwdAcceleration": (ADDRESS, ADDRESS),
    "mj_fwdConstraint": (ADDRESS, ADDRESS),
    "mj_sensorPos": (ADDRESS, ADDRESS),
    "mj_sensorVel": (ADDRESS, ADDRESS),
    "mj_inverse": (ADDRESS, ADDRESS),
    "mj_solveM": (ADDRESS, ADDRESS, ADDRESS, ADDRESS, types.int32),
    "mj_copyState": (ADDRESS, ADDRESS, ADDRESS, types.int32),
    "mj_integratePos": (ADDRESS, ADDRESS, ADDRESS, NUMBER),
}
"""FUNCTIONS [-]: C functions and their arguments. Model, data and arrays are given by address."""


def _load() -> bool:
    """Make the functions of MuJoCo's loaded library known to compiled code."""
    folder = Path(mujoco.__file__).parent
    for path in (path for pattern in NAMES for path in sorted(folder.glob(pattern))):
        try:
            binding.load_library_permanently(str(path))
        except RuntimeError:
            continue
        return all(binding.address_of_symbol(name) is not None for name in FUNCTIONS)
    return False


IS_AVAILABLE = _load()
"""IS_AVAILABLE [-]: whether compiled code can call MuJoCo; false where its library lies outside the package. Calling the
functions below without the library ends the process."""


def c_function(name: str) -> Any:
    """Return a C function of MuJoCo for compiled code.

    Parameters
    ----------
    name : str
        Name, one of `FUNCTIONS`.

    Returns
    -------
    ExternalFunction
        Function without a result.
    """
    return types.ExternalFunction(name, types.void(*FUNCTIONS[name]))


first_half = c_function("mj_step1")
"""First half of a step: kinematics and sensors."""
second_half = c_function("mj_step2")
"""Second half of a step: forces and integration."""
