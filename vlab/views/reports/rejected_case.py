"""Report of a rejected case."""

import json
from pathlib import Path

from vlab.cases.compare import compare_case
from vlab.diagnose.diagnosis import RejectedCase
from vlab.files.output_folder import finite
from vlab.files.text import as_sentence
from vlab.recordings.files import written_whole
from vlab.views.reports.case import case_sections
from vlab.views.reports.diagnosis_summary import title_of
from vlab.views.reports.page import Section, write_report


def write_stopped(done: RejectedCase, folder: Path) -> list[Section]:
    """Write ``diagnosis.json`` and ``report.html`` of a rejected case.

    Parameters
    ----------
    done : RejectedCase
        Rejected case.
    folder : Path
        Output folder.

    Returns
    -------
    list of Section
        Sections of the report.

    Raises
    ------
    OutputRefused
        A file cannot be written.
    """
    diagnosis = done.diagnosis
    with written_whole(folder / "diagnosis.json") as stream:
        stream.write((json.dumps(finite(diagnosis.to_json()), indent=2, allow_nan=False) + "\n").encode())
    return write_stopped_page(done, folder / "report.html")


def write_stopped_page(done: RejectedCase, path: Path) -> list[Section]:
    """Write the report of a rejected case to a file.

    Parameters
    ----------
    done : RejectedCase
        Rejected case.
    path : Path
        HTML file.

    Returns
    -------
    list of Section
        Sections of the report.

    Raises
    ------
    OutputRefused
        The file cannot be written.
    """
    diagnosis = done.diagnosis
    parts = [Section(title="What is wrong with the files", text=tuple(f"{line}." for line in diagnosis.quality))]
    if done.case.recordings():
        parts += case_sections(compare_case(done.case))
    parts.append(Section(title="Next measurement", text=(as_sentence(diagnosis.next_measurement),)))
    words = "The case does not say of its files what they are, so nothing was fitted or sought."
    write_report(path, title=title_of(diagnosis.title, done.case), summary=[words], sections=parts)
    return parts
