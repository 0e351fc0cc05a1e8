"""Model correction by Baruch's reference basis method, equations (3.17)-(3.20).

The measured frequencies, ratios and shapes become exact modes of the corrected model [1]_ [2]_. The mass change is the
smallest that makes the shapes orthonormal. The stiffness change is then the smallest that gives the measured modes.
Both changes are measured as |M^-1/2 (.) M^-1/2|, with the model's mass and the corrected mass. A correction is no
diagnosis: it does not locate the wrong part.

References
----------
.. [1] M. Baruch and I. Y. Bar-Itzhack, Optimal weighted orthogonalization of measured modes, AIAA Journal 16 (1978)
       346-351.
.. [2] M. Baruch, Optimal correction of mass and stiffness matrices using measured modes, AIAA Journal 20 (1982)
       1623-1626.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg
from scipy.optimize import linear_sum_assignment

from vlab.errors import BadRecording, BadStructure, unknown_name
from vlab.fe.second_order import SecondOrderModel
from vlab.signals import Array, ModalModel

DEPENDENT = 1e-8
"""DEPENDENT [1]: smallest eigenvalue of the orthogonality matrix of independent shapes, where half of the digits
remain."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Correction:
    """A corrected model with measures of the change.

    Parameters
    ----------
    model, uncorrected : SecondOrderModel
        Model after and before the correction.
    shapes : (n, p) array
        Measured shapes in the model's coordinate order, with unit modal mass in the uncorrected model (3.17).
    orthogonality : (p, p) array
        shapes^T M shapes before the correction (Tables 4 and 6); the identity means no mass change.
    mass_change, stiffness_change, damping_change : float
        Relative Frobenius norm of M^-1/2 (new - old) M^-1/2, with the uncorrected mass. The norm is independent of the
        coordinates' units.
    origin : (p,) int array
        Uncorrected mode most similar to each measured mode, one to one.
    tracked : (n,) array
        Corrected frequency [Hz] of each uncorrected mode, paired by shape.
    """

    model: SecondOrderModel
    uncorrected: SecondOrderModel
    shapes: Array
    orthogonality: Array
    mass_change: float
    stiffness_change: float
    damping_change: float
    origin: Array
    tracked: Array

    @property
    def others(self) -> Array:
        """Uncorrected modes without a measured partner, ascending."""
        return np.setdiff1d(np.arange(self.model.n), self.origin)

    @property
    def shift(self) -> Array:
        """Frequency change of every uncorrected mode [Hz]."""
        return self.tracked - self.uncorrected.freq

    @property
    def off_diagonal(self) -> tuple[float, float]:
        """Largest and mean absolute off-diagonal of the orthogonality matrix.

        Both are zero for one mode.
        """
        values = np.abs(self.orthogonality[~np.eye(len(self.orthogonality), dtype=bool)])
        return (float(values.max()), float(values.mean())) if values.size else (0.0, 0.0)


def normalise_shapes(shapes: ArrayLike, M: ArrayLike) -> Array:
    """Return shapes of unit modal mass: equation (3.17).

    Signs are kept.

    Parameters
    ----------
    shapes : (n, p) array
        Real mode shapes as columns, at all coordinates of M.
    M : (n, n) array
        Symmetric, positive definite.

    Returns
    -------
    array
        Scaled shapes, (n, p).

    Raises
    ------
    BadRecording
        The shapes are complex, not finite, zero, of wrong length, more than coordinates, or linearly dependent.
    BadStructure
        M is no mass matrix.
    """
    mass, given = _mass(M), np.asarray(shapes)
    if np.iscomplexobj(given):
        if np.any(given.imag != 0):
            raise BadRecording(
                "the shapes are complex; the correction needs real ones, for example real_shapes() of a fit"
            )
        given = given.real
    phi = np.asarray(given, dtype=float)
    if phi.ndim != 2 or len(phi) != len(mass):
        raise BadRecording(f"shapes of {phi.shape} do not fit a mass matrix of {mass.shape}: one row a coordinate")
    n, count = phi.shape
    if not 1 <= count <= n:
        raise BadRecording(f"{count} measured modes for a model of {n} coordinates; 1 to {n} can be corrected to")
    if not np.all(np.isfinite(phi)):
        row, column = (int(i) for i in np.argwhere(~np.isfinite(phi))[0])
        raise BadRecording(f"measured mode {column} is {phi[row, column]} at coordinate {row}; shapes must be finite")
    length = np.abs(phi).max(axis=0)
    if np.any(length == 0):
        raise BadRecording(f"measured mode {int(np.argmin(length))} is zero everywhere; it has no direction")
    phi = phi / length
    phi = phi / np.sqrt(np.einsum("ij,ik,kj->j", phi, mass, phi))
    values, vectors = linalg.eigh(phi.T @ mass @ phi)
    if values[0] <= DEPENDENT:
        share = np.abs(vectors[:, 0])
        mixed = ", ".join(str(k) for k in np.flatnonzero(share > 0.1 * share.max()))
        raise BadRecording(f"the shapes of measured modes {mixed} are linearly dependent; leave one of them out")
    return phi


