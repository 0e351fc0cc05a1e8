"""Cases in folders of real recordings, with digests."""

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import vlab
from vlab import controllers
from vlab.cases.case import CASE
from vlab.errors import BadProof
from vlab.files.plain_text import read_plain_text
from vlab.proof.manifest import NOT_ANSWERING
from vlab.proof.seal import digest, files_digest

KNOWN = "known.toml"
"""KNOWN: answer keys beside a case."""
NO_DATA = (KNOWN, "README.md", "LICENSE")
"""NO_DATA: files of a case folder without influence on answers."""
OF_CASES = ("recording", "frf", "modal")
"""OF_CASES: tables of which a case has at least one, beside its model."""


@dataclass(frozen=True, kw_only=True)
class RealCase:
    """Case of real recordings.

    Parameters
    ----------
    name : str
        Name of the folder, with the name of the case file where the folder has several.
    path : Path
        Case file.
    """

    name: str
    path: Path

    @property
    def folder(self) -> Path:
        """Folder of the case."""
        return self.path.parent

    def data_digest(self) -> str:
        """Return the SHA-256 of the files that may influence an answer."""
        files = [p for p in self.folder.rglob("*") if p.is_file() and p.name not in NO_DATA]
        return files_digest((p.relative_to(self.folder).as_posix(), p) for p in files)


def find_cases(folders: Sequence[Path]) -> list[RealCase]:
    """Return the cases in some folders.

    Parameters
    ----------
    folders : sequence of Path
        Case files, folders of a case, and folders of such folders.

    Returns
    -------
    list of RealCase
        Cases in the order of the folders, then by name.

    Raises
    ------
    BadProof
        A folder is missing or holds no case, or two cases have one name.
    """
    found: list[RealCase] = []
    for folder in folders:
        if not folder.exists():
            raise BadProof(f"{folder}: there is no such folder; name folders of real cases after --real")
        own = _in_file(folder) if folder.is_file() else _in_folder(folder)
        if not own and folder.is_dir():
            own = [case for part in sorted(folder.iterdir()) if part.is_dir() for case in _in_folder(part)]
        if not own:
            raise BadProof(
                f"{folder}: no case is in this folder or in its folders; a case is a TOML file with [model] and recordings "
                "(vlab init drafts one)"
            )
        found += own
    found = list({case.path.resolve(): case for case in found}.values())
    names = [case.name for case in found]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        where = " and ".join(str(case.path) for case in found if case.name == twice)
        raise BadProof(f"two cases have the name {twice!r}: {where}; rename a folder")
    return found


def _in_file(path: Path) -> list[RealCase]:
    return [case for case in _in_folder(path.parent) if case.path == path]


def _in_folder(folder: Path) -> list[RealCase]:
    """Return the cases whose files lie in a folder itself."""
    paths = [path for path in sorted(folder.glob("*.toml")) if path.name != KNOWN and _is_case(path)]
    name = folder.resolve().name
    return [
        RealCase(name=name if path.name == CASE else f"{name}-{path.stem}", path=path)
        for path in paths
        if not path.is_dir()
    ]


def _is_case(path: Path) -> bool:
    """Return whether a TOML file is a case, malformed or not."""
    try:
        raw = tomllib.loads(read_plain_text(path))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError):
        return path.name == CASE
    return path.name == CASE or ("model" in raw and any(name in raw for name in OF_CASES))


def engine_digest() -> str:
    """Return the SHA-256 of the sources that influence a diagnosis."""
    root = Path(vlab.__file__).parent
    left_out = (*NOT_ANSWERING, "proof/", "controllers/")
    files = ((p.relative_to(root).as_posix(), p) for p in root.glob("**/*.py") if "__pycache__" not in p.parts)
    code = files_digest((name, path) for name, path in files if not name.startswith(left_out))
    laws = files_digest((p.name, p) for folder in controllers.__path__ for p in Path(folder).glob("*.py"))
    return digest([code, laws])


def black_box_digest() -> str:
    """Return the SHA-256 of the sources of the black boxes."""
    names = ("black_box.py", "errors.py", "kernels.py", "state_space.py", "subspace.py")
    return files_digest((name, Path(__file__).parent / name) for name in names)
