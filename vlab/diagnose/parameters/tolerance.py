"""Linear effects within what a case states as uncertain.

One factor stands for the mass of many parts, which differ from each other by as much. A small mass at one part is therefore
no missing physics, although the factor cannot take it up.
"""

from collections.abc import Sequence

import numpy as np

from vlab.diagnose.parameters.geometry import LENGTH
from vlab.diagnose.parameters.reduced_model import ReducedModel
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.settings import TOLERANCE
from vlab.physics.effect import LinearPortEffect
from vlab.signals import Array


def modal_tolerances(reduced_model: ReducedModel) -> tuple[Array, Array, Array]:
    """Return the tolerances of modal mass, damping and stiffness.

    The standard deviations of all uncertain parameters combine in quadrature. A length changes mass and stiffness together,
    unlike a linear effect, and does not count.

    Parameters
    ----------
    reduced_model : ReducedModel
        Reduced model with its uncertain parameters.

    Returns
    -------
    tuple of (m,) arrays
        Largest changes of every mode within the statement.
    """
    slopes = reduced_model.slopes(np.zeros(len(reduced_model.prior)))
    out = np.zeros((3, reduced_model.m))
    for change, matrices in zip(reduced_model.changes, slopes, strict=True):
        sd = 0.0 if change.name.rpartition(":")[2] == LENGTH else change.sd
        for total, matrix in zip(out, matrices, strict=True):
            if matrix is not None:
                total += (sd * np.diag(matrix)) ** 2
    mass, damping, stiffness = TOLERANCE.most * np.sqrt(out)
    return mass, damping, stiffness


def is_within_tolerance(term: Term, tolerances: Sequence[Array]) -> bool:
    """Return whether a linear effect is within the tolerances of all modes.

    Parameters
    ----------
    term : Term
        Effect at a location.
    tolerances : sequence of (m,) arrays
        Tolerances of modal mass, damping and stiffness.

    Returns
    -------
    bool
        Whether modal masses, damping and stiffnesses all stay within the tolerances; false for other effects.
    """
    if not isinstance(term.effect, LinearPortEffect):
        return False
    moved = np.sum(term.place.rows**2, axis=0)
    impedance = term.effect.impedance(term.values, term.place.stiffness)
    pairs = zip(impedance, tolerances, strict=True)
    return not any(np.any(np.abs(change) * moved > most) for change, most in pairs)
