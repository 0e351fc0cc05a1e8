"""Runs of one sample period, filtered side by side, and what a signal that enters them leaves in their innovations."""

from dataclasses import dataclass, field

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from vlab.diagnose.data.runs import Signals
from vlab.diagnose.kernels.recursion import states_of
from vlab.diagnose.parameters.reduced_model import Discrete, ReducedModel
from vlab.diagnose.predictors.kalman import FilterGains, Smoothed
from vlab.diagnose.settings import INNOVATIONS
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Cause:
    """Signals that all enter a problem in one way.

    Parameters
    ----------
    series : (n, n_runs, k) array
        The signals.
    force : (m,) array or None
        The modal forces of a unit; None where the signals are added to readings.
    channel : int
        The channel whose readings they are added to.
    """

    series: Array
    force: Array | None = None
    channel: int = 0

    @property
    def way(self) -> bytes | int:
        """What causes that enter in the same way have in common."""
        return self.channel if self.force is None else self.force.tobytes()


@dataclass(eq=False)
class Group:
    """Runs of one sample period, filtered side by side.

    Parameters
    ----------
    e : (n, n_runs, p) array
        Innovations.
    white : (p, p) or (n, n_runs, p, p) array
        What makes their variance one.
    impulses : (n, p, m + p) array
        What unit impulses of the modal forces and of additions to the readings leave in them.
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
        """Times of the runs' first samples from the starts of their recordings [s], (n_runs,)."""
        return np.array([run.t0 for run in self.runs])

    @property
    def times(self) -> Array:
        """Times of all samples from the starts of the recordings [s], (n, n_runs)."""
        return np.arange(len(self.y))[:, None] * self.h + self.starts

    @property
    def counts(self) -> Array:
        """Which samples count from the first that does, (n - first, n_runs) array of bool."""
        keep = np.arange(self.first, len(self.e))[:, None] < self.lengths[None, :]
        if self.usable is not None:
            keep &= self.usable[self.first :].all(axis=2)
        return np.asarray(keep)

    def rows(self, columns: Array) -> Array:
        """Return (rows, k): whitened columns (n, n_runs, p, k) of all samples that count."""
        white = self.white if self.white.ndim == 2 else self.white[self.first :]
        return np.asarray((white @ columns[self.first :])[self.counts].reshape(-1, columns.shape[-1]))


def impulses_of(system: Discrete, gain: Array, n: int) -> Array:
    """Return what unit impulses of the modal forces and the readings leave in the innovations of a steady filter, (n, p, m + p)."""
    A, B, C, D = system.A[0], system.B[0], system.C[0], system.D[0]
    p = len(C)
    after = np.hstack([B - gain @ D, -gain]).T  # the states that follow, one a row
    states = states_of((A - gain @ C).T[None], np.zeros((n - 1, 1, *after.shape)), after[None])
    return np.concatenate([np.hstack([D, np.eye(p)])[None], np.swapaxes(states[:, 0] @ C.T, 1, 2)])


def convolved(impulses: Array, series: Array) -> Array:
    """Return what signals (n, n_runs, q, k) become by impulse responses (n, p, q), (n, n_runs, p, k)."""
    n, size = len(series), np.abs(impulses).max(axis=(1, 2))
    find_permanent_changes = (
        1 + int(np.flatnonzero(size > INNOVATIONS.forgotten * size.max())[-1]) if np.any(size) else 1
    )
    length = next_fast_len(n + find_permanent_changes - 1, real=True)
    answer = rfft(impulses[:find_permanent_changes].astype(series.dtype), length, axis=0)[:, None]
    seen = rfft(series, length, axis=0)
    seen = answer * seen if series.shape[2] == 1 else answer @ seen
    return np.asarray(irfft(seen, length, axis=0, overwrite_x=True)[:n])


def middles(reduced_model: ReducedModel, group: Group) -> tuple[Array, Array, Array]:
    """Return modal displacement, velocity and acceleration in the middle of every step, from the samples before it.

    Only what was known at a sample goes into the laws that act after it: the smoothed motion knows the later samples, and
    a force made of it would explain their noise. The acceleration is the nominal model's own for the same reason.
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
