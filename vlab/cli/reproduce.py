"""``vlab reproduce``."""

import argparse

from vlab.cli.common import Outcome, text_table
from vlab.reproduce.tables import NOT_REPRODUCIBLE, REPRODUCED, reproduce_tables, share


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's arguments."""
    parser.add_argument("table", nargs="*", help=f"tables to reproduce: {', '.join(REPRODUCED)} (default all)")


def run(arguments: argparse.Namespace) -> Outcome:
    """Print each cell published / ours / tolerance / ok."""
    tables = reproduce_tables(arguments.table)
    missing = [{"table": table, "why": why} for table, why in NOT_REPRODUCIBLE.items()]
    lines = []
    for table in tables:
        rows = [
            [
                c.row,
                c.column,
                c.published,
                c.ours,
                c.unit,
                100 * (c.ours - c.published) / c.published if c.published else None,
                c.allowed,
                c.ok if c.determined else f"({'yes' if c.ok else 'no'})",
            ]
            for c in table.cells
        ]
        lines += [
            f"Table {table.table}. {table.title}",
            "",
            text_table(["row", "column", "published", "ours", "unit", "off %", "tolerance", "ok"], rows),
            "",
        ]
    shown = share(tables, determined=False)
    lines += [f"Inside the tolerance: {share(tables)} cells that the published data determine."]
    if shown.of:
        lines += [f"In brackets: {shown} cells that they do not determine; see below."]
    lines += ["", "Not reproduced:", *(f"  Table {part['table']}: {part['why']}" for part in missing)]
    document = {"tables": [t.as_dict() for t in tables], "not_reproducible": missing}
    return Outcome(document=document, text="\n".join(lines), holds=all(t.ok for t in tables))
