"""Locks of the operating system, without stale locks.

A lock ends with its process, however the process ends.
"""

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
"""Lock file of a folder in use; an unlocked file has no meaning."""


def lock(path: Path, *, flags: int = os.O_RDONLY, wait: bool = False) -> int | None:
    """Lock a file or a folder.

    Parameters
    ----------
    path : Path
        File; a folder only on systems that lock folders (not Windows).
    flags : int
        Flags of `os.open`.
    wait : bool
        Whether to wait for the present owner.

    Returns
    -------
    int or None
        Descriptor that holds the lock until closed; None if another process holds the lock or removed the file.

    Raises
    ------
    OSError
        The path cannot be opened, or its file system has no locks.
    """
    descriptor = os.open(path, flags, 0o644)
    try:
        _take(descriptor, wait)
        if os.path.samestat(os.fstat(descriptor), os.stat(path)):
            return descriptor
    except (BlockingIOError, PermissionError, FileNotFoundError):  # msvcrt raises PermissionError for a held lock
        pass
    except BaseException:
        os.close(descriptor)
        raise
    os.close(descriptor)
    return None


@contextlib.contextmanager
def sole_use(folder: Path, *, of: str, wait: bool = False) -> Iterator[None]:
    """Reserve a folder for the process during a block.

    Parameters
    ----------
    folder : Path
        Folder, created if missing.
    of : str
        Name of the work in the message to a second process, such as ``"vlab prove"``.
    wait : bool
        Whether to wait for the other process.

    Returns
    -------
    context manager
        Context.

    Raises
    ------
    OutputRefused
        Another process works in the folder, or the folder cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        held = lock(folder / LOCK, flags=os.O_RDWR | os.O_CREAT, wait=wait)
        while held is None and wait:  # the last owner removed the file
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
