"""Many independent cases on all cores or a dask cluster."""

import multiprocessing
import os
import warnings
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import as_completed
from typing import Any, TypeVar

import numpy as np
from joblib.externals.loky import ProcessPoolExecutor

from vlab.errors import BadExperiment, unknown_name

T = TypeVar("T")
ENGINES = ("joblib", "dask")
ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "MKL", "OMP", "NUMBA", "VECLIB")}
"""ONE_THREAD: environment of a worker; parallel cases leave no core for a second thread."""


def common_instructions() -> dict[str, str]:
    """Return an environment that limits numpy and OpenBLAS to AVX2.

    Nearly all processors have AVX2. By default the libraries choose instructions by the processor, and round
    differently on each. Equal bits on all machines need common instructions.
    """
    core = getattr(np, "_core", None) or np.core
    found = getattr(core._multiarray_umath, "__cpu_dispatch__", [])
    wider = [name for name in found if name.startswith(("AVX512", "X86_V4"))]
    return {"OPENBLAS_CORETYPE": "Haswell", "NPY_DISABLE_CPU_FEATURES": " ".join(wider)}


def cores() -> int:
    """Return the number of cores of this process."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run_all(
    work: Callable[[Any], T],
    items: Sequence[Any],
    *,
    engine: str = "joblib",
    jobs: int = 0,
    scheduler: str = "",
    environment: Mapping[str, str] | None = None,
) -> Generator[T, None, None]:
    """Yield the result of every item, in the order of completion.

    Parameters
    ----------
    work : callable
        Picklable function; its result must name the item.
    items : sequence of object
        Items of work.
    engine : str
        ``"joblib"``: one single-threaded process per core. ``"dask"``: workers of a cluster that sees the same files.
    jobs : int
        Processes; all cores by default. One process means this one, unless an environment is given.
    scheduler : str
        Address of a running dask scheduler; a cluster on this machine by default.
    environment : mapping of str to str, optional
        Variables of worker processes; clusters have their own.

    Yields
    ------
    object
        Result of one item.

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
    if count == 1 and not environment:
        yield from map(work, items)
        return
    yield from _on_cores(work, items, count, {**ONE_THREAD, **(environment or {})})


def _on_cores(
    work: Callable[[Any], T], items: Sequence[Any], count: int, environment: Mapping[str, str]
) -> Iterator[T]:
    executor = ProcessPoolExecutor(max_workers=count, env=dict(environment))
    is_done = False
    try:
        with warnings.catch_warnings():
            # loky replaces a large worker between two cases without loss
            warnings.filterwarnings("ignore", "A worker stopped while some jobs were given")
            for future in as_completed([executor.submit(_alone, work, item) for item in items]):
                yield future.result()
        is_done = True
    finally:  # an interrupted run does not wait for the remaining cases
        executor.shutdown(wait=True, kill_workers=not is_done)


def _alone(work: Callable[[Any], T], item: Any) -> T:
    """Work on one item in a process without children."""
    process = multiprocessing.current_process()
    if not process.daemon:
        process.daemon = True
    return work(item)


def _on_dask(work: Callable[[Any], T], items: Sequence[Any], jobs: int, scheduler: str) -> Iterator[T]:
    try:
        from dask.distributed import Client, LocalCluster
        from dask.distributed import as_completed as done_of
    except ImportError as error:
        raise BadExperiment(
            "dask is not installed; install it with pip install 'vlab-vibration[dask]', or use joblib"
        ) from error
    try:
        here = (
            None if scheduler else LocalCluster(n_workers=jobs or cores(), threads_per_worker=1, dashboard_address=None)
        )
        client = Client(here or scheduler, timeout=30)
    except (OSError, ValueError) as error:
        raise BadExperiment(f"the dask scheduler {scheduler or 'on this machine'} does not answer: {error}") from error
    with client:
        futures = client.map(work, list(items), pure=False, retries=1)
        for future in done_of(futures):
            yield future.result()
    if here is not None:
        here.close()
