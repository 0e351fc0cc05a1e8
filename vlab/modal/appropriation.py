"""Force appropriation: forces and frequency that hold one mode alone.

The input is a matrix of frequency responses to several inputs.
"""

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from vlab.errors import BadRecording
from vlab.signals import Array, FrequencyResponse


@dataclass(frozen=True, kw_only=True, eq=False)
class AppropriatedForces:
    """In-phase or opposed forces with all displacements in quadrature.

    Parameters
    ----------
    hz : float
        Frequency of the smallest indicator [Hz].
    indicator : float
        Mode indicator: 0 for a pure mode, near 1 away from modes.
    forces : (n_inputs,) array
        Forces, the largest 1.
    inputs : tuple of str
        Inputs of the forces.
    """

    hz: float
    indicator: float
    forces: Array
    inputs: tuple[str, ...]


def mode_indicator(receptance: FrequencyResponse) -> tuple[Array, Array]:
    """Return the multivariate mode indicator functions and their forces [1]_.

    The real part of the displacements, relative to their norm, is minimised: Re(H)^H Re(H) f = lambda H^H H f. The
    smallest lambda dips towards 0 at every undamped natural frequency. The second smallest dips where two modes share a
    frequency.

    Parameters
    ----------
    receptance : FrequencyResponse
        Displacement (or acceleration) per force.

    Returns
    -------
    (n_lines, n_inputs) array, ascending in each line, and (n_lines, n_inputs, n_inputs) array
        lambda, and the forces of the k-th lambda in column k.

    References
    ----------
    .. [1] Williams, Crowley and Vold, "The multivariate mode indicator function in modal analysis", IMAC III, 1985.
    """
    values = np.empty((receptance.freq.size, len(receptance.inputs)))
    forces = np.empty((receptance.freq.size, values.shape[1], values.shape[1]))
    for i, H in enumerate(receptance.H):
        real, imaginary = H.real.T @ H.real, H.imag.T @ H.imag
        whole = real + imaginary
        floor = 1e-12 * np.trace(whole)  # regularises inputs without response at the line
        if floor == 0:
            raise BadRecording(f"all responses at {receptance.freq[i]:g} Hz are zero; no force can be appropriated")
        values[i], forces[i] = linalg.eigh(real, whole + floor * np.eye(len(whole)))
    return np.clip(values, 0.0, 1.0), forces


def appropriate(
    receptance: FrequencyResponse, near_hz: float, half_width_hz: float, *, shape: Array | None = None
) -> AppropriatedForces:
    """Return the forces that hold a mode near a frequency.

    Parameters
    ----------
    receptance : FrequencyResponse
        Displacement (or acceleration) per force.
    near_hz : float
        Expected frequency [Hz].
    half_width_hz : float
        Half width of the search [Hz].
    shape : (n_outputs,) array or None
        Shape of the wanted mode, which selects between close modes.

    Returns
    -------
    AppropriatedForces
        Forces, frequency and indicator.

    Raises
    ------
    BadRecording
        No line within the half width.
    """
    lines = np.flatnonzero(np.abs(receptance.freq - near_hz) <= half_width_hz)
    if lines.size == 0:
        raise BadRecording(f"no line within {half_width_hz:g} Hz of {near_hz:g} Hz; widen the search")
    part = receptance.between(receptance.freq[lines[0]], receptance.freq[lines[-1]])
    values, forces = mode_indicator(part)
    unlike = np.zeros_like(values)
    if shape is None:
        unlike[:, 1:] = np.inf
    else:
        held = np.einsum("foi,fik->fok", part.H.imag, forces)
        unlike = 1 - np.einsum("fok,o->fk", held, shape) ** 2 / (np.sum(held**2, axis=1) * (shape @ shape) + 1e-300)
    line, which = np.unravel_index(np.argmin(values + unlike), values.shape)
    chosen = forces[line, :, which]
    return AppropriatedForces(
        hz=float(part.freq[line]),
        indicator=float(values[line, which]),
        forces=chosen / chosen[np.argmax(np.abs(chosen))],
        inputs=receptance.inputs,
    )