def correct_mass(M: ArrayLike, shapes: ArrayLike) -> Array:
    """Return the nearest mass with orthonormal shapes: equation (3.18).

    Parameters
    ----------
    M : (n, n) array
        Symmetric, positive definite mass matrix.
    shapes : (n, p) array
        Shapes scaled by `normalise_shapes`; the scale matters.

    Returns
    -------
    array
        Corrected mass, symmetric positive definite, (n, n).
    """
    mass, phi = _mass(M), np.asarray(shapes, dtype=float)
    normalise_shapes(phi, mass)  # raises for unusable shapes
    gram = phi.T @ mass @ phi
    spread = linalg.solve(gram, phi.T @ mass, assume_a="pos")
    return _symmetric(mass - spread.T @ (gram - np.eye(len(gram))) @ spread)


def correct_stiffness(K: ArrayLike, M_corrected: ArrayLike, shapes: ArrayLike, freq_hz: ArrayLike) -> Array:
    """Return the nearest stiffness with the measured modes.

    Equation (3.19) with its last m_R corrected: K_c = P^T K P + M Phi Omega^2 Phi^T M with P = I - Phi Phi^T M and the
    corrected M throughout. The printed form is not symmetric and has other frequencies.

    Parameters
    ----------
    K : (n, n) array
        Symmetric.
    M_corrected : (n, n) array
        Result of `correct_mass`.
    shapes : (n, p) array
        Orthonormal in `M_corrected`.
    freq_hz : (p,) array
        Measured undamped frequencies [Hz].

    Returns
    -------
    array
        Corrected stiffness, symmetric, (n, n).
    """
    mass, phi = _orthonormal(M_corrected, shapes)
    stiffness = np.asarray(K, dtype=float)
    if stiffness.shape != mass.shape or not np.all(np.isfinite(stiffness)):
        raise BadStructure(f"K of shape {stiffness.shape} is not a finite {len(mass)} x {len(mass)} matrix")
    omega = 2 * np.pi * _frequencies(freq_hz, phi.shape[1])
    momenta = mass @ phi
    P = np.eye(len(mass)) - phi @ momenta.T
    return _symmetric(P.T @ stiffness @ P + (momenta * omega**2) @ momenta.T)


def correct_damping(
    M_corrected: ArrayLike,
    K_corrected: ArrayLike,
    shapes: ArrayLike,
    freq_hz: ArrayLike,
    zeta: ArrayLike,
    *,
    zeta_rest: ArrayLike,
) -> Array:
    """Return C = M Phi diag(2 zeta omega) Phi^T M over all modes.

    The symmetric form of (3.20) covers the measured and the remaining modes of the corrected (K, M). Remaining modes
    keep the ratios `zeta_rest`. C couples no modes.

    Parameters
    ----------
    M_corrected, K_corrected : (n, n) arrays
        Results of `correct_mass` and `correct_stiffness`.
    shapes, freq_hz, zeta : (n, p), (p,) and (p,) arrays
        Measured modes, with shapes orthonormal in `M_corrected`.
    zeta_rest : (n - p,) array or float
        Ratios of the remaining modes, by frequency.

    Returns
    -------
    array
        Corrected damping, symmetric, (n, n).
    """
    mass, phi = _orthonormal(M_corrected, shapes)
    n, count = phi.shape
    omega, rest = _remaining(mass, np.asarray(K_corrected, dtype=float), phi)
    omega = np.concatenate([2 * np.pi * _frequencies(freq_hz, count), omega])
    inherent = np.asarray(zeta_rest, dtype=float)
    if inherent.ndim == 0:
        inherent = np.full(n - count, inherent)
    ratios = np.concatenate(
        [_measured("damping ratios", zeta, count), _measured("damping ratios of the rest", inherent, n - count)]
    )
    momenta = mass @ np.hstack([phi, rest])
    return _symmetric((momenta * (2 * ratios * np.abs(omega))) @ momenta.T)


