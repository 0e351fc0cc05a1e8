"""What is installed, and how it lives beside other people's folders."""

import os
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).parent.parent
LAWS = [path.stem for path in (ROOT / "controllers").glob("*.py")]


def python(folder: Path, *words: str, path: Path = ROOT) -> "subprocess.CompletedProcess[str]":
    """Run Python in a folder, with vlab on the path, as a shell does: without what a command called in this process has set."""
    environment = {**os.environ, "PYTHONPATH": str(path)}
    environment.pop("PYTHONSAFEPATH", None)
    return subprocess.run([sys.executable, *words], cwd=folder, env=environment, capture_output=True, text=True)


@pytest.mark.slow
def test_a_foreign_package_of_controllers_is_not_in_the_way(tmp_path):
    foreign = tmp_path / "controllers"
    foreign.mkdir()
    (foreign / "__init__.py").write_text("NAME = 'foreign'\n")
    names = ", ".join(["Controller", *LAWS])
    (tmp_path / "my.py").write_text(
        f"import controllers\nfrom vlab.lab import Experiment\nfrom vlab.controllers import {names}\nprint(controllers.NAME)\n"
    )
    for words in (["my.py"], ["-m", "vlab", "effects", "--json"]):
        done = python(tmp_path, *words)
        assert done.returncode == 0, done.stderr
    assert "foreign" in python(tmp_path, "my.py").stdout


@pytest.mark.slow
def test_vlab_is_not_in_the_way_of_a_foreign_folder_of_controllers(tmp_path):
    """Nor of one without ``__init__.py``, which any package of that name on the path would hide."""
    (tmp_path / "controllers").mkdir()
    (tmp_path / "controllers" / "mine.py").write_text("NAME = 'mine'\n")
    done = python(tmp_path, "-c", "import vlab.lab, controllers.mine; print(controllers.mine.NAME)")
    assert done.stdout == "mine\n", done.stderr
    assert not (ROOT / "controllers" / "__init__.py").exists()


def test_every_law_has_one_home():
    beside = [path.stem for path in (ROOT / "vlab" / "controllers").glob("*.py")]
    assert beside == ["__init__"]
    assert len(LAWS) >= 16


def wheel_files() -> list[str]:
    """Return the paths that a wheel of this checkout installs."""
    wheel = pytest.importorskip("hatchling.builders.wheel")
    return [file.distribution_path for file in wheel.WheelBuilder(str(ROOT)).recurse_included_files()]


def test_a_wheel_installs_vlab_alone_with_laws_and_assets():
    files = wheel_files()
    assert {Path(name).parts[0] for name in files} == {"vlab"}
    assert {f"vlab/controllers/{name}.py" for name in ["__init__", *LAWS]} <= set(files)
    assert {"vlab/_assets/beam.toml", "vlab/_assets/cases/emps/case.toml", "vlab/_assets/examples/plan.toml"} <= set(
        files
    )
    assert len(files) == len(set(files))


def test_a_wheel_leaves_a_campaigns_answers_and_the_pictures_of_the_readme_out():
    assert not [name for name in wheel_files() if name.startswith(("vlab/_assets/evidence", "vlab/_assets/figures"))]


def test_every_dependency_has_a_lower_bound():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = [one for extra in project["optional-dependencies"].values() for one in extra]
    assert [one for one in [*project["dependencies"], *extras] if ">=" not in one] == ["mujoco[sysid]"]


@pytest.mark.parametrize(
    ("name", "broken"),
    [
        ("osqp", ("1.0.0", "1.0.2")),  # no SolverStatus
        ("pint", ("0.24", "0.24.1", "0.24.3")),  # fail with today's flexparser on Python 3.11
        ("numpy", ("1.26.4",)),  # other requirements ask for 2.0
        ("pyarrow", ("15.0.0",)),  # they ask for 18
        ("hatchling", ("1.24.0",)),  # reads no list of licence files
    ],
)
def test_versions_that_do_not_work_are_not_allowed(name, broken):
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    lists = [project["project"]["dependencies"], *project["project"]["optional-dependencies"].values()]
    asked = [
        Requirement(one) for one in [*project["build-system"]["requires"], *(one for part in lists for one in part)]
    ]
    found = [one.specifier for one in asked if one.name == name]
    assert found
    assert not [version for version in broken if any(specifier.contains(version) for specifier in found)]


@pytest.mark.slow
def test_a_wheel_works_from_another_folder(tmp_path):
    wheel = pytest.importorskip("hatchling.builders.wheel")
    (built,) = wheel.WheelBuilder(str(ROOT)).build(directory=str(tmp_path / "dist"), versions=["standard"])
    assert Path(built).stat().st_size < 3e6
    with zipfile.ZipFile(built) as archive:
        archive.extractall(tmp_path / "site")
    elsewhere = tmp_path / "project"
    (elsewhere / "controllers").mkdir(parents=True)
    (elsewhere / "controllers" / "__init__.py").touch()
    done = python(elsewhere, "-m", "vlab", "modes", "beam", path=tmp_path / "site")
    assert done.returncode == 0, done.stderr
    assert "22.73" in done.stdout
    where = python(elsewhere, "-c", "import vlab.controllers.lqg as law; print(law.__file__)", path=tmp_path / "site")
    assert Path(where.stdout.strip()).parent == tmp_path / "site" / "vlab" / "controllers"
