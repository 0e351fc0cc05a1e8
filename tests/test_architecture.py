"""The page on vlab's structure: every module and name in it exists, and no package is left out."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
TEXT = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
WALK = re.findall(r"^\| [^|]+ \| `(vlab[.\w]*)` \| `(\w+)` \|$", TEXT, re.M)
"""Module and name of each step of the walk."""


def names_of(module: str) -> set[str]:
    """Return the classes and functions that a module defines."""
    path = ROOT / (module.replace(".", "/") + ".py")
    tree = ast.parse((path if path.is_file() else path.with_suffix("") / "__init__.py").read_text(encoding="utf-8"))
    return {node.name for node in tree.body if isinstance(node, (ast.FunctionDef, ast.ClassDef))}


@pytest.mark.parametrize(("module", "name"), WALK)
def test_a_step_of_the_walk_exists(module, name):
    assert name in names_of(module)


def test_the_walk_begins_at_the_command_and_passes_every_package_of_the_diagnosis():
    assert WALK[0] == ("vlab.cli.diagnose", "run")
    passed = {module.split(".")[2] for module, _ in WALK if module.startswith("vlab.diagnose.")}
    packages = {path.parent.name for path in (ROOT / "vlab" / "diagnose").glob("*/__init__.py")}
    assert packages - passed == {"settings", "kernels", "precheck"}  # numbers, loops, and `vlab check`


def test_the_list_of_rooms_is_complete():
    listed = set(re.findall(r"^ {2,4}(\w+)/ ", TEXT, re.M))
    packages = {path.parent.name for path in (ROOT / "vlab").glob("*/__init__.py")}
    assert packages - listed == {"controllers"}  # leads to the folder of the laws
    assert listed - packages <= {path.parent.name for path in (ROOT / "vlab" / "diagnose").glob("*/__init__.py")}
