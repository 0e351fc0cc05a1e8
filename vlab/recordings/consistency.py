"""Consistency of channels that are derivatives of each other.

A constant factor between a channel and the derivative of another at the same place indicates a wrong unit or sign.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vlab.signals import Recording

FACTORS = {
    9.80665: "g taken for m/s^2, or back",
    386.0886: "g taken for in/s^2, or back",
    39.37008: "inch taken for metre, or back",
    3.28084: "foot taken for metre, or back",
    25.4: "inch taken for millimetre, or back",
    4.448222: "pound-force taken for newton, or back",
    2 * np.pi: "Hz taken for rad/s, or back",
    180 / np.pi: "degree taken for radian, or back",
    100.0: "centimetre taken for metre, or per cent for a ratio",
    1000.0: "milli left out, or put in twice",
    1e6: "micro left out, or milli twice",
}
"""Ratios [1] caused by a mistaken unit, with the explanation."""

NEAR = 0.03
"""NEAR [1]: relative distance from a known factor at which the factor is named, the calibration error of an ordinary
sensor."""

_FAMILIES = (
    ("displacement", "velocity", "acceleration"),
    ("angle", "angular-velocity", "angular-acceleration"),
)
_SHORTEST = 64  # fewest samples for a usable spectrum
_STRONG = 0.1  # share of the strongest line; below it noise dominates, which a derivative amplifies
_ALIKE = 0.95  # smallest coherence of one common motion


class Mismatch(NamedTuple):
    """Two channels of one place and their ratio.

    The ratio is of the second channel to the derivative of the first.
    """

    first: int
    second: int
    ratio: float


def known_factor(ratio: float) -> str:
    """Return the unit mistake that explains a ratio.

    Parameters
    ----------
    ratio : float
        Ratio of two channels [1].

    Returns
    -------
    str
        Explanation, "" for none.
    """
    size = abs(ratio)
    for factor, text in FACTORS.items():
        if min(abs(size / factor - 1), abs(size * factor - 1)) < NEAR:
            return text
    return ""


def mismatches(recording: Recording, moving: list[int]) -> Iterator[Mismatch]:
    """Yield channel pairs with a wrong derivative ratio.

    Parameters
    ----------
    recording : Recording
        Recording in SI.
    moving : list of int
        Indices of channels that move.

    Returns
    -------
    iterator of Mismatch
        Pairs with a ratio other than 1.
    """
    if len(recording) < _SHORTEST or not recording.is_uniform:
        return
    channels = recording.channels
    for family in _FAMILIES:
        for low, high in ((0, 1), (1, 2), (0, 2)):
            for i in (k for k in moving if channels[k].kind == family[low] and channels[k].at):
                for j in (k for k in moving if channels[k].kind == family[high] and channels[k].at == channels[i].at):
                    ratio = _ratio(*_spectra(recording.data[:, i], recording.data[:, j], high - low, recording.rate))
                    if ratio is not None and abs(ratio - 1) > 2 * NEAR:
                        yield Mismatch(i, j, ratio)


def _spectra(values: NDArray[Any], other: NDArray[Any], order: int, rate: float) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the spectra of a channel's derivative and of another channel.

    The window acts on differences, because slow motion would leak into the derivative of a windowed channel. The gains
    of the difference, and of the mean over its interval, are divided out.
    """
    derivative = np.diff(values, order) * rate**order
    beside = 0.5 * (other[1:] + other[:-1]) if order == 1 else other[1:-1]
    share = np.fft.rfftfreq(derivative.size)  # cycles per sample
    inside = (share > 3 * share[1]) & (share < 0.4)  # above the window's width and below the Nyquist line
    gain = np.cos(np.pi * share[inside]) if order == 1 else 1.0
    return _spectrum(derivative)[inside] / np.sinc(share[inside]) ** order, _spectrum(beside)[inside] / gain


def _spectrum(values: NDArray[Any]) -> NDArray[Any]:
    centred = values - values.mean()
    size = np.abs(centred).max() or 1.0
    return np.asarray(np.fft.rfft(centred / size * np.hanning(values.size)) * size)


def _ratio(expected: NDArray[Any], measured: NDArray[Any]) -> float | None:
    """Return the real factor between two spectra.

    The result is None for incoherent spectra.
    """
    sizes = np.abs(expected), np.abs(measured)
    if not expected.size:
        return None
    strong = (sizes[0] > _STRONG * sizes[0].max()) & (sizes[1] > _STRONG * sizes[1].max())
    x, y = expected[strong], measured[strong]
    power, cross = np.vdot(x, x).real, np.vdot(x, y)
    coherence = np.abs(cross) ** 2 / (
        power * np.vdot(y, y).real
    )  # numpy gives NaN for empty spectra, which counts as incoherent
    if not coherence > _ALIKE or abs(cross.imag) > abs(cross.real):
        return None
    return float(cross.real / power)
