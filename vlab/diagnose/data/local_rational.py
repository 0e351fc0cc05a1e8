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
    residual: Array,
    linear: Sequence[Array],
    nonlinear: Sequence[Array] = (),
    degree: int = RESIDUAL_NOISE.degree,
) -> Array | None:
    """Return the noise power on every line of a residual.

    Parameters
    ----------
    residual : (n,) array
        Residual.
    linear, nonlinear : sequence of (n // 2 + 1,) complex arrays
        Explanatory spectra X and Z.
    degree : int
        Degree of the polynomials: resonances that one band may hold.

    Returns
    -------
    (n // 2,) array or None
        Squared modulus of the discrete Fourier transform, at most that of the residual. None for too few lines.
    """
    R = spectrum(residual)[1:]
    X, Z = [x[1:] for x in linear], [z[1:] for z in nonlinear]
    unknowns = degree + (len(X) + 1) * (degree + 1) + len(Z)
    count = len(R) // (RESIDUAL_NOISE.lines_per_unknown * unknowns)
    if count == 0:
        return None
    noise = np.zeros(len(R))
    for band in np.array_split(np.arange(len(R)), count):
        powers = np.vander(np.linspace(-1.0, 1.0, band.size), degree + 1, increasing=True)
        columns = [-R[band, None] * powers[:, 1:], powers.astype(complex)]
        columns += [x[band, None] * powers for x in X] + [z[band, None] for z in Z]
        A = np.hstack(columns)
        size = np.linalg.norm(A, axis=0)
        A = A[:, size > 0] / size[size > 0]
        Q, singular, Vh = np.linalg.svd(A, full_matrices=False)
        rank = int(np.sum(singular > RESIDUAL_NOISE.rank * singular[0]))
        Q = Q[:, :rank]
        fit = Vh[:rank].conj().T @ ((Q.conj().T @ R[band]) / singular[:rank])
        # leave-one-out residuals, (R - fit) / (1 - leverage); unbounded near a zero of D, so R is the upper bound
        D = 1.0 + powers[:, 1:] @ (fit[:degree] / size[:degree]) if np.all(size[:degree] > 0) else np.ones(band.size)
        V = np.abs((R[band] - A @ fit) / D) / np.maximum(
            1.0 - np.sum(np.abs(Q) ** 2, axis=1), RESIDUAL_NOISE.least_freedom
        )
        noise[band] = np.minimum(V, np.abs(R[band])) ** 2
    return noise


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
    """Return the spectrum (n // 2 + 1,) without the mean."""
    return np.asarray(np.fft.rfft(x - x.mean()))
