"""Source code of laws without vlab.

A law's class is cut down to the methods that a simulation calls. Functions, constants and imports that these methods
need come along, found by name in the syntax tree. The code is thus the very code of vlab's own simulation, with its
annotations taken off.
"""

import ast
import dataclasses
import inspect
import textwrap
import types
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from vlab.physics.effect import Effect

PROVIDED = {"Step"}
"""PROVIDED: names of vlab that the running part of a law module defines itself."""
NUMPY = ("numpy", "scipy")
"""NUMPY: packages besides the standard library that a law module may import."""


class CannotWrite(ValueError):
    """A law whose code cannot stand alone; the message says why."""


class LawCode:
    """Collected code of laws."""

    def __init__(self) -> None:
        self.imports: dict[str, None] = {}
        self._parts: dict[str, tuple[Any, str]] = {}

    def add(self, effect: Effect) -> str:
        """Add a law.

        Parameters
        ----------
        effect : Effect
            Effect of the catalogue, or a user's own.

        Returns
        -------
        str
            Expression that makes the law.

        Raises
        ------
        CannotWrite
            The code needs parts of vlab, or its source is unknown.
        """
        kept = (dict(self.imports), dict(self._parts))
        try:
            return f"{self._class(type(effect), _called(effect), own=vars(effect))}({self._own(effect)})"
        except (CannotWrite, OSError, TypeError, SyntaxError) as error:
            self.imports, self._parts = kept
            raise CannotWrite(f"the code of {effect.name} cannot stand alone: {error}") from error

    @property
    def text(self) -> str:
        """Code of all laws, without imports."""
        return "\n\n\n".join(text for _, text in self._parts.values())

    def _own(self, effect: Any) -> str:
        """Return an object's own numbers as arguments."""
        return ", ".join(f"{k}={self._value(v, k)}" for k, v in vars(effect).items())

    def _value(self, value: Any, name: str) -> str:
        """Return a number, or a record of numbers, as code."""
        if dataclasses.is_dataclass(value) and not isinstance(value, type):
            made = type(value)
            methods = [k for k, v in vars(made).items() if _function(v) is not None and not k.startswith("__")]
            return f"{self._class(made, methods, own=vars(value))}({self._own(value)})"
        return _literal(value, name)

    def _class(self, made: type, methods: Sequence[str], own: Mapping[str, Any] | None = None) -> str:
        name = made.__name__
        if name in self._parts:
            if self._parts[name][0] is not made:
                raise CannotWrite(f"two classes are named {name}")
            return name
        members: dict[str, str] = {}
        if own:
            members["__init__"] = "def __init__(self, **values):\n    vars(self).update(values)"
        waiting = list(methods)
        while waiting:
            member = waiting.pop(0)
            if member in members or member in (own or ()):
                continue
            raw = inspect.getattr_static(made, member, None)
            function = _function(raw)
            if function is None:
                members[member] = f"{member} = {self._value(raw, f'{name}.{member}')}"
                continue
            tree = _tree(function)
            members[member] = ast.unparse(tree)
            waiting += [at for at in _of_self(tree) if inspect.getattr_static(made, at, None) is not None]
            self._names(tree, function.__globals__)
        words = inspect.cleandoc(made.__doc__ or name)
        if isinstance(law := getattr(made, "law", None), str):
            words += f"\n\nLaw: {law}."
        body = [node for text in members.values() for node in ast.parse(text).body]
        body.sort(key=lambda node: isinstance(node, ast.FunctionDef))
        tree = ast.parse(f"class {name}: pass").body[0]
        assert isinstance(tree, ast.ClassDef)
        if "\n" in words:
            words = textwrap.indent(words, "    ").strip() + "\n    "
        tree.body = [ast.Expr(ast.Constant(words)), *body]
        self._parts[name] = (made, ast.unparse(ast.fix_missing_locations(tree)))
        return name

    def _names(self, tree: ast.AST, names: dict[str, Any]) -> None:
        """Add everything that a function takes from its module."""
        for node in ast.walk(tree):
            if isinstance(node, ast.Name) and node.id in names and node.id not in PROVIDED:
                self._global(node.id, names[node.id])

    def _global(self, name: str, value: Any) -> None:
        if name in self._parts:
            return
        if isinstance(value, types.ModuleType):
            if value.__name__.split(".")[0] == "vlab":
                raise CannotWrite(f"{value.__name__} is a part of vlab")
            self._import(value.__name__.split(".")[0])
            package, _, last = value.__name__.rpartition(".")
            self.imports[f"{f'from {package} ' if package else ''}import {_renamed(last, name)}"] = None
            return
        function = _function(value)
        home = str(getattr(inspect.unwrap(value) if callable(value) else value, "__module__", "") or "")
        is_foreign = home and home.split(".")[0] in (*NUMPY, "functools", "collections", "math", "itertools")
        if callable(value) and is_foreign:
            self._import(home.split(".")[0])
            self.imports[f"from {home.lstrip('_')} import {_renamed(value.__name__, name)}"] = None
        elif function is not None and function.__name__ == name:
            tree = _tree(function)
            self._names(tree, function.__globals__)
            self._parts[name] = (value, ast.unparse(tree))
        elif callable(value):
            raise CannotWrite(f"{name} of {home or 'its module'} is neither a function nor a number")
        else:
            self._parts[name] = (value, f"{name} = {_literal(value, name)}")

    def _import(self, package: str) -> None:
        if package not in (*NUMPY, "functools", "collections", "math", "itertools"):
            raise CannotWrite(f"{package} is no package of a numpy module")


