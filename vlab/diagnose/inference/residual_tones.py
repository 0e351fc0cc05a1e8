"""Strongest tones of a residual, as forces at a port.

A force of one frequency stands out of its neighbours; a resonance need not.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.fft import next_fast_len

from vlab.diagnose.predictors.innovations import Group
from vlab.diagnose.settings import SCORE_TEST
from vlab.signals import Array

Tones = tuple[tuple[float, bool], ...]
"""Frequencies [Hz], and whether a tone stands out of its neighbours."""


@dataclass(frozen=True, eq=False)
class ResidualSpectra:
    """Spectra of the residual of the largest batch of runs.

    Parameters
    ----------
    group : Group
        Batch of runs.
    frequency : (nf,) array
        Frequencies [Hz].
    spectra : (nf, n_runs, p) complex array
        Spectra of the whitened residual.
    """

    group: Group
    frequency: Array
    spectra: Any


def spectra_of_residual(groups: Sequence[Group], base: Array) -> ResidualSpectra:
    """Return the spectra of the residual of the largest batch.

    Parameters
    ----------
    groups : sequence of Group
        Filtered runs.
    base : (rows,) array
        Whitened residual of all batches.

    Returns
    -------
    ResidualSpectra
        Spectra with a line spacing of a quarter of the resolution.
    """
    sizes = [len(g.rows(g.e[..., None])) for g in groups]
    which = int(np.argmax(sizes))
    group = groups[which]
    left = np.zeros_like(group.e)
    left[group.first :][group.counts] = base[sum(sizes[:which]) :][: sizes[which]].reshape(-1, left.shape[2])
    size = next_fast_len(4 * len(left), real=True)
    return ResidualSpectra(group, np.fft.rfftfreq(size, group.h), np.fft.rfft(left, size, axis=0))


def response_to_unit_force(group: Group, row: Array, frequency: Array) -> Any:
    """Return the whitened innovations of a unit force by frequency.

    Parameters
    ----------
    group : Group
        Filtered runs.
    row : (m,) array
        Modal force per unit force.
    frequency : (nf,) array
        Frequencies [Hz]; zero counts as the lowest other one.

    Returns
    -------
    (nf, p) complex array
        Innovations.
    """
    system, K = group.system, group.gains.K[-1]
    C, D = system.C[0], system.D[0]
    poles, vectors = np.linalg.eig(system.A[0] - K @ C)
    push = np.linalg.solve(vectors, (system.B[0] - K @ D) @ row)
    # the position of a free body, unseen by a rate sensor, has its pole at z = 1
    lowest = frequency[frequency > 0].min()
    z = np.exp(2j * np.pi * np.maximum(frequency, lowest) * group.h)
    seen = (push / (z[:, None] - poles)) @ (C @ vectors).T + D @ row
    return seen @ group.white.T


def strongest_tones(residual: ResidualSpectra, answer: Any) -> Tones:
    """Return the frequencies of the strongest tones in a residual.

    Parameters
    ----------
    residual : ResidualSpectra
        Spectra of the residual.
    answer : (nf, p) array
        Whitened innovations of a unit force.

    Returns
    -------
    tuple of (float, bool)
        Frequency [Hz], and whether the tone stands out.
    """
    group, frequency = residual.group, residual.frequency
    seen = np.abs(np.einsum("fp,frp->fr", answer.conj(), residual.spectra)) ** 2
    power = seen.sum(axis=1) / np.maximum(np.sum(np.abs(answer) ** 2, axis=1), 1e-300)
    apart = SCORE_TEST.tone_width / (len(group.e) * group.h)
    power[(frequency < apart) | (frequency > SCORE_TEST.highest_tone / group.h)] = 0.0
    out = []
    whole = power.copy()
    for _ in range(SCORE_TEST.tones):
        top = int(np.argmax(power))
        far = np.abs(frequency - frequency[top])
        beside = whole[(far > apart) & (far < SCORE_TEST.tone_neighbours / SCORE_TEST.tone_width * apart) & (whole > 0)]
        stands_out = bool(beside.size and power[top] > SCORE_TEST.tone_stands_out * np.median(beside))
        out.append((float(frequency[top]) or apart, stands_out))
        power[far < apart] = 0.0
    return tuple(out)
