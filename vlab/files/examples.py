"""Recordings, plans and code supplied with vlab, by name.

``example:NAME`` stands for a case, ``example:FOLDER/NAME`` for a further case of its folder, and ``example:FILE`` for a
single file.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from vlab.errors import UnknownName, unknown_name
from vlab.files.assets import asset

PREFIX = "example:"
CASES, FILES = "cases", "examples"
"""Folders of the cases and of the single files under ``assets``."""
MAIN = "case.toml"
"""File name of the main case of a folder."""


class Example(NamedTuple):
    """Name and path of an example."""

    name: str
    path: Path

    @property
    def is_case(self) -> bool:
        """Whether the example is a case."""
        return self.path.is_dir() or self.path.parent.parent.name == CASES


def examples() -> list[Example]:
    """Return all examples, cases first.

    Returns
    -------
    list of Example
        Examples in alphabetical order.
    """
    return [*_cases(), *(Example(path.name, path) for path in _inside(asset(FILES)) if path.is_file())]


def _cases() -> Iterator[Example]:
    for folder in _inside(asset(CASES)):
        if (folder / MAIN).is_file():
            yield Example(folder.name, folder)
            continue
        for path in _inside(folder):
            if path.suffix == ".toml":
                yield Example(f"{folder.name}/{path.stem}", path)


def _inside(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.name not in ("__pycache__", ".DS_Store"))


def located(path: Path | str) -> Path | str:
    """Return the path that a name of an example stands for.

    Parameters
    ----------
    path : Path or str
        Path, or ``example:NAME``.

    Returns
    -------
    Path or str
        Path of the example, or the given path.

    Raises
    ------
    UnknownName
        No such example.
    """
    text = str(path)
    if not text.startswith(PREFIX):
        return path
    name, known = text.removeprefix(PREFIX), {example.name: example.path for example in examples()}
    if name in known:
        return known[name]
    of_folder = [other for other in known if other.startswith(f"{name}/")]
    if of_folder:
        raise UnknownName(
            f"the example {name!r} has several cases; name one: {', '.join(PREFIX + n for n in of_folder)}"
        )
    raise unknown_name("example", name, known)
