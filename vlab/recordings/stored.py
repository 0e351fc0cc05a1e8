"""vlab's own recordings on disk.

Parquet, CSV and MAT are exact, labels, units and notes included. UFF 58 reports its losses.
"""

from pathlib import Path

import numpy as np

from vlab.errors import BadRecording
from vlab.recordings.files import PathLike, refuse
from vlab.recordings.formats import csv_writer, mat, parquet, uff
from vlab.recordings.table import open_table
from vlab.signals import Recording

WRITERS = {
    ".parquet": parquet.write_parquet,
    ".csv": csv_writer.write_csv,
    ".mat": mat.write_mat,
    ".uff": uff.write_uff,
    ".unv": uff.write_uff,
}
"""Writer by suffix."""


def write_recording(recording: Recording, path: PathLike) -> tuple[str, ...]:
    """Write a recording atomically.

    The suffix selects the format: ``.parquet`` (native), ``.csv``, ``.mat`` (version 5) or ``.uff`` (58b).

    Parameters
    ----------
    recording : Recording
        Recording in SI.
    path : str or path
        Path of the file.

    Returns
    -------
    tuple of str
        Losses on reading back with `read_recording`; empty for an exact file.

    Raises
    ------
    BadRecording
        The suffix is unknown, or the format cannot hold a label or note.
    OutputRefused
        The folder cannot be written.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in WRITERS:
        raise refuse(path, f"recordings are not written as {suffix!r}", fix=f"accepted: {', '.join(WRITERS)}")
    return WRITERS[suffix](recording, path)


def read_recording(path: PathLike, *, folder: PathLike | None = None) -> Recording:
    """Read a recording that `write_recording` wrote.

    Bits, labels, units and notes are the same.

    Parameters
    ----------
    path : str or path
        Path of the file.
    folder : str or path or None
        Folder that must contain the file; `path` is then relative.

    Returns
    -------
    Recording
        Recording in SI.

    Raises
    ------
    BadRecording
        `open_table` refuses the file, or the file lacks vlab's labels.
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
