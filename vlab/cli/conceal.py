"""``vlab conceal``."""

import argparse
from pathlib import Path

from vlab.cli.common import Outcome, add_seed, count_bar
from vlab.cli.table import text_table
from vlab.errors import BadExperiment
from vlab.proof.campaign import ENGINES
from vlab.proof.conceal import conceal_cases, regenerate_cases
from vlab.proof.seal import truth_folder
from vlab.proof.suites import BENCHES, MIXTURES, OWN_FE, SHARED_FE, SOURCES, SUITES


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    known = ", ".join([*SUITES, *MIXTURES])
    parser.add_argument(
        "--suite", default="all", help=f"draw from these suites, separated by commas: {known} (default all)"
    )
    parser.add_argument("--n", type=int, default=12, help="generate this number of cases (default 12)")
    add_seed(parser, "draw everything with this seed (default: fresh, or the seed of the interrupted run)")
    parser.add_argument("--out", help="write the cases to this folder and the truth to OUT-truth (required)")
    parser.add_argument(
        "--benches",
        default=",".join(BENCHES),
        help=f"use these benches, separated by commas: {', '.join(BENCHES)} (default all)",
    )
    parser.add_argument(
        "--structures",
        default=OWN_FE,
        help=f"build beam and grid with the FE code of the generator ({OWN_FE}) or of the diagnosed plants ({SHARED_FE}) "
        f"(default {OWN_FE}); accepted: {', '.join(SOURCES)}",
    )
    parser.add_argument(
        "--again",
        help="regenerate the recordings of this sealed folder, or of this file of vlab prove --pack, bit for bit into OUT "
        "(default: new cases)",
    )
    parser.add_argument(
        "--only", default="", help="with --again: regenerate these cases, separated by commas (default all)"
    )
    parser.add_argument(
        "--with-truth",
        action="store_true",
        help="with --again: write the truth to OUT-truth, too, if its salts were lost",
    )
    add_engine(parser)


def add_engine(parser: argparse.ArgumentParser) -> None:
    """Add the arguments for the distribution of many cases."""
    parser.add_argument(
        "--engine",
        default="joblib",
        choices=ENGINES,
        help="distribute cases with joblib (this machine) or dask (a cluster) (default joblib)",
    )
    parser.add_argument("--jobs", type=int, default=0, help="run this number of processes (default 0: one per core)")
    parser.add_argument(
        "--scheduler", default="", help="connect to the dask scheduler at this address (default: start one)"
    )


def run(arguments: argparse.Namespace) -> Outcome:
    """Generate concealed cases.

    Parameters
    ----------
    arguments : Namespace
        Parsed arguments of the command.

    Returns
    -------
    Outcome
        Document and text of the command.
    """
    if not arguments.out:
        raise BadExperiment("name the folder of the cases with --out; their truth goes to a folder beside it")
    for option, given in (("--only", arguments.only), ("--with-truth", arguments.with_truth)):
        if given and not arguments.again:
            raise BadExperiment(f"{option} belongs to --again, which makes sealed cases again")
    if arguments.again:
        return _again(Path(arguments.again), Path(arguments.out), arguments)
    out = Path(arguments.out)
    with count_bar("conceal", arguments.n) as report:
        commitments, _ = conceal_cases(
            out,
            suites=arguments.suite.split(","),
            count=arguments.n,
            seed=arguments.seed,
            benches=arguments.benches.split(","),
            structures=arguments.structures,
            engine=arguments.engine,
            jobs=arguments.jobs,
            scheduler=arguments.scheduler,
            progress=report,
        )
    document = {
        "out": str(out),
        "truth": str(truth_folder(out)),
        "cases": list(commitments),
        "commitments": commitments,
    }
    table = text_table(["case", "commitment"], list(commitments.items()))
    return Outcome(
        document=document, text=f"{table}\n\ncases in {out}, their truth and the seed in {truth_folder(out)}"
    )


def _again(sealed: Path, out: Path, arguments: argparse.Namespace) -> Outcome:
    with count_bar("conceal", 1) as report:
        commitments = regenerate_cases(
            sealed,
            out,
            only=[name for name in arguments.only.split(",") if name],
            with_truth=arguments.with_truth,
            engine=arguments.engine,
            jobs=arguments.jobs,
            scheduler=arguments.scheduler,
            progress=report,
        )
    document = {"out": str(out), "cases": list(commitments), "commitments": commitments}
    return Outcome(document=document, text=f"{len(commitments)} cases made again in {out}, bit for bit as sealed")
