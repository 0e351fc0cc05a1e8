"""A run folder as a colleague sends it: it runs nobody's code, reads nothing outside itself, and is what was recorded."""

import ast
import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from command import run

from vlab.errors import BadController, BadExperiment, BadRecording
from vlab.files.assets import asset
from vlab.files.toml import Reader
from vlab.lab.laws import named_law
from vlab.lab.run_folder import COPIES, RunSettings, StoredSettings, load_run, perform
from vlab.physics.catalogue import effect_named
from vlab.physics.spec import parse_effect
from vlab.recordings.bound import RECORDING, check_run

EVIL = """from pathlib import Path
Path({mark!r}).write_text("code of a data folder was run")
from vlab.physics.effect import Parameter, PortEffect
class E(PortEffect):
    name, family, law, words = "e", "damping", "F = -a v", "evil"
    parameters = (Parameter(name="a", unit="N s/m", low=1e-9, high=1e9),)
    def force(self, z, v, p, step, memory):
        return -p["a"] * v, memory
class L:
    sensors, actuators = ["base"], ["base"]
    def reset(self): pass
    def step(self, y): return [0.0]
"""
QUICK = ["--plant", "modal", "--seconds", "0.5", "--period", "0.2", "--band", "10", "30"]


@pytest.fixture(scope="module")
def kept(tmp_path_factory) -> Path:
    """A run on a structure file of its own, as vlab wrote it, and then without the files that it was made from."""
    here = tmp_path_factory.mktemp("kept")
    shutil.copy(asset("beam.toml"), here / "mine.toml")
    shutil.copy(asset("laboratory.toml"), here / "hardware-of-mine.toml")
    settings = RunSettings(
        structure=str(here / "mine.toml"),
        hardware=str(here / "hardware-of-mine.toml"),
        plant="modal",
        seconds=2.0,
        period_s=0.5,
        low_hz=4.0,
        high_hz=30.0,
    )
    (here / "run").mkdir()
    perform(settings.prepare(), here / "run").finish(here / "run")
    (here / "mine.toml").unlink()
    (here / "hardware-of-mine.toml").unlink()
    return here / "run"


@pytest.fixture
def folder(kept, tmp_path, monkeypatch) -> Path:
    """A copy of that run, with hostile code beside it; the code leaves a mark where it runs."""
    shutil.copytree(kept, tmp_path / "run")
    (tmp_path / "evil.py").write_text(EVIL.format(mark=str(tmp_path / "pwned.txt")))
    monkeypatch.chdir(tmp_path)
    return tmp_path / "run"


