"""Files at the edge: refused before anything believes them, written whole or not at all."""

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
"""Largest file that is opened and largest content that is unpacked from one [bytes]; a recording is held in memory."""

_ALWAYS = 64 * 1024**2  # bytes that any file may unpack to: half a second of work
_RATIO = 200  # bytes out of one packed byte; a recording of mostly silent channels is below, a bomb is at 1000


def refuse(path: PathLike, what: str, *, fix: str = "") -> BadRecording:
    """Build the one-line error of a file: which, what is wrong with it, and the likely fix."""
    return BadRecording(one_line(path) + ": " + one_line(what) + ("; " + one_line(fix) if fix else ""))


def unpacked_limit(n_bytes: int) -> int:
    """Return how many bytes a packed file of `n_bytes` may unpack to; more is a bomb, not a recording."""
    return min(MAX_BYTES, max(_ALWAYS, _RATIO * n_bytes))


def read_guarded(path: PathLike, *, folder: PathLike | None = None) -> bytes:
    """Return the bytes of an ordinary file of a sane size, inside `folder` where one is given.

    Parameters
    ----------
    path : str or path
        The file; relative to `folder` where one is given.
    folder : str or path, optional
        The file must lie in it after links and ``..`` are followed.

    Raises
    ------
    BadRecording
        Outside the folder, missing, unreadable, not an ordinary file, empty or larger than `MAX_BYTES`.
    """
    try:
        real = Path(path).resolve() if folder is None else path_inside(path, folder, called=str(folder))
        status = real.stat()  # before opening: opening a pipe would wait for ever
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
    except (OSError, RuntimeError) as error:  # RuntimeError: a loop of links (Python 3.11 and 3.12)
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
    """Open a file for writing that appears under its name only when the block has ended without error.

    Parameters
    ----------
    path : str or path
        The file.
    is_new : bool
        Never write over a file: where one of that name is there when the block ends, it stays as it is.

    Raises
    ------
    OutputRefused
        The file cannot be written, or is there already although it must be new.
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
    """Give a file its name in one step that fails where the name is taken."""
    try:
        os.link(part, path)
    except OSError as error:
        if error.errno not in (errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS):
            raise
        with open(path, "xb") as stream:  # a file system without hard links
            stream.write(part.read_bytes())
