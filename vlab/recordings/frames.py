"""Data frames, as of pandas, in place of files."""

from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np

from vlab.errors import BadRecording
from vlab.files.text import in_line
from vlab.recordings.table import EVERY, Table

NAME = "DataFrame"
"""NAME: name of a data frame in messages, in place of a file."""


@runtime_checkable
class DataFrame(Protocol):
    """Named columns over an index, such as ``pandas.DataFrame``."""

    @property
    def columns(self) -> Any:
        """Names of the columns."""

    @property
    def index(self) -> Any:
        """Index of the rows."""

    def __getitem__(self, name: Any) -> Any:
        """Return a column."""


def seconds_of(values: Any) -> Any:
    """Return times in seconds.

    Parameters
    ----------
    values : array
        Numbers [s], time stamps, or times since a start.

    Returns
    -------
    array
        Time stamps as seconds since the first; anything else unchanged.
    """
    values = np.asarray(values)
    return (values - values[0]) / np.timedelta64(1, "s") if values.dtype.kind in "mM" and values.size else values


def table_of(frame: DataFrame, *, time: str = "time", times: tuple[str, ...] = ()) -> Table:
    """Return a data frame as the columns of a file.

    Parameters
    ----------
    frame : DataFrame
        Data frame; columns without numbers are refused when they are read.
    time : str
        Name of the column that a named or a datetime index becomes.
    times : tuple of str
        Names of a time column in lower case; the index counts without such a column only.

    Returns
    -------
    Table
        Columns.

    Raises
    ------
    BadRecording
        No column is numeric.
    """
    columns: dict[str, Any] = {}
    refused: dict[str, str] = {}
    for name in frame.columns:
        values = seconds_of(frame[name])
        try:
            columns[str(name)] = np.asarray(values, dtype=complex if np.iscomplexobj(values) else float)
        except (TypeError, ValueError):
            refused[str(name)] = f"the column {in_line(repr(str(name)))} of the data frame holds no numbers"
    index = seconds_of(frame.index)
    is_time = index is not frame.index and np.asarray(frame.index).dtype.kind in "mM"
    is_time |= str(getattr(frame.index, "name", "")).strip().lower() in times
    if is_time and not any(name.strip().lower() in times for name in columns):
        columns = {time: np.asarray(index, dtype=float), **columns}
    if not columns:
        raise BadRecording(f"the {NAME} has no column of numbers; give named columns of samples")
    return Table(path=Path(NAME), columns=columns, refused=refused, blanks=EVERY)
