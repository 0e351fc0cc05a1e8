"""Linear time-varying system, filter and smoother along a motion.

Smoothing is the adjoint recursion of Bryson and Frazier (1963).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vlab.diagnose.predictors.step_jacobian import Stepper
from vlab.diagnose.predictors.trajectory_data import Motion, TrajectoryData, sampled
from vlab.diagnose.settings import TRAJECTORY
from vlab.parallel import side_by_side
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class TimeVaryingSystem:
    """Linear time-varying system of one run.

    Parameters
    ----------
    motion : Motion
        Motion about which the plant is linearised; time is the first axis of all arrays.
    A : (n, 2 nv, 2 nv) array
        State matrices from sample to sample.
    G : (n, 2 nv, nv) array
        Effect of generalised forces held over the interval.
    fine_A, fine_G : array
        State and input matrices of `TRAJECTORY.fine` equal parts of the interval.
    C, D : (n, p, 2 nv), (n, p, nv) array
        Channels per deviation and per force.
    M : (n, nv, nv) array
        Mass matrices.
    defect : (n, 2 nv) array
        Motion at the next sample minus the model's prediction; zero at the last sample.
    read : (n, p) array
        Channels along the motion.
    drives : (n, nv, n_driven) array
        Generalised force of unit commands of driven actuators.
    """

    motion: Motion
    A: Array
    G: Array
    fine_A: Array
    fine_G: Array
    C: Array
    D: Array
    M: Array
    defect: Array
    read: Array
    drives: Array


def linearise_along(
    trajectory: TrajectoryData, motion: Motion, stepper: Stepper, driven: Sequence[int]
) -> TimeVaryingSystem:
    """Linearise a plant along a motion.

    Parameters
    ----------
    trajectory : TrajectoryData
        Run.
    motion : Motion
        Motion at the run's samples.
    stepper : Stepper
        Stepped plant.
    driven : sequence of int
        Driven actuators.

    Returns
    -------
    TimeVaryingSystem
        Linear time-varying system.
    """
    n, nv, p = len(trajectory), stepper.nv, trajectory.y.shape[1]
    L, M = np.zeros((n, 2 * nv, 2 * nv)), np.zeros((n, nv, nv))
    C, D = np.zeros((n, p, 2 * nv)), np.zeros((n, p, nv))
    defect, read = np.zeros((n, 2 * nv)), np.zeros((n, p))
    drives = np.zeros((n, nv, len(driven)))
    columns = stepper.plant.control_matrix[:, list(driven)]
    for k in range(n):
        q, v = motion.q[k], motion.v[k]
        u, load = trajectory.inputs(k)
        act = None if trajectory.act is None else trajectory.act[k]
        L[k], M[k], by_control, sensors = stepper.slopes(q, v, u, load, act)
        drives[k] = M[k] @ (by_control @ columns)
        read[k], C[k], D[k] = stepper.reading(q, v, *trajectory.present(k), act, M[k], sensors)
        q1, v1 = stepper.advance(q, v, u, load, float(trajectory.h[k]), act)
        if k + 1 < n:
            defect[k] = np.concatenate([stepper.between(q1, motion.q[k + 1]), motion.v[k + 1] - v1])
    later = np.minimum(np.arange(1, n + 1), n - 1)
    fine_A, fine_G = sampled(0.5 * (L + L[later]), 0.5 * (M + M[later]), trajectory.h / TRAJECTORY.fine)
    A, G = fine_A, fine_G
    for _ in range(TRAJECTORY.fine - 1):
        A, G = fine_A @ A, fine_A @ G + fine_G
    return TimeVaryingSystem(
        motion=motion, A=A, G=G, fine_A=fine_A, fine_G=fine_G, C=C, D=D, M=M, defect=defect, read=read, drives=drives
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class SystemBatch:
    """Zero-padded batch of linear time-varying systems.

    Parameters
    ----------
    A, G, fine_A, fine_G, C, D, M, defect : (n, n_runs, ...) array
        Arrays of `TimeVaryingSystem`.
    e : (n, n_runs, p) array
        Recorded channels minus those along the motion.
    h : (n, n_runs) array
        Sample intervals [s].
    lengths : (n_runs,) array
        Samples of every run.
    spread : (n_runs, 2 nv) array
        Standard deviation of the initial deviation.
    noise : (p,) array
        Standard deviation of the channels' noise.
    usable : (n, n_runs, p) array
        Zero for uninformative samples and beyond a run's end.
    """

    A: Array
    G: Array
    fine_A: Array
    fine_G: Array
    C: Array
    D: Array
    M: Array
    defect: Array
    e: Array
    h: Array
    lengths: Array
    spread: Array
    noise: Array
    usable: Array

    @property
    def alive(self) -> Array:
        """Mask (n, n_runs) of recorded samples."""
        return np.arange(len(self.A))[:, None] < self.lengths[None, :]


def pad_and_stack(parts: Sequence[Array]) -> Array:
    """Return series of runs as a zero-padded batch.

    Parameters
    ----------
    parts : sequence of (n_i, ...) array
        Series of every run.

    Returns
    -------
    (n, n_runs, ...) array
        Batch.
    """
    n = max(len(part) for part in parts)
    out = np.zeros((n, len(parts), *parts[0].shape[1:]))
    for i, part in enumerate(parts):
        out[: len(part), i] = part
    return out


def stack(trajectories: Sequence[TrajectoryData], systems: Sequence[TimeVaryingSystem]) -> SystemBatch:
    """Return runs as a batch.

    Parameters
    ----------
    trajectories : sequence of TrajectoryData
        Runs.
    systems : sequence of TimeVaryingSystem
        Linear systems of the runs.

    Returns
    -------
    SystemBatch
        Batch.
    """
    spread = []
    for trajectory, along in zip(trajectories, systems, strict=True):
        largest = np.concatenate(
            [np.ptp(along.motion.q, axis=0).max(keepdims=True), np.abs(along.motion.v).max(axis=0)]
        )
        size = np.concatenate([np.full(along.M.shape[1], largest[0]), np.maximum(largest[1:], 1e-6)])
        spread.append((TRAJECTORY.at_rest if trajectory.at_rest else TRAJECTORY.unknown) * np.maximum(size, 1e-9))
    return SystemBatch(
        **{
            name: pad_and_stack([getattr(a, name) for a in systems])
            for name in ("A", "G", "fine_A", "fine_G", "C", "D", "M", "defect")
        },
        e=pad_and_stack([c.y - a.read for c, a in zip(trajectories, systems, strict=True)]),
        h=pad_and_stack([c.h for c in trajectories]),
        lengths=np.array([len(c) for c in trajectories]),
        spread=np.array(spread),
        noise=np.sqrt(np.mean([c.noise**2 for c in trajectories], axis=0)),
        usable=pad_and_stack([np.ones(c.y.shape) if c.valid is None else c.valid.astype(float) for c in trajectories]),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class FilterGains:
    """Gains and covariances of the filter, (n, n_runs, ...)."""

    K: Array
    S: Array
    P: Array


def gains_of(s: SystemBatch, intensity: Array | float, samples: int | None = None) -> FilterGains:
    """Return the gains of the Kalman filter.

    Parameters
    ----------
    s : SystemBatch
        Batch.
    intensity : float or (b, 1) array
        Variance of the unknown forces in units of the mass matrix [N^2/kg].
    samples : int or None
        Number of samples; all by default.

    Returns
    -------
    FilterGains
        Gains (n, b, n_runs, ...).
    """
    n = len(s.A) if samples is None else min(samples, len(s.A))
    q = np.asarray(intensity, dtype=float)[..., None, None]
    lead = np.broadcast_shapes(np.shape(intensity), (s.A.shape[1],))
    P = np.broadcast_to(np.einsum("ra,ab->rab", s.spread**2, np.eye(s.A.shape[2])), (*lead, *s.A.shape[2:])).copy()
    R = np.diag(s.noise**2)
    out = [np.zeros((n, *lead, *shape)) for shape in ((s.A.shape[2], len(R)), R.shape, s.A.shape[2:])]
    GM = s.G[:n] @ s.M[:n]
    Q, N = GM @ np.swapaxes(s.G[:n], 2, 3), GM @ np.swapaxes(s.D[:n], 2, 3)
    direct = s.D[:n] @ s.M[:n] @ np.swapaxes(s.D[:n], 2, 3)
    has_direct = bool(np.any(direct))
    for k in range(n):
        A, C = s.A[k], s.C[k]
        CT, AT = np.swapaxes(C, 1, 2), np.swapaxes(A, 1, 2)
        PC = P @ CT
        S = C @ PC + R
        cross = A @ PC
        if has_direct:
            S, cross = S + q * direct[k], cross + q * N[k]
        K = np.swapaxes(np.linalg.solve(S, np.swapaxes(cross, -1, -2)), -1, -2)
        out[0][k], out[1][k], out[2][k] = K, S, P
        P = A @ P @ AT + q * Q[k] - K @ np.swapaxes(cross, -1, -2)
        P = 0.5 * (P + np.swapaxes(P, -1, -2))
    return FilterGains(K=out[0], S=out[1], P=out[2])


def innovations(s: SystemBatch, gains: FilterGains, e: Array | None = None) -> tuple[Array, Array]:
    """Return innovations and predicted deviations, zero beyond a run's end.

    Parameters
    ----------
    s : SystemBatch
        Batch.
    gains : FilterGains
        Gains.
    e : (n, n_runs, p) array or None
        Channels minus those along the motion; those of the batch by default.

    Returns
    -------
    innovations : (n, ..., n_runs, p) array
        Innovations.
    predicted : (n, ..., n_runs, 2 nv) array
        Predicted deviations.
    """
    n, lead = len(gains.K), gains.K.shape[1:-2]
    given = s.e if e is None else e
    x = np.zeros((*lead, s.A.shape[2]))
    out, predicted = np.zeros((n, *lead, given.shape[2])), np.zeros((n, *x.shape))
    for k in range(n):
        predicted[k] = x
        left = (given[k] - np.einsum("rpa,...ra->...rp", s.C[k], x)) * s.usable[k]
        out[k] = left
        x = np.einsum("rab,...rb->...ra", s.A[k], x) - s.defect[k] + np.einsum("...ap,...p->...a", gains.K[k], left)
    return out, predicted


def smoothed(s: SystemBatch, gains: FilterGains, left: Array, predicted: Array) -> Array:
    """Return smoothed deviations by the Bryson-Frazier recursion.

    Parameters
    ----------
    s : SystemBatch
        Batch.
    gains : FilterGains
        Gains.
    left : (n, n_runs, p) array
        Innovations.
    predicted : (n, n_runs, 2 nv) array
        Predicted deviations.

    Returns
    -------
    (n, n_runs, 2 nv) array
        Smoothed deviations.
    """
    weighted = np.linalg.solve(gains.S, left[..., None])[..., 0]
    L = s.A - gains.K @ s.C
    r, out = np.zeros_like(predicted[0]), np.zeros_like(predicted)
    for k in range(len(left) - 1, -1, -1):
        r = np.einsum("rpa,rp->ra", s.C[k], weighted[k]) + np.einsum("rab,ra->rb", L[k], r)
        out[k] = predicted[k] + np.einsum("rab,rb->ra", gains.P[k], r)
    return out


def filtered(s: SystemBatch, gains: FilterGains, left: Array, predicted: Array) -> Array:
    """Return deviations given the samples up to their own."""
    own = np.einsum("krab,krpb->krap", gains.P, s.C)
    return np.asarray(predicted + np.einsum("krap,krp->kra", own, np.linalg.solve(gains.S, left[..., None])[..., 0]))


def tuned(s: SystemBatch, near: float | None = None) -> float:
    """Return the most likely intensity of the unknown forces.

    Parameters
    ----------
    s : SystemBatch
        Batch.
    near : float or None
        Earlier intensity near which to search.

    Returns
    -------
    float
        Intensity [N^2/kg].
    """
    response = np.abs(np.einsum("krpa,krab->krpb", s.C[1:], s.G[:-1])).max(axis=3) + np.abs(s.D[:-1]).max(axis=3)
    inertia = np.sqrt(np.einsum("krii->kri", s.M).max(axis=2))[:-1, :, None]
    seen = np.where(s.alive[1:, :, None], response * inertia, np.nan)
    reference = float(np.median(s.noise / np.maximum(np.nanmedian(seen, axis=(0, 1)), 1e-300)) ** 2)
    alive = s.alive[: TRAJECTORY.tuning_samples]

    def likeliest(grid: Array) -> float:
        gains = gains_of(s, grid[:, None], TRAJECTORY.tuning_samples)
        left, _ = innovations(s, gains)
        squared = np.einsum("kbrp,kbrp->kbr", left, np.linalg.solve(gains.S, left[..., None])[..., 0])
        values = -0.5 * np.sum((squared + np.linalg.slogdet(gains.S)[1]) * alive[:, None, :], axis=(0, 2))
        return float(grid[int(np.argmax(values))])

    if near is None:
        near = likeliest(reference * 10.0 ** np.arange(*TRAJECTORY.decades))
        return likeliest(near * 10.0 ** np.array(TRAJECTORY.finer))
    return likeliest(near * 10.0 ** np.array(TRAJECTORY.about_earlier))


def smoothed_motions(
    trajectories: Sequence[TrajectoryData],
    motions: Sequence[Motion],
    stepper: Stepper,
    driven: Sequence[int],
    passes: int,
    near: float | None = None,
) -> tuple[list[TimeVaryingSystem], SystemBatch, FilterGains, float]:
    """Linearise runs along their smoothed motion, in repeated passes.

    Parameters
    ----------
    trajectories : sequence of TrajectoryData
        Runs.
    motions : sequence of Motion
        Initial motions.
    stepper : Stepper
        Stepped plant.
    driven : sequence of int
        Driven actuators.
    passes : int
        Number of smoothing passes.
    near : float or None
        Earlier intensity near which to search.

    Returns
    -------
    systems : list of TimeVaryingSystem
        Linear systems.
    batch : SystemBatch
        Batch of the systems.
    gains : FilterGains
        Gains.
    intensity : float
        Intensity [N^2/kg].
    """
    current, intensity = list(motions), near
    for i in range(passes + 1):
        systems = side_by_side(
            lambda pair: linearise_along(pair[0], pair[1], stepper, driven),
            list(zip(trajectories, current, strict=True)),
        )
        s = stack(trajectories, systems)
        intensity = tuned(s, intensity)
        gains = gains_of(s, intensity)
        if i == passes:
            break
        left, predicted = innovations(s, gains)
        deviation = smoothed(s, gains, left, predicted)
        current = [
            _moved(stepper, m, deviation[: len(c), r])
            for r, (c, m) in enumerate(zip(trajectories, current, strict=True))
        ]
    assert intensity is not None
    return systems, s, gains, intensity


def _moved(stepper: Stepper, motion: Motion, deviation: Array) -> Motion:
    nv = stepper.nv
    if stepper.is_flat:
        return Motion(q=motion.q + deviation[:, :nv], v=motion.v + deviation[:, nv:])
    q = np.array([stepper.moved(a, d) for a, d in zip(motion.q, deviation[:, :nv], strict=True)])
    return Motion(q=q, v=motion.v + deviation[:, nv:])