def _renamed(name: str, used: str) -> str:
    return name if name == used else f"{name} as {used}"


def _called(effect: Effect) -> list[str]:
    """Return the methods that a simulation calls."""
    return list(effect.simulated_by)


def _function(value: Any) -> types.FunctionType | None:
    if isinstance(value, (staticmethod, classmethod)):
        value = value.__func__
    if isinstance(value, property):
        value = value.fget
    value = inspect.unwrap(value) if callable(value) else value
    return value if isinstance(value, types.FunctionType) else None


class _Plain(ast.NodeTransformer):
    """Removal of annotations and of all but a docstring's first paragraph."""

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        self.generic_visit(node)
        node.returns = None
        every = (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs, node.args.vararg, node.args.kwarg)
        for argument in every:
            if argument is not None:
                argument.annotation = None
        words = ast.get_docstring(node)
        if words is not None and len(node.body) > 1:
            first = words.partition("\n\n")[0]
            kept = [] if first.startswith("See `") else [ast.Expr(ast.Constant(first))]
            node.body = [*kept, *node.body[1:]]
        return node

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST | None:
        self.generic_visit(node)
        if node.value is None:
            return ast.Pass()
        return ast.copy_location(ast.Assign(targets=[node.target], value=node.value), node)


def _tree(function: types.FunctionType) -> ast.AST:
    tree = ast.parse(textwrap.dedent(inspect.getsource(function))).body[0]
    if not isinstance(tree, ast.FunctionDef):
        raise CannotWrite(f"{function.__name__} is no plain function")
    if any(isinstance(node, ast.Name) and node.id == "super" for node in ast.walk(tree)):
        raise CannotWrite(f"{function.__name__} calls its base class")
    return ast.fix_missing_locations(_Plain().visit(tree))


def _of_self(tree: ast.AST) -> list[str]:
    """Return the members of its own object that a method names."""
    return [
        node.attr
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in ("self", "cls")
    ]


def _literal(value: Any, name: str) -> str:
    if isinstance(value, np.ndarray):
        return f"np.array({value.tolist()!r})"
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not np.isfinite(value):
        return f'float("{value}")'
    if isinstance(value, (tuple, list)):
        parts = [_literal(part, name) for part in value]
        inside = ", ".join(parts)
        return f"[{inside}]" if isinstance(value, list) else f"({inside}{',' if len(parts) == 1 else ''})"
    try:
        if ast.literal_eval(repr(value)) == value:
            return repr(value)
    except (ValueError, SyntaxError):
        pass
    raise CannotWrite(f"{name} is neither a function nor a number")
