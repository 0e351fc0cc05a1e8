"""Guarded reading and atomic writing of files."""

import contextlib
import errno
import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from vlab.errors import BadRecording, OutputRefused
from vlab.files.containment import NotInside, PathLike, path_inside
from vlab.files.leftovers import part_beside
from vlab.files.text import one_line

MAX_BYTES = 2 * 1024**3
"""MAX_BYTES [bytes]: largest accepted file and largest unpacked content. A recording is held in memory."""

_ALWAYS = 64 * 1024**2  # bytes allowed for every file; unpacking takes half a second
_RATIO = 200  # unpacked bytes per packed byte; mostly silent channels stay below, a decompression bomb reaches 1000


def refuse(path: PathLike, what: str, *, fix: str = "") -> BadRecording:
    """Return the one-line error of a file.

    Parameters
    ----------
    path : str or path
        File.
    what : str
        Defect.
    fix : str
        Likely remedy.
    """
    return BadRecording(one_line(path) + ": " + one_line(what) + ("; " + one_line(fix) if fix else ""))


def unpacked_limit(n_bytes: int) -> int:
    """Return the largest allowed size of unpacked content [bytes].

    A larger content is a decompression bomb.

    Parameters
    ----------
    n_bytes : int
        Size of the packed file [bytes].
    """
    return min(MAX_BYTES, max(_ALWAYS, _RATIO * n_bytes))


def read_guarded(path: PathLike, *, folder: PathLike | None = None) -> bytes:
    """Return the bytes of an ordinary file of limited size.

    Parameters
    ----------
    path : str or path
        File, relative to `folder` if given.
    folder : str or path, optional
        Folder that must contain the file after links and ``..`` are resolved.

    Returns
    -------
    bytes
        Contents.

    Raises
    ------
    BadRecording
        The file is outside the folder, missing, unreadable, not ordinary, empty or larger than `MAX_BYTES`.
    """
    try:
        real = Path(path).resolve() if folder is None else path_inside(path, folder, called=str(folder))
        status = real.stat()  # before opening, because opening a pipe would block
        if stat.S_ISDIR(status.st_mode):
            raise refuse(path, "it is a folder", fix="name the file in it")
        if not stat.S_ISREG(status.st_mode):
            raise refuse(path, "it is a device or a pipe, not a file")
        if status.st_size > MAX_BYTES:
            raise refuse(
                path,
                f"the file has {status.st_size} bytes, at most {MAX_BYTES} are opened",
                fix="cut the recording into parts",
            )
        with open(real, "rb") as stream:
            data = stream.read(MAX_BYTES + 1)
    except NotInside as error:
        raise refuse(path, f"the file {error}", fix="copy it into the folder and name it relative to it") from error
    except FileNotFoundError as error:
        raise refuse(path, "there is no such file", fix="check the name and the folder") from error
    except (OSError, RuntimeError) as error:  # RuntimeError: loop of links (Python 3.11 and 3.12)
        raise refuse(path, f"the file cannot be opened: {getattr(error, 'strerror', None) or error}") from error
    except (ValueError, TypeError, MemoryError) as error:
        if isinstance(error, BadRecording):
            raise
        raise refuse(path, f"the file cannot be opened: {error}") from error
    if not data:
        raise refuse(path, "the file is empty", fix="export or copy it again")
    return data


@contextlib.contextmanager
def written_whole(path: PathLike, *, is_new: bool = False) -> Iterator[BinaryIO]:
    """Open a file for atomic writing.

    The file appears under its name only after the block ends without error.

    Parameters
    ----------
    path : str or path
        The file.
    is_new : bool
        Whether an existing file must stay unchanged.

    Returns
    -------
    context manager of BinaryIO
        Stream of a temporary file.

    Raises
    ------
    OutputRefused
        The file cannot be written, or exists although `is_new` is set.
    """
    path = Path(path)
    try:
        with part_beside(path) as part:
            with open(part, "wb") as stream:
                yield stream
                stream.flush()
                os.fsync(stream.fileno())
            if is_new:
                _move_new(part, path)
            else:
                os.replace(part, path)
    except FileExistsError as error:
        raise OutputRefused(
            f"{one_line(path)}: is there already and is never written over; name another folder"
        ) from error
    except OSError as error:
        if isinstance(error, OutputRefused):
            raise
        raise OutputRefused(
            f"{one_line(path)}: cannot be written: {one_line(error.strerror or error)}; check the folder and its free space"
        ) from error


def _move_new(part: Path, path: Path) -> None:
    """Rename a file atomically unless the name is taken."""
    try:
        os.link(part, path)
    except OSError as error:
        if error.errno not in (errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS):
            raise
        with open(path, "xb") as stream:  # for file systems without hard links
            stream.write(part.read_bytes())
