"""Partial fractions fitted to frequency responses by variable projection.

Residues are eliminated in closed form, and poles follow by descent [1]_. The search removes superfluous poles and adds
poles where the residual has a peak.

References
----------
.. [1] G. H. Golub and V. Pereyra, Separable nonlinear least squares: the variable projection method and its
       applications, Inverse Problems 19 (2003) R1-R26.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from vlab.modal.noise import EXACT, common_weight, noise_model, roughness, rounding_floor
from vlab.modal.tall_matrices import in_blocks, orthonormal, product, stacked
from vlab.signals import Array, ComplexArray, FrequencyResponse

ZETA_RANGE = (1e-7, 3.0)
"""ZETA_RANGE [1]: bounds of damping ratios in the fit. Above 1 a pair is two real poles (a lag in the loop) and is not
reported."""
TRIAL_ZETAS = (0.001, 0.005, 0.02, 0.08, 0.25, 0.6)
"""TRIAL_ZETAS [1]: trial damping ratios of an added pole."""
MAX_ADDED = 6
"""MAX_ADDED [1]: largest number of poles added after the chart."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FitState:
    """The fit at given poles with eliminated residues.

    Derivatives are with respect to (log omega, log zeta).
    """

    theta: Array  # (n_poles, 2)
    cost: float  # sum of squared weighted errors
    gradient: Array
    normal: Array  # Gauss-Newton matrix
    gain: Array  # (n_poles,) cost increase without the pole, with all further poles fixed
    coefficients: Array  # (entry, column of the basis)
    errors: ComplexArray  # (line, entry), weighted

    @property
    def poles(self) -> ComplexArray:
        """Poles [rad/s]; -zeta omega alone for an overdamped pair."""
        omega, zeta = np.exp(self.theta.T)
        return omega * (-zeta + 1j * np.sqrt(np.maximum(1 - zeta**2, 0)))


