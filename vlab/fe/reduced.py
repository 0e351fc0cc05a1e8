"""Reduced models of a structure by name."""

from vlab.errors import BadStructure, unknown_name
from vlab.fe.assembly import build_fe_model
from vlab.fe.damping import modal_ratios
from vlab.fe.model import FeModel
from vlab.fe.reduction import exact_reduction, guyan_reduction
from vlab.structure.model import Structure

MODELS = ("full", "exact", "guyan")
"""The FE model itself, its exact reduction (3.4-3.8) and its Guyan reduction (3.9-3.16)."""


def build_reduced_model(structure: Structure, model: str = "full", variant: str = "published") -> FeModel:
    """Build the FE model of a structure in all coordinates, or in those that its file retains.

    Parameters
    ----------
    model : str
        One of `MODELS`. The exact reduction keeps as many of the lowest modes as coordinates. A Guyan model gets the
        structure's damping ratios again, for static condensation does not keep modal damping.

    Raises
    ------
    UnknownName
        No model of that name, or a retained coordinate that this variant does not have.
    BadStructure
        The structure file retains nothing.
    """
    if model not in MODELS:
        raise unknown_name("model", model, MODELS)
    fe = build_fe_model(structure, variant)
    if model == "full":
        return fe
    if structure.reduction is None:
        raise BadStructure(
            f"structure {structure.name!r} names no coordinates to retain; add [reduction] retained = [...]"
        )
    retained = structure.reduction.retained
    if model == "exact":
        exact = exact_reduction(fe.linear, retained, modes=range(len(retained)))
        return fe.with_coordinates(exact.model, exact.T)
    guyan = guyan_reduction(fe.linear, retained)
    reduced = fe.with_coordinates(guyan.model, guyan.T)
    zeta = modal_ratios(structure.damping, reduced.coils.T @ reduced.linear.eigen[1])
    return fe.with_coordinates(guyan.model.with_modal_damping(zeta), guyan.T)
