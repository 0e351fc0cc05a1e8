"""Many independent cases on all cores of this machine, or on a cluster that dask knows."""

import multiprocessing
import os
import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

import joblib

from vlab.errors import BadExperiment, unknown_name

T = TypeVar("T")
ENGINES = ("joblib", "dask")


def cores() -> int:
    """Return the cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run_all(
    work: Callable[[Any], T], items: Sequence[Any], *, engine: str = "joblib", jobs: int = 0, scheduler: str = ""
) -> Iterator[T]:
    """Yield what `work` makes of every item, in the order in which they are done.

    Parameters
    ----------
    work : callable
        Must be picklable, and say in its result which item it was.
    engine : str
        ``"joblib"``: one process a core, linear algebra on one thread. ``"dask"``: the workers of a cluster, which must
        see the same files.
    jobs : int
        Processes; all cores by default. One runs everything in this process.
    scheduler : str
        Address of a running dask scheduler; a cluster on this machine by default.

    Raises
    ------
    BadExperiment
        Dask is not installed or its scheduler does not answer.
    """
    if engine not in ENGINES:
        raise unknown_name("engine", engine, ENGINES)
    if jobs < 0:
        raise BadExperiment(f"jobs is {jobs}; accepted: 1 or more, 0 for all cores")
    if engine == "dask":
        yield from _on_dask(work, items, jobs, scheduler)
        return
    count = min(jobs or cores(), max(len(items), 1))
    if count == 1:
        yield from map(work, items)
        return
    with joblib.parallel_config(backend="loky", inner_max_num_threads=1), warnings.catch_warnings():
        # loky replaces a worker that has grown, between two cases: nothing is lost
        warnings.filterwarnings("ignore", "A worker stopped while some jobs were given")
        parallel = joblib.Parallel(n_jobs=count, return_as="generator_unordered", batch_size=1)
        yield from parallel(joblib.delayed(_alone)(work, item) for item in items)


def _alone(work: Callable[[Any], T], item: Any) -> T:
    """Work on one item in a process that starts no others: cases side by side leave no core for it."""
    process = multiprocessing.current_process()
    if not process.daemon:
        process.daemon = True
    return work(item)


def _on_dask(work: Callable[[Any], T], items: Sequence[Any], jobs: int, scheduler: str) -> Iterator[T]:
    try:
        from dask.distributed import Client, LocalCluster, as_completed
    except ImportError as error:
        raise BadExperiment("dask is not installed; install it with pip install 'vlab[dask]', or use joblib") from error
    try:
        here = (
            None if scheduler else LocalCluster(n_workers=jobs or cores(), threads_per_worker=1, dashboard_address=None)
        )
        client = Client(here or scheduler, timeout=30)
    except (OSError, ValueError) as error:
        raise BadExperiment(f"the dask scheduler {scheduler or 'on this machine'} does not answer: {error}") from error
    with client:
        futures = client.map(work, list(items), pure=False, retries=1)
        for future in as_completed(futures):
            yield future.result()
    if here is not None:
        here.close()
