"""``vlab prove --real``."""

import argparse
from pathlib import Path
from typing import Any

from vlab.cli.common import Outcome, count_bar
from vlab.cli.table import text_table
from vlab.errors import BadExperiment
from vlab.proof.real.prove import prove_real
from vlab.proof.real.table import box_words, finding_words, key_words, metric_cells, percent
from vlab.recordings.files import written_whole

FIGURE = "real.svg"
OF_CONCEALED = ("cases", "quick", "seed", "truth", "first", "baselines", "reports")
"""OF_CONCEALED: arguments that belong to concealed cases."""


def run_real(arguments: argparse.Namespace) -> Outcome:
    """Diagnose real recordings and compare the answers with what is known.

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
    BadExperiment
        An argument of concealed cases is given, or the output folder or a valid time limit is missing.
    """
    stated = next((name for name in OF_CONCEALED if getattr(arguments, name)), None)
    if stated is not None:
        given = "the folder of concealed cases" if stated == "cases" else f"--{stated}"
        raise BadExperiment(f"{given} does not go with --real; leave it away")
    if not arguments.out:
        raise BadExperiment("--real keeps finished answers; name their folder with --out DIR")
    if arguments.time_limit is not None and not arguments.time_limit > 0.0:
        raise BadExperiment(f"time-limit is {arguments.time_limit:g}; accepted: a positive number of seconds")
    out = Path(arguments.out)
    with count_bar("prove", 1) as report:
        found = prove_real(
            [Path(folder) for folder in arguments.real],
            out,
            keys=Path(arguments.keys) if arguments.keys else None,
            time_limit=arguments.time_limit,
            engine=arguments.engine,
            jobs=arguments.jobs,
            scheduler=arguments.scheduler,
            progress=report,
        )
    _draw(found, out / FIGURE)
    return Outcome(document={**found, "out": str(out)}, text=_text(found, out))


def _draw(found: dict[str, Any], path: Path) -> None:
    from vlab.views.figures import to_svg
    from vlab.views.figures.real import real_figure

    with written_whole(path) as stream:
        stream.write(to_svg(real_figure(found["cases"])).encode())


def _text(found: dict[str, Any], out: Path) -> str:
    heads = ["case", "verdict", "findings", "key", "nominal", "calibrated", "extended", "linear", "nonlinear", "s"]
    rows = [
        [
            row["case"],
            row["verdict"],
            finding_words(row),
            key_words(row),
            *(percent(row["errors"][model]) for model in ("nominal", "calibrated", "extended")),
            *(box_words(row, kind) for kind in ("linear", "nonlinear")),
            f"{row['seconds']:.0f}",
        ]
        for row in found["cases"]
    ]
    parts = [text_table(heads, rows)]
    marks = [cells for row in found["cases"] for cells in metric_cells(row)]
    if marks:
        parts.append(text_table(["benchmark", "recording", "model", "RMSE", "relative error [%]"], marks))
    parts.append("errors in % of the rms of the hold-out recordings; linear and nonlinear are black boxes")
    parts.append(f"{found['summary']}\nreal.json, real.md and {FIGURE} in {out}")
    return "\n\n".join(parts)
