"""Spectra by period or segment, and estimators H1, H2, Hv."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import signal, stats

from vlab.errors import BadRecording
from vlab.signals import Array, ComplexArray

MIN_SEGMENTS = 4
"""MIN_SEGMENTS [1]: fewest segments per input of random data. With as many segments as inputs the coherence is 1
whatever the noise."""
MIN_PERIODS = 2
"""MIN_PERIODS [1]: fewest periods per input of periodic data, for the same reason as `MIN_SEGMENTS`."""
REPEATABILITY = 1e-3
"""REPEATABILITY [1]: probability that a line of input noise passes as excited (F test over the periods)."""
MAX_CONDITION = 1e10
"""MAX_CONDITION [1]: largest condition number of the inputs' coherence matrix. Beyond the limit several channels
hold one input."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Spectra:
    """Spectra before averaging.

    Parameters
    ----------
    X, Y : (n_averages, n_lines, n_channels) complex array
        Spectra of inputs and outputs.
    freq : (n_lines,) array
        Lines [Hz].
    n_effective : float
        Number of independent averages; overlapping segments count less.
    resolution_hz : float
        Noise bandwidth of the window; 0 without one.
    """

    X: ComplexArray
    Y: ComplexArray
    freq: Array
    n_effective: float
    resolution_hz: float

    def at(self, keep: Any) -> "Spectra":
        """Return a selection of lines."""
        return replace(self, X=self.X[:, keep], Y=self.Y[:, keep], freq=self.freq[keep])


def period_spectra(x: Array, y: Array, dt: float, period_s: float) -> Spectra:
    """Transform each of the last whole periods.

    Parameters
    ----------
    x, y : (n, n_channels) array
        Inputs and outputs.
    dt : float
        Time step [s].
    period_s : float
        Period [s].

    Returns
    -------
    Spectra
        Spectra of the periods.
    """
    length = round(period_s / dt)
    if length < 2 or abs(period_s / dt - length) > 1e-4:  # 1e-4 of a sample: 80 dB at Nyquist
        raise BadRecording(
            f"period_s = {period_s:g} s is {period_s / dt:.6g} samples of {dt:g} s; averaging without leakage needs a "
            "whole number"
        )
    n, n_in = len(x) // length, x.shape[1]
    if n < MIN_PERIODS * n_in:
        raise BadRecording(
            f"{n} whole periods of {period_s:g} s for {n_in} inputs: coherence would be 1 by construction; "
            f"at least {MIN_PERIODS} an input are needed: record longer or skip less"
        )
    X, Y = (np.fft.rfft(a[len(a) - n * length :].reshape(n, length, -1), axis=1) for a in (x, y))
    if n_in == 1:
        power, common = np.sum(np.abs(X[:, 1:]) ** 2), n * np.sum(np.abs(X[:, 1:].mean(axis=0)) ** 2)
        if common < 0.5 * power:
            raise BadRecording(
                f"the input does not repeat with period_s = {period_s:g} s; leave it out for random data"
            )
    return Spectra(X=X, Y=Y, freq=_lines(length, dt), n_effective=float(n), resolution_hz=0.0)


