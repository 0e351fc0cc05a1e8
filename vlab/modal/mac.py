"""Comparison of mode shapes: MAC, COMAC, pairing, orthogonality."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import linear_sum_assignment

from vlab.errors import BadRecording
from vlab.signals import Array, ModalModel

FREQUENCY_TIE_BREAK = 1e-3
"""FREQUENCY_TIE_BREAK [1]: MAC equivalent of a frequency ratio of e in the pairing. The small value decides only
between similar shapes."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ModePairing:
    """Pairing of the modes of two models.

    Parameters
    ----------
    a, b : (n,) int arrays
        Mode indices of the first and second model, ascending in `a`.
    mac : (n,) array
        MAC of each pair at the common coordinates.
    freq_error : (n,) array
        Relative deviation of the frequency in `b` from the frequency in `a`.
    coordinates : tuple of str
        Common coordinates.
    """

    a: NDArray[np.int_]
    b: NDArray[np.int_]
    mac: Array
    freq_error: Array
    coordinates: tuple[str, ...]


def mac(a: ArrayLike, b: ArrayLike) -> Array:
    """Return the modal assurance criterion (MAC) of shape columns.

    MAC = |a^H b|^2 / ((a^H a)(b^H b)) [1]_.

    Parameters
    ----------
    a, b : (n_coordinates, n_modes) real or complex array
        Shapes at the same coordinates in the same order; scale and phase of a column have no influence.

    Returns
    -------
    (n_modes_a, n_modes_b) array
        Between 0 (orthogonal) and 1 (proportional).

    References
    ----------
    .. [1] R. J. Allemang and D. L. Brown, A correlation coefficient for modal vector analysis, Proc. 1st International
           Modal Analysis Conference (IMAC), 1982, 110-116.
    """
    left, right = _unit_columns(a, "a"), _unit_columns(b, "b")
    if len(left) != len(right):
        raise BadRecording(f"shapes at {len(left)} and {len(right)} coordinates cannot be compared; select common ones")
    return np.minimum(np.abs(left.conj().T @ right) ** 2, 1.0)


def comac(a: ArrayLike, b: ArrayLike) -> Array:
    """Return the coordinate MAC of paired modes.

    COMAC_i = (sum_k |a_ik b_ik|)^2 / (sum_k |a_ik|^2 sum_k |b_ik|^2) [1]_.

    Parameters
    ----------
    a, b : (n_coordinates, n_modes) real or complex array
        Paired shapes, column by column (see `match_modes`). Columns are scaled to unit length.

    Returns
    -------
    (n_coordinates,) array
        Between 0 and 1; 1 at a coordinate with zero motion in all modes.

    References
    ----------
    .. [1] Lieven and Ewins, "Spatial correlation of mode shapes: the coordinate modal assurance criterion", IMAC VI,
       1988.
    """
    left, right = _unit_columns(a, "a"), _unit_columns(b, "b")
    if left.shape != right.shape:
        raise BadRecording(f"COMAC needs paired shapes of one size, not {left.shape} and {right.shape}")
    both = np.sum(np.abs(left * right.conj()), axis=1) ** 2
    power = np.sum(np.abs(left) ** 2, axis=1) * np.sum(np.abs(right) ** 2, axis=1)
    agree = np.divide(both, power, out=np.zeros_like(both), where=power > 0)
    agree[np.all(left == 0, axis=1) & np.all(right == 0, axis=1)] = 1.0
    return np.minimum(agree, 1.0)


def match_modes(model_a: ModalModel, model_b: ModalModel, *, min_mac: float = 0.0) -> ModePairing:
    """Pair the modes of two models by the largest sum of MACs.

    Parameters
    ----------
    model_a, model_b : ModalModel
        Models with at least 2 common coordinates, in any order.
    min_mac : float
        Smallest MAC of a pair.

    Returns
    -------
    ModePairing
        At most as many pairs as the smaller model has modes.
    """
    common = [name for name in model_a.coordinates if name in model_b.coordinates]
    if len(common) < 2:
        raise BadRecording(
            f"the models have {len(common)} coordinates in common; with fewer than 2 every MAC is 1 "
            f"(a: {', '.join(model_a.coordinates)}; b: {', '.join(model_b.coordinates)})"
        )
    rows_a, rows_b = ([model.coordinates.index(n) for n in common] for model in (model_a, model_b))
    alike = mac(model_a.shapes[rows_a], model_b.shapes[rows_b])
    apart = np.abs(np.log(model_b.freq[None, :] / model_a.freq[:, None]))
    a, b = linear_sum_assignment(alike - FREQUENCY_TIE_BREAK * apart, maximize=True)
    keep = alike[a, b] >= min_mac
    a, b = a[keep], b[keep]
    return ModePairing(
        a=a,
        b=b,
        mac=alike[a, b],
        freq_error=model_b.freq[b] / model_a.freq[a] - 1.0,
        coordinates=tuple(common),
    )


def orthogonality(shapes: ArrayLike, M: ArrayLike) -> NDArray[Any]:
    """Return shapes^H M shapes with unit modal masses.

    For orthogonal shapes the off-diagonal terms vanish.

    Parameters
    ----------
    shapes : (n_coordinates, n_modes) real or complex array
        Mode shapes.
    M : (n_coordinates, n_coordinates) array
        Mass matrix at the shapes' coordinates.

    Returns
    -------
    (n_modes, n_modes) array
        Matrix with unit diagonal.
    """
    phi, mass = np.asarray(shapes), np.asarray(M, dtype=float)
    if phi.ndim != 2 or mass.shape != (len(phi), len(phi)):
        raise BadRecording(f"shapes of {phi.shape} do not fit a mass matrix of {mass.shape}")
    product = phi.conj().T @ mass @ phi
    modal_mass = np.diag(product).real
    if np.any(modal_mass <= 0):
        worst = int(np.argmin(modal_mass))
        raise BadRecording(f"mode {worst} has the modal mass {modal_mass[worst]:g}; M must be positive definite")
    scale = np.sqrt(modal_mass)
    return product / scale[:, None] / scale[None, :]


def _unit_columns(shapes: ArrayLike, name: str) -> NDArray[Any]:
    out = np.asarray(shapes)
    if out.ndim != 2 or not np.all(np.isfinite(out)):
        raise BadRecording(f"shapes {name} must be a finite array (coordinate, mode), not of shape {out.shape}")
    length = np.linalg.norm(out, axis=0)
    if np.any(length == 0):
        raise BadRecording(f"mode {int(np.argmin(length))} of shapes {name} is zero everywhere; it has no direction")
    return out / length
