"""``vlab diagnose``."""

import argparse
from typing import Any

from vlab.cases import load_case
from vlab.cli.common import Outcome, share_bar, text_table
from vlab.diagnose.diagnosis import Diagnosis
from vlab.diagnose.engine import diagnose
from vlab.errors import BadExperiment
from vlab.outputs import keep_apart, output_folder, write_manifest
from vlab.physics.catalogue import EFFECTS, effect_named

VERDICTS = {
    "missing-physics": "Physics is missing in the model.",
    "nothing-missing": "Nothing is missing: the refitted model explains the recordings as far as they can tell.",
    "none-of-these": "The model does not explain the recordings, and no effect of the catalogue does.",
    "bad-recording": "The recordings are damaged, or not what the case says of them; nothing is said of the model.",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's arguments."""
    parser.add_argument("case", help="a case folder with case.toml, or a case file")
    parser.add_argument(
        "--effect",
        action="append",
        default=[],
        metavar="FILE.py:CLASS",
        help="an effect of your own, sought beside the catalogue; may be repeated; runs the code of that file",
    )
    parser.add_argument("--out", help="folder for diagnosis.json, report.html, run.rrd and the amended model")


def run(arguments: argparse.Namespace) -> Outcome:
    """Say what physics the case's model lacks."""
    if arguments.out:
        keep_apart(arguments.out, [arguments.case])
    case = load_case(arguments.case)
    own = [effect_named(name) for name in arguments.effect]
    effects = [*EFFECTS.values(), *own]
    names = [effect.name for effect in effects]
    for effect in own:
        if names.count(effect.name) > 1:
            raise BadExperiment(
                f"--effect: there is another effect named {effect.name!r}; give yours a name of its own"
            )
    if not arguments.out:
        with share_bar("diagnose") as report:
            diagnosis = diagnose(case, effects=effects, progress=report).diagnosis
        return Outcome(document=diagnosis.to_json(), text=_text(diagnosis))
    with output_folder(arguments.out) as folder:
        with share_bar("diagnose") as report:
            done = diagnose(case, effects=effects, progress=report)
        from vlab.views.diagnosis_report import write_diagnosis

        write_diagnosis(done, folder)
        write_manifest(folder, verb="diagnose", case=str(arguments.case))
    document = {**done.diagnosis.to_json(), "out": str(arguments.out)}
    return Outcome(document=document, text=_text(done.diagnosis) + f"\n\nwritten to {arguments.out}")


def _text(diagnosis: Diagnosis) -> str:
    lines = [diagnosis.title, "", VERDICTS[diagnosis.verdict], ""]
    for finding in diagnosis.findings:
        lines.append(f"{finding.name} at {finding.place} (probability {finding.probability:.2f}): {finding.words}")
        lines.append(f"  law: {finding.law}")
        for name, p in finding.parameters.items():
            lines.append(f"  {name} = {p['value']:.4g} {p['unit']}   (90 %: {p['ci90'][0]:.4g} to {p['ci90'][1]:.4g})")
        if len(finding.alike) > 1:
            lines.append(f"  these recordings cannot tell it from: {', '.join(finding.alike[1:])}")
        if len(finding.places_90) > 1:
            lines.append(f"  place: one of {', '.join(finding.places_90)}")
        lines.append("")
    lines += [f"Recordings: {line}." for line in diagnosis.quality]
    lines += [""] if diagnosis.quality else []
    heldout = diagnosis.heldout
    rows = [_row(r["name"], r["role"], r) for r in heldout["per_recording"]] + [_row("all", "", heldout)]
    if diagnosis.checked:
        lines.append(
            text_table(["recording", "role", "as given", "refitted", "amended", "noise", "gap closed %"], rows)
        )
    if diagnosis.alternatives:
        rows = [[a["effect"], a["place"], a["probability"], a["remaining"]] for a in diagnosis.alternatives]
        lines += ["", text_table(["alternative", "place", "probability", "left over / noise"], rows)]
    lines += ["", "Not excluded: " + "; ".join(diagnosis.not_excluded) + "." if diagnosis.not_excluded else ""]
    lines += [f"Next measurement: {diagnosis.next_measurement}.", *diagnosis.notes, f"{diagnosis.seconds:.0f} s"]
    return "\n".join(lines)


def _row(name: str, role: str, values: dict[str, Any]) -> list[Any]:
    gap = values["gap_closed"]
    return [
        name,
        role,
        *(values[f"nrmse_{k}"] for k in ("nominal", "before", "after", "noise")),
        None if gap is None else 100 * gap,
    ]
