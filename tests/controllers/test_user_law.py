"""A user's own law: from the named file only, and every mistake is one line."""

import importlib.metadata
from pathlib import Path

import numpy as np
import pytest
from vlab.controllers.user_law import GROUP, is_user_law, load_user_law

from vlab.cli import main
from vlab.controllers import Controller, LinearLaw
from vlab.errors import BadController, UnknownName
from vlab.files.assets import asset
from vlab.lab import Experiment, run_experiment

HEAD = "import numpy as np\n"


def law_file(tmp_path: Path, step: str = "return -y", *, head: str = "", body: str = "") -> str:
    text = f"{HEAD}{head}\nclass Mine:\n    sensors = actuators = ('base',)\n{body}\n    def reset(self): pass\n    def step(self, y): {step}\n"
    path = tmp_path / "mine.py"
    path.write_text(text)
    return f"{path}:Mine"


def run(law, plant, seconds=0.1):
    return run_experiment(Experiment(plant=plant, seconds=seconds, controller=law)).recording


def test_a_named_class_is_loaded_and_runs(tmp_path):
    law = load_user_law(law_file(tmp_path, "return [-2 * y[0]]"))
    assert isinstance(law, Controller)
    law.reset()
    assert law.step(np.array([3.0])) == pytest.approx([-6.0])


def test_the_example_that_comes_with_vlab_has_ten_lines_and_runs(modal):
    path = asset("examples/saturated_damper.py")
    code = [line for line in path.read_text().split("class ")[1].splitlines() if line.strip() and '"""' not in line]
    assert len(code) <= 10
    record = run(load_user_law(f"{path}:SaturatedDamper"), modal)
    assert np.abs(record["command:base"]).max() <= 0.5


def test_a_law_may_be_a_function_or_an_object(tmp_path):
    path = tmp_path / "other.py"
    path.write_text(
        "from vlab.controllers import LinearLaw, DirectRateFeedback\n"
        "def make(): return LinearLaw([[0.5]], [[1.0]], [[1.0]], [[0.0]], sensors=['base'], actuators=['base'], rate=1000.0)\n"
        "ready = DirectRateFeedback([[2.0]], sensors=['base'], actuators=['base'])\n"
    )
    assert isinstance(load_user_law(f"{path}:make"), LinearLaw)  # theory can predict it: it keeps its matrices
    assert load_user_law(f"{path}:ready").step(np.array([1.0])) == pytest.approx([-2.0])


def test_nothing_is_loaded_that_was_not_named(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mfdrf.py").write_text("raise SystemExit('loaded')")
    assert not is_user_law("mfdrf")
    assert is_user_law("mfdrf.py:Law")
    assert main(["experiment", "beam", "--law", "mfdrff", "--seconds", "0.1", "--out", str(tmp_path / "out")]) == 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("law.py", "names no class of a file; write path/to/law.py:ClassName"),
        ("law.py:", "names no class"),
        ("law.py:a-b", "names no class"),
        ("missing.py:Mine", "there is no law file"),
    ],
)
def test_names_that_name_nothing_are_refused(tmp_path, monkeypatch, text, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "law.py").write_text("")
    with pytest.raises(BadController, match=message):
        load_user_law(text)


def test_a_class_that_is_not_there_gives_those_that_are(tmp_path):
    path = law_file(tmp_path).removesuffix(":Mine")
    with pytest.raises(UnknownName, match="unknown class 'Mien'; did you mean 'Mine'"):
        load_user_law(f"{path}:Mien")


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"head": "1 / 0"}, "fails when it is loaded: ZeroDivisionError"),
        ({"head": "def broken(:"}, "fails when it is loaded: SyntaxError"),
        ({"head": "raise SystemExit"}, "fails when it is loaded: SystemExit"),
        ({"body": "    def __init__(self, gain): pass"}, "cannot be made without arguments: TypeError"),
        ({"body": "    sensors = 'base'"}, "must say its sensors as places"),
        ({"body": "    actuators = ()"}, "must say its actuators as places"),
        ({"body": "    rate = -1"}, "rate = -1 is not a positive number"),
    ],
)
def test_files_that_cannot_become_a_law_are_refused(tmp_path, parts, message):
    with pytest.raises(BadController, match=message) as caught:
        load_user_law(law_file(tmp_path, **parts))
    assert "\n" not in str(caught.value)


def test_a_failure_names_the_line_of_the_users_file(tmp_path, modal):
    path = law_file(tmp_path, "return np.linalg.inv(np.zeros((1, 1)))[0]")
    line = 1 + next(
        i for i, text in enumerate(Path(path.rpartition(":")[0]).read_text().splitlines()) if "inv(" in text
    )
    with pytest.raises(BadController, match=rf"LinAlgError: Singular matrix \(\w+\.py:{line}\)$"):
        run(load_user_law(path), modal)


