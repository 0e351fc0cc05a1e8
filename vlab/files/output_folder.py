"""Output folders, written atomically.

A folder is written beside its final place and moved when complete, so no partial output remains.
"""

import contextlib
import hashlib
import itertools
import json
import math
import os
import platform
import re
import shutil
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from vlab import __version__
from vlab.errors import OutputRefused
from vlab.files.leftovers import OLD, PART, WAS, make_held, release, sweep
from vlab.files.plain_text import read_plain_text

MANIFEST = "manifest.json"
"""File name of a folder's manifest."""


@contextlib.contextmanager
def output_folder(path: Path | str, *, overwrite: bool = False) -> Iterator[Path]:
    """Yield a fresh folder that becomes `path` on success.

    After an error the folder is removed.

    Parameters
    ----------
    path : Path or str
        Final place of the folder.
    overwrite : bool
        Whether to replace a complete folder of vlab (with manifest). A folder with other content is always refused, so
        no foreign file is lost.

    Returns
    -------
    context manager of Path
        Context with the fresh folder.

    Raises
    ------
    OutputRefused
        The place cannot be written, or holds files already.
    """
    target = Path(path)
    check_output(target, overwrite=overwrite)
    with made_parents(target):
        try:
            sweep(target.parent)
            fresh, held = make_held(lambda: _beside(target, PART))
        except OSError as error:
            raise _not_writable(target, error) from error
        try:
            yield fresh
            fresh.chmod(0o755)
            _move_in(fresh, target, overwrite)
        except OutputRefused:
            raise
        except OSError as error:
            raise OutputRefused(f"writing the output folder {target} failed: {error.strerror or error}") from error
        finally:
            shutil.rmtree(fresh, ignore_errors=True)
            release(held)


@contextlib.contextmanager
def numbered_folder(stem: Path | str) -> Iterator[Path]:
    """Yield ``stem-001`` or the next free number.

    The number is reserved during the block. `output_folder` creates the folder. Until then a hidden file represents it;
    `sweep` removes the file of a killed process.

    Parameters
    ----------
    stem : Path or str
        Path without the number.

    Returns
    -------
    context manager of Path
        Context with the path.

    Raises
    ------
    OutputRefused
        The place cannot be written.
    """
    stem = Path(stem)
    with made_parents(stem):
        try:
            sweep(stem.parent)
            claimed, claim, held = _claimed(stem)
        except OSError as error:
            raise _not_writable(stem, error) from error
        try:
            yield claimed
        finally:
            claim.unlink(missing_ok=True)
            release(held)


def check_output(path: Path | str, *, overwrite: bool = False, remedy: str = "name another with --out") -> None:
    """Refuse an output folder with content.

    The check runs before the work and before the folder is filled.

    Parameters
    ----------
    path : Path or str
        Output folder.
    overwrite : bool
        Whether to accept a folder of vlab.
    remedy : str
        Advice in the message for a folder of vlab.

    Raises
    ------
    OutputRefused
        The path is a file, a folder with foreign files, or a folder of vlab without `overwrite`.
    """
    target = Path(path)
    for part in (target, *target.parents):
        if part.exists() and not part.is_dir():
            where = f"the output folder {target}" + ("" if part == target else f" lies in {part}, which")
            raise OutputRefused(f"{where} is a file; name another folder with --out")
    if target.is_dir() and (not any(target.iterdir()) or _is_ours(target)):
        _check_working_folder(target)
    if not target.is_dir() or not any(target.iterdir()):
        return
    if not _is_ours(target):
        raise OutputRefused(
            f"the output folder {target} holds files that vlab did not write; name an empty or new folder with --out"
        )
    if not overwrite:
        raise OutputRefused(f"the output folder {target} is there already; {remedy}")


def _check_working_folder(target: Path) -> None:
    """Refuse the folder of the process, which cannot be replaced."""
    if Path.cwd().is_relative_to(target.resolve()):
        raise OutputRefused(
            f"the output folder {target} is the folder in which the command runs; name another folder with --out"
        )


def folder_beside(folder: Path, form: str) -> Path:
    """Return a folder with a related name beside another folder.

    Parameters
    ----------
    folder : Path
        Existing or future folder; ``.`` and ``..`` are resolved.
    form : str
        Form of the name, with ``{}`` for the name of the folder.

    Returns
    -------
    Path
        Path of the related folder.

    Raises
    ------
    OutputRefused
        The folder has no name, as the root of a file system.
    """
    place = folder.resolve() if folder.name in ("", "..") else folder
    if not place.name:
        raise OutputRefused(f"{folder}: no folder can stand beside the root of a file system; name another folder")
    return place.with_name(form.format(place.name))


def _move_in(fresh: Path, target: Path, overwrite: bool) -> None:
    """Move a folder to its place.

    The move is atomic if the place is free or an empty folder.
    """
    try:
        os.replace(fresh, target)
    except OSError:
        if not target.is_dir():
            raise
        check_output(target, overwrite=overwrite)  # another process may have written there meanwhile
        old, held = make_held(lambda: _beside(target, OLD))
        os.replace(target, old / WAS)
        os.replace(fresh, target)
        shutil.rmtree(old, ignore_errors=True)
        release(held)


