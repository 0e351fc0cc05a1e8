"""Workers that start fast, for the tests that read thousands of files."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from vlab.recordings import isolated


@pytest.fixture(scope="module")
def workers():
    """Serve the readers of `vlab.recordings.isolated` from one process that forks for each file."""
    path = json.dumps([str(isolated.WORKERS), *sys.path])
    command = [sys.executable, "-I", str(Path(__file__).parent / "fork_server.py"), path]
    server = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)

    def run(order, data, *, timeout):
        text = json.dumps(order).encode()
        server.stdin.write(len(text).to_bytes(8, "little") + len(data).to_bytes(8, "little") + text + data)
        server.stdin.flush()
        status = int.from_bytes(server.stdout.read(8), "little", signed=True)
        answer = server.stdout.read(int.from_bytes(server.stdout.read(8), "little"))
        return subprocess.CompletedProcess([], status, answer, b"")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(isolated, "_run", run)
        yield server
    server.stdin.close()
    server.wait()
