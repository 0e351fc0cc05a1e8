"""Measured modes supplied with vlab, for the correction of reduced models."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from vlab.errors import BadStructure, UnknownName
from vlab.files.assets import asset
from vlab.files.toml import Reader, number
from vlab.signals import ModalModel


@dataclass(frozen=True, kw_only=True)
class MeasuredDisplacement:
    """A displacement coordinate with its deflection in every mode.

    Deflections are relative to the largest of the mode.
    """

    coordinate: str
    shape: tuple[float, ...] = number("1")


@dataclass(frozen=True, kw_only=True)
class MeasuredRotation:
    """A rotation coordinate with its angle in every mode.

    Angles [rad] are per largest deflection [m].
    """

    coordinate: str
    shape: tuple[float, ...] = number("1/m")


@dataclass(frozen=True, kw_only=True)
class MeasuredModes:
    """Contents of ``assets/identified/<structure>_modes.toml``.

    Every number has its origin.

    Parameters
    ----------
    frequencies, ratios : tuple of float
        Natural frequencies [Hz] and damping ratios, one a mode.
    others : float
        Damping ratio of the modes without measured shapes.
    """

    format: Literal["vlab-measured-modes-1"]
    structure: str
    title: str
    frequencies: tuple[float, ...] = number("Hz", positive=True)
    ratios: tuple[float, ...] = number("1", at_least=0.0)
    others: float = number("1", at_least=0.0)
    displacement: tuple[MeasuredDisplacement, ...]
    rotation: tuple[MeasuredRotation, ...] = ()

    def at(self, coordinates: tuple[str, ...]) -> ModalModel:
        """Return the modes at given coordinates.

        Parameters
        ----------
        coordinates : tuple of str
            Labels in the wanted order.

        Returns
        -------
        ModalModel
            Frequencies, ratios and shapes.

        Raises
        ------
        BadStructure
            A coordinate was not measured.
        """
        rows = {part.coordinate: part.shape for part in self.displacement}
        rows |= {part.coordinate: part.shape for part in self.rotation}
        missing = [label for label in coordinates if label not in rows]
        if missing:
            raise BadStructure(f"{self.title}: no shapes at {', '.join(missing)} (there are {', '.join(rows)})")
        return ModalModel(
            freq=np.array(self.frequencies),
            zeta=np.array(self.ratios),
            shapes=np.array([rows[label] for label in coordinates]),
            coordinates=coordinates,
        )


def measured_modes(structure: str) -> MeasuredModes:
    """Load the measured modes of a structure.

    Parameters
    ----------
    structure : str
        Name of the structure.

    Returns
    -------
    MeasuredModes
        Modes.

    Raises
    ------
    BadStructure
        vlab has no measured modes of the structure, or the file is malformed.
    """
    try:
        path = asset(f"identified/{structure}_modes.toml")
    except UnknownName as error:
        raise BadStructure(f"no measured modes of structure {structure!r} come with vlab; give your own") from error
    reader = Reader(path)
    return reader.table(MeasuredModes, reader.load())
