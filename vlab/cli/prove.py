"""``vlab prove``."""

import argparse
import contextlib
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

from vlab.cli.common import Outcome, add_seed, count_bar
from vlab.cli.conceal import add_engine
from vlab.cli.prove_real import run_real
from vlab.cli.table import text_table
from vlab.errors import BadExperiment, OutputRefused
from vlab.files.output_folder import numbered_folder
from vlab.proof.conceal import conceal_cases
from vlab.proof.levels import level_table
from vlab.proof.pack import CASES, gather, is_pack, write_pack
from vlab.proof.peers.registry import PEERS
from vlab.proof.peers.scoring import peer_table
from vlab.proof.prove import prove, prove_packed, table_rows
from vlab.proof.seal import answers_folder, truth_folder
from vlab.proof.stated import decision_table, stated_table

QUICK_CASES = 12
QUICK_BENCHES = ("slider", "shaft")
MOST_NAMED = 10
"""MOST_NAMED [-]: most truths without salts named in the text."""
MOST_SHOWN = 60
"""MOST_SHOWN [-]: most cases listed one by one in the text."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "cases",
        nargs="?",
        help="diagnose the cases in this folder of vlab conceal, or count the campaign in this file of --pack again; "
        "not with --quick or --real",
    )
    parser.add_argument(
        "--real",
        nargs="+",
        metavar="FOLDER",
        help="diagnose real recordings instead, in these folders, beside black-box models and what is known of them; "
        "needs --out, which keeps finished answers (default: no)",
    )
    parser.add_argument(
        "--keys", metavar="FILE.toml", help="with --real: read what is known from this file (default assets/real.toml)"
    )
    parser.add_argument(
        "--time-limit",
        type=float,
        metavar="SECONDS",
        help="with --real: add no effects to a case after this time (default: no limit)",
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help="conceal fresh cases first, with a fresh seed that is printed (default: no)",
    )
    add_seed(parser, "with --quick: draw with this seed (default: fresh)")
    parser.add_argument(
        "--n", type=int, default=QUICK_CASES, help="with --quick: conceal this number of cases (default 12)"
    )
    parser.add_argument("--truth", help="read the truth from this folder (default CASES-truth)")
    parser.add_argument(
        "--out",
        help="write answers and score to this folder (default CASES-answers), or unpack a file into this folder "
        "(default out/NAME-001, or the next number)",
    )
    parser.add_argument("--pack", metavar="FILE", help="write the finished campaign to this new file (default: none)")
    parser.add_argument(
        "--first",
        type=int,
        default=0,
        metavar="N",
        help="answer and score the first N cases in drawn order (default 0: all)",
    )
    parser.add_argument(
        "--baselines",
        type=int,
        metavar="N",
        help="run other methods on the same cases, and slow ones, minutes per case, on the first N (default: none)",
    )
    parser.add_argument(
        "--peers",
        default="",
        metavar="NAMES",
        help=f"with --baselines: run these methods only, of {', '.join(PEERS)}; separate by commas (default: all)",
    )
    parser.add_argument(
        "--reports", type=int, default=0, help="write reports of this number of worst cases (default 0)"
    )
    add_engine(parser)


def run(arguments: argparse.Namespace) -> Outcome:
    """Diagnose concealed cases and score the answers.

    Parameters
    ----------
    arguments : Namespace
        Parsed arguments of the command.

    Returns
    -------
    Outcome
        Document and text of the command.
    """
    if arguments.real:
        return run_real(arguments)
    stated = next((f"--{name.replace('_', '-')}" for name in ("keys", "time_limit") if getattr(arguments, name)), None)
    if stated is not None:
        raise BadExperiment(f"{stated} belongs to --real; concealed cases have their truth beside them")
    if bool(arguments.cases) == arguments.quick:
        raise BadExperiment("name a folder of concealed cases, or say --quick; one of the two")
    if arguments.baselines is not None and arguments.baselines < 0:
        raise BadExperiment(f"baselines is {arguments.baselines}; accepted: 0 or more cases for slow methods")
    if arguments.peers and arguments.baselines is None:
        raise BadExperiment("--peers belongs to --baselines; add --baselines N")
    if arguments.first < 0:
        raise BadExperiment(f"first is {arguments.first}; accepted: 1 or more cases, 0 for all")
    if not arguments.quick and arguments.seed is not None:
        raise BadExperiment("--seed belongs to --quick; the cases of a folder have theirs already")
    if arguments.pack and Path(arguments.pack).exists():
        raise OutputRefused(f"{arguments.pack}: is there already and is never written over; name another file")
    if not arguments.quick and is_pack(Path(arguments.cases)):
        return _counted_again(Path(arguments.cases), arguments)
    if not arguments.quick:
        return _outcome(_proved(Path(arguments.cases), arguments), None)
    with tempfile.TemporaryDirectory(prefix="vlab-prove-") as scratch:
        cases = Path(arguments.out or scratch) / "cases"
        with count_bar("conceal", arguments.n) as report:
            _, seed = conceal_cases(
                cases,
                suites=["quick"],
                count=arguments.n,
                seed=arguments.seed,
                benches=QUICK_BENCHES,
                engine=arguments.engine,
                jobs=arguments.jobs,
                scheduler=arguments.scheduler,
                progress=report,
            )
        found = _proved(cases, arguments, quick=True)
        return _outcome({**found, "out": found["out"] if arguments.out else None}, seed)


def _counted_again(file: Path, arguments: argparse.Namespace) -> Outcome:
    """Count a packed campaign, which has its truth but no recordings."""
    for option in ("truth", "first", "baselines", "reports", "pack"):
        if getattr(arguments, option) not in (None, "", 0) or (option == "baselines" and arguments.baselines == 0):
            raise BadExperiment(f"--{option} belongs to a folder of cases; {file} holds a finished campaign")
    named = contextlib.nullcontext(Path(arguments.out)) if arguments.out else numbered_folder(_default_out(file))
    with named as out, count_bar("prove", 1) as report:
        found, changed = prove_packed(
            file, out, engine=arguments.engine, jobs=arguments.jobs, scheduler=arguments.scheduler, progress=report
        )
    answers = answers_folder(out / CASES)
    _write_page(found, answers / "report.html")
    counted = _outcome({**found, "out": str(answers)}, None)
    same = "every measure is that of the packed score"
    differ = f"{len(changed)} measures differ from the packed score: {'; '.join(changed)}"
    return replace(counted, text=f"{counted.text}\n{differ if changed else same}", holds=not changed)


def _default_out(file: Path) -> Path:
    """Return the name that is numbered, without the suffixes."""
    return Path("out") / file.name.removesuffix(".xz").removesuffix(".jsonl")


def _proved(cases: Path, arguments: argparse.Namespace, quick: bool = False) -> dict[str, Any]:
    out = answers_folder(cases) if quick or not arguments.out else Path(arguments.out)
    truth = Path(arguments.truth) if arguments.truth else None
    with count_bar("prove", 1) as report:
        found = prove(
            cases,
            out,
            truth=truth,
            first=arguments.first,
            baselines=arguments.baselines,
            peers=[name.strip() for name in arguments.peers.split(",") if name.strip()],
            reports=arguments.reports,
            report=_write_report,
            engine=arguments.engine,
            jobs=arguments.jobs,
            scheduler=arguments.scheduler,
            progress=report,
        )
    _write_page(found, out / "report.html")
    if arguments.pack:
        write_pack(gather(cases, out, truth or truth_folder(cases)), Path(arguments.pack))
    return {**found, "out": str(out)}


def _write_page(found: dict[str, Any], path: Path) -> None:
    """Write the score as one page."""
    from vlab.views.reports import proof  # imports matplotlib

    proof.write_proof(found, path)


def _write_report(done: Any, folder: Path) -> None:
    from vlab.views.reports.diagnosis import write_diagnosis

    write_diagnosis(done, folder)


def _outcome(found: dict[str, Any], seed: int | None) -> Outcome:
    parts = [
        text_table(*table_rows(found)),
        text_table(["suite", "cases", "right", "95 % interval", "verdicts"], _suites(found)),
    ]
    parts += [text_table(*level_table(found["levels"])), text_table(*decision_table(found["decisions"]))]
    parts.append(text_table(*stated_table(found["stated"])))
    if len(found["judged"]) <= MOST_SHOWN:
        heads = ["case", "suite", "bench", "hidden", "at", "answered", "at", "right"]
        parts.append(text_table(heads, [_case(j) for j in found["judged"]]))
    if found["worst"]:
        rows = [[w["case"], w["suite"], _names(w), w["answered"], w["report"]] for w in found["worst"]]
        parts.append("worst:\n" + text_table(["case", "suite", "hidden", "answered", "report"], rows))
    parts.append(text_table(*peer_table(found)))
    parts.append(_opened(found))
    if not found["is_answered_first"]:
        parts.append("the truth had been opened for other answers before these were frozen: they are no evidence")
    if not found["is_counted_as_set_down"]:
        parts.append("the rules of counting are not those that were set down when the answers were begun")
    kept = (
        f"score and report.html in {found['out']}"
        if found["out"]
        else "nothing is kept; name a folder with --out to keep it"
    )
    drawn = "" if seed is None else f"seed {seed}; "
    parts.append(f"{found['cases']} cases; {drawn}{kept}")
    return Outcome(document={**found, "seed": seed}, text="\n\n".join(parts))


def _opened(found: dict[str, Any]) -> str:
    """Return a sentence on how the truths were opened, with counts."""
    again = found.get("truths_made_again", [])
    text = f"truths opened: {found['cases'] - len(again)} by the salt of their commitment"
    if not again:
        return text
    some = ", ".join(again[:MOST_NAMED]) + (f" and {len(again) - MOST_NAMED} more" if len(again) > MOST_NAMED else "")
    return (
        f"{text}, {len(again)} by making their recordings again from the seed, with the digests committed to ({some})"
    )


def _suites(found: dict[str, Any]) -> list[list[Any]]:
    rows = []
    for name, s in found["suites"].items():
        right = s["right"]
        verdicts = ", ".join(f"{v} {n}" for v, n in s["verdicts"].items())
        interval = f"{right['ci95'][0]:.3f} to {right['ci95'][1]:.3f}"
        rows.append([name, s["cases"], f"{right['count']}/{right['of']}", interval, verdicts])
    return rows


def _case(j: dict[str, Any]) -> list[Any]:
    known = [j["case"], j["suite"], j["bench"], _names(j), j["truth_place"]]
    return [*known, j["answered"], j["place"], j["right"]]


def _names(row: dict[str, Any]) -> str:
    return " + ".join(row["hidden"]) or "nothing"
