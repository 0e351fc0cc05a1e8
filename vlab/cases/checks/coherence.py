"""Coherence check between recorded outputs and inputs."""

from dataclasses import dataclass

import numpy as np

from vlab.cases.channel_map import Run
from vlab.cases.checks.bands import UPPER
from vlab.cases.checks.beside import Beside
from vlab.signals import Array, Recording

SEGMENTS, EACH = 8, 4
"""SEGMENTS [1]: half-overlapping segments of a coherence average.
EACH [1]: additional segments for every input beyond the first."""
DRIVEN = 0.8
"""DRIVEN [1]: coherence of the model's output with the inputs above which a line is used."""
POWER = 1e-3
"""POWER [1]: smallest input power of a used line, relative to the strongest line."""
CHANCE = 3.0
"""CHANCE [standard deviations]: width of the chance level above the mean coherence of unrelated signals."""
MOST = 0.5
"""MOST [1]: smallest share of the recorded output's power in the lines that the segments resolve. Slower motion may move
with the input and is not seen."""
FEWEST_LINES = 8
"""FEWEST_LINES [1]: fewest lines from which a recording is assessed."""
OVERLAP = 0.947
"""OVERLAP [1]: independent segments per half-overlapping segment of a Hann window. Source: Welch 1967, eq. 12; 9/19
of the degrees of freedom of twice as many segments."""


def unrelated(now: Beside) -> str:
    """Return a message if no recorded output is coherent with the inputs.

    The message requires that the model's outputs are coherent, and that the segments resolve most of the recorded power.

    Parameters
    ----------
    now : Beside
        Recordings and their simulation.

    Returns
    -------
    str
        Message, "" without a finding.
    """
    said = False
    for run, own in zip(now.runs, now.simulated, strict=True):
        for name in now.channels:
            if own is None or name not in run.measured.names or not np.ptp(run.measured[name]) > 0.0:
                continue
            means = _means(run, own, name)
            if means is None:
                continue
            if means[0] > means[1]:
                return ""
            said = True
    if not said:
        return ""
    names = " and ".join(dict.fromkeys(drive.channel for run in now.runs for drive in run.drives))
    return (
        f"no recorded output moves with {names}: their coherence is that of unrelated signals, where the model's is above {DRIVEN:g}; the "
        "columns may be those of two runs, or the input another one than that which drove"
    )


def _means(run: Run, own: Recording, name: str) -> tuple[float, float] | None:
    """Return the mean coherence of an output, and its chance level.

    The mean is over the lines that the model drives. Segments become longer where the motion is slow.

    Returns
    -------
    tuple of (float, float) or None
        None without such lines.
    """
    inputs = [run.measured[d.channel] for d in run.drives if np.ptp(run.measured[d.channel]) > 0.0]
    if not inputs or run.law is not None or not run.measured.is_uniform:
        return None
    u, y = np.column_stack(inputs), run.measured[name]
    most = SEGMENTS + EACH * (u.shape[1] - 1)
    for segments in (most, most // 2):  # longer segments resolve slower motion
        length = 2 * len(u) // (segments + 1)
        if length < 2 * FEWEST_LINES:
            continue
        found = _spectra(u, y, length)
        model = _spectra(u, own[name], length)
        resolved = slice(2, int(UPPER * len(found.power)))  # leakage of the mean in a Hann window below
        driven = (model.coherence >= DRIVEN) & (found.drive >= POWER * found.drive.max())
        lines = np.arange(len(driven))[resolved][driven[resolved]]
        count = len(lines)
        if count >= FEWEST_LINES and found.power[resolved].sum() >= MOST * found.total:
            mean, spread = _chance(u.shape[1], segments, count)
            return float(found.coherence[lines].mean()), mean + CHANCE * spread
    return None


def _chance(inputs: int, segments: int, lines: int) -> tuple[float, float]:
    """Return mean and spread of the coherence of unrelated signals, averaged over lines.

    The coherence has a beta distribution. A Hann window correlates neighbouring lines.
    """
    free = OVERLAP * segments
    mean = inputs / free
    return mean, float(np.sqrt(mean * (1.0 - mean) / (free + 1.0) / (lines / 2.0)))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Spectra:
    """Multiple coherence, power of the inputs and power of the output, (n_lines,) each.

    `total` is the power of the output about its mean over the whole record, slow motion included.
    """

    coherence: Array
    drive: Array
    power: Array
    total: float


def _spectra(u: Array, y: Array, length: int) -> _Spectra:
    """Return the spectra of half-overlapping segments."""
    starts = range(0, len(y) - length + 1, length // 2)
    window = np.hanning(length)
    U = np.stack(
        [np.fft.rfft((u[k : k + length] - u[k : k + length].mean(axis=0)) * window[:, None], axis=0) for k in starts]
    )
    Y = np.stack([np.fft.rfft((y[k : k + length] - y[k : k + length].mean()) * window) for k in starts])
    whole = np.stack([np.fft.rfft((y[k : k + length] - y.mean()) * window) for k in starts])
    uu = np.einsum("slj,slk->ljk", U.conj(), U)
    uy = np.einsum("slj,sl->lj", U.conj(), Y)
    yy = np.sum(np.abs(Y) ** 2, axis=0)
    power = np.einsum("ljj->l", uu).real
    uu = uu + 1e-12 * power.max(initial=1e-300) * np.eye(u.shape[1])
    explained = np.einsum("lj,lj->l", uy.conj(), np.linalg.solve(uu, uy[..., None])[..., 0]).real
    coherence = np.clip(explained / np.maximum(yy, 1e-300), 0.0, 1.0)
    return _Spectra(coherence=coherence, drive=power, power=yy, total=float(np.sum(np.abs(whole) ** 2)))
