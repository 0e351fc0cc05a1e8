"""Isolated process for formats with unsafe libraries.

A damaged file can crash the HDF5 library, which is C code. npTDMS allocates whatever counts a header states. A worker
(`vlab.recordings.workers`) receives the bytes of one file through a pipe and returns plain arrays and text through
another. The worker may open no file and has limits on processor time and memory. A worker serves one file, so a file
cannot affect the next. The limits are those of POSIX; on any other system only the wall clock limits a worker.
"""

import functools
import importlib.util
import json
import os
import signal
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from vlab.recordings import files
from vlab.recordings.files import refuse
from vlab.recordings.formats.variables import Skipped

WORKERS = Path(__file__).parent / "workers"
"""Folder of `sandbox.py` and of the readers."""

_SECONDS = 2  # processor time for a file of any size; starting takes 0.25 s
_BYTES_PER_SECOND = 50e6  # slower than any disk; determines the size-dependent time
_BACKSTOP = (
    60 if os.name == "posix" else 5
)  # wall clock over processor time; a loaded machine gives a process little of it
_ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


def read_isolated(
    reader: str,
    data: bytes,
    path: Path,
    *,
    library: str,
    install: str,
    options: Mapping[str, Any] | None = None,
    bytes_per_second: float = _BYTES_PER_SECOND,
) -> dict[str, Any]:
    """Return a reader's result for the bytes of a file.

    Parameters
    ----------
    reader : str
        Name of a module in `WORKERS`.
    data, path : bytes, Path
        Content of the file, and its name for messages.
    library, install : str
        Required library, and the package to install if missing.
    options : mapping, optional
        Options of the reader.
    bytes_per_second : float
        Slowest accepted reading [bytes/s].

    Returns
    -------
    dict
        ``variables``: list of (name, value) for `vlab.recordings.formats.variables.Variables.add`; ``units``; ``meta``;
        ``notes``.

    Raises
    ------
    BadRecording
        The library is missing, or the file is damaged, takes too long or needs too much memory.
    """
    if not is_installed(library):
        raise refuse(path, f"reading {path.suffix} files needs {library}", fix=f"pip install {install}")
    limit, seconds = files.unpacked_limit(len(data)), _SECONDS + int(len(data) / bytes_per_second)
    order = {
        "path": sys.path,
        "reader": reader,
        "seconds": seconds,
        "memory": 2**28 + 3 * len(data) + 3 * limit,
        "options": {"limit": limit, **(options or {})},
    }
    try:
        done = _run(order, data, timeout=_BACKSTOP * seconds)
    except subprocess.TimeoutExpired as error:
        raise _too_long(path, _BACKSTOP * seconds) from error
    except OSError as error:
        raise refuse(path, f"the process that reads {path.suffix} files cannot be started: {error}") from error
    if done.returncode:
        raise _ended(path, done, library, seconds)
    return _answer(path, done.stdout)


@functools.cache
def is_installed(library: str) -> bool:
    """Return whether a library can be imported."""
    return importlib.util.find_spec(library) is not None


def _run(order: Mapping[str, Any], data: bytes, *, timeout: float) -> "subprocess.CompletedProcess[bytes]":
    command = [sys.executable, "-I", str(WORKERS / "sandbox.py"), json.dumps(order)]
    environment = os.environ | _ONE_THREAD
    return subprocess.run(command, input=data, capture_output=True, timeout=timeout, env=environment, check=False)


def _too_long(path: Path, seconds: int) -> Exception:
    return refuse(path, f"reading takes more than {seconds} s", fix="the file is damaged, or made to be slow")


def _ended(path: Path, done: "subprocess.CompletedProcess[bytes]", library: str, seconds: int) -> Exception:
    if -done.returncode in (getattr(signal, name, None) for name in ("SIGXCPU", "SIGKILL")):
        return _too_long(path, seconds)
    last = done.stderr[-2000:].decode(errors="replace").strip().splitlines()[-1:]
    why = f"signal {-done.returncode}" if done.returncode < 0 else f"{''.join(last)} (status {done.returncode})"
    return refuse(path, f"{library} broke down on it: {why}", fix="the file is damaged; export or copy it again")


def _answer(path: Path, answer: bytes) -> dict[str, Any]:
    """Decode a worker's answer.

    The answer consists of the length of a JSON text, the text and the arrays.
    """
    size = int.from_bytes(answer[:8], "little")
    head = json.loads(answer[8 : 8 + size])
    if "refused" in head:
        raise refuse(path, head["refused"], fix="the file is damaged; export or copy it again")
    offset = 8 + size

    def value(tree: Any) -> Any:
        nonlocal offset
        kind, content = tree
        if kind == "array":
            dtype, shape, order = np.dtype(content[0]), content[1], content[2]
            count = int(np.prod(shape, dtype=np.int64))
            array = np.frombuffer(answer, dtype=dtype, count=count, offset=offset).reshape(shape, order=order)
            offset += count * dtype.itemsize
            return array
        if kind == "skipped":
            return Skipped(content)
        if kind == "dict":
            return {name: value(part) for name, part in content}
        return [value(part) for part in content] if kind == "list" else content

    head["variables"] = [(name, value(tree)) for name, tree in head["variables"]]
    if offset != len(answer):
        raise refuse(path, "the reader's answer is not whole", fix="the file is damaged; export or copy it again")
    return dict(head)
