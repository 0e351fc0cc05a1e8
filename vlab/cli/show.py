"""``vlab show``."""

import argparse
import contextlib
import tempfile
from pathlib import Path

from vlab.cli.common import Outcome
from vlab.cli.destination import OVERWRITE
from vlab.errors import BadRecording, OutputRefused
from vlab.files.containment import NotInside, file_inside
from vlab.recordings.bound import RECORDING, check_run

NOT_SHOWN = "the viewer ended with status {status}, and says why above; it needs a display."
ELSEWHERE = "The file opens on any machine with a screen and the same version of Rerun (rerun run.rrd)"
SAVE_IT = "With --save FILE.rrd what would be shown is written, and opens on any machine with a screen"


RRD = b"RRF"
"""RRD: first bytes of a Rerun recording of any version."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("run", nargs="+", help="show this run folder or .rrd file, or two run folders over each other")
    parser.add_argument(
        "--save",
        metavar="FILE.rrd",
        help="with two runs: write this file and open no viewer (default: open the viewer)",
    )
    parser.add_argument(OVERWRITE, action="store_true", help="replace the file of --save (default: refuse)")


def run(arguments: argparse.Namespace) -> Outcome:
    """Open the viewer until it is closed, or write two overlaid runs.

    Parameters
    ----------
    arguments : Namespace
        Parsed arguments of the command.

    Returns
    -------
    Outcome
        Document and text of the command.
    """
    paths = [Path(name) for name in arguments.run]
    if len(paths) > 2:
        raise BadRecording(f"{len(paths)} runs were given; one is shown, or two over each other")
    if len(paths) == 1:
        if arguments.save:
            raise BadRecording("--save is for two runs; of one run the file is there: run.rrd in its folder")
        rrd = _rrd(paths[0])
        return _shown(rrd, str(rrd), ELSEWHERE)
    from vlab.views.rerun.two_runs import load_two, write_two_runs

    runs = load_two(paths)
    if arguments.save:
        target = Path(arguments.save)
        if target.suffix != ".rrd":
            raise OutputRefused(f"{target}: the viewer knows its files by their ending; name it {target.stem}.rrd")
        if target.exists() and not arguments.overwrite:
            raise OutputRefused(f"{target} is there already; name another with --save, or add {OVERWRITE}")
        write_two_runs(target, runs)
        return Outcome(document={"rrd": str(target)}, text=f"written: {target}   (vlab show {target})")
    with tempfile.TemporaryDirectory(prefix="vlab-") as folder:
        return _shown(write_two_runs(Path(folder) / "two-runs.rrd", runs), " and ".join(map(str, paths)), SAVE_IT)


def _rrd(path: Path) -> Path:
    if (path / RECORDING).is_file():
        check_run(path)
    rrd = path / "run.rrd" if path.is_dir() else path
    if path.is_dir() and rrd.exists():
        try:
            file_inside(rrd.name, path, called="the run folder")
        except NotInside as error:
            raise BadRecording(f"{rrd}: the file {error}; restore the run folder") from error
    if not rrd.is_file() or rrd.suffix != ".rrd":
        raise BadRecording(f"{path}: no run.rrd here; give a run folder written by vlab experiment, or an .rrd file")
    with rrd.open("rb") as file:
        if file.read(len(RRD)) != RRD:
            raise BadRecording(
                f"{path}: named as a Rerun recording, but it does not begin as one; is it cut, or another format?"
            )
    return rrd


def _shown(rrd: Path, what: str, remedy: str) -> Outcome:
    from vlab.views.rerun.viewer import start_viewer

    with start_viewer(rrd) as viewer, contextlib.suppress(KeyboardInterrupt):
        viewer.wait()
    status = viewer.returncode
    text = f"{what} shown" if status == 0 else f"{what}: {NOT_SHOWN.format(status=status)} {remedy}"
    return Outcome(document={"rrd": str(rrd), "viewer_status": status}, text=text, holds=status == 0)
