"""``vlab modes``."""

import argparse
from typing import Any

import numpy as np

from vlab.cli.common import Outcome
from vlab.cli.destination import add_out, check_out
from vlab.cli.table import text_table
from vlab.errors import BadStructure
from vlab.files.output_folder import output_folder, write_manifest
from vlab.files.text import in_line
from vlab.modal.mac import comac, mac
from vlab.reproduce import cross_check
from vlab.reproduce.cross_check import SILENT, CrossCheck
from vlab.signals import Array, ModalModel
from vlab.structure import load_structure
from vlab.structure.model import Structure

CALLED = {"fe": "FE matrices"}
"""CALLED: words for a plant whose name in files is that of the FE model; its matrices are integrated in MuJoCo."""
LEAST_MAC = 0.8
"""LEAST_MAC [1]: MAC below which a plant's mode is no counterpart of the FE model's."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("structure", help="use this built-in structure (beam, grid) or structure file")
    parser.add_argument(
        "--variant", default="published", help="model this variant of the structure: published (default) or physical"
    )
    parser.add_argument(
        "--model",
        default="full",
        help="use the full FE model (default), or its exact or guyan reduction to the retained coordinates",
    )
    parser.add_argument(
        "--modes",
        type=int,
        choices=range(1, 13),
        metavar="N",
        help="compare this number of modes, 1 to 12 (default: all published)",
    )
    parser.add_argument(
        "--force", metavar="PLACE", help="with --out: draw open-loop responses to a force at this place (default: none)"
    )
    parser.add_argument(
        "--response",
        nargs="+",
        metavar="PLACE",
        help="with --force: draw responses at these places (default: all coils)",
    )
    add_out(
        parser,
        "report.html, mode shapes, their differences, MAC and responses as figures to this folder (default: print only)",
    )


def run(arguments: argparse.Namespace) -> Outcome:
    """Compare FE model, plants and published values.

    Parameters
    ----------
    arguments : Namespace
        Parsed arguments of the command.

    Returns
    -------
    Outcome
        Document and text of the command.
    """
    structure = load_structure(arguments.structure)
    if (arguments.force or arguments.response) and not (arguments.force and arguments.out):
        raise BadStructure("responses are figures: give --force, where the force acts, and --out, the folder for them")
    check_out(arguments, read=[arguments.structure])
    check = cross_check(structure, arguments.variant, model=arguments.model, modes=arguments.modes)
    document = check.as_dict()
    fe_modes = check.fe_modes()
    plant_modes = {name: check.plant_modes(name) for name in check.plants}
    alike = {name: comac(_moving(fe_modes), _moving(modes)) for name, modes in plant_modes.items()}
    cross_mac = {name: mac(fe_modes.shapes, modes.shapes) for name, modes in plant_modes.items()}
    document["comac"] = {name: dict(zip(check.points, values.tolist(), strict=True)) for name, values in alike.items()}
    document["cross_mac"] = {name: values.tolist() for name, values in cross_mac.items()}
    headers, rows = _table(document, list(check.plants))
    lines = [
        f"{in_line(structure.title)}, variant {arguments.variant}, {arguments.model} FE model",
        "",
        text_table(headers, rows),
        "",
        *_plant_lines(document),
        "",
    ]
    for name, values in alike.items():
        lowest = [f"{check.points[k]} {values[k]:.4f}" for k in values.argsort(kind="stable")[:3]]
        lines.append(f"{_called(name)}: lowest COMAC with the FE model over {len(rows)} modes: {', '.join(lowest)}")
    lines += _unmatched(document, arguments.model)
    lines.append("COMAC and figures compare shape with shape; MAC in the table, a shape with its group of close modes")
    if arguments.out:
        from vlab.views.reports.page import Section, write_report

        drawn = _figures(arguments, structure, check, cross_mac)
        with output_folder(arguments.out, overwrite=arguments.overwrite) as folder:
            for file, (svg, _) in drawn.items():
                (folder / f"{file}.svg").write_text(svg, encoding="utf-8")
            sections = [
                Section(title="Frequencies", tables=[(headers, rows)], text=tuple(line for line in lines[4:] if line)),
                Section(title="Figures", figures=list(drawn.values())),
            ]
            write_report(folder / "report.html", title=f"Modes: {in_line(structure.title)}", sections=sections)
            write_manifest(
                folder, verb="modes", structure=structure.name, variant=arguments.variant, model=arguments.model
            )
        document["out"] = str(arguments.out)
        lines += ["", f"written to {arguments.out}: report.html and {len(drawn)} figures"]
    return Outcome(document=document, text="\n".join(lines))


def _called(name: str) -> str:
    return CALLED.get(name, name)


def _table(document: dict[str, Any], plants: list[str]) -> tuple[list[str], list[list[Any]]]:
    """Return headers and rows of the frequencies."""
    headers = ["mode", "measured Hz", "published Hz", "FE model Hz"]
    headers += [text for name in plants for text in (f"MuJoCo {_called(name)} Hz", "MAC")] + ["zeta"]
    rows = [
        [row["mode"], row["measured_hz"], row["published_hz"], row["fe_hz"]]
        + [value for name in plants for value in (row["plant_hz"][name], row["mac"][name])]
        + [row["zeta"]]
        for row in document["modes"]
    ]
    return headers, rows


def _plant_lines(document: dict[str, Any]) -> list[str]:
    return [
        f"{_called(name)}: {facts['dof']} DOF, step {facts['timestep_s'] * 1e3:g} ms, numerical damping {facts['numerical_damping_ratio']:.1e}, "
        f"{facts['real_time_factor']:.0f} x real time; leaves out: {'; '.join(facts['left_out'])}"
        for name, facts in document["plants"].items()
    ]


def _unmatched(document: dict[str, Any], model: str) -> list[str]:
    """Return a line on modes without a counterpart, if there are any."""
    plants = list(document["plants"])
    far = [(row["mode"], name) for row in document["modes"] for name in plants if (row["mac"][name] or 0.0) < LEAST_MAC]
    if not far:
        return []
    named = ", ".join(f"mode {mode} of {_called(name)}" for mode, name in far)
    guyan = "; Guyan reduction is the error here, --model full has none" if model == "guyan" else ""
    return [f"no counterpart (MAC below {LEAST_MAC:g}): {named}{guyan}"]


def _figures(
    arguments: argparse.Namespace, structure: Structure, check: CrossCheck, cross_mac: dict[str, Array]
) -> dict[str, tuple[str, str]]:
    """Return SVG figures with their captions, by name of the file."""
    from vlab.views.figures import mac_figure, mode_difference_figure, mode_shapes_figure, to_svg

    responses = {}
    if arguments.force:
        from vlab.views.figures.structure_response import response_figures

        responses = response_figures(check.fe, arguments.force, arguments.response or ())
    drawn = {file: (to_svg(figure), file) for file, figure in responses.items()}
    fe_modes = check.fe_modes()
    for name in check.plants:
        modes = check.plant_modes(name)
        drawn[f"shapes-{name}"] = (
            to_svg(mode_shapes_figure(structure, fe_modes, modes)),
            f"Mode shapes, {_called(name)} plant.",
        )
        figure = mac_figure(cross_mac[name], rows="FE", columns=f"{_called(name)} plant")
        drawn[f"mac-{name}"] = (to_svg(figure), f"MAC of the FE model and the {_called(name)} plant.")
        for mode in range(1, fe_modes.freq.size + 1):
            labels = (f"{_called(name)} plant", "analytical (FE)")
            figure = mode_difference_figure(structure, modes, fe_modes, mode, labels=labels)
            caption = f"Mode {mode}, {_called(name)} plant beside FE model."
            drawn[f"difference-{name}-mode{mode:02d}"] = (to_svg(figure), caption)
    return drawn


def _moving(modes: ModalModel) -> Array:
    """Return shapes of unit maximum, with zeros for rounding at fixed points."""
    return np.where(np.abs(modes.shapes) < SILENT, 0.0, modes.shapes)
