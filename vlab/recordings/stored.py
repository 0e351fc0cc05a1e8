"""vlab's own recordings on disk: exact in Parquet, CSV and MAT, labels, units and notes included; UFF 58 says what it loses."""

from pathlib import Path

import numpy as np

from vlab.errors import BadRecording
from vlab.recordings.files import PathLike, refuse
from vlab.recordings.formats import csv, mat, parquet, uff
from vlab.recordings.table import open_table
from vlab.signals import Recording

WRITERS = {
    ".parquet": parquet.write_parquet,
    ".csv": csv.write_csv,
    ".mat": mat.write_mat,
    ".uff": uff.write_uff,
    ".unv": uff.write_uff,
}


def write_recording(recording: Recording, path: PathLike) -> tuple[str, ...]:
    """Write a recording to ``.parquet`` (native), ``.csv``, ``.mat`` (version 5) or ``.uff`` (58b), whole or not at all.

    Returns
    -------
    tuple of str
        What `read_recording` will not give back; empty where the file holds the recording exactly.

    Raises
    ------
    BadRecording
        Another suffix, or labels or notes that the format cannot hold.
    OutputRefused
        The folder cannot be written.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in WRITERS:
        raise refuse(path, f"recordings are not written as {suffix!r}", fix=f"accepted: {', '.join(WRITERS)}")
    return WRITERS[suffix](recording, path)


def read_recording(path: PathLike, *, folder: PathLike | None = None) -> Recording:
    """Read back what `write_recording` wrote: the same bits, labels, units and notes.

    Raises
    ------
    BadRecording
        Everything that `open_table` refuses, and files without vlab's labels.
    """
    table = open_table(path, folder=folder)
    if table.channels is None:
        raise refuse(
            path, "the columns carry no vlab labels", fix="describe them in a case, or use open_table and to_recording"
        )
    data = (
        np.column_stack([table[channel.name] for channel in table.channels])
        if table.channels
        else np.empty((table["time"].size, 0))
    )
    try:
        return Recording(time=table["time"], data=data, channels=table.channels, meta=table.meta)
    except BadRecording as error:
        raise refuse(path, str(error)) from error
