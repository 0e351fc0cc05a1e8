"""Contacts of a model and of its states."""

import ctypes
from typing import Any

import mujoco
import numpy as np

from vlab.signals import Array

PER_PAIR = 50
"""PER_PAIR [1]: largest number of contacts between two geoms, `mjMAXCONPAIR` of MuJoCo."""
TOGETHER = 16
"""TOGETHER [1]: pairs of geoms that may meet within one step. More pairs than that need more memory than is set aside,
and MuJoCo then ends the process in compiled code."""
ROWS = 10
"""ROWS [1]: largest number of constraint rows of a contact: the edges of a pyramidal friction cone in six dimensions."""
BYTES_A_ROW = 512
"""BYTES_A_ROW [bytes]: bound of the memory of a constraint row besides its Jacobian, with its share of the contact."""
_TIMER = ctypes.sizeof(ctypes.c_double) + ctypes.alignment(ctypes.c_double)
_WARNING = 2 * ctypes.sizeof(ctypes.c_int)


def pairs_that_can_touch(model: Any) -> int:
    """Return the number of pairs of geoms that can touch.

    Parameters
    ----------
    model : MjModel
        Compiled model.

    Returns
    -------
    int
        Pairs by the filters of MuJoCo, explicit pairs included.
    """
    if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT:
        return 0
    body = model.body_weldid[model.geom_bodyid]
    parent = model.body_weldid[model.body_parentid[body]]
    meets = (model.geom_contype[:, None] & model.geom_conaffinity) != 0
    meets |= meets.T
    meets &= body[:, None] != body
    if not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_FILTERPARENT:  # neighbours do not touch
        meets &= ~((body[:, None] != 0) & (body != 0) & ((body[:, None] == parent) | (parent[:, None] == body)))
    return int(np.count_nonzero(np.triu(meets, 1))) + int(model.npair)


def first_contacts_fit(model: Any) -> bool:
    """Return whether the memory holds the first contacts of a run.

    These contacts arise within one step.

    Compiled code ends a run at the first contact, because the memory of many contacts has no bound that is known before
    the run.

    Parameters
    ----------
    model : MjModel
        Compiled model.

    Returns
    -------
    bool
        True without possible contacts. False for flexible bodies that can touch, and for solvers with a matrix over
        all constraint rows.
    """
    if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT:
        return True
    pairs = pairs_that_can_touch(model)
    if not pairs:
        return not model.nflex
    if not IS_COUNTED or model.nflex or model.opt.solver == mujoco.mjtSolver.mjSOL_PGS:
        return False
    rows = min(pairs, TOGETHER) * PER_PAIR * ROWS
    jacobian = 4 * int(model.nv) * ctypes.sizeof(ctypes.c_double)
    return bool(2 * rows * (BYTES_A_ROW + jacobian) <= model.narena)


def _place(data: Any) -> int:
    """Return the address of the number of contacts.

    The public arrays before it end at a known distance.
    """
    before = data.solver_fwdinv
    end = int(before.ctypes.data) + before.nbytes
    return end + int(mujoco.mjtWarning.mjNWARNING) * _WARNING + int(mujoco.mjtTimer.mjNTIMER) * _TIMER


def contact_count(data: Any) -> Array:
    """Return the number of contacts of a state.

    Parameters
    ----------
    data : MjData
        State; must outlive the array.

    Returns
    -------
    (1,) array of int32
        Number of contacts, in the memory of the state; always 0 where the installed MuJoCo keeps the number elsewhere.
    """
    if not IS_COUNTED:
        return np.zeros(1, dtype=np.int32)
    return _shared(data)


def _shared(data: Any) -> Array:
    return np.ctypeslib.as_array((ctypes.c_int32 * 1).from_address(_place(data)))


def _is_right() -> bool:
    """Return whether `contact_count` reads what MuJoCo says."""
    ball = '<body pos="{} 0 0"><freejoint/><geom size=".1"/></body>'
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody>{''.join(ball.format(0.15 * i) for i in range(4))}</worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    for apart in (0, 1, 2, 3):
        data.qpos[7 * apart + 2] = 1.0 + apart
        mujoco.mj_fwdPosition(model, data)
        if int(_shared(data)[0]) != data.ncon:
            return False
    return True


IS_COUNTED = _is_right()
"""IS_COUNTED [-]: whether compiled code can read the number of contacts of the installed MuJoCo."""