def _beside(target: Path, ending: str) -> Path:
    return Path(tempfile.mkdtemp(prefix=f".{target.name}-", suffix=ending, dir=target.parent))


def _claimed(stem: Path) -> tuple[Path, Path, int | None]:
    """Return the next numbered folder, its claim file and lock.

    The operating system lets a single process create the file.
    """
    named = (re.fullmatch(rf"{re.escape(stem.name)}-(\d+)", path.name) for path in stem.parent.iterdir())
    numbers = [int(match[1]) for match in named if match]
    for number in itertools.count(max(numbers, default=0) + 1):
        target = stem.with_name(f"{stem.name}-{number:03d}")
        claim = target.with_name(f".{target.name}{PART}")
        with contextlib.suppress(FileExistsError):
            claim, held = make_held(partial(_new_file, claim))
            if not target.exists():  # otherwise its process has just ended
                return target, claim, held
            claim.unlink(missing_ok=True)
            release(held)
    raise AssertionError("numbers have no end")


def _new_file(path: Path) -> Path:
    path.open("xb").close()
    return path


@contextlib.contextmanager
def made_parents(target: Path) -> Iterator[None]:
    """Create the parent folders of a place.

    Parents that stay empty are removed again.

    Parameters
    ----------
    target : Path
        Final place of a file or folder.

    Returns
    -------
    context manager
        Context in which the parents exist.

    Raises
    ------
    OutputRefused
        A parent cannot be created.
    """
    made = [folder for folder in target.parents if not folder.exists()]  # deepest first
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _not_writable(target, error) from error
    try:
        yield
    finally:
        for folder in made:
            with contextlib.suppress(OSError):
                folder.rmdir()


def _not_writable(target: Path, error: OSError) -> OutputRefused:
    return OutputRefused(
        f"the output folder {target} cannot be written: {error.strerror or error}; name another with --out"
    )


def keep_apart(out: Path | str, read: Iterable[Path | str]) -> None:
    """Refuse an output folder that contains an input.

    Replacing the folder would destroy the input.

    Parameters
    ----------
    out : Path or str
        Output folder.
    read : iterable of Path or str
        Input files and folders.

    Raises
    ------
    OutputRefused
        An input is inside; the message names the first. Missing inputs do not count.
    """
    target = Path(out).resolve()
    for name in (name for name in read if name):
        given = Path(name).resolve()
        if given.exists() and (target == given or target in given.parents):
            raise OutputRefused(
                f"the output folder {out} holds {name}, which is read here and would be lost; name another with --out"
            )


def _is_ours(folder: Path) -> bool:
    try:
        return json.loads(read_plain_text(folder / MANIFEST)).get("written_by") == "vlab"
    except (OSError, ValueError, AttributeError):
        return False


def is_untouched_draft(path: Path | str) -> bool:
    """Return whether a folder holds an unfinished result of vlab and nothing else.

    Parameters
    ----------
    path : Path or str
        Existing or future output folder.

    Returns
    -------
    bool
        Whether the manifest has the `digests` of all files as ``unfinished`` and they still hold, so that a new run
        loses nothing.
    """
    folder = Path(path)
    try:
        written = json.loads(read_plain_text(folder / MANIFEST)).get("unfinished")
        names = {p.name for p in folder.iterdir() if p.name != MANIFEST}
        is_same = isinstance(written, dict) and names == set(written)
        return is_same and _is_ours(folder) and all(_digest(folder / name) == written[name] for name in names)
    except (OSError, ValueError, AttributeError):
        return False


def digests(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of every file in a folder.

    Parameters
    ----------
    folder : Path
        Folder without subfolders.

    Returns
    -------
    dict of str to str
        Digests by file name, for the entry ``unfinished`` of a manifest.
    """
    return {path.name: _digest(path) for path in folder.iterdir()}


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def write_manifest(folder: Path, **facts: Any) -> None:
    """Write versions, seeds and settings for a rerun.

    Call the function last.
    """
    from importlib import metadata  # imports the package email

    versions = {name: metadata.version(name) for name in ("mujoco", "numpy", "scipy", "control", "rerun-sdk")}
    content = {
        "written_by": "vlab",
        "vlab": __version__,
        "python": sys.version.split()[0],
        "machine": platform.machine(),
        "versions": versions,
        "files": sorted(p.name for p in folder.iterdir()),
        **facts,
    }
    (folder / MANIFEST).write_text(manifest_text(content), encoding="utf-8")


def manifest_text(content: Mapping[str, Any]) -> str:
    """Return the text of a folder's manifest."""
    return json.dumps(content, indent=2, sort_keys=True) + "\n"


def finite(value: Any) -> Any:
    """Return plain data with None for nonfinite numbers.

    JSON has no NaN.

    Parameters
    ----------
    value : object
        Plain data or arrays.

    Returns
    -------
    object
        Plain data.
    """
    if isinstance(value, dict):
        return {str(key): finite(part) for key, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(part) for part in value]
    if hasattr(value, "tolist"):
        return finite(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
