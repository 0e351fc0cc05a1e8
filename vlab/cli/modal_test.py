"""``vlab modal-test``."""

import argparse
import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from vlab.api.modal_test import Loaded, load_runs, modal_test
from vlab.cli.common import Outcome
from vlab.cli.destination import add_out, check_out
from vlab.cli.table import text_table
from vlab.errors import BadRecording, VlabError
from vlab.files.arguments import unchecked
from vlab.files.output_folder import output_folder, write_manifest
from vlab.files.text import in_line
from vlab.lab.plant_modes import FoundMode, compare_with_plant, plant_modes
from vlab.lab.run_folder import SETTINGS, RunSettings
from vlab.modal.dwell import DwellResult
from vlab.modal.modal_test import ModalTest, ModalTestResult
from vlab.modal.recognise import KINDS
from vlab.signals import ModalModel
from vlab.structure import load_structure


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "run",
        nargs="+",
        help="read these run folders, recordings or frequency responses (.parquet, .csv, .txt, .lvm, .mat, .h5, .npz, .uff, .tdms and more); "
        "those of one input are averaged, of different inputs combined",
    )
    parser.add_argument(
        "--input",
        action="append",
        default=[],
        metavar="NAME[=KIND[,UNIT]]",
        help="use this input channel; give kind and unit for foreign recordings: force=force,lbf; may be repeated "
        "(default: inputs of the recording)",
    )
    parser.add_argument(
        "--output",
        action="append",
        default=[],
        metavar="NAME[=KIND[,UNIT]]",
        help="use this output channel; foreign recordings: acc1=acceleration,g; may be repeated (default: all sensors)",
    )
    parser.add_argument(
        "--time",
        metavar="NAME",
        help="read the time of a foreign recording from this column (default: the column named time or t)",
    )
    parser.add_argument(
        "--frequency",
        metavar="NAME",
        help="read the frequencies of responses from this column (default: the column named f or frequency)",
    )
    parser.add_argument(
        "--rate", type=float, help="set the sample rate in Hz of a foreign recording without a time column"
    )
    _add_estimate(parser)
    parser.add_argument(
        "--against-plant",
        action="store_true",
        help="run folders: compare with the linearised modes of the plant, within 0.1 %% of frequency, 5 %% of damping and "
        "a MAC of 0.98; exit status 1 if a mode is missed (default: no)",
    )
    add_out(parser, "report, figures and responses to this folder (default: print only)")


