"""Location of the files supplied with vlab."""

from pathlib import Path

from vlab.errors import UnknownName

_PACKAGE = Path(__file__).parents[1]
_CANDIDATES = (_PACKAGE / "_assets", _PACKAGE.parent / "assets")


def asset(name: str) -> Path:
    """Return the path of a file or folder under ``assets/``.

    The path is in a checkout or in an installed package.

    Parameters
    ----------
    name : str
        Path relative to ``assets/``.

    Returns
    -------
    Path
        Path.

    Raises
    ------
    UnknownName
        The file is missing.
    """
    for folder in _CANDIDATES:
        path = folder / name
        if path.exists():
            return path
    raise UnknownName(f"vlab's own file assets/{name} is missing; install vlab again or work from a complete checkout")
