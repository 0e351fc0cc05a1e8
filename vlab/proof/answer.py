"""Answer to one concealed case, made without the truth."""

import time
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

from vlab.cases import load_case
from vlab.diagnose.diagnosis import RejectedCase
from vlab.diagnose.pipeline import Diagnosed, FrequencyDiagnosed, diagnose
from vlab.errors import VlabError
from vlab.files.output_folder import finite, output_folder
from vlab.proof.baselines import baselines_of

Report = Callable[[Diagnosed | FrequencyDiagnosed | RejectedCase, Path], None]
"""Function that writes the report of a diagnosis into a folder."""


def answer_case(
    item: tuple[str, Path], *, baselines: bool = False, frees_all: Collection[str] = ()
) -> tuple[str, dict[str, Any]]:
    """Return the name of a case and its answer.

    A failure is also an answer, and a wrong one.

    Parameters
    ----------
    item : (name, folder)
        Case.
    baselines : bool
        Whether the simple methods answer as well.
    frees_all : collection of str
        Cases that the slow mujoco.sysid answers, too.

    Returns
    -------
    (name, answer)
        Name of the case and its answer.
    """
    name, folder = item
    began = time.monotonic()
    try:
        case = load_case(folder)
        answer = diagnose(case).diagnosis.to_json()
        if baselines:
            answer["baselines"] = baselines_of(case, frees_all=name in frees_all)
    except VlabError as error:
        answer = {"verdict": "refused", "findings": [], "error": " ".join(str(error).split())}
    except Exception as error:  # a program fault is counted and listed, and does not stop a campaign
        answer = {
            "verdict": "crashed",
            "findings": [],
            "error": f"{type(error).__name__}: {' '.join(str(error).split())}",
        }
    answer["seconds"] = time.monotonic() - began
    return name, {"case": name, **finite(answer)}


def write_worst(cases: Path, names: list[str], out: Path, report: Report) -> dict[str, str]:
    """Diagnose some cases again and write their reports.

    Parameters
    ----------
    cases : Path
        Folder of the cases.
    names : list of str
        Names of the cases.
    out : Path
        Folder of the answers.
    report : Report
        Function that writes a report.

    Returns
    -------
    dict
        Path of each report by name.
    """
    paths = {}
    for name in names:
        folder = out / name
        if not (folder / "report.html").exists():
            try:
                with output_folder(folder) as fresh:
                    report(diagnose(load_case(cases / name)), fresh)
            except VlabError:
                continue
        paths[name] = str(folder / "report.html")
    return paths
