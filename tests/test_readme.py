"""The lines of the README and of the pages in docs run as they are printed, from top to bottom.

Blocks marked ``sh`` hold lines to run: all of them are, page by page, in a folder of the page's own. Blocks with a ``title`` are
files that the reader saves. Blocks marked ``text`` hold what opens a window, output, or needs the reader's own files; they are
not run.
"""

import os
import re
import shlex
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest
from command import run

from vlab.cli import build_parser

ROOT = Path(__file__).parent.parent
INSTALL = "python3 -m venv .venv && .venv/bin/pip install -q -e "
QUICK = ("vlab effects", "vlab modes beam", "vlab modal-test assets/")
"""How lines begin that take a few seconds and need no line before them."""
BLOCK = re.compile(r'^```(\w+)(?: title="([^"]+)")?\n(.*?)^```$', flags=re.MULTILINE | re.DOTALL)


@dataclass(frozen=True)
class Page:
    """The README or a page of the documentation."""

    path: Path

    @property
    def name(self) -> str:
        return self.path.relative_to(ROOT).as_posix()

    @property
    def blocks(self) -> list[tuple[str, str, str]]:
        """Language, title and text of every block."""
        return [(m[1], m[2] or "", m[3]) for m in BLOCK.finditer(self.path.read_text(encoding="utf-8"))]

    def lines(self, language: str) -> list[str]:
        return [line for kind, _, text in self.blocks if kind == language for line in text.splitlines() if line.strip()]

    @property
    def commands(self) -> list[list[str]]:
        """The words of all lines that call vlab; of a line that installs it, what comes after that."""
        lines = [line.split(" && .venv/bin/")[-1] if line.startswith(INSTALL) else line for line in self.lines("sh")]
        words = [shlex.split(line, comments=True) for line in lines]
        return [line[1:] for line in words if line[0] == "vlab"]

    @property
    def files(self) -> dict[str, str]:
        """The files that the reader saves, by name."""
        return {title: text for _, title, text in self.blocks if title}

    def save_files(self, folder: Path) -> None:
        for name, text in self.files.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(text, encoding="utf-8")


README = Page(ROOT / "README.md")
PAGES = [README, *map(Page, sorted((ROOT / "docs").rglob("*.md")))]
WITH_COMMANDS = [page for page in PAGES if page.commands]
WITH_PYTHON = [page for page in PAGES if any(kind == "python" and not title for kind, title, _ in page.blocks)]


def named(page: Page) -> str:
    return page.name


@pytest.fixture(scope="module")
def copy(tmp_path_factory) -> Path:
    """Return a folder with the assets that lines name, for what they write."""
    folder = tmp_path_factory.mktemp("readme")
    shutil.copytree(ROOT / "assets", folder / "assets", ignore=shutil.ignore_patterns("figures"))
    return folder


def test_every_line_that_is_printed_to_be_run_calls_vlab_or_installs_it():
    other = [line for page in PAGES for line in page.lines("sh") if not line.startswith("vlab ")]
    assert [line.removeprefix(INSTALL) for line in other] == [
        ". && .venv/bin/vlab demo",
        "'.[test]' && .venv/bin/python -m pytest",
    ]
    assert sum(len(page.commands) for page in PAGES) >= 40
    marked = {kind for page in PAGES for kind, _, _ in page.blocks}
    assert marked <= {"sh", "text", "toml", "python", "xml"}


def test_the_readme_is_one_screen():
    assert len(README.path.read_text(encoding="utf-8").split()) < 1200


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_every_line_is_understood(monkeypatch, copy, page):
    monkeypatch.chdir(copy)
    for line in page.lines("text") + page.lines("sh"):
        if not line.startswith("vlab "):
            continue
        words = shlex.split(line, comments=True)
        build_parser(words[1]).parse_args(words[1:])


@pytest.mark.parametrize("page", WITH_COMMANDS, ids=named)
def test_every_file_that_a_line_names_is_shipped_or_written_by_a_line_before(copy, page):
    written: list[str] = []
    for words in page.commands:
        out, pack = (words[words.index(option) + 1] if option in words else None for option in ("--out", "--pack"))
        for word in words:
            name = word.partition(":")[0]
            if name.startswith("out/") and word not in (out, pack) and "--save" not in words[: words.index(word)]:
                assert any(Path(name).is_relative_to(folder) for folder in written), (word, words)
            if name.startswith("assets/"):
                assert (copy / name).exists(), words
            if name.endswith((".py", ".toml")) and not name.startswith(("out/", "assets/")):
                assert name in page.files, words
        if out is not None:
            assert out not in written, f"two lines write {out}"
            written.append(out)
        if pack is not None:
            written.append(pack)


@pytest.mark.parametrize("link", re.findall(r"\]\((?!https?:)([^)#]+)", README.path.read_text(encoding="utf-8")))
def test_the_readme_links_to_files_that_are_there(link):
    assert (ROOT / link).is_file()


QUICK_LINES = {
    " ".join(words): (page, words)
    for page in PAGES
    for words in page.commands
    if " ".join(["vlab", *words]).startswith(QUICK) and "--out" not in words
}
"""By their words: a line that stands on several pages is run once."""


@pytest.mark.parametrize(("page", "words"), QUICK_LINES.values(), ids=list(QUICK_LINES))
def test_a_quick_line_runs_as_printed(capsys, monkeypatch, tmp_path, page, words):
    (tmp_path / "assets").symlink_to(ROOT / "assets")
    page.save_files(tmp_path)
    monkeypatch.chdir(tmp_path)
    status, out, err = run(capsys, *words)
    assert (status, bool(out)) == (0, True), err


@pytest.mark.slow
@pytest.mark.parametrize("page", WITH_PYTHON, ids=named)
def test_the_python_lines_run_as_printed(capsys, page):
    for kind, title, code in page.blocks:
        if kind == "python" and not title:
            exec(compile(code, page.name, "exec"), {"__name__": "page"})
            assert capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize("page", WITH_COMMANDS, ids=named)
def test_all_lines_run_from_top_to_bottom(tmp_path, copy, page):
    shutil.copytree(copy / "assets", tmp_path / "assets")
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    page.save_files(tmp_path)
    for name in page.files:
        if name.endswith(".py"):
            subprocess.run([sys.executable, name], cwd=tmp_path, env=environment, check=True)
    failed = {}
    for words in page.commands:
        line = [sys.executable, "-m", "vlab", *words]
        done = subprocess.run(line, cwd=tmp_path, env=environment, capture_output=True, text=True)
        if done.returncode != 0 or not done.stdout.strip():
            failed[" ".join(words)] = (done.returncode, done.stderr.strip().splitlines()[-1:])
    assert not failed
    if page == README:
        assert (tmp_path / "out" / "demo-001" / "report.html").exists()  # as the README says


@pytest.mark.slow
def test_the_tutorial_finds_what_it_says(tmp_path):
    (page,) = [page for page in PAGES if page.name == "docs/tutorial.md"]
    page.save_files(tmp_path)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, "machine.py"], cwd=tmp_path, env=environment, check=True)
    line = [sys.executable, "-m", "vlab", "diagnose", "slide", "--out", "out/slide"]
    done = subprocess.run(line, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
    force = re.search(r"coulomb-friction at joint:slide .*\n.*\n  force = (\S+) N", done.stdout)
    assert force, done.stdout
    assert float(force[1]) == pytest.approx(1.5, rel=0.01)  # the friction in machine.py
