"""Control law as a file: ``controller.toml``.

`vlab design` writes the file, and `vlab experiment --law FILE` runs the law. Static gains are the matrix D of u = -D y
[N s/m] under `gains`. Any other linear law has the matrices of x+ = A x + B y, u = C x + D y and their rate. All values
are in SI: y in m/s, u in N.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from vlab.controllers.direct_rate_feedback import DirectRateFeedback
from vlab.controllers.linear import LinearLaw

from vlab.errors import BadController
from vlab.files.toml import Reader

FORMAT = "vlab-law-1"
"""Format name in every law file."""
Matrix = tuple[tuple[float, ...], ...]


@dataclass(frozen=True, kw_only=True)
class _LawFile:
    """Contents of a law file."""

    format: Literal["vlab-law-1"]
    sensors: tuple[str, ...]
    actuators: tuple[str, ...]
    law: str = ""
    structure: str = ""
    model: str = ""
    gains: Matrix | None = None
    rate_hz: float | None = None
    A: Matrix | None = None
    B: Matrix | None = None
    C: Matrix | None = None
    D: Matrix | None = None


def is_law_file(text: str) -> bool:
    """Return whether a name means a law file."""
    return text.endswith(".toml")


def write_law(
    law: DirectRateFeedback | LinearLaw, path: Path | str, *, name: str = "", structure: str = "", model: str = ""
) -> None:
    """Write a law to a file.

    Parameters
    ----------
    law : DirectRateFeedback or LinearLaw
        Static gains or linear law.
    path : Path or str
        Path of the file.
    name, structure, model : str
        Design name, structure and design model, as remarks.
    """
    lines = [
        "# Control law in SI: y in m/s, u in N.",
        f"format = {json.dumps(FORMAT)}",
        *(
            f"{key} = {json.dumps(text)}"
            for key, text in (("law", name), ("structure", structure), ("model", model))
            if text
        ),
        f"sensors = {json.dumps(law.sensors)}",
        f"actuators = {json.dumps(law.actuators)}",
    ]
    if isinstance(law, DirectRateFeedback):
        lines += ["# u = -gains y [N s/m]", f"gains = {_matrix(law.gains)}"]
    else:
        lines.append("# x+ = A x + B y, u = C x + D y")
        lines += [f"rate_hz = {law.rate!r}"] if law.rate is not None else []
        lines += [f"{key} = {_matrix(matrix)}" for key, matrix in zip("ABCD", law.matrices, strict=True)]
    Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")


def load_law(path: Path | str) -> DirectRateFeedback | LinearLaw:
    """Load a law from a file.

    Parameters
    ----------
    path : Path or str
        Law file.

    Returns
    -------
    DirectRateFeedback or LinearLaw
        Law.

    Raises
    ------
    BadController
        The file is missing or malformed, a key is unknown, or a matrix does not fit the channels.
    """
    reader = Reader(path, provenance_required=False, error=BadController)
    content = reader.table(_LawFile, reader.load())
    matrices = {key: getattr(content, key) for key in "ABCD"}
    given = [key for key, matrix in matrices.items() if matrix is not None]
    try:
        if content.gains is not None and not given:
            if content.rate_hz is not None:
                raise BadController("constant gains have no rate; leave rate_hz out")
            return DirectRateFeedback(content.gains, sensors=content.sensors, actuators=content.actuators)
        if content.gains is None and len(given) == 4:
            states = len(matrices["A"])
            shapes = {
                "A": (states, states),
                "B": (states, len(content.sensors)),
                "C": (len(content.actuators), states),
                "D": (len(content.actuators), len(content.sensors)),
            }
            A, B, C, D = (_shaped(matrices[key], shapes[key]) for key in "ABCD")
            return LinearLaw(A, B, C, D, sensors=content.sensors, actuators=content.actuators, rate=content.rate_hz)
    except BadController as error:
        raise BadController(f"{path}: {error}") from error
    raise BadController(
        f"{path}: a law has either gains or all of A, B, C, D; {given or ['nothing']} was given besides"
    )


def _shaped(matrix: Matrix, shape: tuple[int, int]) -> object:
    """Return an empty matrix in its shape.

    Nested lists cannot express the shape of an empty matrix. Any other matrix is returned unchanged.
    """
    return np.zeros(shape) if 0 in shape else matrix


def _matrix(matrix: np.ndarray) -> str:
    rows = [f"    {json.dumps(row)}," for row in matrix.tolist()]
    return "\n".join(["[", *rows, "]"]) if rows else "[]"
