"""Settings: every chosen number of the diagnosis stands in `vlab.diagnose.settings`, and nowhere else."""

import ast
from dataclasses import FrozenInstanceError, fields
from pathlib import Path

import pytest

import vlab.diagnose
from vlab.diagnose.settings import SETTINGS, VERDICT

ROOM = Path(vlab.diagnose.__file__).parent
NOT_CHOSEN = {
    ("data/mains_interference.py", "BLACKMAN_HARRIS"): "the coefficients of the window",
    ("data/responses.py", "ORDERS"): "how often a response is differentiated",
    ("inference/window_least_squares.py", "GOLDEN"): "the golden ratio",
}
"""Numbers of mathematics and of definitions."""


def is_number(node: ast.expr) -> bool:
    """Return whether an expression is a number, or holds one."""
    match node:
        case ast.Constant(value=value):
            return isinstance(value, (int, float)) and not isinstance(value, bool)
        case ast.UnaryOp(operand=operand):
            return is_number(operand)
        case ast.BinOp(left=left, right=right):
            return is_number(left) or is_number(right)
        case ast.Tuple(elts=parts) | ast.List(elts=parts) | ast.Set(elts=parts) | ast.Dict(values=parts):
            return any(is_number(part) for part in parts)
        case ast.Call(args=args):
            return any(is_number(argument) for argument in args)
    return False


def numbers_of(source: str) -> list[str]:
    """Return the names at the level of a module that are assigned a number."""
    found = []
    for node in ast.parse(source).body:
        if isinstance(node, (ast.Assign, ast.AnnAssign)) and node.value is not None and is_number(node.value):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            found += [name.id for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)]
    return found


def test_no_number_is_named_outside_the_settings():
    modules = [p for p in ROOM.rglob("*.py") if not p.is_relative_to(ROOM / "settings")]
    assert len(modules) > 60
    found = {(p.relative_to(ROOM).as_posix(), name) for p in modules for name in numbers_of(p.read_text("utf-8"))}
    assert found == set(NOT_CHOSEN)


@pytest.mark.parametrize(
    "line", ["A = 1", "A, B = 1.0, 'b'", "A: float = -2.0", "A = {'a': (1,)}", "A = tuple(f(3))", "A = 2 * B"]
)
def test_a_number_is_recognised_however_it_stands(line):
    assert "A" in numbers_of(line)


def test_settings_are_frozen_and_belong_to_a_module():
    with pytest.raises(FrozenInstanceError):
        VERDICT.least_gap = 0.0
    for module, settings in SETTINGS.items():
        assert (ROOM / f"{module.replace('.', '/')}.py").is_file(), module
        assert fields(settings)
