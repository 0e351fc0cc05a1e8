"""Kalman filter and smoother on the reduced model.

The predictor form (Kalman 1960) is

    x(k+1|k) = A x(k|k-1) + B f(k) + K e(k),  e(k) = y(k) - C x(k|k-1) - D f(k).

Unknown forces are white noise of equal intensity on every mode, correlated with accelerations through D. Smoothing is
the adjoint recursion of Bryson and Frazier (1963). The intensity maximises the likelihood of the innovations.

References
----------
R. E. Kalman, A new approach to linear filtering and prediction problems, J. Basic Eng. 82 (1960) 35-45.
A. E. Bryson, M. Frazier, Smoothing for linear and nonlinear dynamic systems, Proc. Optimum System Synthesis Conf.,
1963.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vlab.compilation import compiled
from vlab.diagnose.data.runs import Signals
from vlab.diagnose.kernels.recursion import states_of
from vlab.diagnose.parameters.discrete import Discrete, discretise
from vlab.diagnose.parameters.reduced_model import ReducedModel
from vlab.diagnose.settings import KALMAN
from vlab.signals import Array

FEW = KALMAN.few
"""FEW [samples]: initially allocated covariances, a constant of the compiled loops."""
MOST_RICCATI = KALMAN.most_riccati
"""MOST_RICCATI [samples]: longest Riccati recursion, a constant of the compiled loops."""
SETTLED = KALMAN.settled
"""SETTLED [1]: relative tolerance of the stationary covariance, a constant of the compiled loops."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FilterGains:
    """Transient and stationary gains of the Kalman filter.

    Parameters
    ----------
    K : (n_gains, n, p) array
        Gains.
    S : (n_gains, p, p) array
        Covariances of the innovations.
    P : (n_gains, n, n) array
        Covariances of the predicted state.
    """

    K: Array
    S: Array
    P: Array

    def at(self, k: int) -> int:
        """Return the index of the gain of sample k."""
        return min(k, len(self.K) - 1)


def filter_gains(system: Discrete, noise: Array, intensity: float, start: Array) -> FilterGains:
    """Return the Kalman gains of a system.

    The inputs of the system are all modal forces, and the first parameter set is used.

    Parameters
    ----------
    system : Discrete
        Discrete-time system.
    noise : (p,) array
        Standard deviation of the channels' noise.
    intensity : float
        Variance of the unknown force on every mode [N^2/kg].
    start : (n, n) array
        Covariance of the initial state.

    Returns
    -------
    FilterGains
        Gains.
    """
    A, B, C, D = (np.ascontiguousarray(part[0]) for part in (system.A, system.B, system.C, system.D))
    Q, N = intensity * B @ B.T, intensity * B @ D.T
    R = np.diag(noise**2) + intensity * D @ D.T
    K, S, P = (part.copy() for part in _riccati(A, C, Q, N, R, np.ascontiguousarray(start, dtype=float)))
    return FilterGains(K=K, S=S, P=P)


@compiled()
def _riccati(
    A: Array, C: Array, Q: Array, N: Array, R: Array, start: Array
) -> tuple[Array, Array, Array]:  # pragma: no cover - compiled
    """Return gains and covariances up to the stationary ones.

    Loops over elements compile several times faster than the slices and sums of arrays that they stand for.
    """
    n, p = A.shape[0], C.shape[0]
    Ks, Ss, Ps = np.empty((FEW, n, p)), np.empty((FEW, p, p)), np.empty((FEW, n, n))
    AT, CT = np.ascontiguousarray(A.T), np.ascontiguousarray(C.T)
    P, count = start, 0
    while count < MOST_RICCATI:
        AP = np.dot(A, P)
        S, APC = np.dot(C, np.dot(P, CT)), np.dot(AP, CT)
        right, K = np.empty((p, n)), np.empty((n, p))
        for i in range(p):
            for j in range(p):
                S[i, j] += R[i, j]
            for j in range(n):
                right[i, j] = APC[j, i] + N[j, i]
        KT = np.linalg.solve(S, right)
        if count == len(Ks):
            Ks, Ss, Ps = _with_room(Ks), _with_room(Ss), _with_room(Ps)
        for i in range(n):
            for j in range(p):
                K[i, j] = Ks[count, i, j] = KT[j, i]
            for j in range(n):
                Ps[count, i, j] = P[i, j]
        for i in range(p):
            for j in range(p):
                Ss[count, i, j] = S[i, j]
        count += 1
        grown, known = np.dot(AP, AT), np.dot(np.dot(K, S), KT)
        new, size, is_settled = np.empty((n, n)), 0.0, True
        for i in range(n):
            for j in range(n):
                grown[i, j] = grown[i, j] + Q[i, j] - known[i, j]
        for i in range(n):
            for j in range(n):
                new[i, j] = 0.5 * (grown[i, j] + grown[j, i])
                size = max(size, abs(new[i, j]))
        for i in range(n):
            for j in range(n):
                is_settled = is_settled and abs(new[i, j] - P[i, j]) <= SETTLED * size
        P = new
        if is_settled:
            break
    return Ks[:count], Ss[:count], Ps[:count]


