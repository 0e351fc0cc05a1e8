"""The page of a run: whole, offline, with what the run was and did."""

import json
import re

import pytest
from command import run

QUICK = ["--plant", "modal", "--seconds", "1.0", "--period", "0.5", "--band", "4", "30", "--law", "mfdrf"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory, quick_layout):
    from vlab.cli import main

    out = tmp_path_factory.mktemp("report") / "run"
    assert main(["experiment", "beam", *QUICK, "--report", "--out", str(out)]) == 0
    return out


def test_the_page_is_whole_and_needs_no_network(folder):
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert page.rstrip().endswith("</html>")
    assert not re.search(r'(?:src|href)\s*=\s*"(?!#|data:)', page)
    assert page.count("<script") == 1  # the page's own, which its policy names by its digest
    for heading in ("What was run", "Effort of the actuators", "Frequency responses", "Time histories and spectra"):
        assert heading in page
    assert page.count("<svg") == 3 + 2  # responses of three sensors; the histories and their spectra


def test_the_page_says_what_the_recording_says(folder):
    page = (folder / "report.html").read_text(encoding="utf-8")
    cells = re.findall(r"<td[^>]*>\s*(.*?)\s*</td>", page)
    efforts = json.loads((folder / "manifest.json").read_text())["effort"]
    for effort in efforts.values():
        at = cells.index(effort["at"])
        assert cells[at + 2] == f"{effort['command_rms']:.4g}"
        assert cells[at + 4] == f"{effort['force_rms']:.4g}"
    assert "law = mfdrf" in page


def test_without_the_word_there_is_no_page(capsys, tmp_path):
    words = ["--plant", "modal", "--seconds", "0.5", "--excite", "release", "--out", str(tmp_path / "run")]
    assert run(capsys, "experiment", "beam", *words)[0] == 0
    assert not (tmp_path / "run" / "report.html").exists()


@pytest.mark.slow
def test_a_run_without_excitation_has_a_page_without_responses(capsys, tmp_path, quick_layout):
    words = ["--plant", "modal", "--seconds", "0.5", "--excite", "release", "--report", "--out", str(tmp_path / "run")]
    assert run(capsys, "experiment", "beam", *words)[0] == 0
    page = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert "Frequency responses" not in page
    assert "Time histories" in page
