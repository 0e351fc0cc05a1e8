"""Construction of plants by name."""

from collections.abc import Callable

from vlab.errors import unknown_name
from vlab.fe import build_fe_model
from vlab.plants.base import Plant
from vlab.plants.composite import build_composite
from vlab.plants.fe_matrices import build_fe_plant
from vlab.plants.grillage import build_grillage
from vlab.plants.linear import build_linear
from vlab.plants.modal import build_modal
from vlab.structure.model import Structure

PLANTS: dict[str, Callable[[Structure, str], Plant]] = {
    "composite": lambda structure, variant: _build_native(structure, variant),
    "fe": lambda structure, variant: build_fe_plant(build_fe_model(structure, variant)),
    "linear": lambda structure, variant: build_linear(build_fe_model(structure, variant)),
    "modal": lambda structure, variant: build_modal(build_fe_model(structure, variant)),
}
"""Builders of a structure's plants by name."""
STEPPED = ("composite", "fe", "modal")
"""STEPPED [-]: plants that MuJoCo itself steps, and that its steps can therefore check against the FE model."""


def _build_native(structure: Structure, variant: str) -> Plant:
    """Build the physical plant.

    The structure is a grid under a carrying bar, or a bar between cables.
    """
    if any(bar.carries for bar in structure.bar):
        return build_grillage(structure, variant)
    return build_composite(structure, variant)


def build_plant(structure: Structure, plant: str = "composite", variant: str = "published") -> Plant:
    """Build a plant of a structure by name.

    Parameters
    ----------
    structure : Structure
        Structure with its points, bars and transducers.
    plant : str
        Name in `PLANTS`.
    variant : str
        Name of the structure's variant.

    Raises
    ------
    UnknownName
        No such plant.
    """
    if plant not in PLANTS:
        raise unknown_name("plant", plant, PLANTS)
    return PLANTS[plant](structure, variant)