def segment_spectra(x: Array, y: Array, dt: float, segment_s: float, overlap: float, window: str) -> Spectra:
    """Transform windowed, overlapping segments without their means.

    Welch's method [1]_; the number of independent averages accounts for the overlap.

    Parameters
    ----------
    x, y : (n, n_channels) array
        Inputs and outputs.
    dt : float
        Time step [s].
    segment_s : float
        Length of a segment [s].
    overlap : float
        Overlap of segments, in [0, 1).
    window : str
        Window, a name of `scipy.signal.get_window`.

    Returns
    -------
    Spectra
        Spectra of the segments.

    References
    ----------
    .. [1] P. D. Welch, The use of fast Fourier transform for the estimation of power spectra, IEEE Transactions on
           Audio and Electroacoustics 15 (1967) 70-73.
    """
    if not 0 <= overlap < 1:
        raise BadRecording(f"overlap = {overlap:g} is not in [0, 1)")
    length = round(min(segment_s / dt, len(x) + 1.0))  # a later check refuses a segment longer than the record
    try:
        taper = signal.get_window(window, max(length, 1))
    except ValueError as error:
        raise BadRecording(f"window {window!r} is not one that scipy.signal.get_window knows") from error
    hop, n_in = max(1, round(length * (1 - overlap))), x.shape[1]
    n = (len(x) - length) // hop + 1 if 2 <= length <= len(x) else 0
    if n < MIN_SEGMENTS * n_in:
        raise BadRecording(
            f"{n} segments of {segment_s:g} s for {n_in} inputs: coherence would be near 1 by construction; at least "
            f"{MIN_SEGMENTS} an input are needed: choose a shorter segment_s or record longer"
        )
    pieces = []
    for a in (x, y):
        cut = a[hop * np.arange(n)[:, None] + np.arange(length)]
        pieces.append(np.fft.rfft((cut - cut.mean(axis=1, keepdims=True)) * taper[:, None], axis=1))
    lags = np.arange(1, min(n, -(-length // hop)))
    rho = np.array([taper[k * hop :] @ taper[: length - k * hop] for k in lags]) / (taper @ taper)
    return Spectra(
        X=pieces[0],
        Y=pieces[1],
        freq=_lines(length, dt),
        n_effective=float(n / (1 + 2 * np.sum((1 - lags / n) * rho**2))),  # Welch, IEEE Trans. AU 15, 1967
        resolution_hz=float((taper @ taper) / np.sum(taper) ** 2 / dt),
    )


def _lines(length: int, dt: float) -> Array:
    return np.arange(length // 2 + 1) / (length * dt)


def excited_lines(X: ComplexArray, floor: float, *, is_periodic: bool) -> NDArray[np.bool_]:
    """Return a mask of lines that every input excites.

    The line at 0 Hz is excluded.

    Parameters
    ----------
    X : complex array
        Spectra of the inputs, (n_averages, n_lines, n_inputs).
    floor : float
        Smallest input power relative to the largest line.
    is_periodic : bool
        Whether a line must also repeat significantly.

    Returns
    -------
    array
        Mask, (n_lines,).
    """
    power = np.mean(np.abs(X) ** 2, axis=0)
    keep = np.all(power > floor * power[1:].max(axis=0), axis=1)
    keep[0] = False
    if is_periodic and X.shape[2] == 1:
        n = len(X)
        mean = X.mean(axis=0)
        spread = np.sum(np.abs(X - mean) ** 2, axis=0) / (n - 1)
        keep &= (n * np.abs(mean) ** 2 > stats.f.ppf(1 - REPEATABILITY, 2, 2 * (n - 1)) * spread)[:, 0]
    return keep


def solve(spectra: Spectra, estimator: str) -> tuple[ComplexArray, Array, Array]:
    """Return H, multiple coherence and variance of H.

    Parameters
    ----------
    spectra : Spectra
        Spectra of inputs and outputs.
    estimator : str
        ``"H1"``, ``"H2"`` or ``"Hv"``.

    Returns
    -------
    tuple of (complex array, array, array)
        H, multiple coherence and variance.
    """
    X, Y = spectra.X, spectra.Y
    if estimator not in ("H1", "H2", "Hv"):
        raise BadRecording(f"unknown estimator {estimator!r} (accepted: H1, H2, Hv)")
    n_in, n_out = X.shape[2], Y.shape[2]
    S_xx = np.einsum("pfi,pfj->fij", X, X.conj()) / len(X)
    S_yx = np.einsum("pfo,pfj->foj", Y, X.conj()) / len(X)
    S_yy = np.mean(np.abs(Y) ** 2, axis=0)
    scale = np.sqrt(np.einsum("fii->fi", S_xx).real)  # inputs have different units; their coherence has none
    normed = S_xx / scale[:, :, None] / scale[:, None, :]
    condition = np.linalg.cond(normed)
    if condition.max() > MAX_CONDITION:
        worst = spectra.freq[np.argmax(condition)]
        raise BadRecording(
            f"the {n_in} inputs are fully coherent with each other at {worst:g} Hz (condition {condition.max():.1e}): "
            "their responses cannot be told apart; drive them with independent signals or one at a time"
        )
    inverse = np.linalg.inv(normed) / scale[:, :, None] / scale[:, None, :]
    H = S_yx @ inverse
    left = np.mean(np.abs(Y - np.einsum("foi,pfi->pfo", H, X)) ** 2, axis=0)  # S_yy - H S_xy would lose digits
    coherence = np.clip(1 - np.divide(left, S_yy, out=np.ones_like(S_yy), where=S_yy > 0), 0.0, 1.0)
    noise = left / max(spectra.n_effective - n_in, 1.0)
    variance = noise[:, :, None] * np.einsum("fii->fi", inverse).real[:, None, :]
    if estimator == "H2":
        H = _h2(X, Y, S_yx, S_yy)
    elif estimator == "Hv":
        H = np.stack([_hv(normed, S_yx[:, o] / scale, S_yy[:, o]) for o in range(n_out)], axis=1) / scale[:, None, :]
    return H, coherence, variance


def _h2(X: ComplexArray, Y: ComplexArray, S_yx: ComplexArray, S_yy: Array) -> ComplexArray:
    if X.shape[2] == 1:
        if np.any(S_yx == 0):
            raise BadRecording("an output does not respond to the input at all at some line: H2 does not exist; use H1")
        return S_yy[:, :, None] / S_yx.conj()
    if X.shape[2] != Y.shape[2]:
        raise BadRecording(f"H2 with {X.shape[2]} inputs needs as many outputs, not {Y.shape[2]}; use H1 or Hv")
    full = np.einsum("pfo,pfq->foq", Y, Y.conj()) / len(Y)
    return full @ np.linalg.inv(np.swapaxes(S_yx, 1, 2).conj())


def _hv(S_xx: ComplexArray, S_yx: ComplexArray, S_yy: Array) -> ComplexArray:
    """Return the total-least-squares estimate Hv.

    Channels have unit power; the combination of inputs and output with least power is set to 0.
    """
    n_in = S_xx.shape[1]
    power = np.sqrt(np.where(S_yy > 0, S_yy, 1.0))
    G = np.empty((len(S_xx), n_in + 1, n_in + 1), complex)
    G[:, :n_in, :n_in], G[:, n_in, n_in] = S_xx, S_yy / power**2
    G[:, n_in, :n_in] = S_yx / power[:, None]
    G[:, :n_in, n_in] = G[:, n_in, :n_in].conj()
    least = np.linalg.eigh(G)[1][:, :, 0]  # power of v^H [x; y] is v^H G v
    return -least[:, :n_in].conj() / least[:, n_in:].conj() * power[:, None]
