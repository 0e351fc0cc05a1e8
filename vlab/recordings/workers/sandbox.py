"""Isolated reading process: bytes in, arrays out.

`vlab.recordings.isolated` starts the script. The process opens no file and has limited time and memory. The reader is a
module in the same folder with ``read(data, options)``. Its result is a dict with ``variables``, a list of (name,
value). A value is an array, a str, a list, a dict of values or ``Skip``. A ``ValueError`` is the reason to refuse the
file.
"""

import importlib
import json
import os
import sys
from typing import Any, Literal

import numpy as np


class Skip(str):
    """Reason why an entry is neither number nor text."""


def limit(seconds: int, memory: int) -> None:
    """Limit processor time, memory and open files.

    Open files stay open. The library cannot open any further file.

    Parameters
    ----------
    seconds : int
        Processor time [s].
    memory : int
        Additional memory [bytes].
    """
    try:
        import resource
    except ImportError:  # not POSIX: the caller's clock and size checks remain
        return
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
    try:
        with open("/proc/self/statm", encoding="ascii") as stream:
            used = int(stream.read().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + memory, used + memory))
    except (OSError, ValueError):  # systems without /proc do not keep this limit either
        pass
    resource.setrlimit(resource.RLIMIT_NOFILE, (0, 0))


def pack(value: Any, buffers: list[Any]) -> tuple[str, Any]:
    """Return the JSON form of a value.

    Parameters
    ----------
    value : object
        Value from a reader.
    buffers : list of object
        List that receives the arrays.

    Returns
    -------
    tuple of (str, object)
        Kind and content.
    """
    if isinstance(value, np.ndarray):
        order: Literal["F", "C"] = "F" if value.flags.f_contiguous and not value.flags.c_contiguous else "C"
        buffers.append(np.ravel(value, order=order).view(np.uint8) if value.size else b"")
        return "array", [value.dtype.str, list(value.shape), order]
    if isinstance(value, Skip):
        return "skipped", str(value)
    if isinstance(value, dict):
        return "dict", [(name, pack(part, buffers)) for name, part in value.items()]
    if isinstance(value, list):
        return "list", [pack(part, buffers) for part in value]
    return "text", str(value)


def answer(head: dict[str, Any], buffers: list[Any]) -> None:
    """Write the answer to standard output.

    The answer consists of the length of the JSON text, the text and the arrays.
    """
    text = json.dumps(head).encode()
    with os.fdopen(1, "wb") as stream:
        for part in (len(text).to_bytes(8, "little"), text, *buffers):
            stream.write(part)


def load(order: dict[str, Any]) -> Any:
    """Return the reader named by an order."""
    sys.path[:] = [os.path.dirname(os.path.abspath(__file__)), *order["path"]]
    return importlib.import_module(order["reader"])


def work(order: dict[str, Any], data: bytes) -> None:
    """Read a file within limits and write the answer."""
    reader = load(order)
    limit(order["seconds"], order["memory"])
    buffers: list[Any] = []
    try:
        head = reader.read(data, order["options"])
        head["variables"] = [(name, pack(value, buffers)) for name, value in head["variables"]]
    except MemoryError:
        head, buffers = {"refused": "reading it needs more memory than a file of its size may take"}, []
    except Exception as error:  # libraries raise a dozen kinds of error on damaged files
        name = "" if isinstance(error, ValueError) else f"{type(error).__name__}: "
        head, buffers = {"refused": f"{name}{str(error)[:1000]}"}, []
    answer(head, buffers)


if __name__ == "__main__":
    sys.modules["sandbox"] = sys.modules["__main__"]  # makes the readers' Skip the same class as this one
    work(json.loads(sys.argv[1]), sys.stdin.buffer.read())
