"""Records of named, nested values as columns.

The module needs numpy only, because isolated readers import it.
"""

from array import array
from typing import Any

import numpy as np

MOST_COLUMNS = 10_000
"""MOST_COLUMNS [1]: largest number of columns of one table."""
LONGEST_LIST = 1000
"""LONGEST_LIST [1]: longest list whose elements become columns; a longer list is an image or a map."""
DEEPEST = 20
"""DEEPEST [1]: deepest nesting of a record."""
LONGEST_STAMP = 45
"""LONGEST_STAMP [1]: characters of the longest text that may be a time stamp."""
_STAMP_SIZE = 12  # memory of a text that may be a time stamp, in numbers
_WHOLE = 2**53  # largest integer exact in a double


class Rows:
    """Columns that grow by one record at a time.

    Parameters
    ----------
    limit : int
        Largest size of all columns [bytes].
    """

    def __init__(self, limit: int) -> None:
        self.limit, self.count = limit, 0
        self.columns: dict[str, array[float]] = {}
        self.refused: dict[str, str] = {}
        self.texts: dict[str, list[str | None]] = {}
        """Texts that may be time stamps, by name; None where a record has none."""

    def add(self, record: Any, prefix: str = "") -> None:
        """Add one record; a value that a record lacks is NaN.

        Parameters
        ----------
        record : dict
            Values by name.
        prefix : str
            Beginning of the names of the columns.

        Raises
        ------
        ValueError
            The columns become too many or too large.
        """
        self._put(prefix, record, 0, is_top=True)
        self.count += 1
        if 8 * self.count * (len(self.columns) + _STAMP_SIZE * len(self.texts)) > self.limit:
            raise ValueError(f"{self.count} records of {len(self.columns)} values are more than {self.limit} bytes")

    def _put(self, name: str, value: Any, depth: int, *, is_top: bool = False) -> None:
        if depth > DEEPEST:
            self.refused[name] = f"it is nested more than {DEEPEST} deep"
        elif isinstance(value, dict):
            for key, part in value.items():
                self._put(f"{name}{key}" if is_top else f"{name}.{key}", part, depth + 1)
        elif isinstance(value, list | tuple):
            if len(value) > LONGEST_LIST:
                self.refused[name] = f"it is a list of {len(value)}; at most {LONGEST_LIST} numbers are read"
                return
            for i, part in enumerate(value):
                self._put(f"{name}[{i}]", part, depth + 1)
        elif isinstance(value, int) and abs(value) > _WHOLE:
            self.refused[name] = "it has numbers beyond the precision of a float; subtract the start of a clock"
        elif value is None or isinstance(value, int | float):
            self._number(name, np.nan if value is None else float(value))
        else:
            if isinstance(value, str):
                self._text(name, value)
            self.refused.setdefault(name, "it is text, not numbers; a time must be in seconds")

    def _text(self, name: str, value: str) -> None:
        if name not in self.texts and (not value[:1].isdigit() or len(value) > LONGEST_STAMP):
            return
        texts = self.texts.setdefault(name, [])
        texts.extend([None] * (self.count - len(texts)))
        if len(texts) == self.count:
            texts.append(value.strip()[: LONGEST_STAMP + 1])

    def _number(self, name: str, value: float) -> None:
        column = self.columns.get(name)
        if column is None:
            if len(self.columns) >= MOST_COLUMNS:
                raise ValueError(f"more than {MOST_COLUMNS} columns")
            column = self.columns[name] = array("d")
        if len(column) < self.count:
            column.extend([np.nan] * (self.count - len(column)))
        if len(column) == self.count:
            column.append(value)

    def arrays(self) -> dict[str, Any]:
        """Return the columns as arrays of equal length."""
        out = {}
        for name, column in self.columns.items():
            values = np.full(self.count, np.nan)
            values[: len(column)] = column
            if name not in self.refused and not np.isnan(values).all():
                out[name] = values
        return out
