"""A worker process that serves many files, each in a fork: the same limits as in use, without starting Python each time.

Run as a script by the fixture `workers` of `conftest.py`: orders and files come in on standard input, answers go out.
"""

import contextlib
import importlib
import json
import os
import sys


def exactly(n_bytes: int) -> bytes:
    data = sys.stdin.buffer.read(n_bytes)
    if len(data) < n_bytes:
        os._exit(0)
    return data


def serve(sandbox) -> None:
    while True:
        size, length = (int.from_bytes(exactly(8), "little") for _ in range(2))
        order, data = json.loads(exactly(size)), exactly(length)
        out, into = os.pipe()
        child = os.fork()
        if not child:
            os.dup2(into, 1)
            os.close(into)
            sandbox.work(order, data)
            os._exit(0)
        os.close(into)
        with open(out, "rb") as stream:
            answer = stream.read()
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        sys.stdout.buffer.write(status.to_bytes(8, "little", signed=True) + len(answer).to_bytes(8, "little") + answer)
        sys.stdout.buffer.flush()


if __name__ == "__main__":
    sys.path[:] = json.loads(sys.argv[1])
    sandbox = importlib.import_module("sandbox")
    for reader in ("read_hdf5", "read_tdms", "read_xlsx", "read_mcap", "read_db3"):
        with contextlib.suppress(ImportError):  # the library of an extra may be missing
            importlib.import_module(reader)
    serve(sandbox)
