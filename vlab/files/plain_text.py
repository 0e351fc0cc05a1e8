"""Text files of users, read with bounded memory and without waiting."""

import stat
from pathlib import Path

MOST_BYTES = 64 * 2**20
"""MOST_BYTES [byte]: largest text file; the largest shipped one has 0.1 MB."""


def read_plain_text(path: Path | str) -> str:
    """Read an ordinary UTF-8 text file of bounded size.

    A device has no end, and opening a pipe waits for its writer; both are refused before opening.

    Parameters
    ----------
    path : Path or str
        File; links are followed.

    Returns
    -------
    str
        Text.

    Raises
    ------
    OSError
        The file is missing, unreadable, a folder, device or pipe, or larger than `MOST_BYTES`.
    UnicodeDecodeError
        The file is no UTF-8 text.
    """
    file = Path(path)
    status = file.stat()  # before opening, because opening a pipe would block
    if not stat.S_ISREG(status.st_mode):
        raise OSError("a folder" if stat.S_ISDIR(status.st_mode) else "a device or a pipe, not a file")
    if status.st_size > MOST_BYTES:
        raise OSError(f"the file has {status.st_size} bytes; at most {MOST_BYTES} are read")
    return file.read_text(encoding="utf-8")
