"""Independent pieces of work on all cores."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

T = TypeVar("T")
S = TypeVar("S")

_work: Callable[[int], Any] | None = None


def _one(index: int) -> Any:
    assert _work is not None
    return _work(index)


def _quiet() -> None:
    """Leave it to the parent to say that it was interrupted, and end without a word when it says so."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)


@contextmanager
def _ends_by_itself() -> Iterator[None]:
    """Let processes that are forked here end when they are told to.

    Short work may be done before the last fork has come to its own first line. The handler that it inherits takes the call to end
    for an interrupt and goes on, and whoever waits for its end waits for ever.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread may; the others' forks take their chance
        return
    usual = signal.signal(signal.SIGTERM, signal.SIG_DFL)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL if usual is None else usual)


def side_by_side(work: Callable[[S], T], items: Sequence[S]) -> list[T]:
    """Return ``[work(item) for item in items]``, the items on as many processes as there are cores.

    The processes are forks, so neither the work nor the items need be pickled, the results must; where forks are not to be had (or in a
    process that is itself a worker) everything runs here. The results do not depend on the number of processes.
    """
    global _work
    count = min(len(items), len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 1)
    if count < 2 or _work is not None or "fork" not in multiprocessing.get_all_start_methods():
        return [work(item) for item in items]
    if multiprocessing.current_process().daemon:
        return [work(item) for item in items]
    _work = lambda index: work(items[index])  # noqa: E731 - forks know the items: only results are sent
    try:
        with _ends_by_itself():
            pool = multiprocessing.get_context("fork").Pool(count, _quiet)
        with pool:
            return pool.map(_one, range(len(items)), chunksize=1)
    finally:
        _work = None
