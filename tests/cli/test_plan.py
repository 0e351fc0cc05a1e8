"""Test plans: records into a case, resumed where they stood, bound to their settings, concealed where asked."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from command import run

from vlab.cases import load_case
from vlab.cli.common import share_bar
from vlab.files.assets import asset
from vlab.lab.plan import load_plan, perform_plan

PLAN = """title = "Two records"
{top}
[settings]
structure = "beam"
plant = "modal"
seconds = 0.4
low_hz = 10.0
high_hz = 30.0
period_s = 0.4
level = 0.1
{shared}
[model]
uncertain = {{ stiffness = 0.05 }}
[[record]]
name = "one"
role = "fit"
seed = 1
[[record]]
name = "two"
role = "holdout"
law = "mfdrf"
seed = 2
{last}
"""
RUBS = 'effect = ["coulomb-friction@20in:force=0.02"]'


def plan_file(folder, *, top="", shared="", last="", **changed):
    text = PLAN.format(top=top, shared=shared, last=last)
    for key, value in changed.items():
        lines = [f"{key} = {value}" if line.startswith(f"{key} = ") else line for line in text.splitlines()]
        text = "\n".join(lines)
    path = folder / "plan.toml"
    path.write_text(text)
    return path


def stamps(folder):
    return {path: path.stat().st_mtime_ns for path in folder.glob("*/recording.parquet")}


def test_a_plan_becomes_a_case_that_its_own_model_explains(capsys, tmp_path):
    out = tmp_path / "out"
    last = '[[record]]\nname = "let-go"\nrole = "holdout"\nexcite = "release"\nlevel = 0.2\n'
    path = plan_file(tmp_path, last=last)
    status, text, err = run(capsys, "experiment", "--plan", str(path), "--out", str(out), "--json")
    document = json.loads(text)
    assert (status, err) == (0, "")
    assert [(r["name"], r["role"], r["performed"]) for r in document["records"]] == [
        ("one", "fit", True), ("two", "holdout", True), ("let-go", "holdout", True),
    ]  # fmt: skip
    for record in document["records"]:
        files = {p.name for p in Path(record["folder"]).iterdir()}
        assert files == {"recording.parquet", "run.toml", "manifest.json", "run.rrd"}
    case = load_case(out)
    assert dict(case.table.model.uncertain) == {"stiffness": 0.05}
    status, text, _ = run(capsys, "compare", str(out), "--json")
    assert status == 0
    for recording in json.loads(text)["runs"]:
        for misfit in recording["misfits"]:
            # The forces are means over the samples: at 30 Hz and 2 kHz off by (omega T)^2/24, below 0.1 %. The state at
            # the start of the release is estimated from its first samples.
            assert misfit["nrmse"] < (5e-3 if "let-go" not in str(recording) else 0.1), misfit


def test_what_is_done_is_not_done_again(capsys, tmp_path):
    out, path = tmp_path / "out", plan_file(tmp_path)
    assert run(capsys, "experiment", "--plan", str(path), "--out", str(out))[0] == 0
    before = stamps(out)
    assert len(before) == 2
    more = '[[record]]\nname = "three"\nrole = "fit"\nseed = 3\n'
    path = plan_file(tmp_path, last=more, title='"Three records"', role='"fit"')
    status, text, _ = run(capsys, "experiment", "--plan", str(path), "--out", str(out))
    assert status == 0
    assert "1 of 3 records performed, 2 had been there" in text
    assert "no page" not in text
    assert (
        "no page was made for what had been there: one, two, three"
        in run(capsys, "experiment", "--plan", str(path), "--out", str(out), "--report")[1]
    )
    after = stamps(out)
    assert len(after) == 3
    assert before.items() < after.items()
    assert {r.role for r in load_case(out).table.recording} == {"fit"}


def test_an_interrupted_plan_leaves_whole_records_and_goes_on(tmp_path):
    plan, out, seen = load_plan(plan_file(tmp_path)), tmp_path / "out", []

    def interrupt(progress):
        seen.append(progress.record)
        if progress.record == "two" and seen.count("two") > 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt, match="1 of 2 records are whole"):
        perform_plan(plan, out, progress=interrupt)
    assert sorted(p.name for p in out.iterdir()) == ["manifest.json", "one"]
    before = stamps(out)
    done = perform_plan(plan, out)
    assert (done.performed, done.kept) == (("two",), ("one",))
    assert before.items() < stamps(out).items()


def test_a_damaged_record_is_performed_again_to_the_same_bits(tmp_path):
    plan, out = load_plan(plan_file(tmp_path)), tmp_path / "out"
    perform_plan(plan, out)
    file = out / "two" / "recording.parquet"
    whole = file.read_bytes()
    file.write_bytes(whole[:-100])
    assert perform_plan(plan, out).performed == ("two",)
    assert file.read_bytes() == whole


def test_changed_settings_are_refused(capsys, tmp_path):
    out, law = tmp_path / "out", tmp_path / "law.py"
    law.write_text((asset("examples/saturated_damper.py")).read_text())
    path = plan_file(tmp_path, law=f'"{law}:SaturatedDamper"')
    assert run(capsys, "experiment", "--plan", str(path), "--code", str(law), "--out", str(out))[0] == 0
    before = stamps(out)
    for changed, said in (
        ({"level": "0.2"}, "record 'one': level was 0.1 and is 0.2"),
        ({"name": '"one"', "role": '"fit"'}, "two records are called 'one'"),
        ({"top": "concealed = true"}, "was begun with concealed = False"),
    ):
        path = plan_file(tmp_path, **{"law": f'"{law}:SaturatedDamper"', **changed})
        status, _, err = run(capsys, "experiment", "--plan", str(path), "--code", str(law), "--out", str(out))
        assert (status, err.count("\n")) == (2, 1)
        assert said in err
    law.write_text(law.read_text().replace("-20.0", "-21.0"))
    path = plan_file(tmp_path, law=f'"{law}:SaturatedDamper"')
    status, _, err = run(capsys, "experiment", "--plan", str(path), "--code", str(law), "--out", str(out))
    assert status == 2
    assert "law.py has other content" in err
    assert stamps(out) == before


def test_a_concealed_plan_says_nothing_beside_its_recordings(capsys, tmp_path):
    out = tmp_path / "out"
    path = plan_file(tmp_path, top="concealed = true", shared=RUBS)
    assert run(capsys, "experiment", "--plan", str(path), "--out", str(out))[0] == 0
    files = [p for p in out.rglob("*") if p.is_file()]
    assert sorted(p.name for p in out.rglob("*.*")) == sorted(
        ["case.toml", "manifest.json", *2 * ["manifest.json", "recording.parquet", "run.toml"]]
    )
    for file in files:
        assert b"coulomb" not in file.read_bytes()
        assert b"friction" not in file.read_bytes()
    assert not any(
        b"coulomb" in (v or b"") for v in (pq.read_schema(out / "one/recording.parquet").metadata or {}).values()
    )
    truth = json.loads((tmp_path / "out-truth" / "truth.json").read_text())
    assert truth["records"]["two"]["settings"]["effect"] == ["coulomb-friction@20in:force=0.02"]
    # No hash binds what is concealed, either: the same plan without the effect has the same manifest.
    plain = plan_file(tmp_path, top="concealed = true")
    assert run(capsys, "experiment", "--plan", str(plain), "--out", str(tmp_path / "plain"))[0] == 0
    assert (out / "manifest.json").read_bytes() == (tmp_path / "plain" / "manifest.json").read_bytes()
    first, second = ((p / "one" / "recording.parquet").read_bytes() for p in (out, tmp_path / "plain"))
    assert first != second  # the effect is at work
    for changed in ({"shared": RUBS.replace("0.02", "0.03")}, {}):
        path = plan_file(tmp_path, top="concealed = true", **changed)
        status, _, err = run(capsys, "experiment", "--plan", str(path), "--out", str(out))
        assert status == 2
        assert "record 'one': effect was" in err


def test_the_truth_of_another_plan_is_not_lost(capsys, tmp_path):
    (tmp_path / "out-truth").mkdir()
    (tmp_path / "out-truth" / "truth.json").write_text("{}")
    path = plan_file(tmp_path, top="concealed = true", shared=RUBS)
    status, _, err = run(capsys, "experiment", "--plan", str(path), "--out", str(tmp_path / "out"))
    assert status == 2
    assert "would be lost" in err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"top": "concaled = true"}, "unknown key 'concaled'; did you mean 'concealed'? (accepted: title, concealed, sett"),
        ({"shared": "sed = 3"}, "settings: unknown key 'sed'; did you mean 'seed'?"),
        ({"shared": 'role = "fit"'}, "settings.role: every record has its own"),
        ({"last": "wrong = 3"}, "record[1]: unknown key 'wrong'"),
        ({"last": "[[record]]\nseed = 3"}, "record[2]: the key 'name' is missing"),
        ({"role": '"test"'}, "unknown value 'test' (accepted: fit, holdout)"),
        ({"name": '"../up"'}, "cannot be that of its folder"),
        ({"name": '"case.toml"'}, "cannot be that of its folder"),
        ({"last": 'variant = "physical"'}, "record 'two' has variant = 'physical', record 'one' has 'published'"),
        ({"law": '"mfdfr"'}, "unknown law 'mfdfr'; did you mean 'mfdrf'"),
        ({"level": '"much"'}, "settings.level: float was expected, 'much' was given"),
        ({"title": "3"}, "title: text"),
        ({"uncertain": "{ stifness = 0.1 }"}, "did you mean 'stiffness'"),
        ({"seconds": "-1.0"}, "record 'one': a duration of -1.0 s cannot be run"),
        ({"shared": "[["}, "malformed TOML"),
    ],
)  # fmt: skip
def test_bad_plans_are_one_line_and_leave_nothing(capsys, tmp_path, monkeypatch, changed, said):
    monkeypatch.chdir(tmp_path)
    path = plan_file(tmp_path, **changed)
    status, out, err = run(capsys, "experiment", "--plan", str(path))
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert said in err
    assert [p.name for p in tmp_path.iterdir()] == ["plan.toml"]


@pytest.mark.parametrize("words", [["beam"], ["--seed", "3"], ["--live"], ["--csv"]])
def test_settings_beside_a_plan_are_refused(capsys, tmp_path, words):
    path = plan_file(tmp_path)
    status, _, err = run(capsys, "experiment", *words, "--plan", str(path))
    assert status == 2
    assert "given besides --plan" in err


def test_a_folder_of_somebody_else_is_left_alone(capsys, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "thesis.txt").write_text("three years")
    status, _, err = run(capsys, "experiment", "--plan", str(plan_file(tmp_path)), "--out", str(tmp_path / "out"))
    assert status == 2
    assert "out holds files of no plan" in err
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["thesis.txt"]


def test_the_example_is_a_plan():
    plan = load_plan(asset("examples/plan.toml"))
    assert len(plan.prepare()) == len(plan.record) == 5
    assert {record.role for record in plan.record} == {"fit", "holdout"}
    release = next(record for record in plan.record if record.excite == "release")
    assert release.period_s is None  # what belongs to the multisine does not apply


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_control_c_and_a_kill_leave_whole_records(tmp_path, number):
    path, out = plan_file(tmp_path, seconds="120.0", plant='"composite"'), tmp_path / "out"
    words = [sys.executable, "-m", "vlab", "experiment", "--plan", str(path), "--out", str(out)]
    process = subprocess.Popen(words, stderr=subprocess.PIPE, text=True, env={**os.environ})
    while not (out / "one").is_dir():
        assert process.poll() is None
        time.sleep(0.1)
    time.sleep(0.5)  # a tenth of what the second record takes
    process.send_signal(number)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "1 of 2 records are whole" in err
    assert sorted(p.name for p in out.iterdir()) == ["manifest.json", "one"]


def test_a_plan_without_a_holdout_says_so(capsys, tmp_path):
    path = plan_file(tmp_path)
    path.write_text(path.read_text().replace("holdout", "fit"))
    status, text, _ = run(capsys, "experiment", "--plan", str(path), "--out", str(tmp_path / "out"))
    assert status == 0
    assert "no record is held out" in text


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_an_interrupt_that_python_dropped_is_heard_at_the_next_step():
    class Last:
        def __del__(self):
            signal.raise_signal(signal.SIGINT)  # an exception in here is printed and forgotten

    with pytest.raises(KeyboardInterrupt), share_bar("plan") as report:  # noqa: PT012
        report(0.1, "one")
        Last()
        report(0.2, "two")
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
