"""Output folders: numbers that nobody else has, nothing overwritten, nothing half-written."""

import multiprocessing
import subprocess
import sys
from pathlib import Path

import pytest
from command import run

from vlab.cli import VERBS, build_parser
from vlab.errors import OutputRefused
from vlab.files.assets import asset
from vlab.files.output_folder import numbered_folder, output_folder, write_manifest

CASE = str(asset("cases/emps/case.toml"))
VERB_LINES = {
    "check": ["check", CASE],
    "compare": ["compare", CASE],
    "correct": ["correct", "grid"],
    "demo": ["demo"],
    "design": ["design", "beam", "--law", "mfdrf"],
    "diagnose": ["diagnose", CASE],
    "experiment": ["experiment", "beam"],
    "modal-test": ["modal-test", CASE],
    "modes": ["modes", "beam"],
    "reproduce": ["reproduce", "--figure", "22"],
    "reproduce, the study": ["reproduce", "--limit-cycle"],
}
"""A line of each verb that writes a folder."""
INTO_A_FOLDER = {"init"}
"""Verbs that write one file into a folder that may be the user's; tests/cli/test_first_steps.py."""
CONTINUED = {"conceal", "prove"}
"""Verbs that go on in their folder, and never replace what is sealed or frozen there."""


def written(folder: Path, text: str) -> Path:
    """Write a folder as a verb does."""
    with output_folder(folder, overwrite=True) as fresh:
        (fresh / "kept.txt").write_text(text)
        write_manifest(fresh)
    return folder


def _one_of_many(stem: str) -> str:
    with numbered_folder(stem) as claimed, output_folder(claimed) as fresh:
        (fresh / "kept.txt").write_text(claimed.name)
    return claimed.name


def test_processes_at_once_get_different_numbers(tmp_path):
    with multiprocessing.get_context("spawn").Pool(4) as pool:
        names = pool.map(_one_of_many, [str(tmp_path / "out" / "run")] * 40, chunksize=1)
    assert sorted(names) == [f"run-{number:03d}" for number in range(1, 41)]
    assert {p.name: (p / "kept.txt").read_text() for p in (tmp_path / "out").iterdir()} == {n: n for n in names}


def test_the_number_follows_the_last_one_there(tmp_path):
    for name in ("run-007", "run-12", "run-x", "runs-99", "55"):
        (tmp_path / name).mkdir()
    with numbered_folder(tmp_path / "run") as claimed:
        assert claimed.name == "run-013"
        with numbered_folder(tmp_path / "run") as other:
            assert other.name == "run-014"


def test_a_claim_goes_where_nothing_came_into_it(tmp_path):
    with pytest.raises(ZeroDivisionError), numbered_folder(tmp_path / "out" / "run") as claimed, output_folder(claimed):
        raise ZeroDivisionError
    assert not list(tmp_path.iterdir())


def test_a_claim_goes_with_its_process(tmp_path):
    code = "import sys, time; from vlab.files.output_folder import numbered_folder\n"
    code += "with numbered_folder(sys.argv[1]) as claimed: print(claimed.name, flush=True); time.sleep(600)"
    line = [sys.executable, "-c", code, str(tmp_path / "run")]
    with subprocess.Popen(line, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "run-001\n"
        with numbered_folder(tmp_path / "run") as claimed:
            assert claimed.name == "run-002"
        process.kill()
    with numbered_folder(tmp_path / "run") as claimed:
        assert claimed.name == "run-001"
    assert not list(tmp_path.iterdir())


def test_what_is_there_is_replaced_only_where_it_is_said(tmp_path):
    kept = written(tmp_path / "out", "old") / "kept.txt"
    with pytest.raises(OutputRefused, match="is there already; name another"), output_folder(tmp_path / "out"):
        pass
    assert kept.read_text() == "old"
    written(tmp_path / "out", "new")
    assert kept.read_text() == "new"
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


@pytest.mark.parametrize("overwrite", [False, True])
def test_what_somebody_wrote_meanwhile_is_not_lost(tmp_path, overwrite):
    with pytest.raises(OutputRefused), output_folder(tmp_path / "out", overwrite=overwrite) as fresh:  # noqa: PT012
        (fresh / "kept.txt").write_text("mine")
        (tmp_path / "out").mkdir()
        (tmp_path / "out" / "thesis.txt").write_text("three years")
    assert [str(p.relative_to(tmp_path)) for p in sorted(tmp_path.rglob("*"))] == ["out", "out/thesis.txt"]


@pytest.mark.parametrize("line", VERB_LINES.values(), ids=VERB_LINES)
def test_a_verb_refuses_a_folder_that_is_there_before_it_works(capsys, tmp_path, line):
    out = written(tmp_path / "out", "old")
    before = sorted((p.name, p.stat().st_mtime_ns) for p in out.iterdir())
    status, _, err = run(capsys, *line, "--out", str(out))
    assert (status, err.count("\n")) == (2, 1)
    assert "is there already; name another with --out, or add --overwrite" in err
    assert sorted((p.name, p.stat().st_mtime_ns) for p in out.iterdir()) == before
    status, _, err = run(capsys, *line, "--overwrite")
    assert (status, "--overwrite replaces the folder of --out, and none was named" in err) == (2, True)


def test_every_verb_that_writes_a_folder_is_among_these():
    writing = {verb for verb in VERBS if "--out" in _options(verb)}
    assert writing - CONTINUED - INTO_A_FOLDER == {name.partition(",")[0] for name in VERB_LINES}
    assert not [verb for verb in CONTINUED if "--overwrite" in _options(verb)]


def _options(verb: str) -> str:
    (verbs,) = (a for a in build_parser(verb)._actions if a.dest == "verb")
    return verbs.choices[verb].format_help()


def test_runs_without_a_name_are_numbered_and_kept(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    line = ["experiment", "beam", "--plant", "modal", "--seconds", "0.5", "--excite", "release"]
    for name in ("run-001", "run-002"):
        status, text, _ = run(capsys, *line)
        assert status == 0
        assert f"written to out/{name}: " in text
    status, _, _ = run(capsys, *line, "--law", "unknown")
    assert status == 2
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["run-001", "run-002"]
    assert run(capsys, *line, "--out", "out/run-001")[0] == 2
    assert run(capsys, *line, "--out", "out/run-001", "--overwrite")[0] == 0


def test_a_file_of_two_runs_is_not_overwritten(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("a", "b"):
        run(capsys, "experiment", "beam", "--plant", "modal", "--seconds", "0.2", "--excite", "release", "--out", name)
    assert run(capsys, "show", "a", "b", "--save", "two.rrd")[0] == 0
    before = Path("two.rrd").stat().st_mtime_ns
    status, _, err = run(capsys, "show", "a", "b", "--save", "two.rrd")
    assert (status, "two.rrd is there already; name another with --save, or add --overwrite" in err) == (2, True)
    assert Path("two.rrd").stat().st_mtime_ns == before
    assert run(capsys, "show", "a", "b", "--save", "two.rrd", "--overwrite")[0] == 0
