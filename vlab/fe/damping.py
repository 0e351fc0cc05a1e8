"""Assignment of measured damping ratios and frequency factors to modes."""

import numpy as np

from vlab.signals import Array
from vlab.structure.discretisation import Tuning
from vlab.structure.model import Damping

SILENT = 1e-6
"""SILENT [1]: share of the largest mode's motion at the coils below which a mode cannot be driven, and was not
measured."""


def driven_modes(at_coils: Array) -> Array:
    """Return the indices of coil-driven modes.

    Parameters
    ----------
    at_coils : (n_coils, n_modes) array
        Mass-normalised mode shapes at the coils.
    """
    motion = np.abs(at_coils).max(axis=0)
    return np.flatnonzero(motion > SILENT * motion.max())


def modal_ratios(damping: Damping, at_coils: Array) -> Array:
    """Return the damping ratio of every mode in order.

    The measured ratios belong to the coil-driven modes in order of frequency. Modes between (arms in opposition, bounce
    on the cables) and above get the ratio of the higher modes.

    Parameters
    ----------
    damping : Damping
        Measured ratios, and the ratio of higher modes.
    at_coils : (n_coils, n_modes) array
        Mass-normalised mode shapes at the coils.
    """
    return _of_driven(damping.ratios, damping.higher, at_coils)


def modal_factors(tuning: Tuning, at_coils: Array) -> Array:
    """Return the frequency factor of every mode.

    Modes that the coils do not drive have factor one.

    Parameters
    ----------
    tuning : Tuning
        Factors of the first coil-driven modes.
    at_coils : (n_coils, n_modes) array
        Mass-normalised mode shapes at the coils.
    """
    return _of_driven(tuning.frequencies, 1.0, at_coils)


def _of_driven(values: tuple[float, ...], others: float, at_coils: Array) -> Array:
    """Return one value for each mode.

    `values` belong to the coil-driven modes in order of frequency; every further mode has the value `others`.
    """
    driven = driven_modes(at_coils)
    out = np.full(at_coils.shape[1], others)
    count = min(len(driven), len(values))
    out[driven[:count]] = values[:count]
    return out
