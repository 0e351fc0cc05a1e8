"""``vlab diagnose``."""

import argparse
import json
import shlex
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from vlab.api.diagnosis import Diagnosis as Answer
from vlab.api.diagnosis import diagnose
from vlab.cases import load_case
from vlab.cases.case import CASE, Case
from vlab.cases.draft import Draft, draft_case
from vlab.cli.case_argument import add_case
from vlab.cli.check import check_words, write_check
from vlab.cli.common import Outcome, process_number, share_bar
from vlab.cli.destination import add_out, check_out, destination
from vlab.cli.init import add_clock, draft_words, next_command
from vlab.cli.table import text_table
from vlab.diagnose.advice import (
    OF_ERRORS,
    RATIO_OF_SEARCH,
    RESERVED,
    attempt_sentence,
    before_heading,
    format_probability,
    share,
)
from vlab.diagnose.diagnosis import Attempt, Diagnosis, Finding
from vlab.diagnose.export import CASE as EXTENDED
from vlab.diagnose.precheck import Precheck, precheck_case
from vlab.errors import BadCase, BadExperiment
from vlab.files.output_folder import check_output, digests, is_untouched_draft, output_folder, write_manifest
from vlab.files.text import in_digits, in_line
from vlab.parallel import limited_to
from vlab.standalone.answer import FOLDER, PATCH
from vlab.units import quantity

