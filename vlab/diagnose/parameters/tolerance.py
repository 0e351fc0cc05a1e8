"""Linear effects within what a case states as uncertain.

One factor stands for the mass of many parts, which differ from each other by as much. A small mass at one part is therefore
no missing physics, although the factor cannot take it up.
"""

from collections.abc import Sequence

import numpy as np

from vlab.diagnose.parameters.mjcf import Uncertain
from vlab.diagnose.parameters.reduced_model import ReducedModel
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.settings import TOLERANCE
from vlab.physics.effect import LinearPortEffect

KINDS = ("mass", "damping", "stiffness")
"""KINDS [-]: kinds of uncertain parameters, in the order of mass, damping and stiffness matrix."""


def is_within_tolerance(term: Term, reduced_model: ReducedModel, parameters: Sequence[Uncertain]) -> bool:
    """Return whether a linear effect changes no mode by more than its stated uncertainty.

    Parameters
    ----------
    term : Term
        Effect at a location.
    reduced_model : ReducedModel
        Reduced model.
    parameters : sequence of Uncertain
        Uncertain parameters with their prior standard deviations.

    Returns
    -------
    bool
        Whether modal masses, damping and stiffnesses all stay within the tolerance; false for other effects.
    """
    if not isinstance(term.effect, LinearPortEffect):
        return False
    moved = np.sum(term.place.rows**2, axis=0)
    impedance = term.effect.impedance(term.values, term.place.stiffness)
    for kind, change, own in zip(KINDS, impedance, (reduced_model.M, reduced_model.C, reduced_model.K), strict=True):
        sd = max((p.sd for p in parameters if p.kind == kind), default=0.0)
        if np.any(np.abs(change) * moved > TOLERANCE.most * sd * np.abs(np.diag(own))):
            return False
    return True
