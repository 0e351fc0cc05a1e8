"""Answer to one concealed case, made without the truth."""

import time
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

from vlab.cases import load_case
from vlab.cases.case import Case
from vlab.diagnose.diagnosis import RejectedCase
from vlab.diagnose.pipeline import Diagnosed, FrequencyDiagnosed, diagnose
from vlab.errors import VlabError
from vlab.files.output_folder import finite, output_folder
from vlab.proof.peers.registry import peers_of

Report = Callable[[Diagnosed | FrequencyDiagnosed | RejectedCase, Path], None]
"""Function that writes the report of a diagnosis into a folder."""


def answer_case(
    item: tuple[str, Path], *, baselines: bool = False, slow_on: Collection[str] = (), peers: Collection[str] = ()
) -> tuple[str, dict[str, Any]]:
    """Return the name of a case and its answer.

    A failure is also an answer, and a wrong one. Peers answer after the diagnosis, whose times leave them out.

    Parameters
    ----------
    item : (name, folder)
        Case.
    baselines : bool
        Whether peers answer as well.
    slow_on : collection of str
        Cases that slow peers answer, too.
    peers : collection of str
        Names of the peers; all by default.

    Returns
    -------
    (name, answer)
        Name of the case and its answer.
    """
    name, folder = item
    began, cpu = time.monotonic(), time.process_time()
    case: Case | None = None
    try:
        case = load_case(folder)
        answer = diagnose(case).diagnosis.to_json()
    except VlabError as error:
        answer = {"verdict": "refused", "findings": [], "error": " ".join(str(error).split())}
    except Exception as error:  # a program fault is counted and listed, and does not stop a campaign
        answer = {
            "verdict": "crashed",
            "findings": [],
            "error": f"{type(error).__name__}: {' '.join(str(error).split())}",
        }
    answer["seconds"], answer["cpu_seconds"] = time.monotonic() - began, time.process_time() - cpu
    if baselines and case is not None:
        answer["baselines"] = peers_of(case, peers, slow_too=name in slow_on)
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