def correct_model(
    model: SecondOrderModel, measured: ModalModel, *, coordinates: Mapping[str, str] | None = None
) -> Correction:
    """Correct a model to measured modes: (3.17)-(3.20).

    Every uncorrected mode is paired one to one with the corrected mode of most similar shape (MAC weighted with the
    mass). An unmeasured mode keeps the ratio of its partner.

    Parameters
    ----------
    model : SecondOrderModel
        Model reduced to the measured coordinates, see `vlab.fe.reduction`.
    measured : ModalModel
        Real shapes at every coordinate of the model, in any order, scale and sign.
    coordinates : mapping of str to str or None
        Model coordinate of each measured one; measured coordinates without entry are unused. None if all labels agree.

    Raises
    ------
    UnknownName
        A label that the model or the measurement does not have.
    BadRecording
        A coordinate was not measured, or the modes are unusable, see `normalise_shapes`.
    """
    count = measured.freq.size
    freq, zeta = _frequencies(measured.freq, count), _measured("damping ratios", measured.zeta, count)
    rows = _measured_rows(model, measured, coordinates)
    return _corrected(model, normalise_shapes(measured.shapes[rows], model.M), freq, zeta)


def correct_sequentially(
    model: SecondOrderModel, measured: ModalModel, *, coordinates: Mapping[str, str] | None = None
) -> list[Correction]:
    """Correct to the first measured modes, adding one a step (section 3.3).

    Each step starts from the uncorrected model. The change of `tracked` from step to step shows whether the model suits
    the method: for a good model the unused modes stay or improve. The last step equals `correct_model`. Correcting the
    preceding step with shapes of the same scale would give the same matrices.

    Parameters
    ----------
    model : SecondOrderModel
        Model reduced to the measured coordinates.
    measured : ModalModel
        Real shapes at every coordinate of the model.
    coordinates : mapping of str to str or None
        Model coordinate of each measured one, see `correct_model`.

    Returns
    -------
    list of Correction
        One a measured mode, in the order of `measured`.
    """
    last = correct_model(model, measured, coordinates=coordinates)
    steps = [
        _corrected(model, last.shapes[:, :k], measured.freq[:k], measured.zeta[:k])
        for k in range(1, measured.freq.size)
    ]
    return [*steps, last]


def _corrected(model: SecondOrderModel, phi: Array, freq: Array, zeta: Array) -> Correction:
    count = phi.shape[1]
    mass = correct_mass(model.M, phi)
    stiffness = correct_stiffness(model.K, mass, phi, freq)
    omega, rest = _remaining(mass, stiffness, phi)
    # MAC between modes before and after, orthonormal in the mass before
    after = np.hstack([phi, rest])
    alike = (model.eigen[1].T @ model.M @ after) ** 2 / np.einsum("ij,ik,kj->j", after, model.M, after)
    before, now = linear_sum_assignment(alike, maximize=True)
    partner = before[np.argsort(now)]
    tracked = np.empty(model.n)
    tracked[partner] = np.concatenate([freq, omega / (2 * np.pi)])
    damping = correct_damping(mass, stiffness, phi, freq, zeta, zeta_rest=model.zeta[partner[count:]])
    new = replace(model, M=mass, K=stiffness, C=damping)
    return Correction(
        model=new,
        uncorrected=model,
        shapes=phi,
        orthogonality=phi.T @ model.M @ phi,
        mass_change=_change(model, model.M, new.M),
        stiffness_change=_change(model, model.K, new.K),
        damping_change=_change(model, model.C, new.C),
        origin=partner[:count],
        tracked=tracked,
    )