def _add_estimate(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the estimate."""
    parser.add_argument(
        "--signal",
        choices=KINDS,
        help="treat the excitation as this kind (default: from notes or samples of the recording)",
    )
    parser.add_argument(
        "--band",
        type=float,
        nargs=2,
        metavar=("LOW", "HIGH"),
        help="search modes in this band in Hz (default: all lines of the response)",
    )
    parser.add_argument(
        "--modes",
        type=int,
        help="report the first modes in the band, this number (default: as many as the data support)",
    )
    parser.add_argument(
        "--estimator",
        choices=("H1", "H2", "Hv"),
        default="H1",
        help="estimate frequency responses by H1 (default), H2 or Hv",
    )
    parser.add_argument(
        "--period", type=float, help="set the period of the excitation in s (default: from the recording)"
    )
    parser.add_argument(
        "--segment",
        type=float,
        help="set the length in s of segments of random data, or of blocks of bursts or blows (default: an eighth of the record; blocks as found)",
    )
    parser.add_argument(
        "--dwell", type=float, help="set the duration in s of each step of a stepped sine (default: detected)"
    )
    parser.add_argument(
        "--window-end",
        type=float,
        default=ModalTest.end_level,
        metavar="LEVEL",
        help="set the exponential window of a hammer block to this value at its end, 1 for no window (default %(default)s); "
        "the added damping is removed",
    )


def run(arguments: argparse.Namespace) -> Outcome:
    """Estimate responses and modes.

    Parameters
    ----------
    arguments : Namespace
        Parsed arguments of the command.

    Returns
    -------
    Outcome
        Document and text of the command.
    """
    check_out(arguments, read=arguments.run)
    runs = load_runs(
        arguments.run,
        inputs=arguments.input,
        outputs=arguments.output,
        time=arguments.time,
        rate_hz=arguments.rate,
        frequency=arguments.frequency,
    )
    result = unchecked(modal_test)(
        [part for data, _ in runs for part in (data if isinstance(data, tuple) else (data,))],
        inputs=arguments.input,
        outputs=arguments.output,
        band_hz=tuple(arguments.band) if arguments.band else None,
        modes=arguments.modes,
        estimator=arguments.estimator,
        signal=arguments.signal,
        period_s=arguments.period,
        segment_s=arguments.segment,
        dwell_s=arguments.dwell,
        window_end=arguments.window_end,
    )
    if isinstance(result, list):
        return _dwells(result, arguments)
    found, true = _against_plant(result, runs, arguments.run) if arguments.against_plant else ([], None)
    document = result.as_dict()
    if true is not None:
        document["against_plant"] = [mode.as_dict() for mode in found]
    if arguments.out:
        from vlab.views.reports.modal_test import write_modal_test

        with output_folder(arguments.out, overwrite=arguments.overwrite) as folder:
            write_modal_test(result, folder, title=_title(arguments.run), found=found, true=true)
            write_manifest(folder, verb="modal-test", runs=[str(path) for path in arguments.run])
        document["out"] = str(arguments.out)
    text = _text(result, found) + _written_to(arguments)
    return Outcome(document=document, text=text, holds=all(mode.ok for mode in found))


def _written_to(arguments: argparse.Namespace) -> str:
    """Return the line on the output folder, if any."""
    return f"\n\nwritten to {arguments.out}: report.html, figures" if arguments.out else ""


def _title(runs: Sequence[str]) -> str:
    names = [Path(path).name for path in runs]
    return f"Modal test: {', '.join(names[:6])}{' and more' if len(names) > 6 else ''}"


def _text(result: ModalTestResult, found: Sequence[FoundMode]) -> str:
    document = result.as_dict()
    kinds = ", ".join(dict.fromkeys(s.kind for s in result.signals))
    origin = (
        f"excitation {kinds}" if result.signals else f"{result.n_given()} given response{'s' * (result.n_given() > 1)}"
    )
    rows = [
        [i + 1, m["hz"], m["hz_sd"], m["zeta"], m["zeta_sd"], m["confidence"], *m["shape"].values()]
        for i, m in enumerate(document["modes"])
    ]
    headers = ["mode", "Hz", "sd", "zeta", "sd", "confidence", *result.mean.outputs]
    parts = [
        f"input {in_line(', '.join(result.mean.inputs))}; {origin}; {result.mean.freq.size} lines; residual of the fit {result.poles.residual:.2g}",
        text_table(headers, rows),
    ]
    from vlab.views.reports.modal_test import FOUND_HEADERS, LEVEL_HEADERS, doubts, found_rows, level_rows

    if len(result.mean.inputs) > 1:
        rows = [[i + 1, m["hz"], *m["input_shape"].values()] for i, m in enumerate(document["modes"])]
        table = text_table(["mode", "Hz", *result.mean.inputs], rows)
        parts.append(f"shapes at the inputs, from the participation of each input (reciprocity)\n{table}")
    parts += doubts(result)
    for part in result.distortion:
        parts.append(
            f"noise and distortion relative to the linear output, {part.input}: {part.realisations} realisations of "
            f"{part.periods} periods\n{text_table(LEVEL_HEADERS, level_rows(part.levels()))}"
        )
    if result.forces:
        rows = [[i + 1, f.hz, f.indicator, *f.forces.tolist()] for i, f in enumerate(result.forces)]
        parts.append(
            "forces that hold each mode alone (vlab experiment --excite dwell:hz=...,forces=.../...)\n"
            + text_table(["mode", "Hz", "indicator", *result.mean.inputs], rows)
        )
    if found:
        good = sum(mode.ok for mode in found)
        parts.append(f"{good} of {len(found)} modes of the plant found\n{text_table(FOUND_HEADERS, found_rows(found))}")
    return "\n\n".join(parts)


def _dwells(dwells: Sequence[DwellResult], arguments: argparse.Namespace) -> Outcome:
    """Report modes held by dwells, one per recording."""
    modes = [
        {
            "hz": d.hz if d.decay_hz is None else d.decay_hz,
            "zeta": d.decay_zeta,
            "shape": dict(zip(d.outputs, d.shape.tolist(), strict=True)),
            "confidence": max(0.0, 1.0 - d.indicator),
            "driven_hz": d.hz,
            "indicator": d.indicator,
            "forces": dict(zip(d.inputs, d.forces.tolist(), strict=True)),
            "decay_residual": d.decay_residual,
        }
        for d in dwells
    ]
    if len({d.outputs for d in dwells}) != 1:
        raise BadRecording("the dwells have different outputs; name common ones with --output")
    rows = [[i + 1, d.hz, d.indicator, d.decay_hz, d.decay_zeta, *d.shape.tolist()] for i, d in enumerate(dwells)]
    headers = ["mode", "driven Hz", "indicator", "decay Hz", "decay zeta", *dwells[0].outputs]
    document: dict[str, Any] = {"frf": [], "modes": modes}
    if arguments.out:
        from vlab.views.reports.modal_test import write_dwells

        with output_folder(arguments.out, overwrite=arguments.overwrite) as folder:
            write_dwells(dwells, folder, title=_title(arguments.run))
            write_manifest(folder, verb="modal-test", runs=[str(path) for path in arguments.run])
        document["out"] = str(arguments.out)
    return Outcome(document=document, text=text_table(headers, rows) + _written_to(arguments))


def _against_plant(
    result: ModalTestResult, runs: Sequence[Loaded], folders: Sequence[str]
) -> tuple[list[FoundMode], ModalModel]:
    """Compare with the linearised plant of the first run."""
    settings = [own.inside(Path(at)) for (_, own), at in zip(runs, folders, strict=True) if own is not None]
    first = settings[0] if len(settings) == len(runs) else None
    if first is None or any(not _same_plant(first, other) for other in settings):
        raise BadRecording(
            "--against-plant needs run folders of vlab experiment, all of one structure, plant and variant"
        )
    if first.law:
        raise BadRecording(
            f"--against-plant: the law {first.law!r} is in the loop, which changes the poles; run without --law"
        )
    low, high = float(result.poles.fitted.freq[0]), float(result.poles.fitted.freq[-1])
    try:
        plant = dataclasses.replace(first, seconds=1.0).prepare().plant
    except VlabError as error:
        raise BadRecording(f"{Path(folders[0]) / SETTINGS}: {error}") from error
    true = plant_modes(plant, result.mean.outputs, low_hz=low, high_hz=high)
    return compare_with_plant(true, result.poles.to_modal_model()), true


def _same_plant(a: RunSettings, b: RunSettings) -> bool:
    if a.is_own_model or b.is_own_model:
        same = Path(a.structure).read_bytes() == Path(b.structure).read_bytes()
    else:
        same = load_structure(a.structure) == load_structure(b.structure)
    return same and all(getattr(a, key) == getattr(b, key) for key in ("plant", "variant", "law", "effect"))
