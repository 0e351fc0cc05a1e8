"""Positions of a model's elements as edits of its text.

A position of the compiled model counts from the body's frame; one of the text may count from a ``frame`` element. An
edit adds the difference of the compiled positions to the text's own position, so both may have different origins.
"""

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np

from vlab.signals import Array
from vlab.standalone.mjcf_text import Element

POSITIONS: Mapping[str, str] = {"body": "body_pos", "joint": "jnt_pos", "site": "site_pos", "geom": "geom_pos"}
"""Field of the compiled model by kind of element."""
TURNS = ("quat", "axisangle", "euler", "xyaxes", "zaxis")
"""Attributes that turn a frame."""
SAME = 1e-10
"""SAME [1]: relative difference of lengths below which a tendon has not moved; that of written numbers."""


def moved_text(element: Element, by: Array, *, is_placed_by_default: bool = False) -> dict[str, Array] | None:
    """Return the attributes that move an element.

    Parameters
    ----------
    element : Element
        Body, joint, site or geom of the text.
    by : (3,) array
        Change of the position in the frame of the parent body [m].
    is_placed_by_default : bool
        Whether a default states a position for elements of this kind.

    Returns
    -------
    dict of str to array, or None
        New ``pos`` or ``fromto``. None if the text's own position is unknown, or in a turned frame.
    """
    parent = element.parent
    while parent is not None and parent.tag == "frame":
        if parent.attributes.keys() & set(TURNS):
            return None
        parent = parent.parent
    attributes = element.attributes
    name = next((n for n in ("fromto", "pos") if n in attributes), None)
    if name is None:
        return None if is_placed_by_default else {"pos": np.array(by, dtype=float)}
    try:
        own = np.array([float(x) for x in attributes[name].split()])
    except ValueError:
        return None
    size = 6 if name == "fromto" else 3
    if own.size != size:
        return None
    return {name: own + np.tile(by, size // 3)}


def tendon_lengths(nominal: Any, wanted: Any) -> list[int]:
    """Return the tendons whose length at the springs' reference differs.

    Parameters
    ----------
    nominal, wanted : mujoco.MjModel
        Compiled models; `wanted` may have more tendons, at the end.

    Returns
    -------
    list of int
        Numbers of the tendons.
    """
    lengths = []
    for model in (nominal, wanted):
        data = mujoco.MjData(model)
        data.qpos[:] = model.qpos_spring
        mujoco.mj_fwdPosition(model, data)
        lengths.append(data.ten_length[: nominal.ntendon].copy())
    return [int(i) for i in np.flatnonzero(~np.isclose(lengths[0], lengths[1], rtol=SAME, atol=0.0))]
