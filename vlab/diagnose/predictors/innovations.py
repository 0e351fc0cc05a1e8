"""Batches of filtered runs, and their innovations."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from vlab.diagnose.data.runs import Signals
from vlab.diagnose.kernels.recursion import states_of
from vlab.diagnose.parameters.discrete import Discrete
from vlab.diagnose.parameters.reduced_model import ReducedModel
from vlab.diagnose.predictors.kalman import FilterGains, Smoothed
from vlab.diagnose.settings import INNOVATIONS
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Cause:
    """Signals that enter a problem in one way.

    Parameters
    ----------
    series : (n, n_runs, k) array
        Signals.
    force : (m,) array or None
        Modal force per unit signal; None for a signal added to a channel.
    channel : int
        Channel of an added signal.
    """

    series: Array
    force: Array | None = None
    channel: int = 0

    @property
    def way(self) -> bytes | int:
        """Key of the signals' entrance into the problem."""
        return self.channel if self.force is None else self.force.tobytes()


@dataclass(eq=False)
class Group:
    """Runs of one sample period, filtered as a batch.

    Parameters
    ----------
    runs : list of Signals
        Runs.
    system : Discrete
        Discrete-time reduced model.
    gains : FilterGains
        Gains of the Kalman filter.
    smoothed : Smoothed
        Filtered and smoothed states.
    u, forces, y : (n, n_runs, ...) array
        Commands, modal forces and channels.
    lengths : (n_runs,) array
        Samples of every run.
    usable : (n, n_runs, p) array or None
        Zero for uninformative samples.
    motion : tuple of array
        Modal displacement, velocity and acceleration in the middle of the steps.
    e : (n, n_runs, p) array
        Innovations.
    white : (p, p) or (n, n_runs, p, p) array
        Whitening matrices of the innovations.
    impulses : (n, p, m + p) array
        Response of the innovations to unit impulses of modal forces and channels.
    first : int
        First sample that counts.
    at_places : dict
        Cached motion by location.
    """

    runs: list[Signals]
    system: Discrete
    gains: FilterGains
    smoothed: Smoothed
    u: Array
    forces: Array
    y: Array
    lengths: Array
    usable: Array | None = None
    motion: tuple[Array, Array, Array] = field(default_factory=tuple)  # type: ignore[assignment]
    e: Array = field(default_factory=lambda: np.zeros(0))
    white: Array = field(default_factory=lambda: np.zeros(0))
    impulses: Array = field(default_factory=lambda: np.zeros(0))
    first: int = 0
    at_places: dict[str, tuple[Array, Array]] = field(default_factory=dict)

    @property
    def h(self) -> float:
        """Sample period [s]."""
        return self.runs[0].h

    @property
    def starts(self) -> Array:
        """Times (n_runs,) of the runs' first samples in their recordings [s]."""
        return np.array([run.t0 for run in self.runs])

    @property
    def commands_before(self) -> Array:
        """Commands (n_runs, n_actuators) before the runs."""
        return np.array([run.command_before for run in self.runs])

    @property
    def times(self) -> Array:
        """Times (n, n_runs) of all samples in their recordings [s]."""
        return np.arange(len(self.y))[:, None] * self.h + self.starts

    @property
    def counts(self) -> Array:
        """Mask (n - first, n_runs) of the samples that count."""
        keep = np.arange(self.first, len(self.e))[:, None] < self.lengths[None, :]
        if self.usable is not None:
            keep &= self.usable[self.first :].all(axis=2)
        return np.asarray(keep)

    def rows(self, columns: Array) -> Array:
        """Return whitened columns (rows, k) of all samples that count."""
        white = self.white if self.white.ndim == 2 else self.white[self.first :]
        return np.asarray((white @ columns[self.first :])[self.counts].reshape(-1, columns.shape[-1]))


def impulses_of(system: Discrete, gain: Array, n: int) -> Array:
    """Return the innovations' response to unit impulses.

    Parameters
    ----------
    system : Discrete
        Discrete-time system.
    gain : (2m, p) array
        Stationary gain.
    n : int
        Samples.

    Returns
    -------
    (n, p, m + p) array
        Response to modal forces and channels.
    """
    A, B, C, D = system.A[0], system.B[0], system.C[0], system.D[0]
    p = len(C)
    after = np.hstack([B - gain @ D, -gain]).T  # the following states, one per row
    states = states_of((A - gain @ C).T[None], np.zeros((n - 1, 1, *after.shape)), after[None])
    return np.concatenate([np.hstack([D, np.eye(p)])[None], np.swapaxes(states[:, 0] @ C.T, 1, 2)])


