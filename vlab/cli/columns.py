"""``vlab columns``."""

import argparse
from pathlib import Path
from typing import Any

from vlab.cases.places import suggest
from vlab.cli.common import Outcome
from vlab.cli.table import text_table
from vlab.files.examples import located
from vlab.files.text import in_line
from vlab.plants.base import Plant
from vlab.plants.mjcf import build_mjcf
from vlab.recordings.datasets import open_any
from vlab.recordings.overview import ColumnOverview, overview

HEADERS = ("column", "rows", "blank", "from", "to", "unit", "kind")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("file", help="read this recording, or the folder of a LeRobot data set or ROS 2 bag")
    parser.add_argument(
        "--model",
        metavar="FILE.xml",
        help="suggest the place of each column in this MJCF model (default: no suggestions)",
    )
    parser.add_argument(
        "--episode", type=int, default=0, help="read this episode of a LeRobot data set (default %(default)s)"
    )


def run(arguments: argparse.Namespace) -> Outcome:
    """List the columns of a file.

    Parameters
    ----------
    arguments : Namespace
        Parsed arguments of the command.

    Returns
    -------
    Outcome
        Document and text of the command.
    """
    table, names = open_any(Path(located(arguments.file)), arguments.episode)
    plant = build_mjcf(Path(arguments.model)) if arguments.model else None
    columns = overview(table)
    document: dict[str, Any] = {
        "file": str(table.path),
        "columns": [_column(column, names.get(column.name, ""), plant) for column in columns],
        "refused": [{"name": name, "why": why} for name, why in table.refused.items()],
        "notes": list(table.notes),
    }
    return Outcome(document=document, text=_text(document))


def _column(column: ColumnOverview, name: str, plant: Plant | None) -> dict[str, Any]:
    out = column.to_json() | ({"also": name} if name else {})
    found = None if plant is None else suggest(name or column.name, plant) or suggest(column.name, plant)
    if found is not None:
        out["suggestion"] = {"at": found.at, "kind": found.kind, "input": found.is_input}
    return out


def _text(document: dict[str, Any]) -> str:
    has_places = any("suggestion" in column for column in document["columns"])
    rows = []
    for column in document["columns"]:
        name = column["name"] + (f" = {column['also']}" if "also" in column else "")
        unit = column["unit"] or (f"{column['unit_guess']}?" if column["unit_guess"] else "")
        kind = column["kind"] + (f", {column['rate_hz']:.5g} Hz" if column["rate_hz"] else "")
        row = [name, column["rows"], column["blank"], float(column["least"]), float(column["greatest"]), unit, kind]
        if has_places:
            found = column.get("suggestion")
            row.append("" if found is None else f"{found['at']}{' (input)' if found['input'] else ''}")
        rows.append(row)
    lines = [text_table([*HEADERS, "place?"] if has_places else HEADERS, rows)]
    names = [column["name"] for column in document["columns"]]
    whole = [
        part
        for part in document["refused"]
        if not any(n.startswith((f"{part['name']}[", f"{part['name']}.", f"{part['name']}_")) for n in names)
    ]
    lines += [f"not readable: {in_line(part['name'])}: {in_line(part['why'])}" for part in whole]
    lines += [in_line(note) for note in document["notes"]]
    if any(column["unit_guess"] for column in document["columns"]):
        lines.append("A unit with a question mark is a guess from the range of the values; state the unit in the case.")
    return "\n".join(lines)
