"""Compiled loops: kept between runs where there is a place for it, and needing none."""

import ast
import inspect
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import vlab.diagnose
from vlab import compilation as compiling
from vlab.cases import compiled_replay
from vlab.compilation import compiled
from vlab.diagnose.kernels import expression_graph, linear_system
from vlab.diagnose.predictors import kalman
from vlab.lab import compiled_loop
from vlab.physics import compiled_commands, compiled_expression, compiled_ports

USE = """
import sys
from pathlib import Path
import numpy as np
{prepare}
from vlab.compilation import compiled
from vlab.diagnose.kernels import expression_graph
from vlab.diagnose.predictors import kalman
double = kalman._with_room(np.ones((2, 1, 1)))
assert double.shape == (4, 1, 1)
print(kalman.__file__)
print(getattr(kalman._with_room._cache, "cache_path", None))
"""


def used(folder, prepare="", **environment):
    """Use a compiled function of the package in a folder; return where it was kept."""
    kept = {k: v for k, v in os.environ.items() if k not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")}
    done = subprocess.run(
        [sys.executable, "-c", USE.format(prepare=prepare)],
        env={**kept, "PYTHONPATH": str(folder), **environment},
        cwd="/",
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    file, where = done.stdout.split()
    assert Path(file).is_relative_to(folder)
    return where


@pytest.fixture
def sealed_off(tmp_path):
    """An installation in which numba can keep nothing: a file stands where its folder would be, whoever the user is."""
    package = Path(vlab.__file__).parent
    ignored = shutil.ignore_patterns("__pycache__", "_assets")
    shutil.copytree(package, tmp_path / "vlab", ignore=ignored)
    if (package.parent / "controllers").is_dir():  # a checkout: `vlab.controllers` leads there
        shutil.copytree(package.parent / "controllers", tmp_path / "controllers", ignore=ignored)
    (tmp_path / "vlab" / "diagnose" / "predictors" / "__pycache__").write_text("")
    return tmp_path


NOWHERE = {"HOME": "/dev/null", "PYTHONDONTWRITEBYTECODE": "1"}


@pytest.mark.slow
def test_neither_the_installation_nor_the_home_need_be_writable(sealed_off, tmp_path):
    (tmp_path / "temporary").mkdir()
    where = used(sealed_off, **NOWHERE, TMPDIR=str(tmp_path / "temporary"))
    assert Path(where).is_relative_to(tmp_path / "temporary")
    assert list(Path(where).glob("*.nbc"))  # processes that are forked need not compile it again
    (folder,) = (tmp_path / "temporary").iterdir()
    assert folder.stat().st_mode & 0o077 == 0


@pytest.mark.slow
def test_nothing_at_all_need_be_writable(sealed_off):
    assert used(sealed_off, "import vlab.compilation as c; c._temporary = lambda: iter(())", **NOWHERE) == "None"


def test_a_folder_that_others_may_write_to_is_not_used(tmp_path, monkeypatch):
    monkeypatch.setattr(compiling.tempfile, "gettempdir", lambda: str(tmp_path))
    monkeypatch.setattr(compiling, "SHARED", ())
    (own,) = compiling._temporary()
    assert Path(own).parent == tmp_path
    Path(own).chmod(0o777)
    assert list(compiling._temporary()) == []
    Path(own).rmdir()
    Path(own).symlink_to(tmp_path)
    assert list(compiling._temporary()) == []


def test_a_cache_that_goes_away_is_done_without(tmp_path, monkeypatch):
    @compiled()
    def twice(x):
        return 2 * x

    def full(*given):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(twice._cache._cache_file, "save", full)
    monkeypatch.setattr(twice._cache._cache_file, "load", full)
    assert twice(3) == 6
    assert twice(1.5) == 3.0


def test_what_is_compiled_is_kept():
    assert kalman._with_room(np.ones((1, 1, 1))).shape == (2, 1, 1)
    assert list(Path(kalman._with_room._cache.cache_path).glob("kalman._with_room*.nbc"))


LOOPS = (compiled_replay, compiled_loop, compiled_ports, compiled_commands, compiled_expression)
KERNELS = (expression_graph, linear_system, kalman)


@pytest.mark.parametrize("module", [*LOOPS, *KERNELS], ids=lambda module: module.__name__)
def test_compiled_loops_assign_elements(module):
    """A slice assignment of an array compiles the text of its error, which takes seconds of every first run."""
    functions = [ast.parse(inspect.getsource(f.py_func)) for f in vars(module).values() if hasattr(f, "py_func")]
    assert functions
    for node in (node for tree in functions for node in ast.walk(tree) if isinstance(node, ast.Assign)):
        sliced = [t for t in node.targets if isinstance(t, ast.Subscript) and any(map(is_slice, ast.walk(t.slice)))]
        assert not sliced or isinstance(node.value, ast.Constant), ast.unparse(node)


def is_slice(node):
    """Return whether a part of an index is a slice."""
    return isinstance(node, ast.Slice)
