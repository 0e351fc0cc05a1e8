"""``vlab modes``."""

import argparse

from vlab.cli.common import Outcome, text_table
from vlab.outputs import output_folder, write_manifest
from vlab.reproduce import cross_check
from vlab.structure import load_structure


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's arguments."""
    parser.add_argument("structure", help="a built-in structure (beam, grid) or a structure file")
    parser.add_argument(
        "--variant", default="published", help="how the structure is modelled: published (default) or physical"
    )
    parser.add_argument(
        "--modes",
        type=int,
        choices=range(1, 13),
        metavar="N",
        help="how many modes (1 to 12; by default all published)",
    )
    parser.add_argument("--out", help="folder for mode shapes and MAC as figures")


def run(arguments: argparse.Namespace) -> Outcome:
    """Compare FE model, plants and published values."""
    structure = load_structure(arguments.structure)
    check = cross_check(structure, arguments.variant, modes=arguments.modes)
    document = check.as_dict()
    plants = list(check.plants)
    rows = [
        [row["mode"], row["measured_hz"], row["published_hz"], row["fe_hz"]]
        + [value for name in plants for value in (row["plant_hz"][name], row["mac"][name])]
        + [row["zeta"]]
        for row in document["modes"]
    ]
    headers = ["mode", "measured Hz", "published Hz", "FE Hz"]
    headers += [text for name in plants for text in (f"{name} Hz", "MAC")] + ["zeta"]
    lines = [f"{structure.title}, variant {arguments.variant}", "", text_table(headers, rows), ""]
    for name, facts in document["plants"].items():
        lines.append(
            f"{name}: {facts['dof']} DOF, step {facts['timestep_s'] * 1e3:g} ms, numerical damping {facts['numerical_damping_ratio']:.1e}, "
            f"{facts['real_time_factor']:.0f} x real time; leaves out: {'; '.join(facts['left_out'])}"
        )
    if arguments.out:
        from vlab.modal.mac import mac
        from vlab.views.figures import mac_figure, mode_shapes_figure, to_svg

        with output_folder(arguments.out) as folder:
            fe_modes = check.fe_modes()
            for name in plants:
                plant_modes = check.plant_modes(name)
                (folder / f"shapes-{name}.svg").write_text(
                    to_svg(mode_shapes_figure(structure, fe_modes, plant_modes)), encoding="utf-8"
                )
                likeness = mac(fe_modes.shapes, plant_modes.shapes)
                (folder / f"mac-{name}.svg").write_text(to_svg(mac_figure(likeness)), encoding="utf-8")
            write_manifest(folder, verb="modes", structure=structure.name, variant=arguments.variant)
        document["out"] = str(arguments.out)
    return Outcome(document=document, text="\n".join(lines))
