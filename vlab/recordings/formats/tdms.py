"""TDMS recordings (LabVIEW) as columns.

Channels are named ``group/channel``; waveforms have a column ``group/time`` [s]. npTDMS is LGPL and therefore an
optional extra, ``vlab-vibration[tdms]``. npTDMS trusts the counts in a file's headers and runs in an isolated process, see
`vlab.recordings.isolated`.
"""

from collections.abc import Collection, Sequence
from pathlib import Path

from vlab.recordings.files import refuse
from vlab.recordings.formats.hdf5 import read_variables
from vlab.recordings.table import Table


def read(
    data: bytes,
    path: Path,
    *,
    names: Sequence[str] | None = None,
    columns: Sequence[str] | None = None,
    blanks: Collection[str] = frozenset(),
) -> Table:
    """Read a TDMS file, see `vlab.recordings.open_table`."""
    if names is not None:
        raise refuse(path, "a TDMS file names its own channels", fix="leave out names")
    install = "'vlab-vibration[tdms]' (npTDMS)"
    return read_variables("read_tdms", data, path, columns, blanks=blanks, library="nptdms", install=install)
