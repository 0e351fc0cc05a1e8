"""``vlab demo``."""

import argparse
import sys
import time

from vlab.cli.common import Outcome, add_seed
from vlab.cli.destination import add_out, check_out, destination
from vlab.cli.table import text_table
from vlab.demo.story import run_demo
from vlab.diagnose.advice import format_probability
from vlab.files.output_folder import output_folder, write_manifest

OUT = "out/demo"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add_out(parser, "report.html and run.rrd to this folder", default=OUT)
    add_seed(parser, "draw the concealed effect with this seed (default 0)", default=0)


def run(arguments: argparse.Namespace) -> Outcome:
    """Run the demonstration and write its report.

    Parameters
    ----------
    arguments : Namespace
        Parsed arguments of the command.

    Returns
    -------
    Outcome
        Document and text of the command.
    """
    begun = time.perf_counter()
    check_out(arguments)
    with destination(arguments, OUT) as out, output_folder(out, overwrite=arguments.overwrite) as folder:
        demo = run_demo(
            folder,
            seed=arguments.seed,
            progress=lambda text: print(f"vlab demo: {text} ...", file=sys.stderr, flush=True),
        )
        print("vlab demo: report ...", file=sys.stderr, flush=True)
        from vlab.views.reports.demo import write_demo

        write_demo(demo, folder)
        write_manifest(folder, verb="demo")
    seconds = time.perf_counter() - begun
    rows = [[t.table, t.title, t.ok] for t in demo.tables]
    misfits = [[c.case.table.title, name, value] for c in demo.comparisons for name, value in c.nrmse.items()]
    text = "\n\n".join(
        [
            text_table(["table", "published and ours", "within tolerance"], rows),
            "MFDRF in the loop at 2 kHz: closed-loop poles from the simulated time histories\n"
            + text_table(
                ["mode", "predicted Hz", "identified Hz", "predicted zeta", "identified zeta", "off %"],
                demo.damping_rows(),
            ),
            f"Concealed in the beam: {demo.concealed.truth}\n"
            + text_table(
                ["found", "place", "probability"],
                [
                    [f.effect, f.place, format_probability(f.probability)]
                    for f in demo.concealed.done.diagnosis.findings
                ],
            ),
            "Real recordings beside their nominal model\n" + text_table(["case", "recording", "NRMSE"], misfits),
            f"{seconds:.0f} s; report: {out}/report.html; moving structure: vlab show {out}",
        ]
    )
    document = {
        "out": str(out),
        "report": f"{out}/report.html",
        "rrd": f"{out}/run.rrd",
        "seconds": seconds,
        "tables_ok": all(t.ok for t in demo.tables),
        "closed_loop": [
            dict(
                zip(
                    ("mode", "predicted_hz", "identified_hz", "predicted_zeta", "identified_zeta", "off_percent"),
                    row,
                    strict=True,
                )
            )
            for row in demo.damping_rows()
        ],
        "concealed": {
            "truth": demo.concealed.truth,
            "is_found": demo.concealed.is_found,
            "diagnosis": demo.concealed.done.diagnosis.to_json(),
        },
        "nrmse": {c.case.table.title: c.nrmse for c in demo.comparisons},
    }
    return Outcome(document=document, text=text, holds=all(t.ok for t in demo.tables) and demo.concealed.is_found)
