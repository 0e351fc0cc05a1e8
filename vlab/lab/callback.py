"""One MuJoCo control callback for many loops.

`mjcb_control` is a single pointer of the whole process. The dispatcher here is installed once while any loop runs and
hands each call to the loop that owns the `MjData` it is called for, so experiments in threads side by side share nothing.
"""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import mujoco

from vlab.errors import BadExperiment

_loops: dict[int, Callable[[Any, Any], None]] = {}
_lock = threading.Lock()


def _dispatch(model: Any, data: Any) -> None:
    loop = _loops.get(id(data))  # MuJoCo hands over the one wrapper that owns the data
    if loop is not None:
        loop(model, data)


@contextmanager
def control_callback(data: Any, loop: Callable[[Any, Any], None]) -> Iterator[None]:
    """Let `loop(model, data)` be MuJoCo's control callback for this `MjData` while the context lasts.

    Raises
    ------
    BadExperiment
        Somebody else's callback is installed, or the data already has a loop.
    """
    key = id(data)
    with _lock:
        present = mujoco.get_mjcb_control()
        if present is not None and present is not _dispatch:
            raise BadExperiment("another mjcb_control is installed; remove it with mujoco.set_mjcb_control(None) first")
        if key in _loops:
            raise BadExperiment("this MjData already runs in a loop")
        _loops[key] = loop
        if present is None:
            mujoco.set_mjcb_control(_dispatch)
    try:
        yield
    finally:
        with _lock:
            del _loops[key]
            if not _loops:
                mujoco.set_mjcb_control(None)
