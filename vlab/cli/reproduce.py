"""``vlab reproduce``."""

import argparse
from collections.abc import Sequence
from typing import Any

from vlab.cli.common import Outcome, add_seed, progress_bar, share_bar
from vlab.cli.destination import add_out, check_out, destination
from vlab.cli.loop_summary import effort_table, ring_down_table
from vlab.cli.table import text_table
from vlab.errors import BadExperiment
from vlab.files.output_folder import finite, output_folder, write_manifest
from vlab.reproduce.control_bench import HARDWARE, TESTS
from vlab.reproduce.figures.control import FIGURES, control_figure
from vlab.reproduce.tables.registry import (
    NOT_REPRODUCIBLE,
    ON_REQUEST,
    SIMULATED,
    TABLES,
    ReproducedTable,
    reproduce_tables,
    share,
    structure_of,
    widened,
)
from vlab.structure import load_structure


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "table",
        nargs="*",
        help=f"reproduce these tables: {', '.join(TABLES)} (default: all but {' and '.join(ON_REQUEST)}, which take a minute more); "
        f"{', '.join(SIMULATED)} use simulated experiments",
    )
    parser.add_argument(
        "--figure",
        metavar="N",
        help=f"draw a figure from simulated experiments instead: {', '.join(FIGURES)}; as SVG, CSV and JSON (default: none)",
    )
    parser.add_argument(
        "--plant",
        default="",
        help=f"simulate experiments on this plant: composite or modal (default {_default_plants()})",
    )
    add_seed(parser, "draw excitation and noise of the experiments with this seed (default 0)", default=0)
    parser.add_argument(
        "--limit-cycle",
        action="store_true",
        help="study the 41 Hz limit cycle of LQG on the beam (section 6.1) instead of tables (default: no)",
    )
    add_out(
        parser,
        "to this folder; with --figure N: figures (default out/figure-N-001, or the next number); with --limit-cycle: "
        "JSON, time histories and figures (two minutes; default: print only)",
    )


def _default_plants() -> str:
    return ", ".join(f"{test.plant} of the {name}" for name, test in TESTS.items())


def run(arguments: argparse.Namespace) -> Outcome:
    """Print published value, own value, tolerance and result of each cell.

    Parameters
    ----------
    arguments : Namespace
        Parsed arguments of the command.

    Returns
    -------
    Outcome
        Document and text of the command.
    """
    check_out(arguments)
    if arguments.limit_cycle:
        return _limit_cycle(arguments)
    if arguments.figure is not None:
        return _figure(arguments)
    if arguments.out:
        raise BadExperiment("--out belongs to --figure and --limit-cycle; the tables come as JSON with --json")
    with share_bar("tables") as report:
        tables = reproduce_tables(
            arguments.table, plant=arguments.plant, seed=arguments.seed, progress=lambda text: report(0.0, text)
        )
    missing = [{"table": table, "why": why} for table, why in NOT_REPRODUCIBLE.items()]
    lines = [line for table in tables for line in _table_lines(table)]
    shares = {name: _shares(tables, name) for name in ("beam", "grid")}
    lines += ["Cells that the published data determine, inside the honest tolerance:"]
    for name, counted in shares.items():
        if counted["of"]:
            percent = 100 * counted["inside_honest"] / counted["of"]
            lines += [f"  {name}: {counted['inside_honest']} of {counted['of']} ({percent:.3g} %)"]
    lines += _widened_lines(tables)
    shown = share(tables, determined=False)
    if shown.of:
        lines += [f"In brackets: {shown} cells that they do not determine; see below."]
    lines += ["", "Not reproduced:", *(f"  Table {part['table']}: {part['why']}" for part in missing)]
    if not arguments.table:
        lines += ["", f"Left out unless named, a minute more: vlab reproduce {' '.join(ON_REQUEST)}"]
    lines += ["", f"Figures with simulated experiments, vlab reproduce --figure N: {', '.join(FIGURES)}"]
    figures = [{"figure": number, "structure": known, "title": title} for number, (known, title, _) in FIGURES.items()]
    document = {
        "tables": [t.as_dict() for t in tables],
        "shares": shares,
        "not_reproducible": missing,
        "figures": figures,
        "on_request": list(ON_REQUEST),
    }
    return Outcome(document=document, text="\n".join(lines), holds=all(t.ok for t in tables))


def _table_lines(table: ReproducedTable) -> list[str]:
    rows = [
        [
            c.row,
            c.column,
            c.published,
            c.ours,
            c.unit,
            None if c.off is None else 100 * c.off,
            c.allowed + ("" if c.honest is None else " *"),
            c.ok if c.determined else f"({'yes' if c.ok else 'no'})",
        ]
        for c in table.cells
    ]
    headers = ["row", "column", "published", "ours", "unit", "off %", "tolerance", "ok"]
    return [f"Table {table.table}. {table.title}", "", text_table(headers, rows), ""]


def _shares(tables: Sequence[ReproducedTable], structure: str) -> dict[str, int]:
    """Count the determined cells within tolerance."""
    own = [table for table in tables if structure_of(table.table) == structure]
    held, honest = share(own), share(own, honest=True)
    return {"of": held.of, "inside_honest": honest.inside, "inside": held.inside}


