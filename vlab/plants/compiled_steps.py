"""Steps of MuJoCo from compiled code.

numba functions call the C functions `mj_step1` and `mj_step2` of MuJoCo's library by name, without Python between steps.
`mj_step1` and `mj_step2` with the controls set between them do what `mj_step` does, for every integrator but Runge-Kutta.
"""

from pathlib import Path
from typing import Any

import mujoco
from llvmlite import binding
from numba import types

NAMES = ("libmujoco.so*", "libmujoco*.dylib", "mujoco.dll")
"""NAMES [-]: file names of MuJoCo's library on Linux, macOS and Windows, as patterns."""


def _load() -> bool:
    """Make the functions of MuJoCo's loaded library known to compiled code."""
    folder = Path(mujoco.__file__).parent
    for path in (path for pattern in NAMES for path in sorted(folder.glob(pattern))):
        try:
            binding.load_library_permanently(str(path))
        except RuntimeError:
            continue
        return all(binding.address_of_symbol(name) is not None for name in ("mj_step1", "mj_step2"))
    return False


IS_AVAILABLE = _load()
"""IS_AVAILABLE [-]: whether compiled code can call MuJoCo; false where its library lies outside the package. Calling the
functions below without the library ends the process."""
_SIGNATURE = types.void(types.intp, types.intp)
first_half: Any = types.ExternalFunction("mj_step1", _SIGNATURE)
"""First half of a step: kinematics and sensors; arguments are the addresses of model and data."""
second_half: Any = types.ExternalFunction("mj_step2", _SIGNATURE)
"""Second half of a step: forces and integration; arguments as those of `first_half`."""
