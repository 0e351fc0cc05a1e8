"""The notebooks and the page on Python run as they are, and no output is kept in them."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import pytest

ROOT = Path(__file__).parents[2]
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))


def code_of(notebook: Path) -> list[str]:
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    sources = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    return [re.sub(r"^%.*$", "", source, flags=re.M) for source in sources]  # lines of the notebook itself


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    plt.close("all")


def run(name: str) -> dict[str, object]:
    names: dict[str, object] = {"__name__": "notebook"}
    for source in code_of(ROOT / "docs" / "notebooks" / f"{name}.ipynb"):
        exec(compile(source, name, "exec"), names)
    return names


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_sound_and_without_outputs(notebook):
    document = json.loads(notebook.read_text(encoding="utf-8"))
    assert document["nbformat"] == 4
    for cell in document["cells"]:
        assert cell.get("outputs", []) == []
        assert cell.get("execution_count") is None
    for source in code_of(notebook):
        compile(source, notebook.name, "exec")


def test_the_notebook_of_the_hammer_finds_the_modes_of_the_beam(folder):
    result = run("hammer")["result"]
    assert result.poles.freq[:3] == pytest.approx([1.866, 4.834, 8.838], rel=0.005)  # published table of the modes


@pytest.mark.slow
def test_the_notebook_of_the_arm_finds_the_friction(folder):
    names = run("arm")
    (finding, *_) = names["result"].findings
    assert (finding.effect, finding.place) == ("coulomb-friction", "joint:elbow")
    assert finding.parameters["force"]["value"] == pytest.approx(names["FRICTION"], rel=0.05)
    assert names["result"].model().dof_frictionloss[1] == pytest.approx(names["FRICTION"], rel=0.05)
    assert (folder / "arm.html").stat().st_size > 10_000


@pytest.mark.slow
def test_the_notebook_of_the_beam_adds_damping(folder):
    names = run("beam")
    assert names["controlled"].poles.zeta[0] > 2 * names["test"].poles.zeta[0]


@pytest.mark.slow
def test_the_five_lines_give_the_answer_of_the_page(tmp_path):
    blocks = re.compile(r'^```\w+ title="([^"]+)"\n(.*?)^```$', flags=re.MULTILINE | re.DOTALL)
    for page in ("tutorial.md", "howto/python.md"):
        for title, text in blocks.findall((ROOT / "docs" / page).read_text(encoding="utf-8")):
            (tmp_path / title).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / title).write_text(text, encoding="utf-8")
    said = ""
    for script in ("machine.py", "answer.py"):
        words = [sys.executable, script]
        done = subprocess.run(
            words, cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=True
        )
        said = done.stdout
    assert re.search(r"missing-physics.*\n  coulomb-friction at joint:slide .*force = 1\.[45]\d* N", said), said
    assert (tmp_path / "slide.html").stat().st_size > 10_000