@compiled()
def _with_room(kept: Array) -> Array:  # pragma: no cover - compiled
    """Return an array of matrices with doubled capacity."""
    out = np.empty((2 * len(kept), kept.shape[1], kept.shape[2]))
    for k in range(len(kept)):
        for i in range(kept.shape[1]):
            for j in range(kept.shape[2]):
                out[k, i, j] = kept[k, i, j]
    return out


@dataclass(frozen=True, kw_only=True, eq=False)
class Smoothed:
    """Filtered and smoothed runs of one sample period.

    Parameters
    ----------
    e : (n, n_runs, p) array
        Innovations, zero beyond a run's end.
    x : (n, n_runs, 2m) array
        Smoothed states, undefined beyond a run's end.
    filtered : (n, n_runs, 2m) array
        States given the samples up to their own.
    predicted : (n, n_runs, p) array
        Channels given earlier samples.
    lengths : (n_runs,) array
        Samples of every run.
    loglik : float
        Log-likelihood of the innovations [nat].
    """

    e: Array
    x: Array
    filtered: Array
    predicted: Array
    lengths: Array
    loglik: float


def run_filter(
    system: Discrete,
    gains: FilterGains,
    forces: Array,
    y: Array,
    lengths: Array,
    *,
    usable: Array | None = None,
    smooth: bool = True,
) -> Smoothed:
    """Filter and smooth a batch of runs.

    Parameters
    ----------
    system : Discrete
        Discrete-time system.
    gains : FilterGains
        Gains.
    forces : (n, n_runs, m) array
        Known modal forces.
    y : (n, n_runs, p) array
        Measured channels.
    lengths : (n_runs,) array
        Samples of every run.
    usable : (n, n_runs, p) array or None
        Zero for uninformative samples, which the filter skips.
    smooth : bool
        Whether to smooth.

    Returns
    -------
    Smoothed
        States, innovations and log-likelihood.
    """
    A, B, C, D = system.A[0], system.B[0], system.C[0], system.D[0]
    n, n_runs, p = y.shape
    direct = y - forces @ D.T
    driven = forces @ B.T
    alive = np.arange(n)[:, None] < lengths[None, :]
    x = np.zeros((n_runs, A.shape[0]))
    predicted, e = np.zeros((n, n_runs, A.shape[0])), np.zeros((n, n_runs, p))
    AT, CT = A.T.copy(), C.T.copy()
    KT = np.transpose(gains.K, (0, 2, 1)).copy()
    converged = min(len(gains.K) - 1, n) if usable is None else n  # the gain is stationary from here
    for k in range(converged):
        predicted[k] = x
        innovation = direct[k] - x @ CT
        innovation *= alive[k][:, None] if usable is None else alive[k][:, None] * usable[k]
        e[k] = innovation
        x = x @ AT + innovation @ KT[gains.at(k)] + driven[k]
    L = A[None] - gains.K @ C
    if converged < n:
        drive = direct[converged:] @ KT[-1] + driven[converged:]
        predicted[converged:] = states_of(L[-1].T[None], drive[:, None], x[None])[:, 0]
        e[converged:] = (direct[converged:] - predicted[converged:] @ CT) * alive[converged:, :, None]
    inverse = np.linalg.inv(gains.S)
    which = np.minimum(np.arange(n), len(gains.S) - 1)
    logdet = np.linalg.slogdet(gains.S)[1]
    squared = np.einsum("krp,kpq,krq->kr", e, inverse[which], e)
    loglik = -0.5 * float(np.sum((squared + logdet[which][:, None]) * alive))
    if not smooth:
        return Smoothed(e=e, x=predicted, filtered=predicted, predicted=y, lengths=lengths, loglik=loglik)
    own = np.linalg.solve(gains.S, C @ gains.P).transpose(0, 2, 1)  # P C^T S^-1, the measurement update
    filtered = predicted + np.einsum("kap,krp->kra", own[which], e)
    guess = predicted @ C.T + forces @ D.T
    weighted = np.einsum("krp,kpq->krq", e, inverse[which])
    if converged < n:  # backwards: r(k-1) = weighted(k) C + r(k) L(k)
        later = (weighted[converged:] @ C)[::-1]
        back = states_of(L[-1][None], later[:, None], np.zeros((1, *x.shape)))[:, 0]
        back = np.concatenate([back[1:], (back[-1] @ L[-1] + later[-1])[None]])[::-1]
        predicted[converged:] += back @ gains.P[-1]
        r = back[0]
    else:
        r = np.zeros_like(x)
    for k in range(converged - 1, -1, -1):
        i = which[k]
        r = weighted[k] @ C + r @ L[i]
        predicted[k] += r @ gains.P[i]
    return Smoothed(e=e, x=predicted, filtered=filtered, predicted=guess, lengths=lengths, loglik=loglik)


