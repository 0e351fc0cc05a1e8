"""Arguments of the Python interface, checked against the types of the signature."""

import inspect
import re
import types
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numpy as np

from vlab.errors import VlabError
from vlab.files.text import in_line, with_article

P = ParamSpec("P")
"""Parameters of the checked function."""
R = TypeVar("R")
"""Result of the checked function."""
WORDS: Mapping[Any, str] = {
    str: "text",
    int: "a whole number",
    float: "a number",
    bool: "True or False",
    types.NoneType: "None",
}
"""WORDS: names of plain types in messages."""
OPTION = re.compile(r"(?P<option>--[a-z][a-z-]*)(?: (?P<value>\S+=[^\s;)]+|\d[\d.]*(?<!\.)|dwell\b))?")
"""OPTION: option in a message, with a value behind it."""
LONGEST = 60
"""LONGEST [1]: largest number of characters of a value in a message."""


class _Unfit(Exception):
    """Value of another type than the signature declares."""


def checked(
    error: type[VlabError], *, options: Mapping[str, str] = types.MappingProxyType({}), **fixes: str
) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Return a decorator that checks arguments against their annotations.

    Numbers of NumPy become numbers of Python, and a single text becomes a sequence of one. Annotations of other kinds
    than plain types, classes, sequences, tuples and unions are not checked.

    Parameters
    ----------
    error : type
        Type of the exception.
    options : mapping of str to str
        Argument by option of the command line, for advice in messages.
    **fixes : str
        Advice by parameter, which ends the message.

    Returns
    -------
    callable
        Decorator; the function then raises `error` for an argument of another type.
    """

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        signature = inspect.signature(function)

        @wraps(function)
        def call(*args: P.args, **kwargs: P.kwargs) -> R:
            try:
                bound = signature.bind(*args, **kwargs)
            except TypeError:  # Python's own message names the argument
                return function(*args, **kwargs)
            hints = typing.get_type_hints(function)
            for name, value in bound.arguments.items():
                hint = hints.get(name, Any)
                try:
                    bound.arguments[name] = _fitted(value, hint)
                except _Unfit as unfit:
                    verb = "is" if unfit.args[0] is value or isinstance(value, np.generic) else "holds"
                    fix = f"; {fixes[name]}" if name in fixes else ""
                    raise error(
                        f"vlab.{function.__qualname__}: {name} {verb} {described(unfit.args[0])}; accepted: {_words(hint)}{fix}"
                    ) from None
            try:
                return function(*bound.args, **bound.kwargs)
            except VlabError as failed:
                text = in_python(str(failed), options)
                if text == str(failed):
                    raise
                raise type(failed)(text) from failed

        return call

    return decorate


def unchecked(function: Callable[P, R]) -> Callable[P, R]:
    """Return a function without its check and its messages for Python.

    The parser of the command line has checked the arguments already.

    Parameters
    ----------
    function : callable
        Function of `checked`.

    Returns
    -------
    callable
        Function as written.
    """
    bare: Callable[P, R] = inspect.unwrap(function)
    return bare


def in_python(text: str, options: Mapping[str, str]) -> str:
    """Return a message with arguments of Python in place of options.

    Parameters
    ----------
    text : str
        Message, such as ``"give --rate 200"``.
    options : mapping of str to str
        Argument by option, such as ``{"--rate": "rate_hz"}``.

    Returns
    -------
    str
        Message, such as ``"give rate_hz=200"``.
    """

    def argument(found: re.Match[str]) -> str:
        option, value = found["option"], found["value"] or ""
        if option not in options:
            return found[0]
        quoted = f'"{value}"' if "=" in value or value.isidentifier() else value
        return f"{options[option]}={f'[{quoted}]' if '=' in value else quoted}"

    return OPTION.sub(argument, text)


def described(value: Any) -> str:
    """Return a value and its type for a message.

    Parameters
    ----------
    value : object
        Value of an argument.

    Returns
    -------
    str
        Such as ``"the text '5'"``, ``"3 (an int)"`` or ``"an ndarray of shape (100, 2)"``.
    """
    kind = with_article(type(value).__name__)
    if isinstance(value, str):
        shown = in_line(repr(value))
        return f"the text {shown if len(shown) <= LONGEST else shown[:LONGEST] + '...'}"
    if isinstance(value, bool | int | float):
        return f"{value!r} ({kind})"
    if value is not None and isinstance(getattr(value, "shape", None), tuple):
        return f"{kind} of shape {value.shape}"
    return kind


def _fitted(value: Any, hint: Any) -> Any:
    """Return a value as its annotation declares it, or raise `_Unfit`."""
    if hint is Any:
        return value
    if isinstance(value, np.generic):
        value = value.item()
    origin, parts = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        worst = value
        for part in parts:
            try:
                return _fitted(value, part)
            except _Unfit as unfit:
                worst = worst if unfit.args[0] is value else unfit.args[0]
        raise _Unfit(worst)
    if origin is tuple and isinstance(value, list | tuple | np.ndarray):
        if len(parts) == len(value) and ... not in parts:
            return tuple(_fitted(item, part) for item, part in zip(value, parts, strict=True))
        raise _Unfit(value)
    if origin is Mapping:
        if not isinstance(value, Mapping):
            raise _Unfit(value)
        return value
    if origin is Sequence:
        return _sequence(value, parts[0])
    if origin is tuple:
        raise _Unfit(value)
    return _plain(value, hint) if isinstance(hint, type) and origin is None else value


def _plain(value: Any, hint: type) -> Any:
    """Return a value as a plain type or an object."""
    if hint is str and isinstance(value, Path):
        return str(value)
    if hint is float and isinstance(value, int) and not isinstance(value, bool):
        return value
    is_number_for_bool = isinstance(value, bool) and hint in (int, float)
    if is_number_for_bool or not isinstance(value, hint):
        raise _Unfit(value)
    return value


def _sequence(value: Any, item: Any) -> Any:
    """Return a sequence with fitted items; text is one item."""
    if isinstance(value, str):
        return (_fitted(value, item),)
    if not isinstance(value, Iterable) or isinstance(value, Mapping) or hasattr(value, "columns"):
        raise _Unfit(value)
    try:
        return [_fitted(part, item) for part in value]
    except _Unfit:
        if isinstance(value, np.ndarray):
            raise _Unfit(value) from None
        raise


def _words(hint: Any) -> str:
    """Return an annotation in words."""
    origin, parts = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        single = [part for part in parts if typing.get_origin(part) is not Sequence]
        words = list(dict.fromkeys(_words(part) for part in single))
        lists = [_words(part) for part in parts if part not in single]
        if words and lists == [f"a sequence of {' or '.join(words)}"]:
            lists = ["a sequence of such"]
        return " or ".join([*words, *lists])
    if origin is tuple:
        return f"({', '.join(_words(part) for part in parts)})"
    if origin is Mapping:
        return "a dict"
    if origin is Sequence:
        return f"a sequence of {_words(parts[0])}"
    return WORDS.get(hint) or str(getattr(hint, "__name__", hint))
