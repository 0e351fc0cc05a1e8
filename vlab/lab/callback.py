"""MuJoCo control callback shared by many loops.

`mjcb_control` is a single pointer of the process. The dispatcher is installed while any loop runs. Each call goes to
the loop that owns its `MjData`, so experiments in parallel threads share nothing. MuJoCo reads the pointer twice, once to
test and once to call, so the dispatcher stays while compiled steps run without the interpreter's lock.
"""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import mujoco

from vlab.errors import BadExperiment

_loops: dict[int, Callable[[Any, Any], None]] = {}
_unlocked: set[object] = set()
_lock = threading.Lock()


def _dispatch(model: Any, data: Any) -> None:
    loop = _loops.get(id(data))  # MuJoCo passes the very wrapper that owns the data
    if loop is not None:
        loop(model, data)


def refuse_foreign_callback() -> None:
    """Refuse a control callback that vlab has not installed.

    Raises
    ------
    BadExperiment
        A foreign callback is installed.
    """
    if mujoco.get_mjcb_control() not in (None, _dispatch):
        raise BadExperiment("another mjcb_control is installed; remove it with mujoco.set_mjcb_control(None) first")


def _remove_if_unused() -> None:
    """Remove an unused dispatcher; `_lock` is held."""
    if not _loops and not _unlocked and mujoco.get_mjcb_control() is _dispatch:
        mujoco.set_mjcb_control(None)


@contextmanager
def callback_kept() -> Iterator[None]:
    """Keep the dispatcher during compiled steps without the interpreter's lock.

    Returns
    -------
    context manager
        Context.
    """
    steps = object()
    with _lock:
        _unlocked.add(steps)
    try:
        yield
    finally:
        with _lock:
            _unlocked.remove(steps)
            _remove_if_unused()


@contextmanager
def control_callback(data: Any, loop: Callable[[Any, Any], None]) -> Iterator[None]:
    """Install a loop as control callback of an `MjData`.

    The callback lasts as long as the context.

    Parameters
    ----------
    data : object
        `MjData` of the loop.
    loop : callable
        Function of model and data.

    Returns
    -------
    context manager
        Context.

    Raises
    ------
    BadExperiment
        A foreign callback is installed, or the data already has a loop.
    """
    key = id(data)
    with _lock:
        refuse_foreign_callback()
        if key in _loops:
            raise BadExperiment("this MjData already runs in a loop")
        if mujoco.get_mjcb_control() is None:
            mujoco.set_mjcb_control(_dispatch)
        _loops[key] = loop
    try:
        yield
    finally:
        with _lock:
            del _loops[key]
            _remove_if_unused()