def _widened_lines(tables: Sequence[ReproducedTable]) -> list[str]:
    """Return the cells with a widened tolerance, and whether each needs it."""
    wide = widened(tables)
    if not wide:
        return []
    rows = [
        f"  Table {number}, {c.column}, {c.row}: {100 * abs(c.off or 0.0):.3g} % off, {100 * (c.honest or 0.0):.3g} % honest, {c.allowed} allowed"
        for number, c in wide
    ]
    return [f"Widened (*): {len(wide)} cells, {sum(c.ok for _, c in wide)} of them inside the wider tolerance:", *rows]


def _figure(arguments: argparse.Namespace) -> Outcome:
    """Run the experiments of a figure and write it."""
    if arguments.table:
        raise BadExperiment(
            f"--figure {arguments.figure} stands alone; leave the tables {', '.join(arguments.table)} away"
        )
    with share_bar(f"figure {arguments.figure}") as report:
        figure = control_figure(
            arguments.figure, plant=arguments.plant, seed=arguments.seed, progress=lambda text: report(0.0, text)
        )
    from vlab.views.reports.control_test import write_control_figure

    with (
        destination(arguments, f"out/figure-{figure.number}") as out,
        output_folder(out, overwrite=arguments.overwrite) as folder,
    ):
        files = write_control_figure(folder, figure)
        write_manifest(
            folder,
            verb="reproduce",
            figure=figure.number,
            plant=figure.plant,
            seed=arguments.seed,
            hardware_values=list(HARDWARE),
        )
    document = figure.as_dict() | {"out": str(out), "files": files}
    lines = [f"{figure.title}; {figure.plant} plant", ""]
    lines += _ring_down_lines(document) if figure.ring_downs else _ratio_lines(document)
    return Outcome(document=finite(document), text="\n".join([*lines, f"written to {out}: {', '.join(files)}"]))


def _ratio_lines(document: dict[str, Any]) -> list[str]:
    """Return peak levels of analysis and experiment, and the actuator effort."""
    rows = [
        [
            part["panel"],
            part["analysis"],
            *(f"{ratio:.2f}" for ratio in part["over_experiment"]),
            f"{part['average_error']:.2f}",
        ]
        for part in document["peak_ratios"]
    ]
    modes = max(len(part["over_experiment"]) for part in document["peak_ratios"])
    lines = ["Peak levels, analysis over simulated experiment:", ""]
    lines += [text_table(["law", "analysis", *(f"mode {i + 1}" for i in range(modes)), "average error"], rows), ""]
    return lines + _effort_lines(document["effort"])


def _ring_down_lines(document: dict[str, Any]) -> list[str]:
    """Return measured damping beside predicted poles, and the actuator effort."""
    parts = document["ring_downs"]
    table = ring_down_table({part["law"]: part["modes"] for part in parts})
    return [table, "", *_effort_lines({part["law"]: part["effort"] for part in parts})]


def _effort_lines(effort: dict[str, Any]) -> list[str]:
    return ["Effort of the actuators:", "", effort_table(effort), ""]


def _limit_cycle(arguments: argparse.Namespace) -> Outcome:
    """Report the limit cycle's explanations, and histories to a folder."""
    from vlab.reproduce.limit_cycle.odds import limit_cycle_odds
    from vlab.reproduce.limit_cycle.runs import simulated_seconds
    from vlab.reproduce.limit_cycle.study import limit_cycle_report

    if arguments.table:
        raise BadExperiment(f"--limit-cycle is a study of its own; leave the tables {', '.join(arguments.table)} away")
    beam = load_structure("beam")
    with share_bar("explanations") as told:
        odds = limit_cycle_odds(beam, seed=arguments.seed, progress=told)
    if not arguments.out:
        document: dict[str, Any] = {**limit_cycle_report(beam), "odds": odds}
    else:
        from vlab.views.reports.limit_cycle import write_limit_cycle

        with output_folder(arguments.out, overwrite=arguments.overwrite) as folder:
            with progress_bar("time histories", simulated_seconds()) as report:
                document = write_limit_cycle(folder, beam, odds, progress=report)
            write_manifest(folder, verb="reproduce", structure=beam.name, study="limit-cycle")
        document["out"] = str(arguments.out)
    lines = [
        "The limit cycle near 41 Hz of LQG on the beam (section 6.1)",
        "",
        *document["verdict"],
        *document["odds"]["sentences"],
    ]
    lines += [line for run in document.get("histories", ()) for line in _history_lines(run)]
    if arguments.out:
        lines += ["", f"written to {arguments.out}: limit-cycle.json, figures"]
    return Outcome(document=finite(document), text="\n".join(lines))


def _history_lines(run: dict[str, Any]) -> list[str]:
    """Return the outcome of a time history beside its prediction."""
    parts = []
    for name in ("simulated", "predicted"):
        told = run[name]
        values = [
            f"{told[key]:.3g} {unit}"
            for key, unit in (("hz", "Hz"), ("amplitude_n", "N"), ("growth_per_s", "1/s growth"))
            if told.get(key) is not None
        ]
        parts.append(f"{name} {', '.join(values) or 'nothing'}")
    return [f"{run['name']}: {'; '.join(parts)}"]