def convolved(impulses: Array, series: Array) -> Array:
    """Return the convolution of signals with truncated impulse responses.

    Parameters
    ----------
    impulses : (n, p, q) array
        Impulse responses.
    series : (n, n_runs, q, k) array
        Signals.

    Returns
    -------
    (n, n_runs, p, k) array
        Filtered signals.
    """
    n, size = len(series), np.abs(impulses).max(axis=(1, 2))
    duration = 1 + int(np.flatnonzero(size > INNOVATIONS.forgotten * size.max())[-1]) if np.any(size) else 1
    length = next_fast_len(n + duration - 1, real=True)
    answer = rfft(impulses[:duration].astype(series.dtype), length, axis=0)[:, None]
    seen = rfft(series, length, axis=0)
    seen = answer * seen if series.shape[2] == 1 else answer @ seen
    return np.asarray(irfft(seen, length, axis=0, overwrite_x=True)[:n])


def carried(group: Group, causes: Sequence[Sequence[Cause]]) -> tuple[Array, list[int]]:
    """Return the innovations' response to causes, and its widths.

    Every entrance has one impulse response, so columns are convolutions with it.

    Parameters
    ----------
    group : Group
        Filtered runs with impulse responses.
    causes : sequence of sequence of Cause
        Causes of every effect.

    Returns
    -------
    response : (n, n_runs, p, sum of widths) array
        Innovations.
    widths : list of int
        Columns of every effect.
    """
    widths = [own[0].series.shape[-1] for own in causes]
    starts = [sum(widths[:i]) for i in range(len(widths) + 1)]
    ways: dict[bytes | int, list[tuple[int, Cause]]] = {}
    for start, own in zip(starts, causes, strict=False):
        for cause in own:
            ways.setdefault(cause.way, []).append((start, cause))
    columns, order = [], []
    for entering in ways.values():
        series = np.concatenate([c.series.astype(np.float32) for _, c in entering], axis=-1)
        columns.append(convolved(_impulse(group, entering[0][1]), series[:, :, None]))
        order += [start + i for start, c in entering for i in range(c.series.shape[-1])]
    if order == list(range(starts[-1])):
        return np.concatenate(columns, axis=-1), widths
    out = np.zeros((*group.y.shape, starts[-1]), dtype=np.float32)
    for i, column in zip(order, np.moveaxis(np.concatenate(columns, axis=-1), -1, 0), strict=True):
        out[..., i] += column
    return out, widths


def _impulse(group: Group, cause: Cause) -> Array:
    """Return the innovations' impulse response (n, p, 1) of a cause."""
    m = group.impulses.shape[2] - group.y.shape[2]
    if cause.force is None:
        return group.impulses[:, :, m + cause.channel, None]
    return np.asarray(group.impulses[:, :, :m] @ cause.force[:, None])


def middles(reduced_model: ReducedModel, group: Group) -> tuple[Array, Array, Array]:
    """Return the modal motion in the middle of steps.

    The smoothed motion depends on later samples, so forces along it would explain their noise. The acceleration is
    nominal for the same reason.

    Parameters
    ----------
    reduced_model : ReducedModel
        Reduced model.
    group : Group
        Filtered runs.

    Returns
    -------
    displacement, velocity, acceleration : (n, n_runs, m) array
        Modal motion.
    """
    m, h = reduced_model.m, group.h
    p, v = group.smoothed.filtered[..., :m], group.smoothed.filtered[..., m:]
    forces = group.forces
    a = (forces - p @ reduced_model.K.T - v @ reduced_model.C.T) @ np.linalg.inv(reduced_model.M).T
    p_mid, v_mid = p + 0.5 * h * v + 0.125 * h * h * a, v + 0.5 * h * a
    return (
        p_mid,
        v_mid,
        (forces - p_mid @ reduced_model.K.T - v_mid @ reduced_model.C.T) @ np.linalg.inv(reduced_model.M).T,
    )
