"""Force appropriation: which forces at which frequency hold one mode alone, from frequency responses to several inputs."""

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from vlab.errors import BadRecording
from vlab.signals import Array, FrequencyResponse


@dataclass(frozen=True, kw_only=True, eq=False)
class AppropriatedForces:
    """Forces in phase or in opposition under which all displacements are in quadrature.

    Parameters
    ----------
    hz : float
        Frequency at which that is best fulfilled [Hz].
    indicator : float
        The mode indicator there: 0 for a pure mode, near 1 away from modes.
    forces : (n_inputs,) array
        The largest is 1.
    inputs : tuple of str
        The inputs they belong to.
    """

    hz: float
    indicator: float
    forces: Array
    inputs: tuple[str, ...]


def mode_indicator(receptance: FrequencyResponse) -> tuple[Array, Array]:
    """Return the multivariate mode indicator functions and their forces [1]_.

    The real part of the displacements relative to all of them is made least: Re(H)^T Re(H) f = lambda H^H H f. The
    smallest lambda dips towards 0 at every undamped natural frequency, the second smallest where two modes share one.

    Parameters
    ----------
    receptance : FrequencyResponse
        Displacement (or acceleration) per force.

    Returns
    -------
    (n_lines, n_inputs) array, ascending in each line, and (n_lines, n_inputs, n_inputs) array
        lambda, and in column k the forces of the k-th.

    References
    ----------
    .. [1] Williams, Crowley and Vold, "The multivariate mode indicator function in modal analysis", IMAC III, 1985.
    """
    values = np.empty((receptance.freq.size, len(receptance.inputs)))
    forces = np.empty((receptance.freq.size, values.shape[1], values.shape[1]))
    for i, H in enumerate(receptance.H):
        real, imaginary = H.real.T @ H.real, H.imag.T @ H.imag
        whole = real + imaginary
        floor = 1e-12 * np.trace(whole)  # inputs that move nothing at this line
        if floor == 0:
            raise BadRecording(f"all responses at {receptance.freq[i]:g} Hz are zero; no force can be appropriated")
        values[i], forces[i] = linalg.eigh(real, whole + floor * np.eye(len(whole)))
    return np.clip(values, 0.0, 1.0), forces


def appropriate(
    receptance: FrequencyResponse, near_hz: float, half_width_hz: float, *, shape: Array | None = None
) -> AppropriatedForces:
    """Return the forces that hold the mode near a frequency.

    Parameters
    ----------
    shape : (n_outputs,) array or None
        Of the mode that is meant: it decides between modes so close that one frequency holds either.

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
