"""A published table beside ours, cell by cell."""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from vlab.published import PublishedTable

Rule = Literal["relative", "absolute", "factor"]


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One compared number.

    Parameters
    ----------
    tolerance : float
        Relative to the published number, absolute, or the factor (above 1) between both, as `rule` says.
    determined : bool
        Whether the published data determine the number. A cell that they do not is shown, but decides nothing.
    """

    row: str
    column: str
    published: float
    ours: float
    tolerance: float
    unit: str
    rule: Rule = "relative"
    determined: bool = True

    @property
    def ok(self) -> bool:
        """Whether ours is within the tolerance (absolute where zero is published)."""
        if self.rule == "factor":
            ratio = self.ours / self.published if self.published else np.inf
            return bool(1 / self.tolerance <= ratio <= self.tolerance)
        size = 1.0 if self.rule == "absolute" else (abs(self.published) or 1.0)
        return bool(abs(self.ours - self.published) <= self.tolerance * size)

    @property
    def allowed(self) -> str:
        """The tolerance in words."""
        if self.rule == "relative":
            return f"{100 * self.tolerance:.3g} %"
        return f"+-{self.tolerance:.3g}" if self.rule == "absolute" else f"factor {self.tolerance:.3g}"


@dataclass(frozen=True, kw_only=True)
class ReproducedTable:
    """A table beside ours."""

    table: str
    title: str
    cells: tuple[Cell, ...]

    @property
    def ok(self) -> bool:
        """Whether every cell is that the published data determine."""
        return all(cell.ok for cell in self.cells if cell.determined)

    def as_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        return {"table": self.table, "title": self.title, "cells": [{**asdict(c), "ok": c.ok} for c in self.cells]}


@dataclass(frozen=True, kw_only=True)
class Share:
    """How many cells of some tables are inside their tolerance."""

    inside: int
    of: int

    def __str__(self) -> str:
        return f"{self.inside} of {self.of}"


def share(tables: Iterable[ReproducedTable], *, determined: bool = True) -> Share:
    """Count the cells inside their tolerance among those that the published data determine, or do not."""
    cells = [cell for table in tables for cell in table.cells if cell.determined == determined]
    return Share(inside=sum(cell.ok for cell in cells), of=len(cells))


def compare(
    table: PublishedTable,
    column: str,
    ours: ArrayLike,
    tolerance: ArrayLike,
    *,
    rule: Rule = "relative",
    determined: bool = True,
    name: str = "",
) -> list[Cell]:
    """Return the cells of a column beside ours.

    Parameters
    ----------
    ours : (n_rows,) array
        In the unit of the column.
    tolerance : float or (n_rows,) array
    name : str
        What the column is called; as in the table by default.
    """
    unit = table.units[table.columns.index(column)]
    tolerances = np.broadcast_to(tolerance, len(table.rows))
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
        )
        for row, printed, value, allowed in zip(
            table.rows, table.column(column), np.asarray(ours, dtype=float), tolerances, strict=True
        )
    ]


def beside(table: PublishedTable, cells: Sequence[Cell], title: str = "") -> ReproducedTable:
    """Return the table that some cells make up."""
    return ReproducedTable(table=table.number, title=title or table.title, cells=tuple(cells))
