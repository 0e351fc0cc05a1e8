"""Strict reading of TOML into frozen dataclasses.

A field declares its content: a plain type (`str`, `bool`, `int`), a `number(...)` with SI unit, another dataclass (a
table), or a tuple of dataclasses (an array of tables). Unknown keys, missing keys, wrong units and nonfinite values are
refused; the message has the path of the key. A number has the form ``{ value = 80.0, unit = "in", origin = "published",
source = "section 2.1" }``. Without required provenance a bare number in SI is accepted as well.
"""

import contextlib
import dataclasses
import math
import tomllib
import types
import typing
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar, cast

from vlab import units
from vlab.errors import BadStructure, VlabError, unknown_name
from vlab.files.plain_text import read_plain_text

T = TypeVar("T")
"""Type of a dataclass."""

ORIGINS = ("published", "identified", "assumed")
"""Origins of a number: a text (table or page), an identification (from data), or an assumption (with reason)."""


@dataclass(frozen=True, kw_only=True)
class Provenance:
    """Origin of a file's number, with value and unit as written."""

    value: float | tuple[float, ...]
    unit: str
    origin: str
    source: str


def number(
    si: str, *, default: Any = dataclasses.MISSING, positive: bool = False, at_least: float | None = None
) -> Any:
    """Declare a dataclass field for a physical number in SI unit `si`.

    A tuple of numbers is allowed.
    """
    metadata = {"si": si, "positive": positive, "at_least": at_least}
    return dataclasses.field(default=default, metadata=metadata)


