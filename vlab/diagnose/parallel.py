"""Independent pieces of work on all cores."""

import multiprocessing
import os
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

T = TypeVar("T")
S = TypeVar("S")

_work: Callable[[Any], Any] | None = None


def _one(item: Any) -> Any:
    assert _work is not None
    return _work(item)


def side_by_side(work: Callable[[S], T], items: Sequence[S]) -> list[T]:
    """Return ``[work(item) for item in items]``, the items on as many processes as there are cores.

    The processes are forks, so the work and what it refers to need not be pickled; where forks are not to be had (or in a
    process that is itself a worker) everything runs here. The results do not depend on the number of processes.
    """
    global _work
    count = min(len(items), len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 1)
    if count < 2 or _work is not None or "fork" not in multiprocessing.get_all_start_methods():
        return [work(item) for item in items]
    if multiprocessing.current_process().daemon:
        return [work(item) for item in items]
    _work = work
    try:
        with multiprocessing.get_context("fork").Pool(count) as pool:
            return pool.map(_one, items, chunksize=1)
    finally:
        _work = None
