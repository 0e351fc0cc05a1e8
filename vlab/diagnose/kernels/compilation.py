"""Loops compiled by numba, with what was compiled kept between runs where there is a place to keep it."""

import contextlib
import os
import stat
import tempfile
from collections.abc import Callable, Iterator
from itertools import chain
from pathlib import Path
from typing import Any, TypeVar

from numba import config, njit
from numba.core.caching import FunctionCache

SHARED = ("/dev/shm",)
"""Writable even in containers in which nothing else is."""
F = TypeVar("F", bound=Callable[..., Any])


class _Kept(FunctionCache):
    """A cache of compiled code that a run does without where it can be read or written no more."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except OSError:
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        try:
            super().save_overload(sig, data)
        except OSError:  # a full disk, a folder that has gone
            self.disable()


def compiled(**options: Any) -> Callable[[F], F]:
    """Return a decorator that compiles a function, see `numba.njit`, and keeps what it compiled.

    It is kept where numba keeps such code: in the installation, or else in the user's home. Where neither can be written it is a
    folder for temporary files, for every process that a diagnosis forks would compile it again; without one it is not kept.
    """

    def decorate(function: F) -> F:
        dispatcher = njit(**options)(function)
        cache = _cache(function)
        if cache is not None:
            dispatcher._cache = cache
        return dispatcher

    return decorate


def _cache(function: Callable[..., Any]) -> _Kept | None:
    settings: Any = config  # numba fills them in when it is loaded
    usual = settings.CACHE_DIR
    try:
        for folder in chain([usual], _temporary()):
            settings.CACHE_DIR = folder
            try:
                return _Kept(function)
            except (RuntimeError, OSError):  # numba: "no locator available"
                continue
    finally:
        settings.CACHE_DIR = usual
    return None


def _temporary() -> Iterator[str]:
    """Yield folders for temporary files that are the user's own: what is kept there is run, so nobody else may write there."""
    if not hasattr(os, "getuid"):
        return
    parents = []
    with contextlib.suppress(OSError):
        parents.append(tempfile.gettempdir())
    for parent in (*parents, *SHARED):
        folder = Path(parent) / f"vlab-compiled-{os.getuid()}"
        if Path(parent) == Path.cwd():  # what `tempfile` falls back to
            continue
        try:
            folder.mkdir(mode=0o700, exist_ok=True)
            found = folder.lstat()
        except OSError:
            continue
        if stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o022:
            yield str(folder)