MOST_ROUNDS = 5
"""MOST_ROUNDS [1]: largest number of diagnoses of ``--until-noise``."""
OF_CALIBRATION = ("sensor-gain@", "sensor-offset@")
"""OF_CALIBRATION: labels of laws that calibrate a sensor."""
DEFAULT = "out/diagnosis"
"""DEFAULT: folder of a diagnosis of logs, which is numbered."""
OF_THE_FIT_ALONE = (
    "The effect that explains the fit recordings has no effect on the held-out recordings: nothing is verified."
)
MOST_FACTORS = 3
"""MOST_FACTORS [1]: calibrated parameters in the line on calibration."""
VERDICTS = {
    "missing-physics": "Physics is missing in the model.",
    "partly-explained": "Physics is missing in the model: what was found explains a part of the mismatch, and more is missing.",
    "unknown-law": "Physics is missing in the model: its place is found, and a tabulated force stands for its law.",
    "nothing-missing": "Nothing is missing: the calibrated model explains the recordings within the noise.",
    "none-of-these": "The model does not explain the recordings, and no effect of the catalogue does.",
    "bad-recording": "The recordings are damaged or contradict the case; the model was not judged.",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add_case(parser, "read this case folder with case.toml, or case file; or a model (MJCF .xml) before its logs")
    parser.add_argument(
        "logs",
        nargs="*",
        default=[],
        metavar="LOG",
        help="draft the case from the model and these recordings, as vlab init does",
    )
    add_clock(parser)
    parser.add_argument(
        "--effect",
        action="append",
        default=[],
        metavar="FILE.py:CLASS",
        help="search for an effect of your own, too, or for entry:NAME of an installed package; runs its code; may be "
        "repeated (default: catalogue only)",
    )
    parser.add_argument(
        "--family",
        action="append",
        default=[],
        metavar="NAME",
        help="search this family of the catalogue only, such as friction; may be repeated (default: all families)",
    )
    parser.add_argument(
        "--only",
        action="append",
        default=[],
        metavar="EFFECT",
        help="search this effect of the catalogue only, such as dead-band; may be repeated (default: all effects)",
    )
    parser.add_argument(
        "--at",
        action="append",
        default=[],
        metavar="PLACE",
        help="search effects at this place only, such as joint:elbow; may be repeated (default: all places)",
    )
    parser.add_argument(
        "--until-noise",
        action="store_true",
        help="diagnose the extended model in its turn, to OUT-2 and so on, until the residual is noise or nothing more is "
        f"found, at most {MOST_ROUNDS} times; needs --out (default: once)",
    )
    parser.add_argument(
        "--jobs", type=process_number, metavar="N", help="use at most this number of processes (default: one a core)"
    )
    parser.add_argument(
        "--time-limit",
        type=float,
        metavar="SECONDS",
        help="add no effects after this time and validate the best hypothesis so far (default: no limit)",
    )
    parser.add_argument(
        "--patch",
        action="store_true",
        help="print the changes of the MJCF model as a unified diff; needs --out (default: write them to the folder only)",
    )
    add_out(
        parser,
        "diagnosis.json, report.html, run.rrd, the extended model and, for an MJCF model, files for MuJoCo alone to this folder (default: print only)",
    )


def run(arguments: argparse.Namespace) -> Outcome:
    """Find missing physics of a case and report the findings.

    Parameters
    ----------
    arguments : Namespace
        Parsed arguments of the command.

    Returns
    -------
    Outcome
        Document and text of the command.
    """
    if arguments.logs and arguments.out and is_untouched_draft(arguments.out):
        arguments.overwrite = True  # of an earlier diagnosis that did not end; the same files come again
    check_out(arguments, read=[arguments.case, *arguments.logs])
    if arguments.logs:
        with destination(arguments, DEFAULT) as out:
            return _of_logs(arguments, out)
    stated = next((f"--{name.replace('_', '-')}" for name in ("time", "rate_hz") if getattr(arguments, name)), None)
    if stated is not None:
        raise BadExperiment(f"{stated} is for logs after a model; a case states the clock of its recordings itself")
    if arguments.patch and not arguments.out:
        raise BadExperiment("--patch prints what is written to a folder; give --out DIR as well")
    if arguments.until_noise and not arguments.out:
        raise BadExperiment("--until-noise diagnoses the extended model that is written; give --out DIR as well")
    for folder in _later_folders(arguments):
        check_output(folder, overwrite=arguments.overwrite, remedy="name another with --out, or add --overwrite")
    result = _searched(arguments, load_case(arguments.case, allow_outside=arguments.allow_outside))
    if not arguments.out:
        return Outcome(document=result.done.diagnosis.to_json(), text=_text(result.done.diagnosis))
    document, written = _written(arguments, result, Path(arguments.out))
    text = "\n".join([_text(result.done.diagnosis), *written])
    return _continued(arguments, result, Outcome(document=document, text=text), Path(arguments.out))


def _later_folders(arguments: argparse.Namespace) -> list[Path]:
    """Return the folders of the second and later diagnoses."""
    if not (arguments.until_noise and arguments.out):
        return []
    out = Path(arguments.out)
    return [out.with_name(f"{out.name}-{k}") for k in range(2, MOST_ROUNDS + 1)]


def _continued(arguments: argparse.Namespace, result: Answer, first: Outcome, out: Path) -> Outcome:
    """Diagnose the extended model, as often as something is found."""
    if not arguments.until_noise:
        return first
    rounds, texts, folder = [first.document], [first.text], out
    for later in (out.with_name(f"{out.name}-{k}") for k in range(2, MOST_ROUNDS + 1)):
        diagnosis, case = result.done.diagnosis, folder / EXTENDED
        if not diagnosis.is_naming or diagnosis.is_complete or not case.is_file():
            break
        result = _searched(arguments, load_case(case, allow_outside=arguments.allow_outside))
        document, written = _written(arguments, result, later)
        rounds.append(document)
        texts += ["", f"Diagnosis of {case}", "", _text(result.done.diagnosis), *written]
        folder = later
    named = [f"{f['effect']} at {f['place']}" for document in rounds for f in document["findings"]]
    texts += ["", closing_words(len(rounds), named, rounds[-1]["verdict"])]
    return Outcome(document={**rounds[0], "rounds": rounds}, text="\n".join(texts))


def closing_words(rounds: int, named: Sequence[str], last: str) -> str:
    """Return the last line of a chain of diagnoses."""
    count = "1 diagnosis" if rounds == 1 else f"{rounds} diagnoses"
    return f"{count}; found: {', '.join(map(in_line, named)) or 'nothing'}; the last verdict is {last}"


def _searched(arguments: argparse.Namespace, case: Case) -> Answer:
    """Diagnose a case with a progress bar."""
    with share_bar("diagnose") as report:
        return diagnose(
            case,
            effects=arguments.effect,
            families=arguments.family or None,
            only=arguments.only or None,
            at=arguments.at or None,
            jobs=arguments.jobs,
            time_limit=arguments.time_limit,
            progress=report,
        )


def _written(
    arguments: argparse.Namespace,
    result: Answer,
    out: Path,
    *,
    draft: Draft | None = None,
    checked: Precheck | None = None,
) -> tuple[dict[str, Any], list[str]]:
    """Write the results, and return the document and lines on the files."""
    is_ours = arguments.overwrite or draft is not None
    with limited_to(arguments.jobs), output_folder(out, overwrite=is_ours) as folder:
        result.write_into(folder)
        _write_drafted(folder, draft, checked)
    saved, diagnosis = json.loads((out / "diagnosis.json").read_text(encoding="utf-8")), result.done.diagnosis
    plain, notes = saved.get("mujoco"), saved.get("notes", [])
    document = {**diagnosis.to_json(), "notes": notes, "out": str(out), "mujoco": plain}
    on_files = map(in_line, notes[len(diagnosis.notes) :])
    lines = ["", f"written to {out}", *_for_mujoco(plain, out, _named(diagnosis)), *on_files]
    if diagnosis.is_naming and (out / EXTENDED).is_file():
        document["next"] = _next_command(out, is_complete=diagnosis.is_complete)
        lines.append(f"next: {document['next']}")
    if arguments.patch:
        document["patch"] = (out / FOLDER / PATCH).read_text(encoding="utf-8") if plain else ""
        lines += ["", document["patch"]]
    return document, lines


def _next_command(out: Path, *, is_complete: bool) -> str:
    """Return the line that goes on with an extended model."""
    words = ["compare", str(out / EXTENDED)]
    if not is_complete:
        words = ["diagnose", str(out / EXTENDED), "--out", str(out.with_name(f"{out.name}-2"))]
    return shlex.join(["vlab", *words])


def _named(diagnosis: Diagnosis) -> set[str]:
    """Return the labels of the findings."""
    return {f"{finding.name}@{place}" for finding in diagnosis.findings for place, _ in finding.places}


def _for_mujoco(plain: dict[str, Any] | None, out: Path, named: Collection[str]) -> list[str]:
    """Return the lines on the files for MuJoCo alone.

    Gains and zeros of the sensors that are no findings belong to the calibration, and take one line.
    """
    if not plain:
        return []
    lines = [f"for MuJoCo alone, in {Path(out) / FOLDER}: {', '.join(plain['files'])}"]
    lines += [f"  {in_line(label)}: {element} of the model" for label, element in plain["in_model"].items()]
    calibrated = {label for label in plain["in_law"] if label.startswith(OF_CALIBRATION) and label not in named}
    lines += [f"  {in_line(label)}: law.py" for label in plain["in_law"] if label not in calibrated]
    lines += ["  calibrated gains and zeros of the sensors: law.py"] if calibrated else []
    return lines + [
        f"  {in_line(label)}: not written, {in_line(reason)}" for label, reason in plain["not_written"].items()
    ]


def _write_drafted(folder: Path, draft: Draft | None, checked: Precheck | None) -> None:
    if draft is not None:
        (folder / CASE).write_text(draft.text, encoding="utf-8")
    if checked is not None:
        write_check(checked, folder)


def _of_logs(arguments: argparse.Namespace, out: Path) -> Outcome:
    """Draft a case, check the case, and diagnose.

    Case and check are written before the search, so that an error or interrupt of the search leaves both.
    """
    if Path(arguments.case).is_dir() or Path(arguments.case).name == CASE:
        raise BadCase(
            f"{arguments.case} is a case, which names its recordings itself, and {arguments.logs[0]} is given beside "
            "the case; leave the logs away, or give a model (MJCF .xml) before them"
        )
    logs = [Path(name) for name in arguments.logs]
    draft = draft_case(arguments.case, logs, out, time=arguments.time, rate_hz=arguments.rate_hz)
    path = out / CASE
    again = next_command("diagnose", path, draft)
    try:
        checked = _checked_draft(arguments, out, draft)
        result = _searched(arguments, load_case(path, allow_outside=draft.leaves_folder))
    except KeyboardInterrupt:
        if is_untouched_draft(out):
            left = f"{out} holds the drafted case without a diagnosis; next: {again}"
            raise KeyboardInterrupt(in_line(left)) from None
        raise
    document, written = _written(arguments, result, out, draft=draft, checked=checked)
    document |= {
        "case": str(path),
        "draft": draft.to_json(),
        "check": checked.to_json(),
    }
    parts = [
        "Drafted case",
        draft_words(draft),
        "",
        "Check",
        check_words(checked),
        "",
        "Diagnosis",
        _text(result.done.diagnosis),
    ]
    outcome = Outcome(
        document=document,
        text="\n".join([*parts, *written, f"the drafted case is {path}", f"after a change of the case: {again}"]),
    )
    return _continued(arguments, result, outcome, out)


def _checked_draft(arguments: argparse.Namespace, out: Path, draft: Draft) -> Precheck:
    """Write a drafted case and its check, and return the check."""
    path = out / CASE
    checked: Precheck | None = None
    for _ in range(2):  # the case first, for the check reads the case where it stays
        with output_folder(out, overwrite=arguments.overwrite or checked is not None) as folder:
            _write_drafted(folder, draft, checked)
            write_manifest(folder, verb="diagnose", case=str(path), unfinished=digests(folder))
        if checked is None:
            with share_bar("check") as report:
                checked = precheck_case(path, allow_outside=draft.leaves_folder, progress=report)
    assert checked is not None
    return checked


def _text(diagnosis: Diagnosis) -> str:
    is_of_the_fit_alone = diagnosis.attempt is not None and diagnosis.attempt.is_of_the_fit_alone
    verdict = OF_THE_FIT_ALONE if is_of_the_fit_alone else VERDICTS[diagnosis.verdict]
    lines = [in_line(diagnosis.title), "", verdict]
    if diagnosis.explained is not None:
        lines.append(f"Explained: {share(diagnosis.explained)} of the mean-square mismatch on {_data_of(diagnosis)}.")
    if diagnosis.verdict == "none-of-these" and diagnosis.calibrated is not None:
        lines.append(_calibration(diagnosis, diagnosis.calibrated))
    lines.append("")
    for finding in diagnosis.findings:
        lines.append(
            f"{finding.name} at {in_line(finding.site)} (probability {finding.probability:.2f}): {finding.words}"
        )
        lines += _values(finding)
        if len(finding.alike) > 1:
            lines.append(f"  indistinguishable from: {', '.join(finding.alike[1:])}")
        if len(finding.places_90) > 1:
            lines.append(f"  90 % credible set of places: {in_line(', '.join(finding.places_90))}")
        if diagnosis.is_held_out and not finding.verified_by:
            lines.append("  from the fit recordings alone: no held-out recording can verify it")
        lines.append("")
    lines += [f"Recordings: {in_line(line)}." for line in diagnosis.quality]
    lines += [""] if diagnosis.quality else []
    if diagnosis.attempt is not None:
        lines += _attempt(diagnosis.attempt)
    if diagnosis.checked:
        lines.append(_errors(diagnosis))
    if diagnosis.alternatives:
        lines += ["", *_alternatives(diagnosis)]
    lines += ["", *(["Not excluded: " + "; ".join(diagnosis.not_excluded) + "."] if diagnosis.not_excluded else [])]
    lines += [
        f"Next measurement: {diagnosis.next_measurement}.",
        *map(in_line, diagnosis.notes),
        f"the diagnosis took {diagnosis.seconds:.0f} s",
    ]
    return "\n".join(lines)


def _data_of(diagnosis: Diagnosis) -> str:
    return "hold-out recordings" if diagnosis.is_held_out else "the fit recordings"


def _calibration(diagnosis: Diagnosis, removed: float) -> str:
    """Return what calibration removes, with the largest factors."""
    largest = sorted(diagnosis.calibration.items(), key=lambda item: -abs(item[1]))[:MOST_FACTORS]
    factors = ", ".join(f"{in_line(name)} x {in_digits(float(np.exp(value)))}" for name, value in largest)
    shown = f" ({factors})" if factors else ""
    return f"Calibration{shown} removes {share(removed)} of the nominal model's mean-square error on {_data_of(diagnosis)}."


def _values(finding: Finding) -> list[str]:
    """Return law and parameters of a finding."""
    lines = [f"  law: {finding.law}"]
    for place, parameters in finding.places:
        where = f" at {in_line(place)}" if finding.elsewhere else ""
        for name, p in parameters.items():
            interval = f"90 %: {p['ci90'][0]:.4g} to {p['ci90'][1]:.4g}"
            lines.append(f"  {name}{where} = {quantity(p['value'], p['unit'])}   ({interval})")
    return lines


def _errors(diagnosis: Diagnosis) -> str:
    """Return the table of errors of the models."""
    attempt = diagnosis.attempt
    errors, after = (diagnosis.heldout, "extended") if attempt is None else (attempt.to_json(), "best attempt")
    rows = [_row(r["name"], r["role"], r) for r in errors["per_recording"]] + [_row("all", "", errors)]
    headers = ("recording", "role", "nominal", before_heading(diagnosis.checked), after, "noise")
    return f"{text_table([*headers, 'gap closed %'], rows)}\n({OF_ERRORS})"


def _attempt(attempt: Attempt) -> list[str]:
    """Return the description of the best attempt, one line per item."""
    lines = [attempt_sentence(attempt)]
    for finding in attempt.findings:
        lines += [f"  {finding.name} at {in_line(finding.site)}", *_values(finding)]
    return [*lines, ""]


def _alternatives(diagnosis: Diagnosis) -> list[str]:
    """Return the table of alternatives, with probabilities if there are any."""
    tried = diagnosis.alternatives
    if all(a["probability"] is None for a in tried):
        rows = [[a["effect"], a["place"], a["remaining_share"], a["remaining"]] for a in tried]
        table = text_table(["tried", "place", "residual / calibrated", "residual / noise"], rows)
        return [table, f"({RATIO_OF_SEARCH})"]
    rows = [[a["effect"], a["place"], format_probability(a["probability"]), a["remaining"]] for a in tried]
    table = text_table(["alternative", "place", "probability", "residual / noise"], rows)
    return [table, f"({RESERVED})", f"({RATIO_OF_SEARCH})"]


def _row(name: str, role: str, values: dict[str, Any]) -> list[Any]:
    gap = values["gap_closed"]
    return [
        name,
        role,
        *(values[f"nrmse_{k}"] for k in ("nominal", "before", "after", "noise")),
        None if gap is None else round(100 * gap, 1),
    ]
