"""Coherence check between recorded outputs and inputs."""

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
FEWEST_LINES = 8
"""FEWEST_LINES [1]: fewest lines from which a recording is assessed."""
OVERLAP = 0.947
"""OVERLAP [1]: independent segments per half-overlapping segment of a Hann window. Source: Welch 1967, eq. 12; 9/19
of the degrees of freedom of twice as many segments."""


def unrelated(now: Beside) -> str:
    """Return a message if no recorded output is coherent with the inputs.

    The message requires that the model's outputs are coherent.

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

    The mean is over the lines that the model drives.

    Returns
    -------
    tuple of (float, float) or None
        None without such lines.
    """
    inputs = [run.measured[d.channel] for d in run.drives if np.ptp(run.measured[d.channel]) > 0.0]
    if not inputs or run.law is not None or not run.measured.is_uniform:
        return None
    u = np.column_stack(inputs)
    n = SEGMENTS + EACH * (u.shape[1] - 1)
    length = 2 * len(u) // (n + 1)
    if length < 2 * FEWEST_LINES:
        return None
    measured, power = _coherence(u, run.measured[name], length)
    simulated, _ = _coherence(u, own[name], length)
    lines = (simulated >= DRIVEN) & (power >= POWER * power.max())
    lines[:2] = False  # leakage of the mean in a Hann window
    lines[int(UPPER * len(lines)) :] = False
    count = int(lines.sum())
    if count < FEWEST_LINES:
        return None
    free, q = OVERLAP * n, u.shape[1]
    mean = q / free
    spread = float(
        np.sqrt(mean * (1.0 - mean) / (free + 1.0) / (count / 2.0))
    )  # variance of a beta distribution; a Hann window correlates neighbouring lines
    return float(measured[lines].mean()), mean + CHANCE * spread


def _coherence(u: Array, y: Array, length: int) -> tuple[Array, Array]:
    """Return multiple coherence and input power, (n_lines,) each."""
    starts = range(0, len(y) - length + 1, length // 2)
    window = np.hanning(length)
    U = np.stack(
        [np.fft.rfft((u[k : k + length] - u[k : k + length].mean(axis=0)) * window[:, None], axis=0) for k in starts]
    )
    Y = np.stack([np.fft.rfft((y[k : k + length] - y[k : k + length].mean()) * window) for k in starts])
    uu = np.einsum("slj,slk->ljk", U.conj(), U)
    uy = np.einsum("slj,sl->lj", U.conj(), Y)
    yy = np.sum(np.abs(Y) ** 2, axis=0)
    power = np.einsum("ljj->l", uu).real
    uu = uu + 1e-12 * power.max(initial=1e-300) * np.eye(u.shape[1])
    explained = np.einsum("lj,lj->l", uy.conj(), np.linalg.solve(uu, uy[..., None])[..., 0]).real
    return np.clip(explained / np.maximum(yy, 1e-300), 0.0, 1.0), power
