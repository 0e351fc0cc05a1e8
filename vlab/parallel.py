"""Independent pieces of work on all cores, by forked processes."""

import gc
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

from threadpoolctl import threadpool_limits

T = TypeVar("T")
S = TypeVar("S")

_work: Callable[[int], Any] | None = None
_most: int | None = None


@contextmanager
def limited_to(jobs: int | None) -> Iterator[None]:
    """Limit the processes of a block, and its linear algebra to one thread.

    The matrices are small. Their threads would wait for each other, and sums would depend on the number of cores.

    Parameters
    ----------
    jobs : int or None
        Most processes at a time; None for one a core.

    Yields
    ------
    None
        The limit holds until the block ends.
    """
    global _most
    before, _most = _most, jobs
    try:
        with threadpool_limits(1, user_api="blas"):
            yield
    finally:
        _most = before


def _one(index: int) -> Any:
    assert _work is not None
    return _work(index)


def _quiet() -> None:
    """Leave interrupts to the parent, and inherited objects uncollected.

    A collection would write to every inherited page, and so copy the parent's memory.
    """
    gc.freeze()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)


@contextmanager
def _ends_by_itself() -> Iterator[None]:
    """Restore default termination for processes forked here.

    Short work may end before the last fork reaches its own initializer. An inherited handler would treat termination as
    an interrupt, and the pool would wait without end.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread may set handlers
        return
    usual = signal.signal(signal.SIGTERM, signal.SIG_DFL)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL if usual is None else usual)


def side_by_side(work: Callable[[S], T], items: Sequence[S]) -> list[T]:
    """Return ``[work(item) for item in items]``, computed on all cores.

    Forked processes inherit work and items, so only the results are pickled. Without forks, or in a worker process, the
    items run in sequence. The results are independent of the number of processes.

    Parameters
    ----------
    work : callable
        Function of one item.
    items : sequence
        Items.

    Returns
    -------
    list
        Results in the order of the items.
    """
    global _work
    count = min(len(items), len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 1)
    count = count if _most is None else min(count, _most)
    if count < 2 or _work is not None or "fork" not in multiprocessing.get_all_start_methods():
        return [work(item) for item in items]
    if multiprocessing.current_process().daemon:
        return [work(item) for item in items]
    _work = lambda index: work(items[index])  # noqa: E731 - forks inherit the items, so only results are sent
    try:
        with _ends_by_itself():
            pool = multiprocessing.get_context("fork").Pool(count, _quiet)
        with pool:
            return pool.map(_one, range(len(items)), chunksize=1)
    finally:
        _work = None
