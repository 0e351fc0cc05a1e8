"""What a run that was killed left half-written beside its output: known by its name, and dead where nobody holds its lock."""

import contextlib
import os
import shutil
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path

from vlab.files.locks import lock

PART, OLD = ".vlab-part", ".vlab-old"
"""How hidden files and folders end that are not whole yet, and folders that hold what a new one replaces."""
WAS = "was"
"""What is replaced, in its folder that ends in `OLD`."""
_DRAWN = 8
"""Characters of a name that tempfile draws."""


def make_held(make: Callable[[], Path]) -> tuple[Path, int | None]:
    """Make a file or folder that nobody sweeps while this process lives.

    Parameters
    ----------
    make : callable
        Makes a new one each time it is called.

    Returns
    -------
    path : Path
    held : int or None
        The descriptor that holds its lock; None where the system has no such locks, and then nothing is swept either.
    """
    while True:
        path = make()
        try:
            held = lock(path)
        except FileNotFoundError:
            continue  # another process swept it before it was held
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
    """Yield an empty file beside a path, to be written and moved there; what is left of it in the end goes.

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
    """Remove from a folder what runs that were killed left there; what a living one holds is not touched.

    A folder that a run was killed over while it replaced it is put back.
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
