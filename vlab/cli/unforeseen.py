"""Unforeseen errors: one line with kind, place and how to report it."""

import re
import traceback
from pathlib import Path

import vlab
from vlab.files.text import one_line

STATUS = 3
"""STATUS: exit status after a fault of vlab itself."""
_PACKAGE = Path(vlab.__file__).parent
_FRAME = re.compile(r'File "([^"\n]+)", line (\d+)')


def line_of(error: BaseException) -> str:
    """Return the error line of an unforeseen error.

    Parameters
    ----------
    error : BaseException
        Unforeseen error.

    Returns
    -------
    str
        One line.
    """
    said = one_line(error)
    kind = type(error).__name__
    return (
        f"{kind} at {place_of(error)}{': ' if said else ''}{said}; this is a fault of vlab: please report this line "
        "with the command and its input (--debug shows the traceback)"
    )


def place_of(error: BaseException) -> str:
    """Return the innermost place of vlab in an error.

    Frames of worker processes count.

    Parameters
    ----------
    error : BaseException
        Unforeseen error.

    Returns
    -------
    str
        Module and line.
    """
    frames = [(frame.filename, frame.lineno or 0) for frame in traceback.extract_tb(error.__traceback__)]
    if type(error.__cause__).__name__.endswith("RemoteTraceback"):  # frames of a worker are available as text only
        frames += [(file, int(number)) for file, number in _FRAME.findall(str(error.__cause__))]
    for file, number in reversed(frames):
        path = Path(file)
        if path.is_relative_to(_PACKAGE):
            module = ".".join(path.relative_to(_PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__")
            return f"{module}:{number}"
    return "vlab"