def test_a_law_with_arguments_says_what_to_do(tmp_path):
    path = tmp_path / "damper.py"
    path.write_text("class Damper:\n    def __init__(self, gain): pass\n")
    with pytest.raises(BadController, match=r"give every argument a default, or make the law in Python"):
        load_user_law(f"{path}:Damper")


@pytest.mark.parametrize("missing", ["step", "reset"])
def test_a_law_without_its_methods_is_refused(tmp_path, missing):
    path = tmp_path / "half.py"
    other = {"step": "reset", "reset": "step"}[missing]
    path.write_text(f"class Half:\n    sensors = actuators = ('base',)\n    def {other}(self, y=0): pass\n")
    with pytest.raises(BadController, match=rf"has no method {missing}\(\)"):
        load_user_law(f"{path}:Half")


@pytest.mark.parametrize(
    ("step", "message"),
    [
        ("return np.zeros(2)", "gave 2 commands at sample 1; 1 are needed"),
        ("return 0.0", "gave a single number at sample 1"),
        ("return np.zeros((1, 1))", r"gave an array of shape \(1, 1\)"),
        ("return None", "gave nothing at sample 1; does step"),
        ("return ['push']", "fails in step\\(\\) at sample 1: ValueError"),
        ("raise RuntimeError('no\\nidea')", r"fails in step\(\) at sample 1: RuntimeError: no idea \(\w+\.py:\d+\)$"),
    ],
)
def test_answers_that_are_no_commands_are_refused_before_the_run(tmp_path, modal, step, message):
    with pytest.raises(BadController, match=message) as caught:
        run(load_user_law(law_file(tmp_path, step)), modal)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("later", "message"),
    [
        ("np.array([np.nan])", "gave nan for base at sample 50"),
        ("np.array([np.inf])", "gave inf for base at sample 50"),
        ("1 / 0", "fails in step\\(\\) at sample 50: ZeroDivisionError"),
        ("np.zeros(3)", "gave 3 commands at sample 50"),
    ],
)
def test_a_law_that_goes_wrong_in_the_run_says_when(tmp_path, modal, later, message):
    body = "    n = 0\n    def count(self):\n        self.n += 1\n        return self.n"
    text = law_file(
        tmp_path, f"return {later} if self.count() == 51 else -y", body=body
    )  # one more: the try before the run
    with pytest.raises(BadController, match=message):
        run(load_user_law(text), modal)


def test_a_law_cannot_change_the_samples_it_is_given(tmp_path):
    law = load_user_law(law_file(tmp_path, "y[0] = 99.0; return -y"))
    y = np.array([1.0])
    law.step(y)
    assert y[0] == 1.0


def test_places_that_do_not_exist_are_named(tmp_path, modal):
    text = law_file(tmp_path, body="    sensors = ('bse',)")
    with pytest.raises(UnknownName, match="unknown sensor 'bse'"):
        run(load_user_law(text), modal)


def test_the_command_line_runs_a_law_and_says_mistakes_in_one_line(tmp_path, capsys):
    text, out = law_file(tmp_path), str(tmp_path / "run")
    assert main(["experiment", "beam", "--plant", "modal", "--law", text, "--seconds", "0.5", "--out", out]) == 0
    assert "command:base" in capsys.readouterr().out
    assert text in (tmp_path / "run" / "run.toml").read_text()
    bad = law_file(tmp_path, "return np.full(1, np.nan)")
    assert (
        main(["experiment", "beam", "--plant", "modal", "--law", bad, "--seconds", "0.5", "--out", str(tmp_path / "b")])
        == 2
    )
    error = capsys.readouterr().err
    assert error.startswith("error: the law ")
    assert error.count("\n") == 1
    assert not (tmp_path / "b").exists()


class Point:
    def __init__(self, name: str, made: object) -> None:
        self.name, self.value, self._made = name, "package:Law", made

    def load(self) -> object:
        if isinstance(self._made, Exception):
            raise self._made
        return self._made


class Plain:
    sensors = actuators = ("base",)

    def reset(self):
        pass

    def step(self, y):
        return -y


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([], "unknown entry point 'mine'"),
        ([Point("mine", Plain), Point("mine", Plain)], "2 installed packages offer a law 'mine'"),
        ([Point("mine", ImportError("gone"))], "fails when it is loaded: ImportError: gone"),
    ],
)
def test_entry_points_that_give_no_law_are_refused(monkeypatch, points, message):
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: points if group == GROUP else [])
    with pytest.raises((BadController, UnknownName), match=message):
        load_user_law("entry:mine")


def test_a_named_entry_point_is_loaded_and_no_other(monkeypatch):
    points = [Point("other", RuntimeError("must not load")), Point("mine", Plain)]
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: points if group == GROUP else [])
    assert load_user_law("entry:mine").step(np.ones(1)) == pytest.approx([-1.0])
