"""``vlab init``."""

import argparse
import shlex
from pathlib import Path
from typing import Any

from vlab.cases.case import CASE
from vlab.cases.draft import Draft, draft_case
from vlab.cli.case_argument import OUTSIDE
from vlab.cli.common import Outcome
from vlab.cli.destination import OVERWRITE
from vlab.cli.table import text_table
from vlab.errors import OutputRefused
from vlab.files.output_folder import made_parents
from vlab.files.text import in_line
from vlab.recordings.files import written_whole

HEADERS = ("column", "at", "kind", "unit", "role", "why this place", "why this unit")
MOST_LEFT = 20
"""MOST_LEFT [1]: largest number of left-out columns in the printed text; the case names more."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("model", help="read this MuJoCo model (MJCF .xml), structure file, beam or grid")
    parser.add_argument("logs", nargs="+", metavar="LOG", help="read these recordings, or the folder of a data set")
    add_clock(parser)
    parser.add_argument("--out", help=f"write {CASE} to this folder (default: beside the first log)")
    parser.add_argument(OVERWRITE, action="store_true", help=f"replace the {CASE} that is there")


def add_clock(parser: argparse.ArgumentParser) -> None:
    """Add the arguments that state the clock of logs."""
    parser.add_argument("--time", metavar="COLUMN", help="take the times from this column (default: found by its name)")
    parser.add_argument(
        "--rate-hz", type=float, metavar="HZ", help="state the sample rate of logs without times (default: none)"
    )


def run(arguments: argparse.Namespace) -> Outcome:
    """Draft a case and say what was matched.

    Parameters
    ----------
    arguments : Namespace
        Parsed arguments of the command.

    Returns
    -------
    Outcome
        Document and text of the command.

    Raises
    ------
    OutputRefused
        A case is there already.
    """
    logs = [Path(name) for name in arguments.logs]
    folder = Path(arguments.out) if arguments.out else logs[0].parent
    path = folder / CASE
    if folder.exists() and not folder.is_dir():
        raise OutputRefused(f"the output folder {folder} is a file; name another folder with --out")
    if folder.suffix.lower() == ".toml" and not folder.is_dir():
        raise OutputRefused(
            f"--out names a folder, and {folder} looks like a file; {CASE} is written inside the folder"
        )
    if path.exists() and not arguments.overwrite:
        raise OutputRefused(f"{path} is there already; name another folder with --out, or add {OVERWRITE}")
    draft = draft_case(arguments.model, logs, folder, time=arguments.time, rate_hz=arguments.rate_hz)
    with made_parents(path), written_whole(path, is_new=not arguments.overwrite) as stream:
        stream.write(draft.text.encode())
    command = next_command("check", path, draft)
    text = f"{draft_words(draft)}\n\nwritten to {path}\nnext: {command}"
    return Outcome(document={"case": str(path), **draft.to_json(), "next": command}, text=text)


def next_command(verb: str, path: Path, draft: Draft) -> str:
    """Return the line that goes on with a drafted case."""
    words = ["vlab", verb, str(path), *([OUTSIDE] if draft.leaves_folder else [])]
    return shlex.join(words)


def draft_words(draft: Draft) -> str:
    """Return what a draft took and left out, as text.

    Parameters
    ----------
    draft : Draft
        Drafted case.

    Returns
    -------
    str
        Table of the columns, recordings and open guesses.
    """
    clock = draft.clock
    stated = f"{clock.rate_hz:g} Hz" if clock.time is None else f"column {clock.time}"
    rows: list[list[Any]] = [
        [m.label, m.at, m.kind, f"{m.unit}{'' if m.is_sure else '?'}", "input" if m.is_input else "", m.why, m.why_unit]
        for m in draft.channels
    ]
    lines = [f"time: {in_line(stated)} ({in_line(clock.why)})", "", text_table(HEADERS, rows), ""]
    for part in draft.parts:
        files = ", ".join(path.name for path in part.paths)
        extent = f" ({part.name})" if part.start_s is not None or part.stop_s is not None else ""
        extent += f" episodes {part.episodes[0]} to {part.episodes[-1]}" if part.episodes else ""
        use = "fitted" if part.role == "fit" else "held out, to verify what is found"
        lines.append(in_line(f"{use}: {files}{extent}"))
    if draft.left_out:
        lines += ["", "left out:"]
        lines += [in_line(f"  {left.label}: {left.why}") for left in draft.left_out[:MOST_LEFT]]
        more = len(draft.left_out) - MOST_LEFT
        lines += [f"  and {more} more, see the case"] if more > 0 else []
    if draft.unsure:
        lines += ["", "to confirm in the case:", *(in_line(f"  {line}") for line in draft.unsure)]
    return "\n".join(lines)
