"""``vlab examples``."""

import argparse
import shutil
import tomllib
from pathlib import Path
from typing import Any

from vlab.cli.common import Outcome
from vlab.cli.table import text_table
from vlab.errors import OutputRefused
from vlab.files.assets import asset
from vlab.files.examples import CASES, FILES, MAIN, PREFIX, Example, examples

USES = {".csv": "vlab columns", ".toml": "vlab experiment --plan", ".py": ""}
"""Command that reads a single file, by suffix."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("--copy", metavar="DIR", help="copy all examples to this new folder (default: list only)")


def run(arguments: argparse.Namespace) -> Outcome:
    """List the examples, or copy them.

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
        The folder is there already or cannot be written.
    """
    document: dict[str, Any] = {"examples": [_plain(example) for example in examples()]}
    rows = [[e["name"], e["title"], e["command"]] for e in document["examples"]]
    text = text_table(["example", "content", "try"], rows)
    if arguments.copy:
        document["out"] = str(_copied(Path(arguments.copy)))
        text += f"\n\nwritten to {arguments.copy}: {CASES}, {FILES}"
    else:
        text += "\n\ncopy them all to a folder of yours: vlab examples --copy DIR"
    return Outcome(document=document, text=text)


def _plain(example: Example) -> dict[str, str]:
    name = PREFIX + example.name
    if example.is_case:
        path = example.path / MAIN if example.path.is_dir() else example.path
        title = tomllib.loads(path.read_text(encoding="utf-8")).get("title", "")
        return {"name": name, "title": title, "command": f"vlab check {name}", "path": str(example.path)}
    with example.path.open(encoding="utf-8") as file:
        title = file.readline().strip().strip('#" ').rstrip(".").partition(":")[0].partition(";")[0]
    verb = USES.get(example.path.suffix, "")
    return {"name": name, "title": title, "command": f"{verb} {name}" if verb else "", "path": str(example.path)}


def _copied(folder: Path) -> Path:
    """Copy all examples to a new folder."""
    if folder.exists():
        raise OutputRefused(f"{folder} is there already; name a new folder with --copy")
    aside = shutil.ignore_patterns("__pycache__")
    try:
        for part in (CASES, FILES):
            shutil.copytree(asset(part), folder / part, ignore=aside)
    except OSError as error:
        raise OutputRefused(f"copying the examples to {folder} failed: {error.strerror or error}") from error
    return folder
