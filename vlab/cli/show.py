"""``vlab show``."""

import argparse
import os
import subprocess
import sys
from pathlib import Path

from vlab.cli.common import Outcome
from vlab.errors import BadRecording


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's arguments."""
    parser.add_argument("run", help="a run folder, or an .rrd file")


def run(arguments: argparse.Namespace) -> Outcome:
    """Open the viewer and wait until it is closed."""
    path = Path(arguments.run)
    rrd = path / "run.rrd" if path.is_dir() else path
    if not rrd.is_file() or rrd.suffix != ".rrd":
        raise BadRecording(f"{path}: no run.rrd here; give a run folder written by vlab experiment, or an .rrd file")
    command = [sys.executable, "-m", "rerun", "--bind", "127.0.0.1", str(rrd)]
    try:  # the viewer reports usage to its makers unless told not to
        status = subprocess.run(command, env={**os.environ, "CI": "1"}, stdout=sys.stderr, check=False).returncode
    except OSError as error:
        raise BadRecording(f"the Rerun viewer cannot be started: {error}") from error
    return Outcome(document={"rrd": str(rrd), "viewer_status": status}, text=f"{rrd} shown", holds=status == 0)
