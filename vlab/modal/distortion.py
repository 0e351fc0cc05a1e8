"""Noise and nonlinear distortion from periodic data, by the robust method [1]_.

Changes from period to period are noise. Additional changes from realisation to realisation of the phases are distortion
of a nonlinear structure. Such distortion repeats with the period and resembles noise on the best linear approximation.
Output at lines that an odd multisine omits is also distortion. The line's number shows an even law (a quadratic
stiffness) or an odd law (a cubic stiffness, or friction).

References
----------
.. [1] R. Pintelon, J. Schoukens, *System Identification: A Frequency Domain Approach*, 2nd ed., IEEE Press, 2012,
   sections 4.3.1 (robust method) and 4.3.2 (detection lines).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlab.errors import BadRecording
from vlab.modal.channels import checked_data
from vlab.modal.frf import PERIODIC_FLOOR
from vlab.modal.spectra import excited_lines, period_spectra
from vlab.signals import Array, ComplexArray, Recording


@dataclass(frozen=True, kw_only=True, eq=False)
class DetectionLines:
    """Output at unexcited lines of the band.

    Parameters
    ----------
    freq : (n,) array
        Frequencies [Hz].
    is_even : (n,) bool array
        Whether the line is an even multiple of 1/period; every other line is odd.
    level : (n, n_outputs) array
        Output amplitude [unit of the output], rms over the realisations, with noise.
    noise_sd : (n, n_outputs) array
        Standard deviation of the amplitude from noise alone.
    """

    freq: Array
    is_even: NDArray[np.bool_]
    level: Array
    noise_sd: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Distortion:
    """Best linear approximation of one input, with noise and distortion.

    Parameters
    ----------
    freq : (n,) array
        Excited lines [Hz].
    G : (n, n_outputs) complex array
        Best linear approximation, mean over the realisations.
    noise_sd : (n, n_outputs) array
        Standard deviation of G from noise, from the spread over the periods.
    total_sd : (n, n_outputs) array or None
        Standard deviation of G from noise and nonlinear distortion, from the spread over the realisations; None for one
        realisation.
    amplitude : (n,) array
        Amplitude of the input at each line.
    detection : DetectionLines
        Unexcited lines; empty if every line of the band is excited.
    outputs, input, units : names of the channels, and the units of the outputs
        Names of the channels, and units of the outputs.
    realisations, periods : int
        Numbers of averages.
    """

    freq: Array
    G: ComplexArray
    noise_sd: Array
    total_sd: Array | None
    amplitude: Array
    detection: DetectionLines
    outputs: tuple[str, ...]
    units: tuple[str, ...]
    input: str
    realisations: int
    periods: int

    @property
    def distortion_sd(self) -> Array | None:
        """Standard deviation of G from distortion, in one realisation.

        The value is 0 if noise explains the spread.
        """
        if self.total_sd is None:
            return None
        return np.sqrt(self.realisations * np.maximum(self.total_sd**2 - self.noise_sd**2, 0.0))

    def levels(self, low: float = 0.0, high: float = np.inf) -> list[dict[str, Any]]:
        """Return each output's power levels in a band [dB].

        The reference is the power of the output's linear response. ``noise_db`` is the noise of one realisation after
        averaging its periods. ``nonlinear_db`` is the distortion that differs between realisations: None for a single
        one, -inf if noise explains the spread. ``even_db`` and ``odd_db`` are mean powers of a detection line without
        noise, relative to an excited line.

        Parameters
        ----------
        low, high : float
            Band [Hz].

        Returns
        -------
        list of dict of str to object
            One dictionary an output.
        """
        here = (self.freq >= low) & (self.freq <= high)
        linear = np.sum(np.abs(self.G * self.amplitude[:, None])[here] ** 2, axis=0)
        noise = self.realisations * np.sum((self.noise_sd * self.amplitude[:, None])[here] ** 2, axis=0)
        spread = None if self.distortion_sd is None else (self.distortion_sd * self.amplitude[:, None])[here] ** 2
        lines = self.detection
        seen = (lines.freq >= low) & (lines.freq <= high)
        beside = {}
        for name, which in (("even_db", lines.is_even), ("odd_db", ~lines.is_even)):
            at = seen & which
            excess = np.mean(lines.level[at] ** 2 - lines.noise_sd[at] ** 2, axis=0) if at.any() else None
            beside[name] = None if excess is None else _decibel(excess, linear / max(here.sum(), 1))
        rows = []
        for o, output in enumerate(self.outputs):
            row: dict[str, Any] = {"output": output, "noise_db": float(_decibel(noise, linear)[o])}
            row["nonlinear_db"] = None if spread is None else float(_decibel(spread.sum(axis=0), linear)[o])
            rows.append(row | {name: None if value is None else float(value[o]) for name, value in beside.items()})
        return rows


def _decibel(power: Array, reference: Array) -> Array:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(10 * np.log10(np.maximum(power, 0.0) / reference))


def separate_distortion(
    recordings: Sequence[Recording], *, input: str, outputs: Sequence[str], period_s: float, skip_s: float = 0.0
) -> Distortion:
    """Return the best linear approximation, noise and distortion.

    Parameters
    ----------
    recordings : sequence of Recording
        One a realisation: same lines and amplitudes, other phases. The level must be the same, because the
        approximation depends on it.
    input : str
        Name of the input channel.
    outputs : sequence of str
        Names of the output channels.
    period_s : float
        Period [s], a whole number of samples. The last whole periods after `skip_s` are used.
    skip_s : float
        Time to drop at the start [s].

    Returns
    -------
    Distortion
        Approximation with standard deviations.

    Raises
    ------
    BadRecording
        Recordings of different rates, no common excited line, or an error of the spectra.
    """
    outputs = tuple(outputs)
    spectra = []
    for recording in recordings:
        dt, x, y = checked_data(recording, (input,), outputs, skip_s)
        spectra.append((period_spectra(x, y, dt, period_s), round(period_s / dt)))
    if len({length for _, length in spectra}) != 1:
        raise BadRecording("the realisations have different sample rates; record all at one rate")
    count = min(len(part.X) for part, _ in spectra)
    masks = [excited_lines(part.X, PERIODIC_FLOOR, is_periodic=True) for part, _ in spectra]
    keep = np.logical_and.reduce(masks)
    if not keep.any():
        raise BadRecording("the realisations have no excited line in common; give them the same band, period and lines")
    scale = 2.0 / spectra[0][1]
    X = np.stack([part.X[-count:, :, 0] for part, _ in spectra]) * scale  # (realisation, period, line)
    Y = np.stack([part.Y[-count:] for part, _ in spectra]) * scale
    freq = spectra[0][0].freq
    G_each, noise_each = _realisations(X[:, :, keep], Y[:, :, keep])
    n = len(recordings)
    G = G_each.mean(axis=0)
    total = np.sum(np.abs(G_each - G) ** 2, axis=0) / (n * (n - 1)) if n > 1 else None
    anywhere = np.logical_or.reduce(masks)
    inside = (np.arange(freq.size) >= np.argmax(keep)) & (np.arange(freq.size) < freq.size - np.argmax(keep[::-1]))
    return Distortion(
        freq=freq[keep],
        G=G,
        noise_sd=np.sqrt(noise_each.mean(axis=0) / n),
        total_sd=None if total is None else np.sqrt(total),
        amplitude=np.sqrt(np.mean(np.abs(X[:, :, keep].mean(axis=1)) ** 2, axis=0)),
        detection=_detection(X, Y, freq, np.flatnonzero(inside & ~anywhere), G, freq[keep]),
        outputs=outputs,
        units=tuple(recordings[0].channels[recordings[0].index(name)].unit for name in outputs),
        input=input,
        realisations=n,
        periods=count,
    )


def _realisations(X: ComplexArray, Y: ComplexArray) -> tuple[ComplexArray, Array]:
    """Return responses and noise variances, (realisation, line, output)."""
    mean_x = X.mean(axis=1)
    G = Y.mean(axis=1) / mean_x[:, :, None]
    left = Y - G[:, None] * X[:, :, :, None]  # input noise counts through the ratio
    periods = X.shape[1]
    variance = np.sum(np.abs(left) ** 2, axis=1) / (periods * (periods - 1))
    return G, variance / np.abs(mean_x)[:, :, None] ** 2


def _detection(
    X: ComplexArray, Y: ComplexArray, freq: Array, lines: NDArray[Any], G: ComplexArray, at: Array
) -> DetectionLines:
    """Return the output at unexcited lines.

    The small input at such lines is compensated.
    """
    near = (
        np.stack([np.interp(freq[lines], at, part) for part in (*G.real.T, *G.imag.T)])
        if lines.size
        else np.zeros((0, 0))
    )
    n_out = Y.shape[-1]
    passed = (near[:n_out] + 1j * near[n_out:]).T if lines.size else np.zeros((0, n_out), complex)
    beside = Y[:, :, lines] - passed * X[:, :, lines, None]
    mean, periods = beside.mean(axis=1), X.shape[1]
    noise = np.sum(np.abs(beside - mean[:, None]) ** 2, axis=1) / (periods * (periods - 1))
    return DetectionLines(
        freq=freq[lines],
        is_even=lines % 2 == 0,
        level=np.sqrt(np.mean(np.abs(mean) ** 2, axis=0)),
        noise_sd=np.sqrt(noise.mean(axis=0)),
    )
