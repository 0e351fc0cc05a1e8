"""Published tables, as printed, with their units."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np

from vlab import units
from vlab.errors import BadStructure, unknown_name
from vlab.files.assets import asset
from vlab.files.toml import Reader
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True)
class PublishedTable:
    """Published table.

    Parameters
    ----------
    number : str
        Number in the dissertation.
    part : str
        Part of a table with several parts under one number.
    units : tuple of str
        Unit of each column.
    cells : tuple of tuple of float
        Values as printed.
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
class PublishedDesign:
    """Settings of the published designs of a section, as printed.

    Units are inches, pounds and centiseconds.

    Parameters
    ----------
    name, section : str
        Name of the design and section of the dissertation.
    model : str
        Reduced model of the controllers: ``"exact"`` or ``"corrected-guyan"``.
    weights : str
        ``"identity"`` for Q = q I, ``"energy"`` for Q = diag(M, K).
    q, r : float
        Weights Q = q I and R = r I.
    v1, v2, alpha : float
        Intensities V_1 = v1 I and V_2 = v2 I, and stability margin of the Kalman filter.
    damped_modes, zeta_min : int and float
        Number n_m of the first modes with a damping ratio of at least zeta_L.
    index_modes : int
        Number n_f of initial shapes in the indices of LQDRF.
    """

    name: str
    section: str
    model: Literal["exact", "corrected-guyan"]
    weights: Literal["identity", "energy"]
    q: float = 1.0
    r: float
    v1: float
    v2: float
    alpha: float
    damped_modes: int
    zeta_min: float
    index_modes: int

    @property
    def si(self) -> frozenset[str]:
        """Names of the values in SI: none."""
        return frozenset()


@dataclass(frozen=True, kw_only=True)
class _Tables:
    format: Literal["vlab-tables-1"]
    structure: str
    source: str
    table: tuple[PublishedTable, ...]
    design: tuple[PublishedDesign, ...] = ()


@lru_cache(maxsize=8)
def _published(structure: str) -> Any:
    """Read the frozen tables of a structure once.

    A reproduction uses the tables dozens of times.
    """
    try:
        path = asset(f"published/{structure}.toml")
    except LookupError:
        return None
    reader = Reader(path, provenance_required=False)
    return reader.table(_Tables, reader.load())


def published_tables(structure: str) -> tuple[PublishedTable, ...]:
    """Return the published tables of a structure; empty without publication."""
    content = _published(structure)
    return () if content is None else tuple(content.table)


def published_table(structure: str, number: str, part: str = "") -> PublishedTable:
    """Return one published table.

    Parameters
    ----------
    structure : str
        Built-in structure.
    number : str
        Number of the table.
    part : str
        Part of the table, if there are several.

    Returns
    -------
    PublishedTable
        Table as printed.

    Raises
    ------
    UnknownName
        There is no such table; the message lists the available ones.
    """
    tables = published_tables(structure)
    for table in tables:
        if table.number == number and table.part == part:
            return table
    raise unknown_name(
        "published table", f"{number} {part}".strip(), [f"{t.number} {t.part}".strip() for t in tables], where=structure
    )


def published_designs(structure: str) -> tuple[PublishedDesign, ...]:
    """Return the settings of a structure's published designs, if any."""
    content = _published(structure)
    return () if content is None else tuple(content.design)


def published_design(structure: str, name: str = "identity") -> PublishedDesign:
    """Return the settings of one published design.

    Parameters
    ----------
    structure : str
        Built-in structure.
    name : str
        Name of the design.

    Returns
    -------
    PublishedDesign
        Settings as printed.

    Raises
    ------
    UnknownName
        There is no such design; the message lists the available ones.
    """
    designs = published_designs(structure)
    for design in designs:
        if design.name == name:
            return design
    raise unknown_name("published design", name, [design.name for design in designs], where=structure)
