"""HDF5 and MAT 7.3 recordings: numeric data sets as columns by path.

An isolated process reads the file, see `vlab.recordings.isolated`. Links to outside files, external and virtual storage
and plug-in filters are named and never followed. A data set with unwritten parts is refused, because the library would
fill them with zeros.
"""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from vlab.recordings.files import refuse
from vlab.recordings.formats.variables import Variables
from vlab.recordings.isolated import read_isolated
from vlab.recordings.table import Table


def read(
    data: bytes,
    path: Path,
    *,
    names: Sequence[str] | None = None,
    columns: Sequence[str] | None = None,
    blanks: Collection[str] = frozenset(),
) -> Table:
    """Read an HDF5 file, see `vlab.recordings.open_table`.

    `vlab.recordings.formats.variables.Variables` gives the column names.
    """
    if names is not None:
        raise refuse(path, "an HDF5 file names its own data sets", fix="leave out names")
    return read_variables("read_hdf5", data, path, columns, blanks=blanks, library="h5py", install="h5py")


def read_matlab(
    data: bytes, path: Path, *, columns: Sequence[str] | None = None, blanks: Collection[str] = frozenset()
) -> Table:
    """Read the variables of a MAT 7.3 file."""
    options = {"matlab": True}
    return read_variables(
        "read_hdf5", data, path, columns, blanks=blanks, library="h5py", install="h5py", options=options
    )


def read_variables(
    reader: str,
    data: bytes,
    path: Path,
    columns: Sequence[str] | None,
    *,
    library: str,
    install: str,
    blanks: Collection[str] = frozenset(),
    options: Mapping[str, Any] | None = None,
) -> Table:
    """Read a file's variables in an isolated process.

    Parameters
    ----------
    reader : str
        Module of `vlab.recordings.workers`.
    data : bytes
        Bytes of the file.
    path : Path
        Path of the file, for messages.
    columns : sequence of str or None
        Columns to read; all by default.
    blanks : collection of str
        Columns that may have blank cells or NaN.
    library, install : str
        Required library and its package to install.
    blanks : collection of str
        Columns that may hold NaN.
    options : mapping, optional
        Options of the reader.

    Returns
    -------
    Table
        Variables as columns.

    Raises
    ------
    BadRecording
        The file is damaged.
    """
    answer = read_isolated(
        reader, data, path, library=library, install=install, options={"matlab": False, **(options or {})}
    )
    found = Variables.of_answer(answer, path)
    found.meta = answer["meta"] | found.meta
    return found.table(path, columns, blanks)
