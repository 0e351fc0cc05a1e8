"""Start of the Rerun viewer on this machine."""

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

from vlab.errors import OutputRefused

HERE = "127.0.0.1"
PORT = 9876
"""PORT: default port of a viewer."""
PATIENCE_S = 30.0
"""PATIENCE_S [s]: longest start of a viewer."""
_SETTLED_S = 1.0


def start_viewer(rrd: Path | None = None, *, port: int = PORT, quiet: bool = False) -> subprocess.Popen[bytes]:
    """Start a viewer with a file, or for a run.

    Parameters
    ----------
    rrd : Path or None
        Rerun file, or None.
    port : int
        Port of the viewer.
    quiet : bool
        Whether the output of the viewer is discarded instead of sent to stderr.

    Returns
    -------
    subprocess.Popen
        Process of the viewer.

    Raises
    ------
    OutputRefused
        The viewer cannot be started.
    """
    command = [sys.executable, "-P", "-m", "rerun", "--bind", HERE, "--port", str(port)]
    command += [str(rrd)] if rrd is not None else ["--expect-data-soon"]
    said = subprocess.DEVNULL if quiet else None
    try:  # disable the usage reports of the viewer
        return subprocess.Popen(
            command,
            env={**os.environ, "CI": "1"},
            stdout=said if quiet else sys.stderr,
            stderr=said,
            start_new_session=rrd is None,  # the viewer outlives the run and its Ctrl-C
        )
    except OSError as error:
        raise OutputRefused(f"the Rerun viewer cannot be started: {error}") from error


def listening(port: int) -> bool:
    """Return whether a port of this machine takes connections."""
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.settimeout(0.5)
        return probe.connect_ex((HERE, port)) == 0


def viewer_at(port: int) -> str:
    """Return the address of a viewer at a port.

    Parameters
    ----------
    port : int
        Port of the viewer.

    Returns
    -------
    str
        Address.

    Raises
    ------
    OutputRefused
        The port is invalid, no display is available, or the viewer ends or does not listen.
    """
    if not 1 <= port <= 65535:
        raise OutputRefused(f"the port {port} does not exist; accepted: 1 to 65535 (Rerun's own is {PORT})")
    if not listening(port):
        if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            raise OutputRefused(
                f"there is no display for a viewer and none listens at {HERE}:{port}; "
                "leave out --live and open the run later with vlab show"
            )
        _wait(start_viewer(port=port, quiet=True), port)
    return f"rerun+http://{HERE}:{port}/proxy"


def _wait(viewer: "subprocess.Popen[bytes]", port: int) -> None:
    """Wait for a started viewer to listen and show its window."""
    begun = time.monotonic()
    heard = None
    while heard is None or time.monotonic() < heard + _SETTLED_S:
        if viewer.poll() is not None:
            raise OutputRefused(
                f"the Rerun viewer ended at once (status {viewer.returncode}), most likely without a display; "
                "leave out --live and open the run later with vlab show"
            )
        if time.monotonic() > begun + PATIENCE_S:
            os.killpg(viewer.pid, signal.SIGTERM)  # Rerun's command starts the viewer as a child process
            raise OutputRefused(f"the Rerun viewer did not listen at {HERE}:{port} within {PATIENCE_S:g} s")
        if heard is None and listening(port):
            heard = time.monotonic()
        time.sleep(0.05)
