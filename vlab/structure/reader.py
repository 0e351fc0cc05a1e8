"""Reading structure files."""

from pathlib import Path

from vlab.errors import unknown_name
from vlab.files.assets import asset
from vlab.files.toml import Reader
from vlab.structure.model import Structure

BUILT_IN = ("beam", "grid")
"""Structures that come with vlab, by name."""


def load_structure(name_or_file: str | Path) -> Structure:
    """Load a structure by name (``"beam"``) or from a structure file.

    Raises
    ------
    UnknownName
        Neither a built-in name nor an existing file.
    BadStructure
        The file is malformed, a key is unknown or missing, a number has the wrong unit, no origin, or is not finite.
    """
    text = str(name_or_file)
    if text in BUILT_IN:
        path = asset(f"{text}.toml")
    else:
        path = Path(name_or_file)
        if not path.is_file():
            raise unknown_name("structure", text, [*BUILT_IN, "the path of a structure file"])
    reader = Reader(path)
    structure = reader.table(Structure, reader.load())
    object.__setattr__(structure, "provenance", dict(reader.provenance))
    return structure
