"""Reader of structure files."""

from pathlib import Path

from vlab.errors import unknown_name
from vlab.files.assets import asset
from vlab.files.toml import Reader
from vlab.structure.model import Structure

BUILT_IN = ("beam", "grid")
"""Names of the structures supplied with vlab."""


def load_structure(name_or_file: str | Path) -> Structure:
    """Load a structure by name or file.

    Parameters
    ----------
    name_or_file : str or Path
        Name such as ``"beam"``, or path of a structure file.

    Returns
    -------
    Structure
        Structure.

    Raises
    ------
    UnknownName
        The text is neither a built-in name nor an existing file.
    BadStructure
        The file is malformed, a key is unknown or missing, or a number has a wrong unit, no origin or a nonfinite
        value.
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
