"""The process in which one file is read: bytes in, arrays out, no file opened, limited time and memory.

Started by `vlab.recordings.isolated` as a script. The reader is a module beside this one with ``read(data, options)`` that
returns a dict with ``variables``, a list of (name, value); a value is an array, a str, a list, a dict of values or
``Skip``. What it raises as ``ValueError`` is the reason why the file is refused.
"""

import importlib
import json
import os
import sys
from typing import Any, Literal

import numpy as np


class Skip(str):
    """Why something in a file is no number and no text."""


def limit(seconds: int, memory: int) -> None:
    """Allow so much processor time [s] and further memory [bytes], and no further open file.

    What is open stays open; the library of a format cannot open anything else, whatever a file asks of it.
    """
    try:
        import resource
    except ImportError:  # not POSIX: the caller's clock and its checks of sizes remain
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
    """Return the JSON form of a value; arrays go to `buffers`."""
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
    """Write the answer: the length of the JSON text, the text, the arrays."""
    text = json.dumps(head).encode()
    with os.fdopen(1, "wb") as stream:
        for part in (len(text).to_bytes(8, "little"), text, *buffers):
            stream.write(part)


def load(order: dict[str, Any]) -> Any:
    """Return the reader that an order names."""
    sys.path[:] = [os.path.dirname(os.path.abspath(__file__)), *order["path"]]
    return importlib.import_module(order["reader"])


def work(order: dict[str, Any], data: bytes) -> None:
    """Read a file as an order says, within its limits, and write the answer to standard output."""
    reader = load(order)
    limit(order["seconds"], order["memory"])
    buffers: list[Any] = []
    try:
        head = reader.read(data, order["options"])
        head["variables"] = [(name, pack(value, buffers)) for name, value in head["variables"]]
    except MemoryError:
        head, buffers = {"refused": "reading it needs more memory than a file of its size may take"}, []
    except Exception as error:  # the libraries raise a dozen kinds on damaged files
        name = "" if isinstance(error, ValueError) else f"{type(error).__name__}: "
        head, buffers = {"refused": f"{name}{str(error)[:1000]}"}, []
    answer(head, buffers)


if __name__ == "__main__":
    sys.modules["sandbox"] = sys.modules["__main__"]  # so that the readers' Skip is this one
    work(json.loads(sys.argv[1]), sys.stdin.buffer.read())
