"""Locks of the operating system: they end with the process that holds them, however it ends, so none is ever stale."""

import contextlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path

from vlab.errors import OutputRefused

if sys.platform == "win32":
    import msvcrt

    def _take(descriptor: int, wait: bool) -> None:
        msvcrt.locking(descriptor, msvcrt.LK_LOCK if wait else msvcrt.LK_NBLCK, 1)
else:
    import fcntl

    def _take(descriptor: int, wait: bool) -> None:
        fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))


LOCK = ".lock"
"""The file in a folder that is locked while somebody works there; unlocked it says nothing."""


def lock(path: Path, *, flags: int = os.O_RDONLY, wait: bool = False) -> int | None:
    """Lock a file or a folder.

    Parameters
    ----------
    path : Path
        A folder only where the system locks folders; Windows does not.
    flags : int
        How it is opened, see `os.open`.
    wait : bool
        Wait for whoever holds it.

    Returns
    -------
    int or None
        The descriptor, which holds the lock until it is closed; None where another process holds it, or removed it meanwhile.

    Raises
    ------
    OSError
        It cannot be opened, or its file system has no locks.
    """
    descriptor = os.open(path, flags, 0o644)
    try:
        _take(descriptor, wait)
        if os.path.samestat(os.fstat(descriptor), os.stat(path)):
            return descriptor
    except (BlockingIOError, PermissionError, FileNotFoundError):  # msvcrt says PermissionError of a lock that is held
        pass
    except BaseException:
        os.close(descriptor)
        raise
    os.close(descriptor)
    return None


@contextlib.contextmanager
def sole_use(folder: Path, *, of: str, wait: bool = False) -> Iterator[None]:
    """Keep a folder to this process while the block runs.

    Parameters
    ----------
    folder : Path
        It is made where it is missing.
    of : str
        Who works there, for the message to the second one: ``"vlab prove"``.
    wait : bool
        Wait for the other rather than refuse.

    Raises
    ------
    OutputRefused
        Another process works there, or the folder cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        held = lock(folder / LOCK, flags=os.O_RDWR | os.O_CREAT, wait=wait)
        while held is None and wait:  # the file was removed by whoever held it
            held = lock(folder / LOCK, flags=os.O_RDWR | os.O_CREAT, wait=wait)
    except OSError as error:
        raise OutputRefused(
            f"{folder} cannot be locked for {of}: {error.strerror or error}; name another folder"
        ) from error
    if held is None:
        raise OutputRefused(f"another {of} is at work in {folder}; wait until it has ended, or name another folder")
    try:
        yield
    finally:
        os.close(held)
