"""``vlab compare``."""

import argparse

from vlab.cases.compare import compare_case
from vlab.cli.case_argument import add_case
from vlab.cli.common import Outcome, share_bar
from vlab.cli.destination import add_out, check_out
from vlab.cli.table import text_table
from vlab.files.output_folder import output_folder, write_manifest
from vlab.files.text import in_line


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add_case(parser)
    add_out(parser, "report.html and run.rrd to this folder (default: print only)")


def run(arguments: argparse.Namespace) -> Outcome:
    """Simulate the recordings of a case and report the residuals.

    Parameters
    ----------
    arguments : Namespace
        Parsed arguments of the command.

    Returns
    -------
    Outcome
        Document and text of the command.
    """
    check_out(arguments, read=[arguments.case])
    with share_bar("compare") as report:
        comparison = compare_case(arguments.case, allow_outside=arguments.allow_outside, progress=report)
    document = comparison.to_json()
    from vlab.views.reports.case import HEADERS, misfit_rows, write_case

    rows = misfit_rows(comparison)
    text = "\n".join(
        [
            in_line(comparison.case.table.title),
            "",
            *([text_table(HEADERS, rows)] if rows else []),
            *map(in_line, comparison.remarks),
        ]
    )
    if arguments.out:
        with output_folder(arguments.out, overwrite=arguments.overwrite) as folder:
            write_case(comparison, folder)
            write_manifest(folder, verb="compare", case=str(arguments.case))
        document["out"] = str(arguments.out)
        text += f"\n\nwritten to {arguments.out}: report.html, run.rrd"
    return Outcome(document=document, text=text)
