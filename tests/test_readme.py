"""The README's lines run as they are printed, from top to bottom.

Blocks marked ``sh`` hold lines to run: all of them are. Blocks marked ``text`` hold what opens a window or needs the reader's
own files, and are not run.
"""

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from command import run

from vlab.cli import build_parser

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
INSTALL = "python3 -m venv .venv && .venv/bin/pip install -q -e "
QUICK = ("vlab effects", "vlab modes beam", "vlab modal-test assets/")
"""How lines begin that take a few seconds and need no line before them."""


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", README, flags=re.MULTILINE | re.DOTALL)


def printed_lines() -> list[str]:
    return [line for block in blocks("sh") for line in block.splitlines() if line.strip()]


def commands() -> list[list[str]]:
    """Return the words of all lines that call vlab; of a line that installs it, what comes after that."""
    lines = [line.split(" && .venv/bin/")[-1] if line.startswith(INSTALL) else line for line in printed_lines()]
    words = [shlex.split(line, comments=True) for line in lines]
    return [line[1:] for line in words if line[0] == "vlab"]


@pytest.fixture(scope="module")
def copy(tmp_path_factory) -> Path:
    """Return a folder with the assets that lines name, for what they write."""
    folder = tmp_path_factory.mktemp("readme")
    aside = shutil.ignore_patterns("evidence", "figures")
    shutil.copytree(ROOT / "assets", folder / "assets", ignore=aside)
    return folder


def test_every_line_that_is_printed_to_be_run_calls_vlab_or_installs_it():
    other = [line for line in printed_lines() if not line.startswith("vlab ")]
    assert [line.removeprefix(INSTALL) for line in other] == [
        ". && .venv/bin/vlab demo",
        "'.[test]' && .venv/bin/python -m pytest",
    ]
    assert len(commands()) >= 30
    marked = re.findall(r"^```(.*)$", README, flags=re.MULTILINE)
    assert set(marked) <= {"", "sh", "text", "toml", "python"}


def test_every_line_is_understood(monkeypatch, copy):
    monkeypatch.chdir(copy)
    for block in blocks("text") + blocks("sh"):
        for line in block.splitlines():
            words = shlex.split(line, comments=True)
            if words[:1] == ["vlab"]:
                build_parser(words[1]).parse_args(words[1:])


def test_every_file_that_a_line_names_is_shipped_or_written_by_a_line_before(copy):
    written: list[str] = []
    for words in commands():
        out = words[words.index("--out") + 1] if "--out" in words else None
        for word in words:
            name = word.partition(":")[0]
            if name.startswith("out/") and word != out and "--save" not in words[: words.index(word)]:
                assert any(Path(name).is_relative_to(folder) for folder in written), (word, words)
            if name.startswith("assets/"):
                assert (copy / name).exists(), words
        if out is not None:
            assert out not in written, f"two lines write {out}"
            written.append(out)


@pytest.mark.parametrize("words", [w for w in commands() if " ".join(["vlab", *w]).startswith(QUICK)], ids=" ".join)
def test_a_quick_line_runs_as_printed(capsys, monkeypatch, copy, words):
    monkeypatch.chdir(copy)
    status, out, err = run(capsys, *words)
    assert (status, bool(out)) == (0, True), err


def test_the_python_lines_run_as_printed(capsys):
    (code,) = blocks("python")
    exec(compile(code, "README.md", "exec"), {"__name__": "readme"})
    assert "sensor:base" in capsys.readouterr().out


@pytest.mark.slow
def test_all_lines_run_from_top_to_bottom(tmp_path, copy):
    shutil.copytree(copy / "assets", tmp_path / "assets")
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    failed = {}
    for words in commands():
        line = [sys.executable, "-m", "vlab", *words]
        done = subprocess.run(line, cwd=tmp_path, env=environment, capture_output=True, text=True)
        if done.returncode != 0 or not done.stdout.strip():
            failed[" ".join(words)] = (done.returncode, done.stderr.strip().splitlines()[-1:])
    assert not failed
    assert (tmp_path / "out" / "demo-001" / "report.html").exists()  # as the README says
    assert (tmp_path / "out" / "run-003").is_dir()
