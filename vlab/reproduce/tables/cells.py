"""Comparison of a published table, cell by cell."""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from vlab.design.published_tables import PublishedTable

Rule = Literal["relative", "absolute", "factor"]


@dataclass(frozen=True, kw_only=True)
class Cell:
    """Compared number.

    Parameters
    ----------
    tolerance : float
        Tolerance by `rule`: relative, absolute, or a factor above 1.
    determined : bool
        Whether the published data determine the number; other cells decide nothing.
    honest : float or None
        Tolerance set before the number was known, if `tolerance` had to be wider.
    """

    row: str
    column: str
    published: float
    ours: float
    tolerance: float
    unit: str
    rule: Rule = "relative"
    determined: bool = True
    honest: float | None = None

    @property
    def ok(self) -> bool:
        """Whether the own value is within the tolerance.

        The tolerance is absolute for a published zero.
        """
        return self._within(self.tolerance)

    @property
    def is_honest(self) -> bool:
        """Whether the own value is within the first tolerance."""
        return self._within(self.tolerance if self.honest is None else self.honest)

    @property
    def off(self) -> float | None:
        """Relative deviation from the published number; None for zero."""
        return (self.ours - self.published) / self.published if self.published else None

    def _within(self, tolerance: float) -> bool:
        if self.rule == "factor":
            ratio = self.ours / self.published if self.published else np.inf
            return bool(1 / tolerance <= ratio <= tolerance)
        size = 1.0 if self.rule == "absolute" else (abs(self.published) or 1.0)
        return bool(abs(self.ours - self.published) <= tolerance * size)

    @property
    def allowed(self) -> str:
        """Tolerance as text."""
        if self.rule == "relative":
            return f"{100 * self.tolerance:.3g} %"
        return f"+-{self.tolerance:.3g}" if self.rule == "absolute" else f"factor {self.tolerance:.3g}"


@dataclass(frozen=True, kw_only=True)
class ReproducedTable:
    """Published table beside own values."""

    table: str
    title: str
    cells: tuple[Cell, ...]

    @property
    def ok(self) -> bool:
        """Whether every determined cell is within tolerance."""
        return all(cell.ok for cell in self.cells if cell.determined)

    def as_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        return {
            "table": self.table,
            "title": self.title,
            "cells": [{**asdict(c), "ok": c.ok, "ok_honest": c.is_honest} for c in self.cells],
        }


@dataclass(frozen=True, kw_only=True)
class Share:
    """Count of cells within tolerance."""

    inside: int
    of: int

    def __str__(self) -> str:
        return f"{self.inside} of {self.of}"


def share(tables: Iterable[ReproducedTable], *, determined: bool = True, honest: bool = False) -> Share:
    """Count the determined, or undetermined, cells within tolerance.

    Parameters
    ----------
    tables : iterable of ReproducedTable
        Tables.
    determined : bool
        Whether determined cells are counted.
    honest : bool
        Whether the first tolerances apply.

    Returns
    -------
    Share
        Count and total.
    """
    cells = [cell for table in tables for cell in table.cells if cell.determined == determined]
    return Share(inside=sum(cell.is_honest if honest else cell.ok for cell in cells), of=len(cells))


def widened(tables: Iterable[ReproducedTable]) -> list[tuple[str, Cell]]:
    """Return the cells with a widened tolerance, by table number."""
    return [(t.table, c) for t in tables for c in t.cells if c.honest is not None and c.determined]


def compare(
    table: PublishedTable,
    column: str,
    ours: ArrayLike,
    tolerance: ArrayLike,
    *,
    rule: Rule = "relative",
    determined: bool = True,
    name: str = "",
    honest: ArrayLike | None = None,
) -> list[Cell]:
    """Return the cells of a column beside own values.

    Parameters
    ----------
    table : PublishedTable
        Published table.
    column : str
        Name of the column.
    ours : (n_rows,) array
        Own values in the unit of the column.
    tolerance : float or (n_rows,) array
        Tolerance.
    rule : Rule
        Kind of tolerance.
    determined : bool
        Whether the published data determine the numbers.
    name : str
        Heading; that of the table by default.
    honest : float or (n_rows,) array or None
        First tolerances; the same by default.

    Returns
    -------
    list of Cell
        One cell per row.
    """
    unit = table.units[table.columns.index(column)]
    count = len(table.rows)
    tolerances = np.broadcast_to(tolerance, count)
    before = np.broadcast_to(tolerances if honest is None else honest, count)
    return [
        Cell(
            row=row,
            column=name or column,
            published=float(printed),
            ours=float(value),
            tolerance=float(allowed),
            unit=unit,
            rule=rule,
            determined=determined,
            honest=float(first) if first < allowed else None,
        )
        for row, printed, value, allowed, first in zip(
            table.rows, table.column(column), np.asarray(ours, dtype=float), tolerances, before, strict=True
        )
    ]


def beside(table: PublishedTable, cells: Sequence[Cell], title: str = "") -> ReproducedTable:
    """Return the table of some cells."""
    return ReproducedTable(table=table.number, title=title or table.title, cells=tuple(cells))
