"""Incoherent noise of a residual, by the local rational method.

Missing physics is a function of inputs and motion. Noise is the part that neither explains: of one sensor, common to
sensors, or of an input through the structure. In every narrow band the spectrum R of a residual is

    R(k) D(k) = sum_i N_i(k) X_i(k) + T(k) + sum_j c_j Z_j(k) + D(k) V(k),

with polynomials D (D(0) = 1), N_i and T of degree `RESIDUAL_NOISE.degree` in frequency. X are the inputs' spectra, T is
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
from scipy import stats

from vlab.cases.channel_map import ORDER, Run
from vlab.diagnose.data.runs import fastest, uniform
from vlab.diagnose.settings import RESIDUAL_NOISE
from vlab.signals import Array


def incoherent_rms(run: Run, channel: str, residual: Array) -> float:
    """Estimate the rms of the noise in a residual.

    Parameters
    ----------
    run : Run
        Recording whose inputs and compared channels explain the coherent part.
    channel : str
        Channel of the residual.
    residual : (n,) array
        Recorded minus simulated values [SI].

    Returns
    -------
    float
        Rms [unit of the channel]. Zero for uneven times, too few samples, or noise above a tenth of the motion.
    """
    if not run.measured.is_uniform or np.ptp(residual) == 0:
        return 0.0
    inputs = [_spectrum(run.measured[drive.channel]) for drive in run.drives]
    inputs = [x for x in inputs if np.any(x)]
    motions = [run.measured.index(c.channel) for c in run.compared if np.ptp(run.measured[c.channel]) > 0]
    lines = [noise_lines(residual, inputs, _nonlinear(run, column)) for column in motions]
    power = min((p for p in lines if p is not None), key=np.sum, default=np.zeros(0)) / len(residual) ** 2
    squares = 2.0 * float(np.sum(power)) + min(float(np.mean(residual)) ** 2, _of_mean(power))
    rms = float(np.sqrt(min(squares, float(np.mean(residual**2)))))
    return rms if RESIDUAL_NOISE.least_snr * rms <= float(np.std(run.measured[channel])) else 0.0


def _of_mean(power: Array) -> float:
    """Return the 95 % quantile of the noise in the squared mean.

    Noise as red as a random walk, of power 1/f^2, is assumed. The mean stands at half of the first line's frequency,
    and its square is chi-squared with one degree of freedom.

    Parameters
    ----------
    power : (n,) array
        Noise power on the lines from the first.
    """
    first = power[: RESIDUAL_NOISE.first_lines]
    return (
        float(stats.chi2.ppf(0.95, 1)) * 4.0 * 2.0 * float(np.mean(first * np.arange(1, len(first) + 1) ** 2))
        if len(first)
        else 0.0
    )


def noise_share(residual: Array, linear: Sequence[Array], nonlinear: Sequence[Array] = ()) -> float | None:
    """Return the noise share of a residual's rms about its mean.

    Parameters
    ----------
    residual : (n,) array
        Residual.
    linear, nonlinear : sequence of (n // 2 + 1,) complex arrays
        Explanatory spectra X and Z.

    Returns
    -------
    float or None
        Share from 0 to 1; None where the record has too few lines.
    """
    noise = noise_lines(residual, linear, nonlinear)
    total = float(np.sum(np.abs(_spectrum(residual)) ** 2))
    return None if noise is None or total == 0 else float(np.sqrt(np.sum(noise) / total))


def noise_lines(residual: Array, linear: Sequence[Array], nonlinear: Sequence[Array] = ()) -> Array | None:
    """Return the noise power on every line of a residual's spectrum without the mean.

    Parameters
    ----------
    residual : (n,) array
        Residual.
    linear, nonlinear : sequence of (n // 2 + 1,) complex arrays
        Explanatory spectra X and Z.

    Returns
    -------
    (n // 2,) array or None
        Squared modulus of the discrete Fourier transform, at most that of the residual. None for too few lines.
    """
    R = _spectrum(residual)[1:]
    X, Z = [x[1:] for x in linear], [z[1:] for z in nonlinear]
    unknowns = RESIDUAL_NOISE.degree + (len(X) + 1) * (RESIDUAL_NOISE.degree + 1) + len(Z)
    count = len(R) // (RESIDUAL_NOISE.lines_per_unknown * unknowns)
    if count == 0:
        return None
    noise = np.zeros(len(R))
    for band in np.array_split(np.arange(len(R)), count):
        powers = np.vander(np.linspace(-1.0, 1.0, band.size), RESIDUAL_NOISE.degree + 1, increasing=True)
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
        D = (
            1.0 + powers[:, 1:] @ (fit[: RESIDUAL_NOISE.degree] / size[: RESIDUAL_NOISE.degree])
            if np.all(size[: RESIDUAL_NOISE.degree] > 0)
            else np.ones(band.size)
        )
        V = np.abs((R[band] - A @ fit) / D) / np.maximum(
            1.0 - np.sum(np.abs(Q) ** 2, axis=1), RESIDUAL_NOISE.least_freedom
        )
        noise[band] = np.minimum(V, np.abs(R[band])) ** 2
    return noise


def _nonlinear(run: Run, column: int) -> list[Array]:
    """Return spectra of nonlinear functions of a recorded motion.

    The functions are friction, drag, cubic and quadratic springs, and a drifting spring.

    Parameters
    ----------
    run : Run
        Recording.
    column : int
        Column of the motion.
    """
    n, h = len(run.measured), uniform(run.measured.time)
    order = ORDER.get(run.measured.channels[column].kind, 0)
    values = run.measured.data[:, column]
    omega = 2j * np.pi * np.fft.rfftfreq(n, h)
    top = RESIDUAL_NOISE.motion_band * fastest(values[:, None], h, [order])
    Y = np.where(np.abs(omega) < 2 * np.pi * top, np.fft.rfft(values - values.mean()), 0.0)
    Y[0], omega[0] = 0.0, 1.0
    x, v = (np.fft.irfft(Y * omega ** (power - order), n) for power in (0, 1))
    drift = np.linspace(-1.0, 1.0, n)
    return [_spectrum(z) for z in (np.sign(v), np.abs(v) * v, x**3, x**2, drift * x)]


def _spectrum(x: Array) -> Array:
    return np.asarray(np.fft.rfft(x - x.mean()))
