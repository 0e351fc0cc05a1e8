"""A newcomer: from a wheel in a fresh environment, in a folder of their own, from a model and logs to an answer.

The environment shares the installed libraries of this one, so nothing is fetched.
"""

import json
import os
import subprocess
import sysconfig
import venv
from pathlib import Path

import pytest
from arm_logs import write_arm

ROOT = Path(__file__).parent.parent
FRICTION = 0.15  # N m, in the elbow of the machine and not of the model
FIVE_LINES = """\
import numpy as np, vlab
logs = [np.genfromtxt(f"arm/run{k}.csv", delimiter=",", names=True, deletechars="") for k in (1, 2, 3)]
turn = lambda log, name: np.radians(log[name])
runs = [({j: turn(log, f"action.{j}.pos") for j in J}, {f"joint:{j}": turn(log, f"{j}.pos") for j in J}) for log in logs]
print(vlab.Case.from_arrays("arm/arm.xml", logs[0]["timestamp"] / 1e3, *map(list, zip(*runs))))
"""

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def home(tmp_path_factory) -> Path:
    """Return a folder with a fresh environment, in which the wheel is installed, and the arm's files."""
    wheel = pytest.importorskip("hatchling.builders.wheel")
    home = tmp_path_factory.mktemp("home")
    (built,) = wheel.WheelBuilder(str(ROOT)).build(directory=str(home / "dist"), versions=["standard"])
    venv.create(home / "venv", with_pip=True)
    python = home / "venv" / "bin" / "python"
    install = [str(python), "-m", "pip", "install", "-q", "--no-deps", "--no-index", built]
    subprocess.run(install, check=True)
    site = subprocess.run(
        [str(python), "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"],
        check=True, capture_output=True, text=True,
    ).stdout.strip()  # fmt: skip
    (Path(site) / "libraries.pth").write_text(sysconfig.get_path("purelib") + "\n")
    write_arm(home / "arm", logs=3, seconds=6.0, friction=FRICTION)
    return home


def called(home: Path, *words: str) -> "subprocess.CompletedProcess[str]":
    """Run a program of the fresh environment in the newcomer's folder."""
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    program = str(home / "venv" / "bin" / words[0])
    return subprocess.run([program, *words[1:]], cwd=home, env=environment, capture_output=True, text=True)


def test_the_command_comes_from_the_wheel(home):
    done = called(home, "python", "-c", "import vlab; print(vlab.__file__)")
    assert Path(done.stdout.strip()).is_relative_to(home / "venv")
    done = called(home, "vlab", "--version")
    assert done.stdout.startswith("vlab "), done.stderr


def test_init_and_check_lead_to_the_next_command(home):
    logs = [f"arm/run{k}.csv" for k in (1, 2, 3)]
    done = called(home, "vlab", "init", "arm/arm.xml", *logs)
    assert done.returncode == 0, done.stderr
    assert "next: vlab check arm/case.toml" in done.stdout
    done = called(home, "vlab", "check", "arm/case.toml", "--out", "out/check")
    assert done.returncode == 0, done.stderr
    assert "next: vlab diagnose arm/case.toml" in done.stdout
    assert (home / "out" / "check" / "check.png").stat().st_size > 10_000


def test_a_diagnosis_names_the_friction_and_writes_the_page(home):
    words = ["diagnose", "arm/case.toml", "--family", "friction", "--until-noise", "--out", "out/arm", "--json"]
    done = called(home, "vlab", *words)
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    finding = document["rounds"][0]["findings"][0]
    assert (finding["effect"], finding["place"]) == ("coulomb-friction", "joint:elbow_flex")
    assert finding["parameters"]["force"]["value"] == pytest.approx(FRICTION, rel=0.1)
    assert (home / "out" / "arm" / "report.html").stat().st_size > 10_000


def test_five_lines_of_python_hold_the_same_case(home):
    (home / "five.py").write_text("J = ('shoulder_pan', 'elbow_flex')\n" + FIVE_LINES)
    done = called(home, "python", "five.py")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("<Case")


def test_examples_are_reachable(home):
    done = called(home, "vlab", "examples")
    assert "example:emps" in done.stdout, done.stderr
    done = called(home, "vlab", "check", "example:silverbox")
    assert done.returncode == 0, done.stderr
    done = called(home, "vlab", "examples", "--copy", "mine")
    assert done.returncode == 0, done.stderr
    assert (home / "mine" / "cases" / "emps" / "case.toml").is_file()
    assert called(home, "vlab", "examples", "--copy", "mine").returncode == 2
