"""Reduced models of a structure by name."""

import numpy as np
from scipy.optimize import linear_sum_assignment

from vlab.errors import BadStructure, unknown_name
from vlab.fe.assembly import build_fe_model
from vlab.fe.correction import correct_model
from vlab.fe.measured_modes import measured_modes
from vlab.fe.model import FeModel
from vlab.fe.reduction import Reduction, exact_reduction, guyan_reduction
from vlab.fe.second_order import SecondOrderModel
from vlab.signals import Array
from vlab.structure.discretisation import Reduction as Retained
from vlab.structure.model import Structure

MODELS = ("full", "exact", "guyan", "corrected-guyan")
"""The FE model, its exact reduction (3.4-3.8), its Guyan reduction (3.9-3.16), and the Guyan reduction corrected to
measured modes (3.17-3.20)."""


def build_reduced_model(structure: Structure, model: str = "full", variant: str = "published") -> FeModel:
    """Build a structure's FE model, full or reduced.

    A reduced model has the coordinates that the structure file retains.

    Parameters
    ----------
    structure : Structure
        Structure with its points, bars and transducers.
    model : str
        Name in `MODELS`. The exact reduction keeps as many modes as coordinates, the lowest by default. Static
        condensation loses modal damping, so each mode of a Guyan model gets the ratio of its most similar full mode.
        The corrected model has the measured ratios.
    variant : str
        Variant of the full model.

    Returns
    -------
    FeModel
        FE model.

    Raises
    ------
    UnknownName
        No such model, or a retained coordinate is not in the variant.
    BadStructure
        The structure file retains nothing, or vlab has no measured modes of the structure.
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
    if model == "exact":
        return _exact(fe, structure.reduction)
    guyan = guyan_reduction(fe.linear, structure.reduction.retained)
    if model == "guyan":
        damped = guyan.model.with_modal_damping(fe.linear.zeta[_alike(fe.linear, guyan)])
    else:
        measured = measured_modes(structure.name)
        unmeasured = guyan.model.with_modal_damping(np.full(guyan.model.n, measured.others))
        damped = correct_model(unmeasured, measured.at(unmeasured.coordinates)).model
    return fe.with_coordinates(damped, guyan.T)


def _exact(fe: FeModel, choice: Retained) -> FeModel:
    retained = choice.exact or choice.retained
    modes = [mode - 1 for mode in choice.exact_modes] or range(len(retained))
    exact = exact_reduction(fe.linear, retained, modes=modes)
    return fe.with_coordinates(exact.model, exact.T)


def _alike(full: SecondOrderModel, reduction: Reduction) -> Array:
    """Return the full mode most similar to each reduced mode.

    The pairing is one to one, by the MAC in the full mass.
    """
    products = reduction.model.eigen[1].T @ reduction.T.T @ full.M @ full.eigen[1]
    return linear_sum_assignment(products**2, maximize=True)[1]
