"""``vlab bench``."""

import argparse
import sys

from vlab.benchmark.comparisons import as_document, run_bench
from vlab.cli.common import Outcome
from vlab.cli.table import text_table


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments: none."""


def run(arguments: argparse.Namespace) -> Outcome:
    """Time all comparisons.

    Parameters
    ----------
    arguments : Namespace
        Parsed arguments of the command.

    Returns
    -------
    Outcome
        Document and text of the command.
    """
    rows = run_bench(progress=lambda text: print(f"timing {text} ...", file=sys.stderr))
    from vlab.benchmark.rerun_writing import rerun_row

    rows.append(rerun_row())
    table = [[r.work, r.ours_s, r.real_time_factor, r.peer, r.peer_s, r.ratio] for r in rows]
    return Outcome(
        document=as_document(rows), text=text_table(["work", "ours s", "x real time", "peer", "peer s", "ratio"], table)
    )
