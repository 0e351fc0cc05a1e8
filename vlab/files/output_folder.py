"""Output folders: written beside their place and moved in whole, so that nothing half-written stays behind."""

import contextlib
import itertools
import json
import math
import os
import platform
import re
import shutil
import sys
import tempfile
from collections.abc import Iterable, Iterator
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import Any

from vlab import __version__
from vlab.errors import OutputRefused
from vlab.files.leftovers import OLD, PART, WAS, make_held, release, sweep

MANIFEST = "manifest.json"


@contextlib.contextmanager
def output_folder(path: Path | str, *, overwrite: bool = False) -> Iterator[Path]:
    """Yield a fresh folder that becomes `path` when the block ends well, and vanishes when it does not.

    Parameters
    ----------
    overwrite : bool
        Replace as a whole a folder that vlab wrote before (it holds a manifest). Any other folder with something in it is
        refused in either case, so nothing of anybody else's is lost.

    Raises
    ------
    OutputRefused
        The place cannot be written, or holds files already.
    """
    target = Path(path)
    check_output(target, overwrite=overwrite)
    with _parents(target):
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
    """Yield ``stem-001``, or the number after the last one there, which nobody else gets while the block runs.

    It is for `output_folder` to make. Until then a hidden file stands for it, which is swept after a process that was killed.

    Raises
    ------
    OutputRefused
        The place cannot be written.
    """
    stem = Path(stem)
    with _parents(stem):
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
    """Refuse an output folder that holds something: before the work that would fill it, and before it is filled.

    Parameters
    ----------
    overwrite : bool
        Accept a folder that vlab wrote.
    remedy : str
        What is said to do instead where vlab wrote it.

    Raises
    ------
    OutputRefused
        A file, a folder with files of somebody else's, or one of vlab's that is not to be overwritten.
    """
    target = Path(path)
    if target.exists() and not target.is_dir():
        raise OutputRefused(f"the output folder {target} is a file; name another folder with --out")
    if not target.is_dir() or not any(target.iterdir()):
        return
    if not _is_ours(target):
        raise OutputRefused(
            f"the output folder {target} holds files that vlab did not write; name an empty or new folder with --out"
        )
    if not overwrite:
        raise OutputRefused(f"the output folder {target} is there already; {remedy}")


def _move_in(fresh: Path, target: Path, overwrite: bool) -> None:
    """Put a folder where it belongs: in one step where nothing is, or an empty folder."""
    try:
        os.replace(fresh, target)
    except OSError:
        if not target.is_dir():
            raise
        check_output(target, overwrite=overwrite)  # somebody may have written there meanwhile
        old, held = make_held(lambda: _beside(target, OLD))
        os.replace(target, old / WAS)
        os.replace(fresh, target)
        shutil.rmtree(old, ignore_errors=True)
        release(held)


def _beside(target: Path, ending: str) -> Path:
    return Path(tempfile.mkdtemp(prefix=f".{target.name}-", suffix=ending, dir=target.parent))


def _claimed(stem: Path) -> tuple[Path, Path, int | None]:
    """Return the next number's folder, and the file that claims it with its lock; the system lets one process make the file."""
    named = (re.fullmatch(rf"{re.escape(stem.name)}-(\d+)", path.name) for path in stem.parent.iterdir())
    numbers = [int(match[1]) for match in named if match]
    for number in itertools.count(max(numbers, default=0) + 1):
        target = stem.with_name(f"{stem.name}-{number:03d}")
        claim = target.with_name(f".{target.name}{PART}")
        with contextlib.suppress(FileExistsError):
            claim, held = make_held(partial(_new_file, claim))
            if not target.exists():  # else its process has just ended
                return target, claim, held
            claim.unlink(missing_ok=True)
            release(held)
    raise AssertionError("numbers have no end")


def _new_file(path: Path) -> Path:
    path.open("xb").close()
    return path


@contextlib.contextmanager
def _parents(target: Path) -> Iterator[None]:
    """Make the folders above a place, and remove those again into which nothing came."""
    made = [folder for folder in target.parents if not folder.exists()]  # the deepest first
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
    """Refuse an output folder that is, or holds, something that is read: replacing the folder would destroy it.

    Raises
    ------
    OutputRefused
        The first such file or folder is named; names of what is not there do not count.
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
        return json.loads((folder / MANIFEST).read_text(encoding="utf-8")).get("written_by") == "vlab"
    except (OSError, ValueError, AttributeError):
        return False


def write_manifest(folder: Path, **facts: Any) -> None:
    """Write what a rerun needs to know: versions, seeds, settings; call it last."""
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
    (folder / MANIFEST).write_text(json.dumps(content, indent=2, sort_keys=True) + "\n", encoding="utf-8")


def finite(value: Any) -> Any:
    """Return plain data in which numbers that are not finite are None: JSON knows no NaN."""
    if isinstance(value, dict):
        return {str(key): finite(part) for key, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(part) for part in value]
    if hasattr(value, "tolist"):
        return finite(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
