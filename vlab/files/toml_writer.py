"""TOML text of plain data."""

from collections.abc import Mapping, Sequence
from typing import Any


class Verbatim:
    """TOML text that is written as it is."""

    def __init__(self, text: str) -> None:
        self._text = text

    def __str__(self) -> str:
        return self._text


def toml_text(table: Mapping[str, Any], path: str = "") -> str:
    """Return a table as lossless TOML text.

    Parameters
    ----------
    table : mapping
        Table.
    path : str
        Dotted name of the table.

    Returns
    -------
    str
        TOML.
    """
    plain = {k: v for k, v in table.items() if not isinstance(v, Mapping) and not _is_tables(v)}
    lines = [f"{_key(k)} = {toml_value(v)}" for k, v in plain.items()]
    for key, value in table.items():
        name = f"{path}.{_key(key)}" if path else _key(key)
        if isinstance(value, Mapping) and value:
            lines += ["", f"[{name}]", toml_text(value, name)]
        elif _is_tables(value):
            for part in value:
                lines += ["", f"[[{name}]]", toml_text(part, name)]
    return "\n".join(lines).strip("\n") + ("\n" if not path else "")


def _is_tables(value: Any) -> bool:
    return (
        isinstance(value, Sequence)
        and not isinstance(value, str)
        and bool(value)
        and all(isinstance(v, Mapping) for v in value)
    )


def _key(key: str) -> str:
    bare = key and all(c.isascii() and (c.isalnum() or c in "-_") for c in key)
    return key if bare else toml_value(key)


def toml_value(value: Any) -> str:
    """Return a value as TOML text on one line.

    Parameters
    ----------
    value : object
        Text, number, truth value, list, table or `Verbatim`.

    Returns
    -------
    str
        TOML.
    """
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        escaped = value.replace("\\", "\\\\").replace('"', '\\"')
        return '"' + "".join(c if c.isprintable() else _escaped(c) for c in escaped) + '"'
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(k)} = {toml_value(v)}" for k, v in value.items()) + " }"
    if isinstance(value, Sequence):
        return "[" + ", ".join(toml_value(v) for v in value) + "]"
    return repr(value) if isinstance(value, (int, float)) else str(value)


def _escaped(c: str) -> str:
    return f"\\u{ord(c):04x}" if ord(c) < 0x10000 else f"\\U{ord(c):08x}"
