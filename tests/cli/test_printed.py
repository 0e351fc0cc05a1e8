"""What data say of themselves does not drive the terminal, and does not become HTML."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from command import run

from vlab.cli.diagnose import closing_words
from vlab.cli.table import text_table
from vlab.files.assets import asset
from vlab.views.rerun.viewer import start_viewer

RIG = """<mujoco><option timestep="0.001" gravity="0 0 0"/><worldbody><body>
<joint name="x&#10;all is well" type="slide" axis="1 0 0" stiffness="400"/><geom size="0.05" mass="1"/></body></worldbody>
<actuator><motor name="coil" joint="x&#10;all is well"/></actuator>
<sensor><jointpos name="las&#x202e;er" joint="x&#10;all is well"/></sensor></mujoco>"""
CASE = """title = "\\u001b[31mred\\u202e \\u009b2J \\nnothing is missing <script>alert(1)</script>"
[model]
mjcf = "rig.xml"
[[recording]]
name = "run\\u001b]0;owned\\u0007"
file = "run.csv"
role = "fit"
time = "t"
[[recording.channel]]
column = "u"
at = "coil"
kind = "force"
unit = "N"
input = true
[[recording.channel]]
column = "x"
at = "las\\u202eer"
name = "<b>x\\u001b[2J"
kind = "displacement"
unit = "m"
"""


@pytest.fixture
def case(tmp_path) -> Path:
    (tmp_path / "rig.xml").write_text(RIG, encoding="utf-8")
    (tmp_path / "case.toml").write_text(CASE, encoding="utf-8")
    t = np.arange(200) / 500
    table = np.column_stack([t, np.sin(50 * t), 1e-3 * np.sin(50 * t)])
    np.savetxt(tmp_path / "run.csv", table, delimiter=",", header="t,u,x", comments="")
    return tmp_path


def assert_harmless(text: str) -> None:
    assert all(line.replace("\t", " ").isprintable() for line in text.split("\n"))


def test_titles_and_names_of_a_case_do_not_drive_the_terminal(case, capsys):
    status, out, err = run(capsys, "compare", str(case))
    assert (status, err) == (0, "")
    assert_harmless(out)
    assert out.startswith("\\x1b[31mred\\u202e \\x9b2J \\x0anothing is missing <script>")
    assert "\nnothing is missing" not in out
    assert "las\\u202eer" in out or "<b>x\\x1b[2J" in out
    status, out, _ = run(capsys, "compare", str(case), "--json")
    assert json.loads(out)["title"].startswith("\x1b[31mred\u202e")  # data stay as they are
    assert_harmless(out)


def test_errors_that_quote_data_do_not_either(case, capsys):
    (case / "case.toml").write_text(CASE.replace('at = "coil"', 'at = "co\\u001b[31mil\\u202e"'), encoding="utf-8")
    status, out, err = run(capsys, "compare", str(case))
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert_harmless(err)
    assert "co\\x1b[31mil\\u202e" in err
    status, _, err = run(capsys, "compare", "a\x1b[31m\udc80", "--b\x1b")
    assert status == 2
    assert_harmless(err)


def test_a_table_keeps_every_row_on_its_line():
    text = text_table(["name\x1b", "x"], [["a\nb", 1.0], ["c\rd", 2.0]])
    assert_harmless(text)
    assert len(text.split("\n")) == 4


def test_a_table_fits_the_terminal_and_loses_no_word():
    name, why = (
        "/joint_trajectory/points/positions/shoulder_lift_joint",
        "its name, and it is ahead of the readings " * 3,
    )
    text = text_table(["column", "why", "rms"], [[name, why, 0.25], ["t", None, 12.5]], width=70)
    lines = text.split("\n")
    assert max(map(len, lines)) <= 70
    column = "".join(line[: lines[1].index(" ")].strip() for line in lines[2:-1])
    assert column == name
    words = [word for line in lines[2:-1] for word in line[lines[1].index(" ") :].split()]
    assert sorted(words) == sorted([*why.split(), "0.25"])
    assert text_table(["column", "why", "rms"], [[name, why, 0.25]]).count("\n") == 2  # whole lines in a pipe


@pytest.mark.parametrize("width", [1, 10, 40])
def test_a_table_that_cannot_fit_is_as_narrow_as_its_words(width):
    text = text_table(["a heading", "b"], [["word", 1.0], ["", None]], width=width)
    assert text.split("\n")[-1].strip() == "-"
    assert "heading" in text


@pytest.mark.slow
def test_a_page_escapes_what_data_say(case, capsys, tmp_path):
    assert run(capsys, "compare", str(case), "--out", str(tmp_path / "out"))[0] == 0
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "<script>alert" not in page
    assert "&lt;script&gt;alert" in page
    assert "\x1b" not in page


@pytest.mark.slow
def test_modules_of_the_current_folder_are_not_run(tmp_path):
    """Neither by `python -m vlab` nor by the processes that it starts."""
    for name in ("numpy.py", "rerun.py", "mujoco.py", "joblib.py", "tqdm.py", "sitecustomize.py"):
        (tmp_path / name).write_text(f"open({str(tmp_path / 'pwned.txt')!r}, 'w').write(__file__); raise SystemExit(9)")
    root = Path(asset("beam.toml")).parents[1]
    environment = {**os.environ, "PYTHONPATH": str(root)}
    environment.pop("PYTHONSAFEPATH", None)
    words = [sys.executable, "-m", "vlab", "effects", "coulomb-friction"]
    done = subprocess.run(words, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, (tmp_path / "pwned.txt").exists()) == (0, False), done.stderr


@pytest.mark.slow
def test_the_viewer_is_not_looked_for_in_the_current_folder(tmp_path, monkeypatch):
    (tmp_path / "rerun.py").write_text(f"open({str(tmp_path / 'pwned.txt')!r}, 'w').write('x')")
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    with start_viewer(tmp_path / "none.rrd", quiet=True) as viewer:
        viewer.wait(timeout=60)
    assert not (tmp_path / "pwned.txt").exists()


def test_a_chain_of_one_diagnosis_is_counted_in_the_singular():
    assert closing_words(1, ["stop at joint:a"], "missing-physics").startswith("1 diagnosis; found: stop at joint:a;")
    assert closing_words(2, [], "none-of-these").startswith("2 diagnoses; found: nothing;")
