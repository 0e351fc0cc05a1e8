"""Assignment of measured damping ratios and frequency factors to modes."""

from dataclasses import dataclass

import numpy as np

from vlab.signals import Array
from vlab.structure.discretisation import Tuning
from vlab.structure.model import Damping

SILENT = 1e-6
"""SILENT [1]: share of the largest mode's motion at the coils below which a mode cannot be driven, and was not
measured."""


NEAR = 0.1
"""NEAR [1]: relative change of frequency up to which a deviation leaves a mode the same; stated deviations are smaller."""


def driven_modes(at_coils: Array) -> Array:
    """Return the indices of coil-driven modes.

    Parameters
    ----------
    at_coils : (n_coils, n_modes) array
        Mass-normalised mode shapes at the coils.
    """
    motion = np.abs(at_coils).max(axis=0)
    return np.flatnonzero(motion > SILENT * motion.max())


@dataclass(frozen=True, eq=False)
class SilentModes:
    """Modes between the measured ones of a structure, at its points.

    Parameters
    ----------
    omega : (k,) array
        Natural frequencies [rad/s].
    at_points : (n_points, k) array
        Mode shapes at the points.
    """

    omega: Array
    at_points: Array

    def among(self, omega: Array, at_points: Array) -> Array:
        """Return the index of the mode most like each silent mode.

        Parameters
        ----------
        omega : (n_modes,) array
            Natural frequencies of a deviating structure [rad/s].
        at_points : (n_points, n_modes) array
            Mode shapes at the points.

        Returns
        -------
        (k,) array of int
            Modes of largest modal assurance criterion near the frequency.
        """
        sizes = np.sum(at_points**2, axis=0)
        shares = (self.at_points.T @ at_points) ** 2 / np.where(sizes > 0, sizes, np.inf)
        is_near = np.abs(omega / self.omega[:, None] - 1.0) < NEAR
        return np.asarray(np.where(is_near, shares, -1.0).argmax(axis=1))


NO_SILENT = SilentModes(np.zeros(0), np.zeros((0, 0)))
"""No silent modes."""


def measured_modes(at_coils: Array, omega: Array, at_points: Array, silent: SilentModes) -> Array:
    """Return the indices of the modes that a test of the structure measures.

    A deviation of one arm couples a silent mode of the symmetric structure, as of arms in opposition, to driven modes.
    The order of the measured modes does not count such a mode.

    Parameters
    ----------
    at_coils : (n_coils, n_modes) array
        Mass-normalised mode shapes at the coils.
    omega : (n_modes,) array
        Natural frequencies [rad/s].
    at_points : (n_points, n_modes) array
        Mode shapes at the points of the structure.
    silent : SilentModes
        Silent modes of the structure without deviations.

    Returns
    -------
    (n,) array of int
        Coil-driven modes without those most like a silent mode.
    """
    driven = driven_modes(at_coils)
    return np.setdiff1d(driven, silent.among(omega, at_points)) if silent.omega.size else driven


def modal_ratios(damping: Damping, measured: Array, count: int) -> Array:
    """Return the damping ratio of every mode in order.

    The measured ratios belong to the measured modes in order of frequency. Modes between (arms in opposition, bounce on
    the cables) and above get the ratio of the higher modes.

    Parameters
    ----------
    damping : Damping
        Measured ratios, and the ratio of higher modes.
    measured : (n,) array of int
        Measured modes, by `measured_modes`.
    count : int
        Number of modes.
    """
    return _of_measured(damping.ratios, damping.higher, measured, count)


def modal_factors(tuning: Tuning, measured: Array, count: int) -> Array:
    """Return the frequency factor of every mode.

    Modes that are not measured have factor one.

    Parameters
    ----------
    tuning : Tuning
        Factors of the first measured modes.
    measured : (n,) array of int
        Measured modes, by `measured_modes`.
    count : int
        Number of modes.
    """
    return _of_measured(tuning.frequencies, 1.0, measured, count)


def _of_measured(values: tuple[float, ...], others: float, measured: Array, count: int) -> Array:
    """Return one value for each mode.

    `values` belong to the measured modes in order of frequency; every further mode has the value `others`.
    """
    out = np.full(count, others)
    known = min(len(measured), len(values))
    out[measured[:known]] = values[:known]
    return out
