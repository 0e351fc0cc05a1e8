"""Published tables, as printed, with their units."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from vlab import units
from vlab.assets import asset
from vlab.errors import BadStructure, unknown_name
from vlab.schema import Reader
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True)
class PublishedTable:
    """One table.

    Parameters
    ----------
    number : str
        As the dissertation numbers it.
    part : str
        Which of several tables under one number.
    units : tuple of str
        Unit of each column.
    cells : tuple of tuple of float
        As printed.
    """

    number: str
    title: str
    rows: tuple[str, ...]
    columns: tuple[str, ...]
    units: tuple[str, ...]
    cells: tuple[tuple[float, ...], ...]
    part: str = ""

    def __post_init__(self) -> None:
        shape = np.shape(self.cells)
        if shape != (len(self.rows), len(self.columns)) or len(self.units) != len(self.columns):
            raise BadStructure(
                f"table {self.number}: cells of shape {shape} do not fit {len(self.rows)} rows and {len(self.columns)} columns"
            )

    def column(self, name: str) -> Array:
        """Return a column as printed."""
        if name not in self.columns:
            raise unknown_name("column", name, self.columns, where=f"table {self.number}")
        return np.array(self.cells)[:, self.columns.index(name)]

    def si(self, unit: str) -> Array:
        """Return all cells in an SI unit."""
        return np.array(self.cells) * np.array([units.factor(given, unit) for given in self.units])


@dataclass(frozen=True, kw_only=True)
class _Tables:
    format: Literal["vlab-tables-1"]
    structure: str
    source: str
    table: tuple[PublishedTable, ...]


def published_tables(structure: str) -> tuple[PublishedTable, ...]:
    """Return the published tables of a structure, or none where nothing was published."""
    try:
        path = asset(f"published/{structure}.toml")
    except LookupError:
        return ()
    reader = Reader(path, provenance_required=False)
    content: Any = reader.table(_Tables, reader.load())
    return tuple(content.table)


def published_table(structure: str, number: str, part: str = "") -> PublishedTable:
    """Return one table, or raise `UnknownName` with the ones there are."""
    tables = published_tables(structure)
    for table in tables:
        if table.number == number and table.part == part:
            return table
    raise unknown_name(
        "published table", f"{number} {part}".strip(), [f"{t.number} {t.part}".strip() for t in tables], where=structure
    )