@dataclass
class Reader:
    """Reader of one TOML file into dataclasses.

    The reader collects the provenance of the numbers.

    Parameters
    ----------
    file : Path or str
        File name in every error.
    provenance_required : bool
        Whether numbers need unit, origin and source.
    error : type
        Kind of `VlabError` to raise.
    """

    file: Path | str
    provenance_required: bool = True
    error: type[VlabError] = BadStructure

    def __post_init__(self) -> None:
        self.provenance: dict[str, Provenance] = {}
        self._origins: Mapping[str, str] = {}
        self._labels: Mapping[str, str] = {}

    def parse(self, text: str) -> dict[str, Any]:
        """Parse TOML text, or raise with the faulty line."""
        try:
            return tomllib.loads(text)
        except (tomllib.TOMLDecodeError, RecursionError) as error:
            raise self.error(f"{self.file}: malformed TOML: {error}") from error

    def load(self) -> dict[str, Any]:
        """Read and parse the file."""
        try:
            text = read_plain_text(self.file)
        except FileNotFoundError as error:
            raise self.error(f"{self.file}: there is no such file; check the path") from error
        except (OSError, UnicodeDecodeError) as error:
            raise self.error(f"{self.file}: cannot be read as a TOML text file: {error}") from error
        if text.lstrip("\ufeff \t\r\n").startswith("<"):
            raise self.error(
                f"{self.file}: this is XML, such as a MuJoCo model, and a TOML file was expected; "
                f"to compare a model with recordings, draft a case: vlab init {self.file} LOG..."
            )
        return self.parse(text)

    @contextlib.contextmanager
    def placed(self, origins: Mapping[str, str]) -> Iterator[None]:
        """Name the tables of the file in errors about tables that were drawn from it.

        Parameters
        ----------
        origins : mapping
            Place in the file by place in the drawn tables, such as ``channel[0]`` by ``recording[0].channel[0]``.

        Yields
        ------
        None
            The names hold inside the block.
        """
        self._origins = origins
        try:
            yield
        finally:
            self._origins = {}

    def fail(self, path: str, message: str) -> VlabError:
        """Return the error for one key."""
        place = self._in_file(path)
        own = [table for table in self._labels if place == table or place.startswith(f"{table}.")]
        label = f" ({self._labels[max(own, key=len)]})" if own else ""
        return self.error(f"{self.file}: {place or 'top level'}: {message}{label}")

    def label(self, labels: Mapping[str, str]) -> None:
        """Name tables in errors as the user knows them.

        Parameters
        ----------
        labels : mapping of str to str
            Words such as ``column 'encoder' of run1.csv`` by place, such as ``recording[0].channel[1]``.
        """
        self._labels = labels

    def _in_file(self, path: str) -> str:
        """Return a path with the place of its table in the file."""
        for drawn in sorted(self._origins, key=len, reverse=True):
            if path == drawn or path.startswith(f"{drawn}."):
                return f"{self._origins[drawn]}{path[len(drawn) :]}"
        return path

    def table(self, cls: type[T], table: Any, path: str = "") -> T:
        """Read a TOML table into a dataclass.

        Parameters
        ----------
        cls : type
            Dataclass.
        table : object
            Parsed table.
        path : str
            Path of the table in the file, for messages.

        Returns
        -------
        T
            Object of `cls`.
        """
        if not isinstance(table, Mapping):
            raise self.fail(path, f"a table was expected, {type(table).__name__} was given")
        fields = {f.name: f for f in dataclasses.fields(cast(Any, cls)) if f.init}
        for key in table:
            if key not in fields:
                detail = str(unknown_name("key", str(key), fields))
                raise self.fail(path, detail)
        hints = typing.get_type_hints(cls)
        values: dict[str, Any] = {}
        for name, field in fields.items():
            key_path = f"{path}.{name}" if path else name
            if name not in table:
                if field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING:
                    raise self.fail(path, f"the key {name!r} is missing")
                continue
            values[name] = self._value(hints[name], field.metadata, table[name], key_path)
        try:
            return cls(**values)
        except VlabError as error:
            raise self.fail(path, str(error)) from error

    def _value(self, hint: Any, metadata: Mapping[str, Any], raw: Any, path: str) -> Any:
        if "si" in metadata:
            return self._number(raw, metadata, path)
        if typing.get_origin(hint) in (
            types.UnionType,
            typing.Union,
        ):  # Optional[...]: the key may be absent, never null
            hint = next(part for part in typing.get_args(hint) if part is not type(None))
        if dataclasses.is_dataclass(hint):
            return self.table(cast(type, hint), raw, path)
        origin = typing.get_origin(hint)
        if origin is tuple:
            item = typing.get_args(hint)[0]
            if not isinstance(raw, list):
                raise self.fail(path, f"a list was expected, {type(raw).__name__} was given")
            return tuple(self._value(item, {}, part, f"{path}[{i}]") for i, part in enumerate(raw))
        if origin is dict:
            item = typing.get_args(hint)[1]
            if not isinstance(raw, Mapping):
                raise self.fail(path, f"a table was expected, {type(raw).__name__} was given")
            return {str(k): self._value(item, {}, part, f"{path}.{k}") for k, part in raw.items()}
        if origin is typing.Literal:
            if raw not in typing.get_args(hint):
                raise self.fail(path, str(unknown_name("value", str(raw), typing.get_args(hint))))
            return raw
        if hint is float and isinstance(raw, (int, float)) and not isinstance(raw, bool):
            return self._finite(raw, path)
        if hint in (str, int, bool) and type(raw) is hint:
            return raw
        raise self.fail(path, f"{getattr(hint, '__name__', hint)} was expected, {raw!r} was given")

    def _finite(self, raw: Any, path: str) -> float:
        if isinstance(raw, bool) or not isinstance(raw, (int, float)):
            raise self.fail(path, f"a number was expected, {raw!r} was given")
        try:
            value = float(raw)
        except OverflowError:
            raise self.fail(path, "the whole number is above 1e308; it must be a finite number") from None
        if not math.isfinite(value):
            raise self.fail(path, f"the number is {raw}; it must be finite")
        return value

    def _number(self, raw: Any, metadata: Mapping[str, Any], path: str) -> Any:
        si = metadata["si"]
        if isinstance(raw, Mapping):
            allowed = ("value", "unit", "origin", "source")
            for key in raw:
                if key not in allowed:
                    raise self.fail(path, str(unknown_name("key", str(key), allowed)))
            for key in ("value", "unit", *(("origin", "source") if self.provenance_required else ())):
                if key not in raw:
                    raise self.fail(
                        path,
                        f"the number has no {key!r}; write {{ value = ..., unit = {si!r}, origin = ..., source = ... }}",
                    )
            value, unit = raw["value"], raw["unit"]
            origin, source = raw.get("origin", "assumed"), raw.get("source", "")
            if origin not in ORIGINS:
                raise self.fail(path, str(unknown_name("origin", str(origin), ORIGINS)))
        elif self.provenance_required:
            raise self.fail(
                path,
                f"the bare value {raw!r} has no unit and origin; write {{ value = ..., unit = {si!r}, origin = ..., source = ... }}",
            )
        else:
            value, unit, origin, source = raw, si, "assumed", ""
        if not isinstance(unit, str):
            raise self.fail(path, f"the unit must be a string like {si!r}, {unit!r} was given")
        try:
            scale = units.factor(unit, si)
        except VlabError as error:
            raise self.fail(path, str(error)) from error
        many = isinstance(value, list)
        given = tuple(self._finite(part, path) for part in (value if many else [value]))
        for part in given:
            if metadata.get("positive") and not part > 0:
                raise self.fail(path, f"the value is {part:g} {unit}; it must be positive")
            lowest = metadata.get("at_least")
            if lowest is not None and part * scale < lowest:
                raise self.fail(path, f"the value is {part:g} {unit}; it must be at least {lowest:g} {si}")
        self.provenance[path] = Provenance(value=given if many else given[0], unit=unit, origin=origin, source=source)
        converted = tuple(part * scale for part in given)
        return converted if many else converted[0]
