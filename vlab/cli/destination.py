"""``--out`` and ``--overwrite``: where a verb writes. Nothing that is there already is lost unless the user says so."""

import argparse
import contextlib
from collections.abc import Iterable, Iterator
from pathlib import Path

from vlab.errors import OutputRefused
from vlab.files.output_folder import check_output, keep_apart, numbered_folder

OVERWRITE = "--overwrite"


def add_out(parser: argparse.ArgumentParser, what: str, *, default: str = "") -> None:
    """Add the arguments that say where a verb writes.

    Parameters
    ----------
    what : str
        What the folder is for.
    default : str
        The name that is numbered where the user gives none; nothing is written then if it is empty.
    """
    numbered = f" (default {default}-001, or the next number)" if default else ""
    parser.add_argument("--out", help=f"write {what}{numbered}")
    parser.add_argument(OVERWRITE, action="store_true", help="replace the folder of --out if vlab wrote the folder")


def check_out(arguments: argparse.Namespace, *, read: Iterable[Path | str] = ()) -> None:
    """Refuse a folder that must not be written, before the work whose result would go there.

    Parameters
    ----------
    read : iterable of Path or str
        Files and folders that the verb reads.

    Raises
    ------
    OutputRefused
        The folder holds what is read, or something that is not to be overwritten; or ``--overwrite`` without ``--out``.
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
    """Yield the folder that the user named, or the next number of the default, claimed while the block runs.

    Parameters
    ----------
    default : str
        The name that is numbered.

    Raises
    ------
    OutputRefused
        The place cannot be written.
    """
    if arguments.out:
        yield Path(arguments.out)
    else:
        with numbered_folder(default) as folder:
            yield folder