class FitProblem:
    """Weighted data and partial fractions in q.

    The fractions are c1 + c2 q over D(q) = q^2 + 2 zeta omega q + omega^2, with additional powers of s. For sampled
    data q = (1 - 1/z) / T. The limit for T -> 0 is j omega, and no digits are lost at low frequencies.
    """

    def __init__(self, used: FrequencyResponse, step: float, powers: Sequence[int], variance: Array | None) -> None:
        self.omega = 2 * np.pi * used.freq
        self.shape = used.H.shape
        self.H = used.H.reshape(self.omega.size, -1)
        self.step = step
        self.q = 1j * self.omega if step == 0 else -np.expm1(-1j * self.omega * step) / step
        self.powers = np.stack([(1j * self.omega / self.omega[-1]) ** p for p in powers], axis=1)
        highest = 3 * self.omega[-1] if step == 0 else min(3 * self.omega[-1], 0.99 * np.pi / step)
        self.limits = np.log([(0.3 * self.omega[0], ZETA_RANGE[0]), (highest, ZETA_RANGE[1])])
        self.is_known = variance is not None
        self.weigh(roughness(used) if variance is None else variance, is_shared=True)

    def weigh(self, variance: Array, *, is_shared: bool) -> None:
        """Set the weights of lines and responses.

        Either each response has its own weights over the lines, or all share them up to a factor (one factorisation).
        """
        self.variance = variance
        self.weight = 1 / np.sqrt(variance)
        self.groups = [[e] for e in range(variance.shape[1])]
        if is_shared:
            self.weight = np.outer(*common_weight(variance))
            self.groups = [list(range(variance.shape[1]))]
        self.exact_cost = EXACT**2 * float(np.sum(np.abs(self.weight * self.H) ** 2))

    def bounded(self, theta: Array) -> Array:
        """Return the parameters clipped to their bounds."""
        return np.clip(theta, *self.limits)

    def noise(self, state: FitState) -> float:
        """Return the variance of a real weighted error.

        Correlated errors of neighbouring lines (windows, misfit) increase the variance.

        Parameters
        ----------
        state : FitState
            Present fit.

        Returns
        -------
        float
            Variance.
        """
        n_free = 2 * self.H.size - self.H.shape[1] * (2 * len(state.theta) + self.powers.shape[1]) - state.theta.size
        e = state.errors
        power = np.sum(np.abs(e) ** 2) + 1e-300
        rho = [float(np.sum((e[k:] * e[:-k].conj()).real) / power) for k in (1, 2, 3)]
        level = max(state.cost, self.exact_cost) / max(n_free, 1)
        return max(level, 0.5 * self.is_known) * (1 + 2 * sum(max(r, 0.0) for r in rho))

    def denominators(self, theta: Array) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Return D and its derivatives, (line, pole) each.

        The derivatives are with respect to log omega and log zeta.

        Parameters
        ----------
        theta : array
            log omega and log zeta of the poles, (n_poles, 2).

        Returns
        -------
        tuple of (complex array, complex array, complex array)
            D, dD/dlog omega, dD/dlog zeta.
        """
        omega, zeta = np.exp(theta.T)
        q, T = self.q[:, None], self.step
        if T == 0:
            linear = 2 * zeta * omega * q
            return q**2 + linear + omega**2, linear + 2 * omega**2, linear
        q = q * T
        a, x = zeta * omega * T, (1 - zeta**2) * (omega * T) ** 2  # z = exp(-a +- j sqrt(x))
        d = np.sqrt(np.abs(x)) + 1e-300
        v = np.where(x >= 0, 2 * np.sin(d / 2) ** 2, -2 * np.sinh(d / 2) ** 2)  # 1 - cos(sqrt(x))
        v_x = 0.5 * np.where(x >= 0, np.sin(d), np.sinh(d)) / d
        rho, u = np.exp(-a), -np.expm1(-a)
        D = u**2 + 2 * rho * v + 2 * rho * (u - v) * q + rho**2 * q**2

        def slope(da: Array, dx: Array) -> ComplexArray:
            du, dv = rho * da, v_x * dx
            return 2 * (u * du - du * v + rho * dv + (rho * (du - dv) - du * (u - v)) * q - rho * du * q**2)

        return D / T**2, slope(a, 2 * x) / T**2, slope(a, -2 * (zeta * omega * T) ** 2) / T**2

    def numerators(self, theta: Array) -> ComplexArray:
        """Return both numerators of each pole, (line, pole, 2).

        The scale gives order 1 over D at resonance.
        """
        omega, zeta = np.exp(theta.T)
        ones = np.ones_like(self.q)
        return np.stack([np.outer(ones, zeta * omega**2), np.outer(self.q, zeta * omega)], axis=2)

    def basis(self, theta: Array) -> ComplexArray:
        """Return all linear terms, (line, column).

        Two columns a pole precede the powers.
        """
        parts = self.numerators(theta) / self.denominators(theta)[0][:, :, None]
        return np.hstack([parts.reshape(self.q.size, 2 * len(theta)), self.powers])

    def evaluate(self, theta: Array) -> FitState:
        """Eliminate the residues and differentiate.

        Kaufman's form of variable projection gives the Jacobian.

        Parameters
        ----------
        theta : array
            log omega and log zeta of the poles, (n_poles, 2).

        Returns
        -------
        FitState
            Cost, gradient and Gauss-Newton matrix.
        """
        m, n_lines, n_entries = len(theta), *self.H.shape
        D, D_omega, D_zeta = self.denominators(theta)
        numerators = self.numerators(theta)
        basis = np.hstack([(numerators / D[:, :, None]).reshape(n_lines, 2 * m), self.powers])
        slopes = np.stack([-D_omega / D**2, -D_zeta / D**2], axis=2)  # (line, pole, parameter)
        slopes = (slopes[:, :, :, None] * numerators[:, :, None, :]).reshape(n_lines, 4 * m)  # times numerator
        normal, gradient, gain = np.zeros((m, 2, m, 2)), np.zeros((m, 2)), np.zeros(m)
        coefficients, errors = np.empty((basis.shape[1], n_entries)), np.empty_like(self.H)
        area = max(4 * m, basis.shape[1]) * max(4 * m, basis.shape[1], max(map(len, self.groups)))
        for group in self.groups:
            w, own = self.weight[:, group], self.weight[0, group]  # group[0] has the line weights, `own` the factors
            Q, inverse = orthonormal(in_blocks(stacked(w[:, :1] * basis), area))
            y = in_blocks(stacked(w * self.H[:, group]), area)
            at = product(Q, y)
            r = y - Q @ at
            c = inverse @ at
            V = in_blocks(stacked(w[:, :1] * slopes), area)
            V = V - Q @ product(Q, V)
            pairs = c[: 2 * m].reshape(m, 2, len(group))
            gradient += np.einsum("kje,kpje->kp", pairs, product(V, r).reshape(m, 2, 2, len(group)))
            both = np.einsum("kje,lie->kjli", pairs, pairs)
            normal += np.einsum("kpjlqi,kjli->kplq", product(V, V).reshape(m, 2, 2, m, 2, 2), both)
            gain += _gains(inverse, pairs)
            coefficients[:, group] = c * (own[0] / own)
            r = r.reshape(-1, len(group))  # pads the last block
            errors[:, group] = r[:n_lines] + 1j * r[n_lines : 2 * n_lines]
        return FitState(
            theta=theta,
            cost=float(np.sum(np.abs(errors) ** 2)),
            gradient=gradient.ravel(),
            normal=normal.reshape(2 * m, 2 * m),
            gain=gain,
            coefficients=coefficients.T,
            errors=errors,
        )

    def residues(self, state: FitState) -> ComplexArray:
        """Return the residues in s, (pole, output, input).

        Parameters
        ----------
        state : FitState
            Present fit.

        Returns
        -------
        complex array
            Residues, (pole, output, input).
        """
        omega, zeta = np.exp(state.theta.T)
        s, T = state.poles, self.step
        q = s if T == 0 else -np.expm1(-s * T) / T
        c = state.coefficients[:, : 2 * s.size].reshape(self.H.shape[1], s.size, 2)
        modal = c[:, :, 0] * (zeta * omega**2) + c[:, :, 1] * (zeta * omega * q)
        # D = exp(-2 zeta omega T) (q - q_k)(q - q_k*) and dq/ds = exp(-s T)
        slope = np.exp(-2 * zeta * omega * T) * 2j * q.imag * np.exp(-s * T)
        slope = np.where(slope == 0, 1.0, slope)  # overdamped pair: not reported
        return (modal / slope).T.reshape(s.size, *self.shape[1:])

    def candidate_gains(self, state: FitState, trial: Array) -> Array:
        """Return the cost decrease by each trial pole alone.

        Parameters
        ----------
        state : FitState
            Present fit.
        trial : array
            log omega and log zeta of the trial poles, (m, 2).

        Returns
        -------
        array
            Decrease of the cost, (m,).
        """
        w, basis = self.weight[:, :1], self.basis(state.theta)
        columns = self.numerators(trial) / self.denominators(trial)[0][:, :, None]
        area = 2 * len(trial) * max(basis.shape[1], self.H.shape[1])
        Q, _ = orthonormal(in_blocks(stacked(w * basis), area))
        V = in_blocks(stacked(w * columns.reshape(self.q.size, -1)), area)
        V = V - Q @ product(Q, V)
        onto = product(V, in_blocks(stacked(state.errors), area)).reshape(len(trial), 2, -1)
        pair = V.reshape(-1, len(trial), 2)
        return _quadratic(np.einsum("fmi,fmj->mij", pair, pair), onto)


def pole_mac(p: ComplexArray, q: ComplexArray) -> Array:
    """Return the MAC of the decays exp(p t) and exp(q t).

    The value is 1 for equal poles and 1/2 at a distance of half the half-power width.
    """
    return 4 * p.real[:, None] * q.real / np.abs(p[:, None] + q.conj()) ** 2


def _gains(inverse: Array, pairs: Array) -> Array:
    """Return the cost increase without each pole's coefficients."""
    rows = inverse[: 2 * len(pairs)].reshape(len(pairs), 2, len(inverse))
    return _quadratic(rows @ np.swapaxes(rows, 1, 2), pairs)


