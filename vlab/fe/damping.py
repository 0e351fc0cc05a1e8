"""Which measured damping ratio, and which factor on a frequency, belongs to which mode of a model."""

import numpy as np

from vlab.signals import Array
from vlab.structure.model import Damping, Tuning

SILENT = 1e-6
"""A mode whose motion at every coil is below this share of the largest mode's was not measured: it cannot be driven."""


def driven_modes(at_coils: Array) -> Array:
    """Return the indices of the modes that the coils can drive.

    Parameters
    ----------
    at_coils : (n_coils, n_modes) array
        Mass-normalised mode shapes at the coils.
    """
    motion = np.abs(at_coils).max(axis=0)
    return np.flatnonzero(motion > SILENT * motion.max())


def modal_ratios(damping: Damping, at_coils: Array) -> Array:
    """Return the damping ratio of every mode of a model, in its order.

    The measured ratios belong to the modes that the coils can drive, in order of frequency. A model may have others in
    between (arms that swing against each other, the bounce on the cables); they and the modes above the measured ones
    get the ratio of the higher modes.

    Parameters
    ----------
    at_coils : (n_coils, n_modes) array
        Mass-normalised mode shapes at the coils.
    """
    return _of_driven(damping.ratios, damping.higher, at_coils)


def modal_factors(tuning: Tuning, at_coils: Array) -> Array:
    """Return the factor on the frequency of every mode of a model; those that the coils do not drive have one.

    Parameters
    ----------
    at_coils : (n_coils, n_modes) array
        Mass-normalised mode shapes at the coils.
    """
    return _of_driven(tuning.frequencies, 1.0, at_coils)


def _of_driven(values: tuple[float, ...], others: float, at_coils: Array) -> Array:
    """Return the values of the modes that the coils drive, in order of frequency, and one value for all others."""
    driven = driven_modes(at_coils)
    out = np.full(at_coils.shape[1], others)
    count = min(len(driven), len(values))
    out[driven[:count]] = values[:count]
    return out
