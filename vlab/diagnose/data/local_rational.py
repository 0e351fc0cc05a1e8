"""Local rational method for the unexplained part of a spectrum.

In every narrow band the spectrum R of a signal is

    R(k) D(k) = sum_i N_i(k) X_i(k) + T(k) + sum_j c_j Z_j(k) + D(k) V(k),

with polynomials D (D(0) = 1), N_i and T in frequency. X are the inputs' spectra, T is
the transient of leakage and free decay, Z are spectra of nonlinear functions of the motion. V is the noise. Every line
of V is a leave-one-out error, so a resonance of few lines does not count as explained.

References
----------
R. Pintelon, J. Schoukens, System Identification: A Frequency Domain Approach, 2nd ed., Wiley, 2012, chapter 7 (local
polynomials).
T. McKelvey, G. Guérin, Non-parametric frequency response estimation using a local rational model, IFAC Proc. 45 (2012)
49.
"""

from collections.abc import Sequence

import numpy as np

from vlab.diagnose.data.band import fastest
from vlab.diagnose.settings import RESIDUAL_NOISE
from vlab.signals import Array


def noise_lines(
    residuals: Array,
    linear: Sequence[Array],
    nonlinear: Sequence[Sequence[Array]] = ((),),
    degree: int = RESIDUAL_NOISE.degree,
) -> Array | None:
    """Return the noise power on every line of residuals.

    Parameters
    ----------
    residuals : (n, n_residuals) array
        Residuals under the same inputs.
    linear : sequence of (n // 2 + 1,) complex arrays
        Explanatory spectra X.
    nonlinear : sequence of sequence of (n // 2 + 1,) complex arrays
        Alternative sets of explanatory spectra Z, of equal number.
    degree : int
        Degree of the polynomials: resonances that one band may hold.

    Returns
    -------
    (n_alternatives, n // 2, n_residuals) array or None
        Squared modulus of the discrete Fourier transform, at most that of the residual. None for too few lines.
    """
    R = spectrum(residuals)[1:]
    X, alternatives = [x[1:] for x in linear], [[z[1:] for z in Z] for Z in nonlinear]
    unknowns = degree + (len(X) + 1) * (degree + 1) + len(alternatives[0])
    count = len(R) // (RESIDUAL_NOISE.lines_per_unknown * unknowns)
    if count == 0:
        return None
    noise = np.zeros((len(alternatives), *R.shape))
    for band in np.array_split(np.arange(len(R)), count):
        powers = np.vander(np.linspace(-1.0, 1.0, band.size), degree + 1, increasing=True)
        smooth = _orthonormal(np.hstack([powers.astype(complex), *(x[band, None] * powers for x in X)]))
        for lines, Z in zip(noise, alternatives, strict=True):
            Q = smooth
            if Z:
                Q = np.hstack([smooth, _orthonormal(np.column_stack([z[band] for z in Z]), smooth)])
            lines[band] = _left_out(R[band], Q, powers[:, 1:]).T
    return noise


def _orthonormal(columns: Array, beside: Array | None = None) -> Array:
    """Return an orthonormal basis of columns, orthogonal to another basis.

    Parameters
    ----------
    columns : (n, k) complex array
        Columns of any scale.
    beside : (n, r) complex array or None
        Orthonormal basis.

    Returns
    -------
    (n, rank) complex array
        Basis.
    """
    size = np.linalg.norm(columns, axis=0)
    A = columns[:, size > 0] / size[size > 0]
    if beside is not None:
        A = A - beside @ (beside.conj().T @ A)
    if not A.shape[1]:
        return A
    Q, singular, _ = np.linalg.svd(A, full_matrices=False)
    largest = singular[0] if beside is None else max(float(singular[0]), 1.0)  # a column within the basis is rounding
    return np.asarray(Q[:, singular > RESIDUAL_NOISE.rank * largest])


def _left_out(R: Array, Q: Array, powers: Array) -> Array:
    """Return the squared leave-one-out residuals of a band.

    The residuals are (R - fit) / (1 - leverage) over D. Residuals are unbounded near a zero of D, so R is the upper
    bound.

    Parameters
    ----------
    R : (n, n_residuals) complex array
        Spectra.
    Q : (n, rank) complex array
        Orthonormal basis of all regressors but those of D.
    powers : (n, degree) array
        Powers of the frequency in D.

    Returns
    -------
    (n_residuals, n) array
        Squares.
    """
    columns = -R.T[:, :, None] * powers  # (n_residuals, n, degree)
    size = np.linalg.norm(columns, axis=1, keepdims=True)
    scaled = columns / np.where(size > 0, size, 1.0)
    outside, rest = scaled - Q @ (Q.conj().T @ scaled), R - Q @ (Q.conj().T @ R)
    U, singular, Vh = np.linalg.svd(outside, full_matrices=False)
    is_kept = singular > RESIDUAL_NOISE.rank
    U = U * is_kept[:, None, :]
    inverse = is_kept / np.where(is_kept, singular, 1.0)
    along = np.einsum("ijk,ji->ik", U.conj(), rest)
    fit = np.einsum("ikj,ik->ij", Vh.conj(), inverse * along) / np.where(size > 0, size, 1.0)[:, 0]
    D = 1.0 + fit @ powers.T
    leverage = np.sum(np.abs(Q) ** 2, axis=1) + np.sum(np.abs(U) ** 2, axis=2)
    V = np.abs((rest.T - np.einsum("ijk,ik->ij", U, along)) / D)
    V = V / np.maximum(1.0 - leverage, RESIDUAL_NOISE.least_freedom)
    return np.asarray(np.minimum(V, np.abs(R.T)) ** 2)


def nonlinear_spectra(values: Array, order: int, h: float) -> list[Array]:
    """Return spectra of nonlinear functions of a recorded motion.

    The functions are friction, drag, cubic and quadratic springs, and a drifting spring.

    Parameters
    ----------
    values : (n,) array
        Recorded motion [SI].
    order : int
        0 position, 1 velocity, 2 acceleration.
    h : float
        Sample period [s].

    Returns
    -------
    list of (n // 2 + 1,) complex arrays
        Spectra.
    """
    n = len(values)
    omega = 2j * np.pi * np.fft.rfftfreq(n, h)
    top = RESIDUAL_NOISE.motion_band * fastest(values[:, None], h, [order])
    Y = np.where(np.abs(omega) < 2 * np.pi * top, np.fft.rfft(values - values.mean()), 0.0)
    Y[0], omega[0] = 0.0, 1.0
    x, v = (np.fft.irfft(Y * omega ** (power - order), n) for power in (0, 1))
    drift = np.linspace(-1.0, 1.0, n)
    return [spectrum(z) for z in (np.sign(v), np.abs(v) * v, x**3, x**2, drift * x)]


def spectrum(x: Array) -> Array:
    """Return the spectra (n_freq, ...) of signals (n, ...) without means."""
    return np.asarray(np.fft.rfft(x - x.mean(axis=0), axis=0))