def _quadratic(gram: Array, columns: Array) -> Array:
    """Return the trace of B' A^-1 B for each pair of matrices.

    A is (pole, 2, 2) and may be singular to rounding; B is (pole, 2, column).
    """
    least = 1e-12 * np.trace(gram, axis1=1, axis2=2)[:, None, None] + 1e-300
    return np.sum(columns * np.linalg.solve(gram + least * np.eye(2), columns), axis=(1, 2))


def _descend(problem: FitProblem, theta: Array, steps: int = 40) -> FitState:
    """Minimise by Levenberg-Marquardt in (log omega, log zeta)."""
    state = problem.evaluate(problem.bounded(theta))
    damping = 1e-4
    for _ in range(steps if len(theta) else 0):
        scale = np.diag(state.normal) + 1e-12 * np.diag(state.normal).max() + 1e-300
        for _ in range(8):
            step = np.linalg.solve(state.normal + damping * np.diag(scale), state.gradient)
            moved = state.theta + np.clip(step.reshape(-1, 2), (-0.2, -1.0), (0.2, 1.0))
            trial = problem.evaluate(problem.bounded(moved))
            if trial.cost < state.cost:
                break
            damping *= 10
        else:
            return state
        expected = float(step @ state.gradient)
        state, damping = trial, max(damping / 10, 1e-12)
        if expected < 1e-4 * problem.noise(state):
            return state
    return state