def stack_runs(runs: Sequence[Signals], parts: Sequence[Array]) -> tuple[Array, Array]:
    """Return series of runs as a zero-padded batch.

    Parameters
    ----------
    runs : sequence of Signals
        Runs.
    parts : sequence of (n_i, k) array
        Series of every run.

    Returns
    -------
    series : (n, n_runs, k) array
        Batch.
    lengths : (n_runs,) array
        Samples of every run.
    """
    lengths = np.array([len(run) for run in runs])
    out = np.zeros((lengths.max(), len(runs), parts[0].shape[1]))
    for i, part in enumerate(parts):
        out[: len(part), i] = part
    return out, lengths


def start_covariance(system: Discrete, y: Array) -> Array:
    """Return a wide covariance of the initial state.

    Every mode alone can explain the largest recorded motion.

    Parameters
    ----------
    system : Discrete
        Discrete-time system.
    y : (n, n_runs, p) array
        Measured channels.

    Returns
    -------
    (2m, 2m) array
        Diagonal covariance.
    """
    A, C = system.A[0], system.C[0]
    m = A.shape[0] // 2
    largest = np.abs(y).max(axis=(0, 1))
    out = np.zeros(2 * m)
    for i in range(2 * m):
        x, seen = np.zeros(2 * m), np.zeros(len(C))
        x[i] = 1.0
        for _ in range(KALMAN.start_steps):
            seen = np.maximum(seen, np.abs(C @ x))
            x = A @ x
        ratio = np.divide(largest, seen, out=np.full(len(C), np.inf), where=seen > 1e-12 * max(seen.max(), 1e-300))
        out[i] = 4.0 * float(ratio.min()) ** 2 if np.isfinite(ratio.min()) else 1.0
    return np.diag(np.maximum(out, 1e-300))


def tune(
    system: Discrete,
    noise: Array,
    forces: Array,
    y: Array,
    lengths: Array,
    usable: Array | None = None,
    near: float = 0.0,
) -> tuple[float, FilterGains]:
    """Return the most likely intensity, and its gains.

    Parameters
    ----------
    system : Discrete
        Discrete-time system.
    noise : (p,) array
        Standard deviation of the channels' noise.
    forces : (n, n_runs, m) array
        Known modal forces.
    y : (n, n_runs, p) array
        Measured channels.
    lengths : (n_runs,) array
        Samples of every run.
    usable : (n, n_runs, p) array or None
        Zero for uninformative samples.
    near : float
        Intensity near which to search [N^2/kg]; 0 for a full search.

    Returns
    -------
    intensity : float
        Variance of the unknown force on every mode [N^2/kg].
    gains : FilterGains
        Gains.
    """
    n = min(len(y), KALMAN.tuning_samples)
    short = np.minimum(lengths, n)
    part = None if usable is None else usable[:n]
    start = start_covariance(system, y)
    B, C = system.B[0], system.C[0]
    # scale of the search: the force that moves a channel by its noise in one step
    response = np.abs(C @ system.A[0] @ B).max(axis=1) + np.abs(system.D[0]).max(axis=1)
    moved = response > 0.0  # a channel across the motion of all modes has no such force
    reference = float(np.median(noise[moved] / response[moved]) ** 2) if moved.any() else 1.0

    def value(log_q: float) -> float:
        gains = filter_gains(system, noise, reference * 10.0**log_q, start)
        return run_filter(system, gains, forces[:n], y[:n], short, usable=part, smooth=False).loglik

    known: dict[float, float] = {}

    def best_of(options: Sequence[float]) -> float:
        known.update({o: value(o) for o in options if o not in known})
        return max(options, key=lambda o: known[o])

    coarse, fine = KALMAN.finer
    if near > 0:
        best = best_of([float(np.log10(near / reference)) + step for step in (-coarse, 0.0, coarse)])
    else:
        best = best_of([float(g) for g in np.arange(*KALMAN.decades)])
        best = best_of([best - coarse, best, best + coarse])
    best = best_of([best - fine, best, best + fine])
    intensity = reference * 10.0**best
    return intensity, filter_gains(system, noise, intensity, start)


def smoothed_states(reduced_model: ReducedModel, runs: Sequence[Signals]) -> tuple[list[Array], float]:
    """Return smoothed modal states on the nominal model.

    Parameters
    ----------
    reduced_model : ReducedModel
        Reduced model.
    runs : sequence of Signals
        Runs of one sample period.

    Returns
    -------
    states : list of (n_i, 2m) array
        Smoothed states.
    intensity : float
        Tuned intensity [N^2/kg].
    """
    system = discretise(
        reduced_model.M[None],
        reduced_model.C[None],
        reduced_model.K[None],
        np.eye(reduced_model.m),
        reduced_model.rows,
        runs[0].h,
    )
    y, lengths = stack_runs(runs, [run.y for run in runs])
    forces, _ = stack_runs(runs, [run.u @ reduced_model.forces.T + run.load @ reduced_model.loads.T for run in runs])
    usable = stack_runs(runs, [run.usable for run in runs])[0] if any(r.valid is not None for r in runs) else None
    noise = np.sqrt(np.mean([run.noise**2 for run in runs], axis=0))
    intensity, gains = tune(system, noise, forces, y, lengths, usable)
    x = run_filter(system, gains, forces, y, lengths, usable=usable).x
    return [x[: len(run), i] for i, run in enumerate(runs)], intensity
