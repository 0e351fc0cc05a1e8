"""Where a file that data name really lies: links and ``..`` followed, and never outside the folder that the user named."""

import os
import stat
from pathlib import Path

PathLike = str | os.PathLike[str]


class NotInside(ValueError):
    """A name that leads out of its folder, or is no name of an ordinary file; its text says which, for a message."""


def path_inside(name: PathLike, folder: PathLike, *, called: str = "the folder") -> Path:
    """Return the real path that a name in a folder leads to, whether there is something or not.

    Parameters
    ----------
    name : str or path
        As the data write it, relative to the folder.
    folder : str or path
        What the user named.
    called : str
        The folder, in the error's text.

    Returns
    -------
    Path
        Absolute, links followed.

    Raises
    ------
    NotInside
        It lies outside, or cannot be a path: a null byte, a loop of links, a name too long.
    """
    try:
        real = (Path(folder) / name).resolve()
        if not real.is_relative_to(Path(folder).resolve()):
            raise NotInside(f"lies outside {called}")
        real.exists()  # a name too long shows only here
    except (OSError, RuntimeError, ValueError) as error:
        if isinstance(error, NotInside):
            raise
        raise NotInside(f"is no file name ({getattr(error, 'strerror', None) or error})") from error
    return real


def file_inside(name: PathLike, folder: PathLike, *, called: str = "the folder") -> Path:
    """Return the real path of an ordinary file in a folder; see `path_inside`.

    Raises
    ------
    NotInside
        It lies outside, or there is no such file, or it is a folder, a device or a pipe.
    """
    real = path_inside(name, folder, called=called)
    try:
        mode = real.stat().st_mode
    except OSError as error:
        raise NotInside("is not there") from error
    if not stat.S_ISREG(mode):
        raise NotInside("is a folder" if stat.S_ISDIR(mode) else "is a device or a pipe, not a file")
    return real