def _measured_rows(model: SecondOrderModel, measured: ModalModel, coordinates: Mapping[str, str] | None) -> list[int]:
    for label in measured.coordinates:
        if measured.coordinates.count(label) > 1:
            raise BadRecording(f"the measured coordinate {label!r} stands {measured.coordinates.count(label)} times")
    names = dict(coordinates) if coordinates is not None else {label: label for label in measured.coordinates}
    source: dict[str, str] = {}
    for label, name in names.items():
        if label not in measured.coordinates:
            raise unknown_name("measured coordinate", label, measured.coordinates)
        if name not in model.coordinates:
            raise unknown_name("coordinate of the model", name, model.coordinates)
        if name in source:
            raise BadRecording(f"{source[name]!r} and {label!r} are both mapped to the model's coordinate {name!r}")
        source[name] = label
    missing = [name for name in model.coordinates if name not in source]
    if missing:
        raise BadRecording(
            f"not measured: {', '.join(missing)}; reduce the model to the measured coordinates first (guyan_reduction)"
        )
    return [measured.coordinates.index(source[name]) for name in model.coordinates]


def _mass(M: ArrayLike) -> Array:
    mass = np.asarray(M, dtype=float)
    if mass.ndim != 2 or mass.shape[0] != mass.shape[1] or not np.all(np.isfinite(mass)):
        raise BadStructure(f"M of shape {mass.shape} is not a finite square matrix")
    if not np.allclose(mass, mass.T, rtol=0, atol=1e-6 * np.abs(mass).max(initial=1e-300)):
        raise BadStructure("M is not symmetric")
    try:
        linalg.cholesky(mass)
    except linalg.LinAlgError as error:
        raise BadStructure("M is not positive definite: a coordinate carries no mass") from error
    return mass


def _orthonormal(M: ArrayLike, shapes: ArrayLike) -> tuple[Array, Array]:
    mass, phi = _mass(M), np.asarray(shapes, dtype=float)
    normalise_shapes(phi, mass)
    error = np.abs(phi.T @ mass @ phi - np.eye(phi.shape[1])).max()
    if error > 1e-6:  # above the rounding of nearly dependent shapes
        raise BadRecording(
            f"the shapes miss orthonormality in the corrected mass by {error:.2g}; call correct_mass first"
        )
    return mass, phi


def _remaining(mass: Array, stiffness: Array, phi: Array) -> tuple[Array, Array]:
    """Return frequencies and shapes of the modes besides phi.

    The modes carry no momentum in phi; omega is in rad/s.
    """
    root = linalg.cholesky(mass, lower=True)
    basis = linalg.qr(root.T @ phi)[0][:, phi.shape[1] :]
    if basis.shape[1] == 0:
        return np.empty(0), np.empty((len(mass), 0))
    free = linalg.solve_triangular(root, basis, trans="T", lower=True)
    squared, vectors = linalg.eigh(free.T @ stiffness @ free)
    return np.sign(squared) * np.sqrt(np.abs(squared)), free @ vectors


def _frequencies(freq_hz: ArrayLike, count: int) -> Array:
    freq = _measured("frequencies", freq_hz, count)
    if np.any(freq < 0):
        raise BadRecording(
            f"measured mode {int(np.argmin(freq))} has the frequency {freq.min():g} Hz; it must not be negative"
        )
    return freq


def _measured(what: str, given: ArrayLike, count: int) -> Array:
    values = np.asarray(given, dtype=float)
    if values.shape != (count,):
        raise BadRecording(f"{what} of shape {values.shape} do not fit {count} modes")
    if not np.all(np.isfinite(values)):
        worst = int(np.argmin(np.isfinite(values)))
        raise BadRecording(f"the {what} of mode {worst} is {values[worst]}; it must be finite")
    return values


def _change(model: SecondOrderModel, old: Array, new: Array) -> float:
    modes = model.eigen[1]
    size = np.linalg.norm(modes.T @ old @ modes)
    moved = np.linalg.norm(modes.T @ (new - old) @ modes)
    return float(moved / size) if size > 0 else (float("inf") if moved > 0 else 0.0)


def _symmetric(matrix: Array) -> Array:
    return (matrix + matrix.T) / 2
