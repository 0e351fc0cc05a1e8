"""``vlab correct``."""

import argparse
import json
from typing import Any

from vlab.cli.common import Outcome, add_seed, progress_bar
from vlab.cli.destination import add_out, check_out
from vlab.cli.table import text_table
from vlab.files.output_folder import finite, output_folder, write_manifest
from vlab.files.text import in_line
from vlab.reproduce.correction.pipeline import CorrectionTest, correct_by_test

PERIOD_S, PERIODS = 100.0, 3


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "structure", help="use this built-in structure with sensors at its joints (grid) or structure file"
    )
    parser.add_argument(
        "--variant", default="published", help="model this variant of the structure: published (default) or physical"
    )
    add_seed(parser, "draw variation, excitation and noise with this seed (default 0)", default=0)
    parser.add_argument(
        "--modes", type=int, default=11, metavar="N", help="use at most this number of measured modes (default 11)"
    )
    parser.add_argument(
        "--spread",
        type=float,
        default=0.05,
        metavar="X",
        help="vary the structure by this relative standard deviation [-] (default 0.05)",
    )
    parser.add_argument(
        "--noise",
        type=float,
        default=0.03,
        metavar="X",
        help="add sensor noise of this rms relative to the signal [-] (default 0.03)",
    )
    parser.add_argument(
        "--reduction", default="guyan", help="reduce the model to the sensors by guyan (default) or exact"
    )
    parser.add_argument(
        "--retain",
        action="append",
        metavar="COORDINATE",
        help="retain this coordinate, such as v:joint1 or rx:point13; may be repeated (default: those of the structure file)",
    )
    add_out(parser, "corrected matrices, numbers and the MAC as a figure to this folder (default: print only)")


def run(arguments: argparse.Namespace) -> Outcome:
    """Test the structure and correct its model.

    Parameters
    ----------
    arguments : Namespace
        Parsed arguments of the command.

    Returns
    -------
    Outcome
        Document and text of the command.
    """
    check_out(arguments, read=[arguments.structure])
    with progress_bar("modal test", PERIOD_S * PERIODS) as progress:
        result = correct_by_test(
            arguments.structure,
            seed=arguments.seed,
            modes=arguments.modes,
            retained=arguments.retain,
            spread=arguments.spread,
            noise=arguments.noise,
            reduction=arguments.reduction,
            variant=arguments.variant,
            period_s=PERIOD_S,
            periods=PERIODS,
            progress=progress,
        )
    document = result.as_dict()
    lines = _lines(arguments, result, document)
    if arguments.out:
        _write_folder(arguments, result, document)
        document["out"] = str(arguments.out)
    return Outcome(document=document, text="\n".join(lines), holds=result.holds)


def _lines(arguments: argparse.Namespace, result: CorrectionTest, document: dict[str, Any]) -> list[str]:
    """Return the text of the command."""
    keys = ["mode", "model_hz", "true_hz", "measured_hz", "before_use_hz", "corrected_hz", "mac_before", "zeta"]
    headers = ["mode", "model Hz", "true Hz", "measured Hz", "before use Hz", "corrected Hz", "MAC before", "zeta"]
    rows = [[row[key] for key in keys] for row in document["modes"]]
    lines = [
        f"{in_line(result.fe.structure.title)}, variant {arguments.variant}, {arguments.reduction} reduction to "
        f"{len(document['coordinates'])} coordinates; spread {arguments.spread:g}, noise {arguments.noise:g}, seed {arguments.seed}",
        f"{document['identified_modes']} modes identified, {len(rows)} used; residual of the fit {document['fit_residual']:.2g}",
        "",
        text_table(headers, rows),
        "",
    ]
    for name, size in document["orthogonality"].items():
        lines.append(f"off-diagonals in the {name} mass: max {size['max']:.3f}, mean {size['mean']:.3f}")
    change, unused = document["change"], document["unused_rms_error"]
    lines.append(
        f"change: mass {change['mass']:.3f}, stiffness {change['stiffness']:.3f}, damping {change['damping']:.3f} (relative)"
    )
    lines.append(
        "rms error of the measured modes not yet used, after 0, 1, ... modes: " + ", ".join(f"{e:.2%}" for e in unused)
    )
    for row in document["unmeasured"]:
        lines.append(f"not measured: {row['model_hz']:.4f} Hz before, {row['corrected_hz']:.4f} Hz after")
    lines.append(f"measured modes reproduced to {result.error:.1e} relative (accepted: {result.accepted:.1g})")
    return lines


def _write_folder(arguments: argparse.Namespace, result: CorrectionTest, document: dict[str, Any]) -> None:
    """Write matrices, numbers, figure and manifest."""
    import numpy as np

    from vlab.modal.mac import mac
    from vlab.views.figures import mac_figure, to_svg

    with output_folder(arguments.out, overwrite=arguments.overwrite) as folder:
        before, after = result.correction.uncorrected, result.correction.model
        np.savez(folder / "corrected.npz", M=after.M, C=after.C, K=after.K, coordinates=np.array(after.coordinates))
        likeness = mac(before.eigen[1], result.measured.shapes)
        (folder / "mac-before.svg").write_text(
            to_svg(mac_figure(likeness, rows="model", columns="measured")), encoding="utf-8"
        )
        (folder / "correction.json").write_text(
            json.dumps(finite(document), allow_nan=False, indent=2) + "\n", encoding="utf-8"
        )
        write_manifest(
            folder,
            verb="correct",
            structure=result.fe.structure.name,
            variant=arguments.variant,
            seed=arguments.seed,
            modes=arguments.modes,
            spread=arguments.spread,
            noise=arguments.noise,
            reduction=arguments.reduction,
            coordinates=document["coordinates"],
        )
