"""The face of the package: quick import, names, types, installed packages."""

import ast
import importlib
import subprocess
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest

import vlab
from vlab.errors import BadExperiment, BadRecording, UnknownName
from vlab.physics.catalogue import effect_named
from vlab.physics.port_linear import ViscousDamping
from vlab.recordings import open_table
from vlab.recordings.table import Table

ROOT = Path(vlab.__file__).parent


def test_the_import_loads_no_heavy_package():
    code = "import sys, vlab; dir(vlab); print(sorted({m.split('.')[0] for m in sys.modules}))"
    words = [sys.executable, "-c", code]
    loaded = ast.literal_eval(subprocess.run(words, capture_output=True, text=True, check=True, cwd=ROOT.parent).stdout)
    assert not {"mujoco", "scipy", "numpy", "matplotlib", "rerun", "numba", "pyarrow", "control", "pint"} & set(loaded)


def test_every_public_name_is_there_and_documented():
    for name in vlab.__all__:
        assert name in dir(vlab)
        assert getattr(vlab, name).__doc__, name
    with pytest.raises(AttributeError, match="diagnos"):
        vlab.diagnos  # noqa: B018


def test_the_listed_names_are_public():
    assert not {"Any", "ModuleType", "TYPE_CHECKING", "import_module", "_HOMES"} & set(dir(vlab))


def test_the_names_of_the_types_are_those_of_the_first_use():
    tree = ast.parse((ROOT / "__init__.py").read_text(encoding="utf-8"))
    (block,) = [node for node in tree.body if isinstance(node, ast.If)]
    typed = {alias.name: node.module for node in block.body for alias in node.names}
    verbs = {name.rpartition(".")[2]: module for name, module in vlab._VERBS.items()}
    assert typed == {**vlab._HOMES, **verbs}
    assert set(vlab.__all__) - {"__version__"} == set(typed)


def test_the_package_says_that_it_is_typed():
    assert (ROOT / "py.typed").is_file()


@pytest.mark.parametrize("name", ["diagnose", "design"])
def test_a_package_may_be_called_whatever_was_imported_before(name):
    package = importlib.import_module(f"vlab.{name}")
    assert getattr(vlab, name) is package
    with pytest.raises(TypeError):
        package(no_such_setting=1)


class Installed(ViscousDamping):
    name = "installed-damper"


def read_numbers(data, path, *, names, columns, blanks):
    return Table(path=path, columns={"x": np.array([float(word) for word in data.split()])}, blanks=blanks)


def install(monkeypatch, group, name, value):
    point = EntryPoint(name=name, value=value, group=group)
    known = lambda **given: [point] if given == {"group": group} else []  # noqa: E731
    monkeypatch.setattr("importlib.metadata.entry_points", known)


def test_an_installed_package_brings_an_effect(monkeypatch):
    install(monkeypatch, "vlab.effects", "damper", f"{__name__}:Installed")
    assert effect_named("entry:damper").name == "installed-damper"
    with pytest.raises(UnknownName, match="did you mean 'damper'"):
        effect_named("entry:dampr")
    with pytest.raises(BadExperiment, match="data run nobody's code"):
        effect_named("entry:damper", code=())  # a file of data names it


def test_an_installed_package_brings_a_reader(monkeypatch, tmp_path):
    file = tmp_path / "log.numbers"
    file.write_text("1 2 3.5")
    with pytest.raises(BadRecording, match="files of kind '.numbers' are not read"):
        open_table(file)
    install(monkeypatch, "vlab.readers", "numbers", f"{__name__}:read_numbers")
    np.testing.assert_array_equal(open_table(file)["x"], [1.0, 2.0, 3.5])
    install(monkeypatch, "vlab.readers", "numbers", f"{__name__}:no_such_function")
    with pytest.raises(BadRecording, match="fails when it is loaded"):
        open_table(file)


def test_a_reader_takes_no_kind_that_vlab_reads(monkeypatch, tmp_path):
    install(monkeypatch, "vlab.readers", "csv", f"{__name__}:read_numbers")
    (tmp_path / "log.csv").write_text("a,b\n1,2\n3,4\n")
    assert open_table(tmp_path / "log.csv").names == ("a", "b")
