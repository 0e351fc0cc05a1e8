"""``vlab check``."""

import argparse
import json
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from vlab.cases.case import load_case
from vlab.cases.checks.undriven import undriven, words_on
from vlab.cases.compare import Comparison
from vlab.cases.log_units import in_log_unit, log_units
from vlab.cli.case_argument import OUTSIDE, add_case
from vlab.cli.common import Outcome, share_bar
from vlab.cli.destination import add_out, check_out
from vlab.cli.table import text_table
from vlab.diagnose.precheck import ChannelCheck, Precheck, Remark, precheck_case
from vlab.files.output_folder import finite, output_folder, write_manifest
from vlab.files.text import in_line

HEADERS = (
    *("recording", "role", "channel", "recorded rms", "simulated rms", "unit", "correlation", "NRMSE"),
    *("best delay ms", "left over % now, shifted", "noise rms", "sensor step", "power from Hz", "to Hz"),
)
PICTURE, DOCUMENT = "check.png", "check.json"
"""Names of the written files."""
ADD_CHANNEL = "a [[recording.channel]] with input = true and the actuator as at, or a model without the actuator"
"""ADD_CHANNEL: edit of a case whose actuator has no column."""
MOST_DRAWN = 12
"""MOST_DRAWN [1]: largest number of channels in the picture, those with the largest NRMSE."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add_case(parser)
    add_out(parser, f"{PICTURE} and {DOCUMENT} to this folder (default: print only)")


def run(arguments: argparse.Namespace) -> Outcome:
    """Check a case before a diagnosis.

    Parameters
    ----------
    arguments : Namespace
        Parsed arguments of the command.

    Returns
    -------
    Outcome
        Document and text of the command.
    """
    check_out(arguments, read=[arguments.case])
    with share_bar("check") as report:
        checked = precheck_case(arguments.case, allow_outside=arguments.allow_outside, progress=report)
    checked = with_undriven(checked, arguments.case, allow_outside=arguments.allow_outside)
    document: dict[str, Any] = {"case": str(arguments.case), **checked.to_json()}
    lines = [check_words(checked)]
    if arguments.out:
        with output_folder(arguments.out, overwrite=arguments.overwrite) as folder:
            write_check(checked, folder)
            write_manifest(folder, verb="check", case=str(arguments.case))
        document["out"] = str(arguments.out)
        lines += ["", f"written to {arguments.out}: {', '.join(written(checked))}"]
    if not checked.refused:
        words = ["vlab", "diagnose", str(arguments.case), *([OUTSIDE] if arguments.allow_outside else [])]
        document["next"] = shlex.join([*words, "--out", "out/diagnosis"])
        has_mistakes = any(remark.severity != "note" and remark.mend for remark in checked.remarks)
        first = ["First correct the case as the warnings say, and check it again."] if has_mistakes else []
        lines += ["", *first, f"next: {document['next']}"]
    return Outcome(document=document, text="\n".join(lines))


def with_undriven(checked: Precheck, path: Path | str, *, allow_outside: bool = False) -> Precheck:
    """Return a check with a warning on actuators that no column drives.

    Parameters
    ----------
    checked : Precheck
        Result of the check.
    path : path
        Folder or file of the case.
    allow_outside : bool
        Whether the case may name files outside its folder.

    Returns
    -------
    Precheck
        Check with the warning, if any.
    """
    compared = checked.comparison
    case = load_case(path, allow_outside=allow_outside) if compared is None else compared.case
    names = undriven(case, case.runs() if compared is None else [r.run for r in compared.runs])
    if not names:
        return checked
    remark = Remark(channel=", ".join(names), what=words_on(names), mend=ADD_CHANNEL, severity="warning")
    first = next((k for k, one in enumerate(checked.remarks) if one.severity == "note"), len(checked.remarks))
    return replace(checked, remarks=(*checked.remarks[:first], remark, *checked.remarks[first:]))


def written(checked: Precheck) -> list[str]:
    """Return the names of the files that `write_check` writes."""
    has_picture = checked.comparison is not None and any(run.misfits for run in checked.comparison.runs)
    return [*([PICTURE] if has_picture else []), DOCUMENT]


def write_check(checked: Precheck, folder: Path) -> None:
    """Write the picture and the document of a check.

    Parameters
    ----------
    checked : Precheck
        Result of the check.
    folder : Path
        Folder that is there.
    """
    if PICTURE in written(checked):
        assert checked.comparison is not None
        (folder / PICTURE).write_bytes(_picture(checked.comparison))
    text = json.dumps(finite(checked.to_json()), indent=2, allow_nan=False)
    (folder / DOCUMENT).write_text(text + "\n", encoding="utf-8")


def _picture(comparison: Comparison) -> bytes:
    """Return a PNG of the worst recording about its largest misfit."""
    from vlab.views.figures import POINTS, aligned, to_png, traces_figure

    worst = max((r for r in comparison.runs if r.misfits), key=lambda r: max(m.nrmse for m in r.misfits))
    largest = sorted(worst.misfits, key=lambda m: -m.nrmse)[:MOST_DRAWN]
    names = [m.channel for m in worst.misfits if m in largest]
    time, recorded, simulated = aligned(worst.measured, worst.simulated, largest[0].channel)
    half, at = 0.5 * POINTS * worst.measured.sample_period, float(time[int(np.argmax(np.abs(recorded - simulated)))])
    first = min(max(at - half, float(time[0])), max(float(time[-1]) - 2 * half, float(time[0])))
    pair = [
        (f"{how}, {worst.run.name}", x) for how, x in (("recorded", worst.measured), ("simulated", worst.simulated))
    ]
    roles = ("measured", "nominal")
    return to_png(traces_figure(pair, names, start=first, stop=first + 2 * half, is_titled=True, roles=roles))


def check_words(checked: Precheck) -> str:
    """Return a check as text.

    Parameters
    ----------
    checked : Precheck
        Result of the check.

    Returns
    -------
    str
        Table of the channels, observations and limits.
    """
    lines = [in_line(checked.title), ""]
    if checked.channels:
        units = {} if checked.comparison is None else log_units(checked.comparison.case.table)
        rows = [_row(channel, units.get(channel.channel)) for channel in checked.channels]
        lines += [text_table(HEADERS, rows), "", *_periods(checked)]
    for remark in checked.remarks:
        mend = f"; to mend it: {remark.mend}" if remark.mend else ""
        mark = "" if remark.severity == "note" else f"{remark.severity.upper()}: "
        lines.append(in_line(f"{mark}{remark.what}{mend}"))
    lines += [""] if checked.remarks else []
    if checked.refused:
        return "\n".join([*lines, *(in_line(f"vlab diagnose would refuse the case: {why}") for why in checked.refused)])
    lines.append("No test says that vlab diagnose would refuse the case.")
    if checked.seconds_expected is not None:
        lines.append(f"A diagnosis takes roughly {rough(checked.seconds_expected)} on a free machine like this one.")
    return "\n".join(lines)


def _row(c: ChannelCheck, log_unit: str | None) -> list[object]:
    """Return a channel's cells, sizes in the log's unit."""
    left = (
        None if c.left_now is None or c.left_shifted is None else f"{100 * c.left_now:.3g}, {100 * c.left_shifted:.3g}"
    )
    delay = None if c.delay_s is None else 1e3 * c.delay_s
    sizes = (c.recorded_rms, c.simulated_rms, c.noise, c.step)
    (recorded, simulated, noise, step), unit = in_log_unit(sizes, c.unit, log_unit)
    return [
        *(c.recording, "input" if c.is_input else c.role, c.channel, recorded, simulated, unit),
        *(c.correlation, c.nrmse, delay, left, noise, step, c.low_hz, c.high_hz),
    ]


def _periods(checked: Precheck) -> list[str]:
    """Return one line on the sample period of each recording."""
    out = []
    for run in () if checked.comparison is None else checked.comparison.runs:
        period = run.measured.sample_period
        seconds = float(run.measured.time[-1] - run.measured.time[0])
        out.append(
            in_line(
                f"{run.run.name}: {len(run.measured)} samples in {seconds:.4g} s, one in {1e3 * period:.4g} ms; "
                f"integration step {1e3 * run.simulation.timestep_s:.4g} ms"
            )
        )
    return out


def rough(seconds: float) -> str:
    """Return a rough time, such as ``"20 to 80 s"``."""
    unit, size = ("min", 60.0) if seconds > 300.0 else ("s", 1.0)
    low, high = (float(f"{factor * seconds / size:.1g}") for factor in (0.5, 2.0))
    return f"{low:g} to {high:g} {unit}"
