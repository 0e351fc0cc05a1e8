"""Loops compiled by numba, with a persistent cache."""

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
"""SHARED [-]: folders that are writable even in read-only containers."""
F = TypeVar("F", bound=Callable[..., Any])


class _Kept(FunctionCache):
    """Cache of compiled code that tolerates read and write errors."""

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
    """Return a decorator that compiles and caches a function.

    The cache is numba's usual folder: the installation or the user's home. The fallback is a private temporary folder,
    since every forked process would compile again otherwise. Without any folder nothing is cached.

    Parameters
    ----------
    **options : Any
        Options of `numba.njit`.

    Returns
    -------
    callable
        Decorator of a function.
    """

    def decorate(function: F) -> F:
        dispatcher = njit(**options)(function)
        cache = _cache(function)
        if cache is not None:
            dispatcher._cache = cache
        return dispatcher

    return decorate


def _cache(function: Callable[..., Any]) -> _Kept | None:
    settings: Any = config  # numba sets the attributes at import
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
    """Yield temporary folders that only the user can write.

    Cached code is executed, so a folder writable by others is unsafe.
    """
    if not hasattr(os, "getuid"):
        return
    parents = []
    with contextlib.suppress(OSError):
        parents.append(tempfile.gettempdir())
    for parent in (*parents, *SHARED):
        folder = Path(parent) / f"vlab-compiled-{os.getuid()}"
        if Path(parent) == Path.cwd():  # fallback of `tempfile`
            continue
        try:
            folder.mkdir(mode=0o700, exist_ok=True)
            found = folder.lstat()
        except OSError:
            continue
        if stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o022:
            yield str(folder)
