"""``vlab design``."""

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from vlab import units
from vlab.api.design import UNITS, design
from vlab.api.law_argument import file_of
from vlab.cli.common import Outcome, add_seed
from vlab.cli.destination import add_out, check_out
from vlab.cli.table import text_table
from vlab.controllers.catalogue import LAWS, laws_with_delay
from vlab.controllers.lqdrf import KINDS
from vlab.controllers.rate_feedback_design import PRINTED
from vlab.errors import BadDesign, unknown_name
from vlab.fe.reduced import MODELS
from vlab.files.output_folder import MANIFEST
from vlab.files.text import in_line
from vlab.hardware.array_controller import array_text
from vlab.lab.robustness import robustness_text


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("structure", help="use this built-in structure (beam, grid) or structure file")
    parser.add_argument(
        "--law",
        default="",
        help=f"design this law: {', '.join(LAWS)}; or judge a law: path/to/law.py:ClassName, entry:NAME, controller.toml (required)",
    )
    parser.add_argument(
        "--model", help=f"design on this model: {', '.join(MODELS)} (default: that of the published design)"
    )
    parser.add_argument(
        "--variant", default="published", help="model this variant of the structure: published (default) or physical"
    )
    published = " (default: that of the published design)"
    parser.add_argument("--weights", help="weight the state by identity, Q = q I (default), or energy, Q = diag(M, K)")
    for name, what in (
        ("q", "set Q = q I"),
        ("r", "set R = r I"),
        ("v1", "set the intensity of the process noise, V1 = v1 I"),
        ("v2", "set the intensity of the measurement noise, V2 = v2 I"),
        ("alpha", "set the stability margin of the filter"),
    ):
        parser.add_argument(f"--{name}", type=float, help=f"{what}, in the units of --units{published}")
    parser.add_argument(
        "--units",
        choices=UNITS,
        default="si",
        help="read --q, --r, --v1, --v2 and --alpha in m, N and s (si, default), or in inches, pounds and centiseconds "
        "(published)",
    )
    parser.add_argument(
        "--damping", type=float, help=f"bound the damping ratio of the first modes from below [-]{published}"
    )
    parser.add_argument("--modes", type=int, help=f"apply that bound to this number of modes{published}")
    parser.add_argument("--shapes", type=int, help=f"minimise LQDRF over this number of initial shapes{published}")
    parser.add_argument(
        "--objective",
        help="lqdrf: minimise the largest index (largest) or the largest ratio to the regulator's index (ratio) (default largest)",
    )
    parser.add_argument(
        "--starts", type=int, help="search from this number of random starts (default: that of the law)"
    )
    add_seed(parser, "draw the random starts with this seed (default 0)")
    parser.add_argument("--rate", type=float, help="sample a law with states at this rate in Hz (default 1000)")
    parser.add_argument(
        "--with-delay",
        action="store_true",
        help=f"{', '.join(laws_with_delay())}: design for the loop with its delay and hold (default: without)",
    )
    parser.add_argument(
        "--robustness",
        action="store_true",
        help="compute margins of the sampled loop and the first unstable mode (default: no)",
    )
    parser.add_argument("--array", action="store_true", help="check the law on the array controller (default: no)")
    add_out(parser, "design.json, controller.toml and figures to this folder (default: print only)")


def run(arguments: argparse.Namespace) -> Outcome:
    """Design a law, or load one, and report its performance.

    Parameters
    ----------
    arguments : Namespace
        Parsed arguments of the command.

    Returns
    -------
    Outcome
        Document and text of the command.
    """
    if not arguments.law:
        raise BadDesign(f"no law was named; give --law with one of {', '.join(LAWS)}, or a law file")
    if arguments.with_delay and arguments.law not in laws_with_delay():
        known = ", ".join(laws_with_delay())
        raise BadDesign(
            f"--with-delay is for the law {known}; {arguments.law!r} has no model that the delay could be in"
        )
    if arguments.objective is not None and arguments.objective not in KINDS:
        raise unknown_name("objective", arguments.objective, KINDS, where="--objective")
    check_out(arguments, read=[arguments.structure, file_of(arguments.law)])
    same = (
        "variant", "weights", "q", "r", "v1", "v2", "alpha", "damping", "modes", "shapes", "objective", "starts", "seed",
        "with_delay", "robustness", "array", "units",
    )  # fmt: skip
    settings = {name: getattr(arguments, name) for name in same}
    made = design(arguments.structure, arguments.law, model=arguments.model or "", rate_hz=arguments.rate, **settings)
    document = made.document
    if arguments.out:
        made.save(arguments.out, overwrite=arguments.overwrite)
        document["out"] = str(arguments.out)
    return Outcome(document=document, text=_text(made.structure.title, document))


def _asked_text(asked: dict[str, Any]) -> str:
    """Return weights, noise and margin with their units."""
    names = [name for name in asked["units"] if name != "q" or asked["weights"] == "identity"]
    weights = "Q = q I" if asked["weights"] == "identity" else "Q = diag(M, K)"
    each = ", ".join(f"{name} = {asked[name]:g} ({asked['units'][name]})" for name in names)
    return f"{weights}, R = r I, V1 = v1 I, V2 = v2 I; {each}"


def _text(title: str, document: dict[str, Any]) -> str:
    objective = document["objective"]
    lines = [f"{in_line(title)}: {document['law']} on the {document['model']} model, {document['seconds']:.2f} s", ""]
    if "asked" in document:
        lines[1:1] = [_asked_text(document["asked"])]
    gains = document["gains"]
    if gains["unit"] == "N s/m":
        D = units.from_si(np.array(gains["D"]), PRINTED, "N s/m")
        rows = [
            [name, *(round(float(d), 6) + 0.0 for d in row)] for name, row in zip(gains["actuators"], D, strict=True)
        ]
        lines += [text_table([f"D [{PRINTED}]", *gains["sensors"]], rows), ""]
    keys = ("modes", "frequencies_hz", "damping_ratios", "performance_indices")
    rows = [list(row) for row in zip(*(document[key] for key in keys), strict=True)]
    lines += [text_table(["mode", "Hz", "damping ratio", "index"], rows), ""]
    shown = f"{objective['value']:.6g} {objective['unit']}".removesuffix(" 1")
    printed = objective.get(f"value_{PRINTED}")
    lines.append(f"{objective['name']}: {shown}" + (f" ({printed:.5f} {PRINTED})" if printed is not None else ""))
    if "search" in document:
        search = document["search"]
        bound = f"; nothing lies below {search['lower_bound']:.6g}" if search["lower_bound"] is not None else ""
        rest = "" if search["converged"] else " (not at rest: modes meet there, more may be had)"
        lines += [
            f"{search['reached']} of {search['starts']} starts reached it; the last step promised {search['local_gap']:.1e} of it{rest}{bound}",
            f"a better optimum that attracts more than {search['unseen_share']:.0%} of the starts would have been seen with 95 % probability",
            "optima found: " + ", ".join(f"{value:.6g}" for value in search["local_minima"]),
            "active: " + (", ".join(f"{name} ({price:.3g})" for name, price in search["active"].items()) or "nothing"),
        ]
    if "array" in document:
        lines += ["", array_text(document["array"])]
    if "robustness" in document:
        lines += ["", "in the sampled loop on the full model:", robustness_text(document["robustness"])]
    if "out" in document:
        there = sorted(path.name for path in Path(document["out"]).iterdir() if path.name != MANIFEST)
        lines.append(f"written to {document['out']}: {', '.join(there)}")
    return "\n".join(lines)