def change(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


NAMED = {
    "effect": ("effect = []", 'effect = ["evil.py:E@20in:a=1"]', "unknown effect 'evil.py:E': it is code that a file of data names"),
    "second effect": (
        "effect = []",
        'effect = ["coulomb-friction@20in:force=0.02", "./evil.py:E@20in:a=1"]',
        "unknown effect './evil.py:E'",
    ),
    "law": ('law = ""', 'law = "evil.py:L"', "run without --law"),
}  # fmt: skip


@pytest.mark.parametrize(("old", "new", "match"), NAMED.values(), ids=NAMED)
def test_settings_of_a_run_folder_run_nobodys_code(folder, capsys, old, new, match):
    change(folder / "run.toml", old, new)
    words = ["modal-test", str(folder), "--band", "4", "30", "--modes", "2", "--against-plant"]
    status, out, err = run(capsys, *words)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert match in err
    assert not (folder.parent / "pwned.txt").exists()


def test_settings_from_a_file_name_code_only_that_the_user_named_too(folder):
    settings = StoredSettings(structure="beam", plant="modal", law="evil.py:L", effect=("evil.py:E@20in:a=1",))
    with pytest.raises(BadController, match="it is code that a file of data names"):
        settings.prepare()
    with pytest.raises(BadExperiment, match="unknown effect 'evil.py:E'"):
        replace(settings, law="").prepare(code=["other.py"])
    assert isinstance(load_run(folder)[1], StoredSettings)
    assert not (folder.parent / "pwned.txt").exists()
    settings.prepare(code=["./evil.py"])  # the same file
    assert (folder.parent / "pwned.txt").exists()


def test_settings_made_in_python_may_name_code(folder):
    RunSettings(structure="beam", plant="modal", effect=("evil.py:E@20in:a=1",)).prepare()
    assert (folder.parent / "pwned.txt").exists()


@pytest.mark.parametrize("name", ["evil.py:E", "evil.py", "entry:anything", "/tmp/../evil.py:E", "evil.py:E.py"])
def test_a_name_from_data_runs_no_code(folder, beam, name):
    with pytest.raises(BadExperiment, match="it is code that a file of data names"):
        effect_named(name, code=())
    with pytest.raises(BadExperiment, match="it is code that a file of data names"):
        parse_effect(f"{name}@20in:a=1", code=["other.py"])
    with pytest.raises(BadController, match="it is code that a file of data names"):
        named_law(beam, name, code=())
    assert not (folder.parent / "pwned.txt").exists()


PLAN = """title = "a plan by mail"
[settings]
structure = "beam"
plant = "modal"
seconds = 0.4
period_s = 0.4
low_hz = 10.0
high_hz = 30.0
{line}
[[record]]
name = "one"
role = "fit"
"""


@pytest.mark.parametrize("line", ['effect = ["evil.py:E@20in:a=1"]', 'law = "evil.py:L"'])
def test_a_plan_runs_code_only_where_it_is_named_beside_the_plan(folder, capsys, line):
    here = folder.parent
    (here / "plan.toml").write_text(PLAN.format(line=line))
    status, out, err = run(capsys, "experiment", "--plan", "plan.toml", "--out", "out")
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert "it is code that a file of data names" in err
    assert not (here / "pwned.txt").exists()
    assert not (here / "out").exists()
    assert run(capsys, "experiment", "--plan", "plan.toml", "--code", "evil.py", "--out", "out")[0] == 0
    assert (here / "pwned.txt").exists()


@pytest.mark.slow
def test_code_that_is_typed_is_run(folder, capsys):
    words = ["experiment", "beam", *QUICK, "--effect", "evil.py:E@20in:a=1", "--law", "evil.py:L", "--out", "typed"]
    assert run(capsys, *words)[0] == 0
    assert (folder.parent / "pwned.txt").exists()
    status, _, err = run(capsys, "experiment", "beam", *QUICK, "--code", "evil.py", "--out", "typed")
    assert status == 2
    assert "--code is for --plan" in err


LOADERS = ("effect_named", "parse_effect", "named_law", "bench_law")
"""Functions that run code where their name is one of code, unless `code` says which the user named."""


def test_every_caller_says_whose_code_a_name_may_run():
    """A name that is no constant may come from data, so whoever looks it up says what the user named: see `check_code`."""
    root = Path(named_law.__code__.co_filename).parents[2]
    silent, direct = [], {}
    for path in [*(root / "vlab").rglob("*.py"), *(root / "controllers").rglob("*.py")]:
        text = path.read_text(encoding="utf-8")
        if not any(name in text for name in (*LOADERS, "load_user_law", "class_from_file", "exec(", "eval(")):
            continue
        for function in [n for n in ast.walk(ast.parse(text)) if isinstance(n, ast.FunctionDef)]:
            calls = [n for n in ast.walk(function) if isinstance(n, ast.Call) and isinstance(n.func, ast.Name)]
            names = {c.func.id for c in calls}
            for call in calls:
                says = any(k.arg == "code" for k in call.keywords)
                is_constant = any(isinstance(a, ast.Constant) for a in call.args)
                if call.func.id in LOADERS and not says and not is_constant:
                    silent.append(f"{path.name}: {function.name}")
            for loads in {"load_user_law", "class_from_file", "_users_own", "exec", "eval"} & names:
                direct[function.name] = (loads, "check_code" in names)
    assert silent == []
    assert direct == {
        "named_law": ("load_user_law", True),
        "bench_law": ("load_user_law", True),
        "effect_named": ("_users_own", True),
        "load_user_law": ("class_from_file", False),
        "_users_own": ("class_from_file", False),
    }


# ---- files ---------------------------------------------------------------------------------------------------------


def test_a_run_folder_holds_the_files_that_it_was_made_from(folder, capsys):
    assert {p.name for p in folder.iterdir()} == {
        RECORDING, "run.toml", "manifest.json", COPIES["structure"], COPIES["hardware"],
    }  # fmt: skip
    settings = load_run(folder)[1]
    with pytest.raises(LookupError, match="unknown structure"):
        settings.prepare()  # from where it was made
    assert settings.inside(folder).prepare().structure.name == "beam"


def test_nothing_outside_a_run_folder_is_read_for_it(folder, tmp_path):
    settings = load_run(folder)[1]
    copy = folder / COPIES["structure"]
    elsewhere = tmp_path / "elsewhere.toml"
    copy.rename(elsewhere)
    with pytest.raises(BadRecording, match=r"structure = .*mine.toml' is read from structure.toml in the run folder"):
        settings.inside(folder)
    copy.symlink_to(elsewhere)
    with pytest.raises(BadRecording, match="lies outside"):
        settings.inside(folder)
    (folder / "run.toml").rename(tmp_path / "run.toml")
    (folder / "run.toml").symlink_to(tmp_path / "run.toml")
    with pytest.raises(BadRecording, match=r"run\.toml: the file lies outside"):
        load_run(folder)


def test_no_link_leads_the_viewer_out_of_a_run_folder(folder, capsys, tmp_path):
    (tmp_path / "other.rrd").write_bytes(b"RRF2")
    (folder / "run.rrd").symlink_to(tmp_path / "other.rrd")
    status, out, err = run(capsys, "show", str(folder))
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert "lies outside the run folder" in err


# ---- the recording -------------------------------------------------------------------------------------------------


def spoil(path: Path) -> None:
    """Change one byte of the numbers: the file stays readable, for Parquet keeps no sum of its pages here."""
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


def test_a_recording_that_its_manifest_does_not_know_is_refused_by_every_verb(folder, capsys, tmp_path):
    spoil(folder / RECORDING)
    (folder / "run.rrd").write_bytes(b"RRF2")
    case = tmp_path / "case.toml"
    channel = '[[recording.channel]]\ncolumn = "{}"\nat = "{}"\nkind = "{}"\nunit = "{}"\n'
    case.write_text(
        'title = "t"\n[model]\nstructure = "beam"\nplant = "modal"\n[[recording]]\n'
        f'file = "run/{RECORDING}"\nrole = "fit"\ntime = "time"\n'
        + channel.format("force:base", "base", "force", "N") + "input = true\n"
        + channel.format("sensor:20in", "20in", "velocity", "m/s")
    )  # fmt: skip
    shutil.copytree(folder, tmp_path / "other")
    for words in (
        ["modal-test", str(folder), "--band", "4", "30", "--modes", "2"],
        ["modal-test", str(folder / RECORDING), "--band", "4", "30", "--modes", "2"],
        ["show", str(folder)],
        ["show", str(folder), str(tmp_path / "other"), "--save", "two.rrd"],
        ["compare", str(case)],
        ["diagnose", str(case)],
    ):
        status, out, err = run(capsys, *words)
        assert (status, out, err.count("\n")) == (2, "", 1), words
        assert "is not the one whose hash the manifest.json beside it states" in err


@pytest.mark.parametrize("how", ["no hash", "no JSON", "link"])
def test_a_manifest_that_states_no_hash_is_refused(folder, tmp_path, how):
    manifest = folder / "manifest.json"
    if how == "no hash":
        content = json.loads(manifest.read_text())
        del content["recording_sha256"]
        manifest.write_text(json.dumps(content))
    elif how == "no JSON":
        manifest.write_text("[" * 100_000)
    else:
        manifest.rename(tmp_path / "manifest.json")
        manifest.symlink_to(tmp_path / "manifest.json")
    with pytest.raises(BadRecording, match=r"its manifest\.json does not state the hash"):
        load_run(folder)


def test_a_recording_as_it_was_written_is_read(folder):
    check_run(folder)
    recording, settings = load_run(folder)
    assert recording.meta["structure"] == settings.structure
    assert Reader(folder / "run.toml").load()["seed"] == 0
