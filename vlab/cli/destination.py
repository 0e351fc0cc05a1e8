"""Output folder of a command: ``--out`` and ``--overwrite``.

Existing files stay without an explicit ``--overwrite``.
"""

import argparse
import contextlib
from collections.abc import Iterable, Iterator
from pathlib import Path

from vlab.errors import OutputRefused
from vlab.files.output_folder import check_output, keep_apart, numbered_folder

OVERWRITE = "--overwrite"


def add_out(parser: argparse.ArgumentParser, what: str, *, default: str = "") -> None:
    """Add the arguments of the output folder.

    Parameters
    ----------
    parser : ArgumentParser
        Parser of the command.
    what : str
        Content of the folder, for the help.
    default : str
        Name that is numbered without ``--out``; empty for no output.
    """
    numbered = f" (default {default}-001, or the next number)" if default else ""
    parser.add_argument("--out", help=f"write {what}{numbered}")
    parser.add_argument(OVERWRITE, action="store_true", help="replace the folder of --out if vlab wrote the folder")


def check_out(arguments: argparse.Namespace, *, read: Iterable[Path | str] = ()) -> None:
    """Refuse a protected output folder before the work starts.

    Parameters
    ----------
    arguments : Namespace
        Parsed arguments of the command.
    read : iterable of Path or str
        Input files and folders of the command.

    Raises
    ------
    OutputRefused
        The folder holds input files or protected files, or ``--overwrite`` comes without ``--out``.
    """
    if arguments.out:
        keep_apart(arguments.out, read)
        check_output(
            arguments.out, overwrite=arguments.overwrite, remedy=f"name another with --out, or add {OVERWRITE}"
        )
    elif arguments.overwrite:
        raise OutputRefused(f"{OVERWRITE} replaces the folder of --out, and none was named; name it, or leave it away")


@contextlib.contextmanager
def destination(arguments: argparse.Namespace, default: str) -> Iterator[Path]:
    """Yield the named or next numbered folder.

    Parameters
    ----------
    arguments : Namespace
        Parsed arguments of the command.
    default : str
        Name that is numbered.

    Yields
    ------
    Path
        Output folder.

    Raises
    ------
    OutputRefused
        The folder cannot be written.
    """
    if arguments.out:
        yield Path(arguments.out)
    else:
        with numbered_folder(default) as folder:
            yield folder
