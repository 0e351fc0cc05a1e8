"""Files at the edge: refused before anything believes them, written whole or not at all."""

import contextlib
import os
import stat
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from vlab.errors import BadRecording, OutputRefused

MAX_BYTES = 2 * 1024**3
"""Largest file that is opened and largest content that is unpacked from one [bytes]; a recording is held in memory."""

_ALWAYS = 64 * 1024**2  # bytes that any file may unpack to: half a second of work
_RATIO = 200  # bytes out of one packed byte; a recording of mostly silent channels is below, a bomb is at 1000

PathLike = str | os.PathLike[str]


def one_line(text: object, *, longest: int = 400) -> str:
    """Return text from a file or a library as one printable line, so that it cannot forge or break a message."""
    line = "".join(
        c if c.isprintable() else " " if c.isspace() else f"\\x{ord(c):02x}" for c in str(text)[: 2 * longest]
    )
    line = " ".join(line.split())
    return line if len(line) <= longest else line[:longest] + "..."


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
        real = (Path(path) if folder is None else Path(folder) / path).resolve()
        if folder is not None and not real.is_relative_to(Path(folder).resolve()):
            raise refuse(
                path, f"the file lies outside {folder}", fix="copy it into that folder and name it relative to it"
            )
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
def written_whole(path: PathLike) -> Iterator[BinaryIO]:
    """Open a file for writing that appears under its name only when the block has ended without error."""
    path = Path(path)
    part = path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}.part")
    try:
        with open(part, "xb") as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(part, path)
    except OSError as error:
        raise OutputRefused(
            f"{one_line(path)}: cannot be written: {one_line(error.strerror or error)}; check the folder and its free space"
        ) from error
    finally:
        part.unlink(missing_ok=True)
