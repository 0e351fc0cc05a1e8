"""Excel workbooks (.xlsx): the first sheet with numbers.

openpyxl reads the workbook in an isolated process, see `vlab.recordings.isolated`. Formulas are never computed; their
stored values count. Macros are never run.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path

from vlab.recordings.files import refuse
from vlab.recordings.formats import csv
from vlab.recordings.isolated import read_isolated
from vlab.recordings.table import Table

BYTES_PER_SECOND = 2e5
"""BYTES_PER_SECOND [bytes/s]: slowest accepted reading of a workbook, which is packed XML."""


def read(
    data: bytes,
    path: Path,
    *,
    names: Sequence[str] | None = None,
    columns: Sequence[str] | None = None,
    blanks: Collection[str] = frozenset(),
) -> Table:
    """Read a workbook, see `vlab.recordings.open_table`.

    Parameters
    ----------
    data : bytes
        Bytes of the file.
    path : Path
        Path of the file, for messages.
    names : sequence of str or None
        Column names of a sheet without names, or in place of its names.
    columns : sequence of str or None
        Columns to read; all by default.
    blanks : collection of str
        Columns that may have blank cells or NaN.

    Returns
    -------
    Table
        Columns, notes and units.

    Raises
    ------
    BadRecording
        The library is missing, or the file is damaged or without numbers.
    """
    answer = read_isolated(
        "read_xlsx",
        data,
        path,
        library="openpyxl",
        install="'vlab-vibration[xlsx]' (openpyxl)",
        bytes_per_second=BYTES_PER_SECOND,
    )
    if not answer["text"]:
        raise refuse(path, "no sheet holds numbers", fix="save the numbers on one sheet, names in the first row")
    table = csv.read(answer["text"].encode(), path, names=names, columns=columns, blanks=blanks)
    return replace(table, notes=(*answer["notes"], *table.notes))