def fit_partial_fractions(problem: FitProblem, start: ComplexArray, n_modes: int | None) -> FitState:
    """Return the partial fractions supported by the data.

    Parameters
    ----------
    problem : FitProblem
        Weighted data.
    start : complex array
        Start values of the poles [rad/s].
    n_modes : int or None
        Required number of modes; None for as many as supported.

    Returns
    -------
    FitState
        Fit.
    """
    most = max(1, problem.omega.size // 3 - problem.powers.shape[1])
    start = start[np.argsort(-start.real / np.abs(start))][:most]  # with few lines, lightly damped poles first
    theta = np.log(np.stack([np.abs(start), -start.real / np.abs(start)], axis=1))
    state = _pruned(problem, _descend(problem, theta, 8))
    room = MAX_ADDED
    for _ in range(2):
        problem.weigh(_updated_variance(problem, state), is_shared=True)
        state = _descend(problem, state.theta)
        while room > 0:
            must = n_modes is not None and int(np.sum(is_mode(problem, state))) < n_modes
            larger = _enriched(problem, state, must=must)
            if larger is None:
                break
            state, room = larger, room - 1
        state = _pruned(problem, state)
    problem.weigh(_updated_variance(problem, state), is_shared=False)
    return _descend(problem, state.theta)


def _updated_variance(problem: FitProblem, state: FitState) -> Array:
    """Return the variance from the residual.

    A known variance stands unless the model lacks a pole.
    """
    problem.is_known &= state.cost < 4 * problem.H.size  # within twice the known standard deviation
    if problem.is_known:
        return problem.variance
    error = state.errors / problem.weight
    fitted = problem.H - error  # weighting by the measured H would favour lines that noise made small
    return noise_model(np.abs(error) ** 2, fitted) + rounding_floor(problem.H)


def _penalty(problem: FitProblem, state: FitState) -> float:
    """Return the cost decrease required of another pole.

    The Bayesian information criterion gives the value.
    """
    return (2 * problem.H.shape[1] + 2) * float(np.log(2 * problem.omega.size)) * problem.noise(state)


def is_mode(problem: FitProblem, state: FitState) -> NDArray[np.bool_]:
    """Return a mask of oscillating poles within the band."""
    omega, zeta = np.exp(state.theta.T)
    return (omega >= problem.omega[0]) & (omega <= problem.omega[-1]) & (zeta < 1)


def fits_several_lines(problem: FitProblem, state: FitState, pole: int) -> bool:
    """Return whether a pole is significant without its best line.

    The residues of a narrow pole fit any single line exactly, so an outlier is no resonance.

    Parameters
    ----------
    problem : FitProblem
        Weighted data.
    state : FitState
        Fit.
    pole : int
        Index of the pole.

    Returns
    -------
    bool
        Whether the other lines decrease the cost by more than the information criterion asks.
    """
    without = problem.evaluate(np.delete(state.theta, pole, axis=0))
    lines = np.sum(np.abs(without.errors) ** 2 - np.abs(state.errors) ** 2, axis=1)
    return bool(lines.sum() - lines.max() > _penalty(problem, state))


def _pruned(problem: FitProblem, state: FitState) -> FitState:
    """Remove poles with a small effect on the cost.

    The remaining poles are refitted.
    """
    spared: list[complex] = []
    while len(state.theta):
        penalty = _penalty(problem, state)
        poles = state.poles
        alike = pole_mac(poles, poles) - np.eye(len(poles))
        doubtful = state.gain < 30 * penalty
        doubtful |= (np.max(alike, axis=1) > 0.3) & (state.gain < 1e4 * penalty)
        doubtful &= ~np.isin(poles, spared)
        if not np.any(doubtful):
            break
        weakest = int(np.argmin(np.where(doubtful, state.gain, np.inf)))
        without = _descend(problem, np.delete(state.theta, weakest, axis=0), 10)
        if without.cost - state.cost < penalty:
            state, spared = without, []
        else:
            spared.append(poles[weakest])
    return state


def _enriched(problem: FitProblem, state: FitState, *, must: bool) -> FitState | None:
    """Add a pole at the largest residual, or return None."""
    if state.cost <= problem.exact_cost or 2 * len(state.theta) + problem.powers.shape[1] > problem.omega.size - 4:
        return None
    power = uniform_filter1d(np.sum(np.abs(state.errors) ** 2, axis=1), 3)
    inner = np.flatnonzero((power[1:-1] >= power[:-2]) & (power[1:-1] >= power[2:])) + 1
    peaks = problem.omega[inner[np.argsort(power[inner])[-12:]]]
    centres = np.concatenate([peaks, np.linspace(problem.omega[0], problem.omega[-1], 14)[1:-1]])
    trial = np.log(np.array([(omega, zeta) for omega in centres for zeta in TRIAL_ZETAS]))
    gains = problem.candidate_gains(state, trial)
    best = trial[np.argmax(gains)]
    if not must and gains.max() < 0.25 * _penalty(problem, state):
        return None
    larger = _descend(problem, np.vstack([state.theta, best]), 20)
    return larger if must or state.cost - larger.cost > _penalty(problem, larger) else None
