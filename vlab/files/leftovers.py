"""Unfinished output of killed runs: recognition and removal.

The name marks such a file or folder. An unheld lock shows that its process has ended.
"""

import contextlib
import os
import shutil
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path

from vlab.files.locks import lock

PART, OLD = ".vlab-part", ".vlab-old"
"""PART: suffix of hidden files and folders under construction.
OLD: suffix of folders with replaced content."""
WAS = "was"
"""Name of the replaced content in its `OLD` folder."""
_DRAWN = 8
"""_DRAWN [characters]: length of the random part of a tempfile name."""


def make_held(make: Callable[[], Path]) -> tuple[Path, int | None]:
    """Create a file or folder protected from `sweep`.

    The protection lasts as long as the process.

    Parameters
    ----------
    make : callable
        Function that creates a new path at each call.

    Returns
    -------
    path : Path
        Path of the file or folder.
    held : int or None
        Descriptor of the lock; None on a system without such locks, where `sweep` removes nothing.
    """
    while True:
        path = make()
        try:
            held = lock(path)
        except FileNotFoundError:
            continue  # another process removed the path before it was locked
        except OSError:
            return path, None
        if held is not None:
            return path, held


def release(held: int | None) -> None:
    """Close the descriptor of `make_held`."""
    if held is not None:
        os.close(held)


@contextlib.contextmanager
def part_beside(path: Path) -> Iterator[Path]:
    """Yield an empty file beside a path.

    The caller writes and moves the file; a remaining file is removed at the end.

    Parameters
    ----------
    path : Path
        Path of the final file.

    Returns
    -------
    context manager of Path
        Context with the file's path.

    Raises
    ------
    OSError
        The folder cannot be written.
    """

    def make() -> Path:
        part = path.with_name(f".{path.name}.{uuid.uuid4().hex[:_DRAWN]}{PART}")
        part.open("xb").close()
        return part

    sweep(path.parent)
    part, held = make_held(make)
    try:
        yield part
    finally:
        part.unlink(missing_ok=True)
        release(held)


def sweep(folder: Path) -> None:
    """Remove the leftovers of killed runs from a folder.

    Leftovers of a living process stay. A folder under replacement is restored.
    """
    try:
        names = [n for n in os.listdir(folder) if n.startswith(".") and n.endswith((PART, OLD))]
    except OSError:
        return
    for name in names:
        path = folder / name
        with contextlib.suppress(OSError):
            held = lock(path)
            if held is None:
                continue
            try:
                _remove(path)
            finally:
                os.close(held)


def _remove(path: Path) -> None:
    if path.is_symlink() or not path.is_dir():
        path.unlink()
        return
    target = path.with_name(path.name[1 : -len(OLD) - _DRAWN - 1])
    if path.name.endswith(OLD) and (path / WAS).exists() and not target.exists():
        os.replace(path / WAS, target)
    shutil.rmtree(path, ignore_errors=True)
