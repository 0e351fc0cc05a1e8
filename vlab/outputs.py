"""Output folders: written beside their place and moved in whole, so that nothing half-written stays behind."""

import contextlib
import json
import math
import os
import platform
import shutil
import sys
import tempfile
from collections.abc import Iterable, Iterator
from importlib import metadata
from pathlib import Path
from typing import Any

from vlab import __version__
from vlab.errors import OutputRefused
from vlab.leftovers import OLD, PART, WAS, make_held, release, sweep

MANIFEST = "manifest.json"


@contextlib.contextmanager
def output_folder(path: Path | str) -> Iterator[Path]:
    """Yield a fresh folder that becomes `path` when the block ends well, and vanishes when it does not.

    A folder that vlab wrote before (it holds a manifest) is replaced as a whole; any other folder with something in it
    is refused, so nothing of anybody else's is lost.

    Raises
    ------
    OutputRefused
        The place cannot be written, or holds files that are not vlab's.
    """
    target = Path(path)
    if target.is_dir() and any(target.iterdir()) and not _is_ours(target):
        raise OutputRefused(
            f"the output folder {target} holds files that vlab did not write; name an empty or new folder with --out"
        )
    if target.exists() and not target.is_dir():
        raise OutputRefused(f"the output folder {target} is a file; name another folder with --out")
    made = [folder for folder in target.parents if not folder.exists()]  # the deepest first
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        sweep(target.parent)
        fresh, held = make_held(lambda: _beside(target, PART))
    except OSError as error:
        raise OutputRefused(
            f"the output folder {target} cannot be written: {error.strerror or error}; name another with --out"
        ) from error
    try:
        yield fresh
        fresh.chmod(0o755)
        if target.exists():
            old, held_old = make_held(lambda: _beside(target, OLD))
            os.replace(target, old / WAS)
            os.replace(fresh, target)
            shutil.rmtree(old, ignore_errors=True)
            release(held_old)
        else:
            os.replace(fresh, target)
    except OSError as error:
        raise OutputRefused(f"writing the output folder {target} failed: {error.strerror or error}") from error
    finally:
        shutil.rmtree(fresh, ignore_errors=True)
        release(held)
        for folder in made:  # goes where nothing came into it
            with contextlib.suppress(OSError):
                folder.rmdir()


def _beside(target: Path, ending: str) -> Path:
    return Path(tempfile.mkdtemp(prefix=f".{target.name}-", suffix=ending, dir=target.parent))


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
