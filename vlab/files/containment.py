"""Resolution of file names from data, confined to a folder.

Links and ``..`` are followed, and a path outside the user's folder is refused.
"""

import os
import stat
from pathlib import Path

PathLike = str | os.PathLike[str]


class NotInside(ValueError):
    """A name that leaves its folder or is no ordinary file.

    The text states the reason, for a message.
    """


def path_inside(name: PathLike, folder: PathLike, *, called: str = "the folder") -> Path:
    """Return the real path of a name in a folder.

    The path need not exist.

    Parameters
    ----------
    name : str or path
        Name in the data, relative to the folder.
    folder : str or path
        Folder named by the user.
    called : str
        Name of the folder in messages.

    Returns
    -------
    Path
        Absolute path with links resolved.

    Raises
    ------
    NotInside
        The path lies outside, or is invalid: a null byte, a loop of links, an excessive length.
    """
    try:
        real = (Path(folder) / name).resolve()
        if not real.is_relative_to(Path(folder).resolve()):
            raise NotInside(f"lies outside {called}")
        real.exists()  # raises for an excessive length
    except (OSError, RuntimeError, ValueError) as error:
        if isinstance(error, NotInside):
            raise
        raise NotInside(f"is no file name ({getattr(error, 'strerror', None) or error})") from error
    return real


def file_inside(name: PathLike, folder: PathLike, *, called: str = "the folder") -> Path:
    """Return the real path of an ordinary file in a folder.

    See `path_inside`.

    Parameters
    ----------
    name : str or path
        Name in the data, relative to the folder.
    folder : str or path
        Folder named by the user.
    called : str
        Name of the folder in messages.

    Returns
    -------
    Path
        Absolute path with links resolved.

    Raises
    ------
    NotInside
        The path lies outside, does not exist, or is a folder, device or pipe.
    """
    real = path_inside(name, folder, called=called)
    try:
        mode = real.stat().st_mode
    except OSError as error:
        raise NotInside("is not there") from error
    if not stat.S_ISREG(mode):
        raise NotInside("is a folder" if stat.S_ISDIR(mode) else "is a device or a pipe, not a file")
    return real
