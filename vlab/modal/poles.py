"""Poles, damping ratios and mode shapes from frequency responses.

Three steps. Polyreference least squares (pLSCF) at many model orders gives a stabilisation chart without starting
values; poles that persist over the orders are starting values for a weighted least squares fit of partial fractions
(maximum likelihood when the variance is known), in which the residues are eliminated in closed form; then poles that
the data do not need are taken out, and poles that the residual asks for are put in.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.optimize import linear_sum_assignment

from vlab.errors import BadRecording
from vlab.modal.frf import MeasuredFrequencyResponse
from vlab.signals import Array, ComplexArray, FrequencyResponse, ModalModel

FREQ_TOLERANCE, ZETA_TOLERANCE = 0.01, 0.05
"""A pole is marked stable when one of the order before is this near, relatively (customary for such charts)."""
PROPORTIONAL_ERROR = 0.01
"""Relative error of H assumed before any residual is known, so that sharp peaks do not drown what is heavily damped."""
EXACT = 1e-8
"""Relative misfit below which data count as exact: what is smaller is rounding, not modes."""
ZETA_RANGE = (1e-7, 3.0)
"""Damping ratios that the fit may visit; above 1 a pair is two real poles (a lag in the loop) and not reported."""
TRIAL_ZETAS = (0.001, 0.005, 0.02, 0.08, 0.25, 0.6)
"""Damping ratios that are tried where the residual shows that a pole is missing."""
GHOST_MAC = 0.8
"""Shapes that are more alike, of poles that the lines do not resolve, are one mode and its leakage."""
MAX_ADDED = 6
"""Poles that may be added after the chart."""
PRODUCT_SIZE = 200_000
"""Multiplications in one matrix product. From 262 144 OpenBLAS wakes a second thread, which for matrices this small
costs up to ten times what it saves wherever another program keeps a core busy."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Stabilisation:
    """All poles with positive damping and imaginary part that were found at each model order.

    Parameters
    ----------
    order : (n,) int array
        Order of the denominator at which the pole was found.
    freq, zeta : (n,) array
        Natural frequency [Hz] and damping ratio.
    is_stable : (n,) bool array
        Whether the order before had it too, within `FREQ_TOLERANCE` and `ZETA_TOLERANCE`.
    """

    order: NDArray[np.int_]
    freq: Array
    zeta: Array
    is_stable: NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True, eq=False)
class PoleEstimate:
    """What the frequency responses say about the modes, with evidence.

    Parameters
    ----------
    s : (n_modes,) complex array
        Poles [rad/s], imaginary part positive, by ascending natural frequency.
    freq, zeta : (n_modes,) array
        Natural frequency abs(s) / 2 pi [Hz] and damping ratio.
    shapes : (n_outputs, n_modes) complex array
        Residues, scaled so that the largest component of each mode is 1.
    participation : (n_inputs, n_modes) complex array
        The residue matrix of a mode is shape times participation (transposed).
    freq_sd, zeta_sd : (n_modes,) array
        Standard deviations from the residual [Hz], [1]; leakage and nonlinearity are not in them.
    confidence : (n_modes,) array
        0 to 1: how well the pole is found again by itself over the upper half of the model orders.
    stabilisation : Stabilisation
        For the chart.
    fitted : FrequencyResponse
        The partial fractions at the lines of the data.
    residual : float
        Relative misfit, norm(H - fitted) / norm(H).
    n_nuisance : int
        Further poles in the fit that are not reported: outside the band, overdamped, or below the confidence asked for.
    """

    s: ComplexArray
    freq: Array
    zeta: Array
    shapes: ComplexArray
    participation: ComplexArray
    freq_sd: Array
    zeta_sd: Array
    confidence: Array
    stabilisation: Stabilisation
    fitted: FrequencyResponse
    residual: float
    n_nuisance: int

    def real_shapes(self) -> Array:
        """Return the shapes turned to where they are most nearly real, and their real part, largest component 1."""
        turned = self.shapes * np.exp(-0.5j * np.angle(np.sum(self.shapes**2, axis=0)))
        return turned.real / _largest(turned.real)

    def to_modal_model(self, *, is_real: bool = True) -> ModalModel:
        """Return frequencies, damping ratios and shapes (real by default) at the output channels."""
        shapes = self.real_shapes() if is_real else self.shapes
        return ModalModel(freq=self.freq, zeta=self.zeta, shapes=shapes, coordinates=self.fitted.outputs)


def estimate_poles(
    frf: FrequencyResponse,
    *,
    sample_rate: float | None = None,
    band_hz: tuple[float, float] | None = None,
    orders: Sequence[int] | None = None,
    n_modes: int | None = None,
    min_confidence: float = 0.5,
    residual_powers: Sequence[int] = (-2, -1, 0, 1, 2),
) -> PoleEstimate:
    """Estimate poles and mode shapes from frequency responses.

    Lines need not be evenly spaced. Damping ratios from 0.0005 to 0.6 may stand side by side. Residues belong to a real
    system (conjugate pairs), poles are stable.

    Parameters
    ----------
    frf : FrequencyResponse
        Receptance, mobility or accelerance. A `MeasuredFrequencyResponse` is weighted by its variance; otherwise an
        additive and a proportional noise of each response are estimated from the residual.
    sample_rate : float
        Of sampled responses [Hz]: the partial fractions are then those of a sampled system, exact up to half of it.
        None for continuous ones. Far below half the rate it makes no difference.
    band_hz : (low, high)
        Lines used and modes reported; all by default.
    orders : sequence of int
        Model orders of the chart, about 2 to 5 times the number of modes; by default every second from 4 to 60.
    n_modes : int
        Report at most so many, the most significant ones, however low their confidence. None: what the data support.
    min_confidence : float
        Below, a pole is not reported (only without `n_modes`).
    residual_powers : sequence of int
        Powers of j omega that stand for all modes outside the band.

    Returns
    -------
    PoleEstimate

    Raises
    ------
    BadRecording
        Too few lines in the band for the orders, a band without lines, or no pole found.

    References
    ----------
    .. [1] Guillaume, Verboven, Vanlanduit, Van der Auweraer and Peeters, "A poly-reference implementation of the
       least-squares complex frequency-domain estimator", IMAC XXI, 2003.
    .. [2] Cauberghe, Guillaume, Verboven, Vanlanduit and Parloo, "On the influence of the parameter constraint on the
       stability of the poles and the discrimination capabilities of the stabilisation diagrams", MSSP 19, 2005 (why
       the highest coefficient of exp(-j omega T) is the one set to 1: spurious poles then come out unstable).
    .. [3] Golub and Pereyra, "Separable nonlinear least squares: the variable projection method", Inverse Problems 19,
       2003.
    """
    used, step = _checked(frf, sample_rate, band_hz)
    wanted = _checked_orders(orders, used)
    problem = _Problem(used, step, residual_powers, _known_variance(used))
    charts = [_plscf(problem, wanted)]
    state = _fit(problem, _persistent(charts[0], problem.omega), n_modes)
    charts.append(_plscf(problem, wanted, state.poles))
    return _report(used, problem, state, charts, wanted, n_modes, min_confidence)


def _checked(
    frf: FrequencyResponse, sample_rate: float | None, band_hz: tuple[float, float] | None
) -> tuple[FrequencyResponse, float]:
    """Return the lines used and the sampling interval (0: continuous)."""
    low, high = (0.0, np.inf) if band_hz is None else band_hz
    if not 0 <= low < high:
        raise BadRecording(f"band_hz = ({low:g}, {high:g}) is not a band; give (low, high) in Hz")
    if sample_rate is not None and not sample_rate > 0:
        raise BadRecording(f"sample_rate = {sample_rate:g} Hz must be positive (None for continuous responses)")
    nyquist = np.inf if sample_rate is None else sample_rate / 2
    used = frf.between(max(low, np.finfo(float).tiny), min(high, nyquist * (1 - 1e-12)))
    if used.freq.size < 8:
        span = f"{frf.freq[0]:g} to {frf.freq[-1]:g} Hz" if frf.freq.size else "none"
        raise BadRecording(
            f"{used.freq.size} usable lines between {low:g} and {high:g} Hz (the response has {frf.freq.size}: {span}); "
            "at least 8 are needed: widen band_hz or measure longer"
        )
    if not np.any(used.H):
        raise BadRecording("all responses in the band are zero")
    return used, 0.0 if sample_rate is None else 1 / sample_rate


def _checked_orders(orders: Sequence[int] | None, used: FrequencyResponse) -> list[int]:
    """Return ascending orders that the number of lines can carry."""
    n_in = len(used.inputs)
    limit = (2 * used.freq.size - 2) // (2 * (n_in + 1))
    if orders is None:
        return list(range(2 if n_in > 1 else 4, max(6, min(60 // n_in, limit)) + 1, 2 if n_in < 4 else 1))
    chosen = sorted({int(n) for n in orders})
    if not chosen or chosen[0] < 2 or chosen[-1] > limit:
        raise BadRecording(f"orders {list(orders)} must be from 2 to {limit}, which {used.freq.size} lines can carry")
    return chosen


def _known_variance(used: FrequencyResponse) -> Array | None:
    """Return the measured variance, smoothed over lines: from few periods it scatters too much to weight by."""
    if not isinstance(used, MeasuredFrequencyResponse) or used.variance is None:
        return None
    H, variance = used.H.reshape(used.freq.size, -1), used.variance.reshape(used.freq.size, -1)
    smooth = _noise_model(variance, H)
    spare = max(np.nan_to_num(used.n_averages) - len(used.inputs), 1.0)  # degrees of freedom of each variance
    width = int(min(used.freq.size, np.ceil(80 / spare) + 1))
    return smooth * uniform_filter1d(variance / (smooth + 1e-300), width, axis=0, mode="nearest") + _floor(H)


def _roughness(used: FrequencyResponse) -> Array:
    """Return a first guess of the variance from how far each line is from the chord between its neighbours."""
    f, H = used.freq, used.H.reshape(used.freq.size, -1)
    part = ((f[1:-1] - f[:-2]) / (f[2:] - f[:-2]))[:, None]
    apart = np.abs(H[1:-1] - (1 - part) * H[:-2] - part * H[2:]) ** 2 / (1 + part**2 + (1 - part) ** 2)
    additive = np.median(apart, axis=0) / np.log(2)  # the square of a complex Gaussian number is exponential
    return additive + (PROPORTIONAL_ERROR * np.abs(H)) ** 2 + _floor(H)


def _floor(H: ComplexArray) -> Array:
    power = np.abs(H) ** 2
    return EXACT**2 * (power + 1e-4 * power.mean(axis=0) + 1e-30 * power.max())


def _noise_model(squares: Array, H: ComplexArray) -> Array:
    """Fit variance = a + b abs(H)^2 to squared errors, per column (Itakura-Saito distance, multiplicative updates)."""
    level = squares.mean(axis=0)
    y, x = squares / (level + 1e-300), np.abs(H) ** 2
    x = x / (x.mean(axis=0) + 1e-300)
    a, b = np.full(level.shape, 0.5), np.full(level.shape, 0.5)
    for _ in range(60):
        v = a + b * x + 1e-30
        a = a * np.sqrt(np.sum(y / v**2, axis=0) / np.sum(1 / v, axis=0))
        v = a + b * x + 1e-30
        b = b * np.sqrt(np.sum(y * x / v**2, axis=0) / (np.sum(x / v, axis=0) + 1e-30))
    return level * (a + b * x)


def _plscf(problem: "_Problem", orders: Sequence[int], known: ComplexArray | None = None) -> list[ComplexArray]:
    """Return the damped, oscillating poles at each order of the right matrix fraction B(w) A(w)^-1, w = exp(-j omega T).

    A band from low frequencies fills the half circle and the coefficients are real. A band far from 0 is moved to its
    centre, fills most of the circle, and the coefficients are complex; its mirror image is then out of band. Poles
    known already divide the equations by what they make of A(w) [Sanathanan and Koerner, IEEE Trans. Autom. Control 8,
    1963], which takes out the bias and the dominance of sharp peaks that the linearisation brought in.
    """
    omega, (n_lines, n_out, n_in) = problem.omega, problem.shape
    top = max(orders)
    is_real = omega[0] < 0.5 * omega[-1]
    centre = 0.0 if is_real else 0.5 * (omega[0] + omega[-1])
    T = np.pi / omega[-1] if is_real else 0.8 * 2 * np.pi / (omega[-1] - omega[0])
    w = np.exp(-1j * (omega - centre) * T)
    line, factor = _common_weight(problem.variance)
    H = problem.H.reshape(problem.shape) / np.sqrt(np.mean(factor.reshape(n_out, n_in) ** -2, axis=1))[:, None]
    if known is not None:
        roots = np.exp(-(np.concatenate([known, known.conj()]) if is_real else known - 1j * centre) * T)
        line = line / np.prod(np.abs(w[:, None] - roots), axis=1)
    powers = line[:, None] * w[:, None] ** np.arange(top + 1)
    size = (top + 1) * n_in

    def blocks(a: NDArray[Any]) -> NDArray[Any]:
        return _in_blocks(_stacked(a) if is_real else a, size**2)

    Q, _ = _orthonormal(blocks(powers))
    gram, explained = np.zeros((size, size)), []
    for o in range(n_out):
        Y = blocks((-powers[:, :, None] * H[:, o, None, :]).reshape(n_lines, size))
        explained.append(_product(Q, Y))
        rest = Y - Q @ explained[-1]
        gram = gram + _product(rest, rest)
    # Column n of Q is what column n of B adds to those before: an order below the top leaves Y what later ones explain,
    # so that one orthogonalisation serves all orders.
    R = np.stack(explained, axis=1)
    chart: dict[int, ComplexArray] = {}
    below = top
    for n in sorted(orders, reverse=True):
        exposed = R[n + 1 : below + 1].reshape(-1, size)
        gram, below = gram + exposed.conj().T @ exposed, n
        m = n * n_in
        alpha = np.linalg.lstsq(gram[:m, :m], -gram[:m, m : m + n_in], rcond=None)[0]  # the highest coefficient is 1
        companion = np.eye(m, k=n_in, dtype=alpha.dtype)
        companion[-n_in:] = -np.hstack([alpha[j : j + n_in] for j in range(0, m, n_in)])
        roots = np.linalg.eigvals(companion).astype(complex)
        s = -np.log(roots[np.abs(roots) > 1]) / T + 1j * centre
        chart[n] = s[s.imag > 0]
    return [chart[n] for n in orders]


def _common_weight(variance: Array) -> tuple[Array, Array]:
    """Return weights over the lines and factors of the responses whose products come near 1 / sqrt(variance)."""
    size = 1 / np.mean(1 / variance, axis=0)
    return 1 / np.sqrt(np.mean(variance / size, axis=1)), 1 / np.sqrt(size)


def _in_blocks(A: NDArray[Any], area: int) -> NDArray[Any]:
    """Cut a tall matrix (padded with zeros) into blocks of rows of which products with `area` results stay small."""
    size = PRODUCT_SIZE // 4 if np.iscomplexobj(A) else PRODUCT_SIZE  # a complex product is four real ones
    rows = min(len(A), max(8, size // area))
    n_blocks = -(-len(A) // rows)
    return np.vstack([A, np.zeros((n_blocks * rows - len(A), A.shape[1]))]).reshape(n_blocks, rows, A.shape[1])


def _product(A: NDArray[Any], B: NDArray[Any]) -> NDArray[Any]:
    """Return A^H B of matrices in blocks of rows."""
    return np.sum(np.swapaxes(A, 1, 2).conj() @ B, axis=0)


def _stacked(a: NDArray[Any]) -> Array:
    return np.concatenate([a.real, a.imag], axis=-2)


def _pole_mac(p: ComplexArray, q: ComplexArray) -> Array:
    """Return the MAC of the decays exp(p t) and exp(q t): 1 for equal poles, 1/2 a half-power half-width apart."""
    return 4 * p.real[:, None] * q.real / np.abs(p[:, None] + q.conj()) ** 2


def _persistent(chart: list[ComplexArray], omega: Array) -> ComplexArray:
    """Follow poles from order to order and return one for each trail that lasts, in the band or just outside."""
    low, high = omega[0] - 0.1 * np.ptp(omega), omega[-1] + 0.1 * np.ptp(omega)
    trails: list[list[complex]] = []
    born: list[int] = []
    for i, found in enumerate(chart):
        poles = found[(np.abs(found) >= low) & (np.abs(found) <= high)]
        taken = np.zeros(poles.size, bool)
        if trails and poles.size:
            alike = _pole_mac(np.array([trail[-1] for trail in trails]), poles)
            for row, column in zip(*linear_sum_assignment(alike, maximize=True), strict=True):
                if alike[row, column] > 0.3:
                    trails[row].append(poles[column])
                    taken[column] = True
        trails += [[p] for p in poles[~taken]]
        born += [i] * int(np.sum(~taken))
    chosen = []
    for trail, first in zip(trails, born, strict=True):
        if len(trail) >= max(3, len(chart) / 6, 0.4 * (len(chart) - first)):
            late = np.array(trail[len(trail) // 2 :])
            chosen.append(late[np.argmax(_pole_mac(late, late).sum(axis=0))])
    return np.array(chosen, complex)


@dataclass(frozen=True, kw_only=True, eq=False)
class _State:
    """The fit at given poles: residues are eliminated, derivatives are with respect to (log omega, log zeta)."""

    theta: Array  # (n_poles, 2)
    cost: float  # sum of squared weighted errors
    gradient: Array
    normal: Array  # Gauss-Newton matrix
    gain: Array  # (n_poles,) what the cost loses without the pole, the other poles staying
    coefficients: Array  # (entry, column of the basis)
    errors: ComplexArray  # (line, entry), weighted

    @property
    def poles(self) -> ComplexArray:
        """The poles [rad/s]; overdamped pairs are given by -zeta omega alone."""
        omega, zeta = np.exp(self.theta.T)
        return omega * (-zeta + 1j * np.sqrt(np.maximum(1 - zeta**2, 0)))


class _Problem:
    """Weighted data, and the partial fractions c1 + c2 q over D(q) = q^2 + 2 zeta omega q + omega^2 with powers of s.

    For sampled data q = (1 - 1/z) / T, which is j omega for T -> 0 and does not lose digits at low frequencies.
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
        self.weigh(_roughness(used) if variance is None else variance, is_shared=True)

    def weigh(self, variance: Array, *, is_shared: bool) -> None:
        """Set the weights: each response its own over the lines, or all one but for a factor (one factorisation)."""
        self.variance = variance
        self.weight = 1 / np.sqrt(variance)
        self.groups = [[e] for e in range(variance.shape[1])]
        if is_shared:
            self.weight = np.outer(*_common_weight(variance))
            self.groups = [list(range(variance.shape[1]))]
        self.exact_cost = EXACT**2 * float(np.sum(np.abs(self.weight * self.H) ** 2))

    def bounded(self, theta: Array) -> Array:
        """Return the parameters moved into where the fit may go."""
        return np.clip(theta, *self.limits)

    def noise(self, state: _State) -> float:
        """Return the variance of a real weighted error, more where neighbouring lines err alike (windows, misfit)."""
        n_free = 2 * self.H.size - self.H.shape[1] * (2 * len(state.theta) + self.powers.shape[1]) - state.theta.size
        e = state.errors
        power = np.sum(np.abs(e) ** 2) + 1e-300
        rho = [float(np.sum((e[k:] * e[:-k].conj()).real) / power) for k in (1, 2, 3)]
        level = max(state.cost, self.exact_cost) / max(n_free, 1)
        return max(level, 0.5 * self.is_known) * (1 + 2 * sum(max(r, 0.0) for r in rho))

    def denominators(self, theta: Array) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Return D and its derivatives by log omega and log zeta, (line, pole) each."""
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
        """Return the two numerators of each pole, (line, pole, 2), scaled to order 1 over D at resonance."""
        omega, zeta = np.exp(theta.T)
        ones = np.ones_like(self.q)
        return np.stack([np.outer(ones, zeta * omega**2), np.outer(self.q, zeta * omega)], axis=2)

    def basis(self, theta: Array) -> ComplexArray:
        parts = self.numerators(theta) / self.denominators(theta)[0][:, :, None]
        return np.hstack([parts.reshape(self.q.size, 2 * len(theta)), self.powers])

    def evaluate(self, theta: Array) -> _State:
        """Eliminate the residues and differentiate (Kaufman's form of variable projection)."""
        m, n_lines, n_entries = len(theta), *self.H.shape
        D, D_omega, D_zeta = self.denominators(theta)
        numerators = self.numerators(theta)
        basis = np.hstack([(numerators / D[:, :, None]).reshape(n_lines, 2 * m), self.powers])
        slopes = np.stack([-D_omega / D**2, -D_zeta / D**2], axis=2)  # (line, pole, parameter)
        slopes = (slopes[:, :, :, None] * numerators[:, :, None, :]).reshape(n_lines, 4 * m)  # ... times numerator
        normal, gradient, gain = np.zeros((m, 2, m, 2)), np.zeros((m, 2)), np.zeros(m)
        coefficients, errors = np.empty((basis.shape[1], n_entries)), np.empty_like(self.H)
        area = max(4 * m, basis.shape[1]) * max(4 * m, basis.shape[1], max(map(len, self.groups)))
        for group in self.groups:
            w, own = self.weight[:, group], self.weight[0, group]  # group[0] carries the lines, `own` the factors
            Q, inverse = _orthonormal(_in_blocks(_stacked(w[:, :1] * basis), area))
            y = _in_blocks(_stacked(w * self.H[:, group]), area)
            at = _product(Q, y)
            r = y - Q @ at
            c = inverse @ at
            V = _in_blocks(_stacked(w[:, :1] * slopes), area)
            V = V - Q @ _product(Q, V)
            pairs = c[: 2 * m].reshape(m, 2, len(group))
            gradient += np.einsum("kje,kpje->kp", pairs, _product(V, r).reshape(m, 2, 2, len(group)))
            both = np.einsum("kje,lie->kjli", pairs, pairs)
            normal += np.einsum("kpjlqi,kjli->kplq", _product(V, V).reshape(m, 2, 2, m, 2, 2), both)
            gain += _gains(inverse, pairs)
            coefficients[:, group] = c * (own[0] / own)
            r = r.reshape(-1, len(group))  # with the padding at its end
            errors[:, group] = r[:n_lines] + 1j * r[n_lines : 2 * n_lines]
        return _State(
            theta=theta,
            cost=float(np.sum(np.abs(errors) ** 2)),
            gradient=gradient.ravel(),
            normal=normal.reshape(2 * m, 2 * m),
            gain=gain,
            coefficients=coefficients.T,
            errors=errors,
        )

    def residues(self, state: _State) -> ComplexArray:
        """Return the residues in s, (pole, output, input)."""
        omega, zeta = np.exp(state.theta.T)
        s, T = state.poles, self.step
        q = s if T == 0 else -np.expm1(-s * T) / T
        c = state.coefficients[:, : 2 * s.size].reshape(self.H.shape[1], s.size, 2)
        modal = c[:, :, 0] * (zeta * omega**2) + c[:, :, 1] * (zeta * omega * q)
        # D = exp(-2 zeta omega T) (q - q_k)(q - q_k*) and dq/ds = exp(-s T)
        slope = np.exp(-2 * zeta * omega * T) * 2j * q.imag * np.exp(-s * T)
        slope = np.where(slope == 0, 1.0, slope)  # overdamped: not reported
        return (modal / slope).T.reshape(s.size, *self.shape[1:])

    def candidate_gains(self, state: _State, trial: Array) -> Array:
        """Return what the cost loses with each trial pole (one at a time) beside those of the state."""
        w, basis = self.weight[:, :1], self.basis(state.theta)
        columns = self.numerators(trial) / self.denominators(trial)[0][:, :, None]
        area = 2 * len(trial) * max(basis.shape[1], self.H.shape[1])
        Q, _ = _orthonormal(_in_blocks(_stacked(w * basis), area))
        V = _in_blocks(_stacked(w * columns.reshape(self.q.size, -1)), area)
        V = V - Q @ _product(Q, V)
        onto = _product(V, _in_blocks(_stacked(state.errors), area)).reshape(len(trial), 2, -1)
        pair = V.reshape(-1, len(trial), 2)
        gram = np.einsum("fmi,fmj->mij", pair, pair)
        gram += (1e-12 * np.trace(gram, axis1=1, axis2=2)[:, None, None] + 1e-300) * np.eye(2)
        return np.sum(onto * np.linalg.solve(gram, onto), axis=(1, 2))


def _orthonormal(A: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return Q and R^-1 of A = Q R for a tall matrix in blocks of rows.

    Cholesky QR twice: as accurate as Householder's for columns that are not nearly dependent, and several times faster
    for tall matrices; the shift keeps it going where poles coincide.
    """
    inverse = np.diag(1 / (np.sqrt(np.sum(np.abs(A) ** 2, axis=(0, 1))) + 1e-300)).astype(A.dtype)
    Q = A @ inverse
    for shift in (1e-13, 1e-15):
        gram = _product(Q, Q) + shift * np.eye(len(inverse))
        factor = np.linalg.inv(np.linalg.cholesky(gram)).conj().T
        Q, inverse = Q @ factor, inverse @ factor
    return Q, inverse


def _gains(inverse: Array, pairs: Array) -> Array:
    """Return for each pole what the sum of squares gains when its two coefficients are set to zero."""
    rows = inverse[: 2 * len(pairs)].reshape(len(pairs), 2, len(inverse))
    return np.sum(pairs * np.linalg.solve(rows @ np.swapaxes(rows, 1, 2), pairs), axis=(1, 2))


def _descend(problem: _Problem, theta: Array, steps: int = 40) -> _State:
    """Levenberg-Marquardt in (log omega, log zeta)."""
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


def _fit(problem: _Problem, start: ComplexArray, n_modes: int | None) -> _State:
    """Return the partial fractions that the data need, no fewer and no more."""
    most = max(1, problem.omega.size // 3 - problem.powers.shape[1])
    start = start[np.argsort(-start.real / np.abs(start))][:most]  # where lines are few, light damping first
    theta = np.log(np.stack([np.abs(start), -start.real / np.abs(start)], axis=1))
    state = _pruned(problem, _descend(problem, theta, 8))
    room = MAX_ADDED
    for _ in range(2):
        problem.weigh(_updated_variance(problem, state), is_shared=True)
        state = _descend(problem, state.theta)
        while room > 0:
            must = n_modes is not None and int(np.sum(_is_mode(problem, state))) < n_modes
            larger = _enriched(problem, state, must=must)
            if larger is None:
                break
            state, room = larger, room - 1
        state = _pruned(problem, state)
    problem.weigh(_updated_variance(problem, state), is_shared=False)
    return _descend(problem, state.theta)


def _updated_variance(problem: _Problem, state: _State) -> Array:
    """Return the variance that the residual shows, or the known one unless the model misses something."""
    problem.is_known &= state.cost < 4 * problem.H.size  # within twice the known deviation
    if problem.is_known:
        return problem.variance
    error = state.errors / problem.weight
    fitted = problem.H - error  # the measured H would weight down what noise made large
    return _noise_model(np.abs(error) ** 2, fitted) + _floor(problem.H)


def _penalty(problem: _Problem, state: _State) -> float:
    """Return how much less the cost must be with another pole (Bayesian information criterion)."""
    return (2 * problem.H.shape[1] + 2) * float(np.log(2 * problem.omega.size)) * problem.noise(state)


def _is_mode(problem: _Problem, state: _State) -> NDArray[np.bool_]:
    omega, zeta = np.exp(state.theta.T)
    return (omega >= problem.omega[0]) & (omega <= problem.omega[-1]) & (zeta < 1)


def _pruned(problem: _Problem, state: _State) -> _State:
    """Take out poles without which the cost is hardly more, with the others moving in to fill the gap."""
    spared: list[complex] = []
    while len(state.theta):
        penalty = _penalty(problem, state)
        poles = state.poles
        alike = _pole_mac(poles, poles) - np.eye(len(poles))
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


def _enriched(problem: _Problem, state: _State, *, must: bool) -> _State | None:
    """Put a pole in where the residual asks for it, or return None."""
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


def _report(
    used: FrequencyResponse,
    problem: _Problem,
    state: _State,
    charts: list[list[ComplexArray]],
    orders: Sequence[int],
    n_modes: int | None,
    min_confidence: float,
) -> PoleEstimate:
    """Choose what is reported of the fit, and add shapes, deviations and confidence."""
    poles = state.poles
    each = np.array([_confidence(poles, chart) for chart in charts])
    confidence, chart = each.max(axis=0), charts[int(np.argmax(each.sum(axis=1)))]
    residues = problem.residues(state)
    H = (problem.basis(state.theta) @ state.coefficients.T).reshape(used.H.shape)
    residual = float(np.linalg.norm(H - used.H) / np.linalg.norm(used.H))
    keep = _is_mode(problem, state)
    if residual > 100 * EXACT:  # in exact data two poles are two modes however near
        keep &= ~_is_ghost(state, residues, used)
    modes = np.flatnonzero(keep & ((confidence >= min_confidence) | (n_modes is not None)))
    modes = modes[np.lexsort((-state.gain[modes], confidence[modes] < 0.5))][:n_modes]
    modes = modes[np.argsort(np.abs(poles[modes]))]
    if modes.size == 0:
        raise BadRecording(
            f"no mode found from {used.freq[0]:g} to {used.freq[-1]:g} Hz ({len(poles)} uncertain poles); look at coherence "
            "and leakage, widen band_hz, raise orders or give n_modes"
        )
    scale = np.sqrt(np.maximum(np.diag(state.normal), 1e-300))
    covariance = np.linalg.pinv(state.normal / np.outer(scale, scale), hermitian=True) * problem.noise(state)
    sd = (np.sqrt(np.maximum(np.diag(covariance), 0.0)) / scale).reshape(-1, 2)[modes]
    shapes, participation = _shapes(residues[modes])
    omega, zeta = np.exp(state.theta[modes].T)
    return PoleEstimate(
        s=poles[modes],
        freq=omega / (2 * np.pi),
        zeta=zeta,
        shapes=shapes,
        participation=participation,
        freq_sd=omega / (2 * np.pi) * sd[:, 0],
        zeta_sd=zeta * sd[:, 1],
        confidence=confidence[modes],
        stabilisation=_stabilisation(chart, orders),
        fitted=FrequencyResponse(freq=used.freq, H=H, outputs=used.outputs, inputs=used.inputs, unit=used.unit),
        residual=residual,
        n_nuisance=len(poles) - modes.size,
    )


def _confidence(poles: ComplexArray, chart: list[ComplexArray]) -> Array:
    """Return the mean over the upper half of the orders of the largest MAC between a pole and those of the order."""
    upper = chart[len(chart) // 2 :]
    best = [_pole_mac(poles, found).max(axis=1) if found.size else np.zeros(poles.size) for found in upper]
    return np.mean(best, axis=0) if poles.size else np.zeros(0)


def _is_ghost(state: _State, residues: ComplexArray, used: FrequencyResponse) -> NDArray[np.bool_]:
    """Mark poles that are the leakage or the bent peak of a stronger one: of like shape, and nearer than one line."""
    poles, gain = state.poles, state.gain
    window = used.resolution_hz if isinstance(used, MeasuredFrequencyResponse) else 0.0
    reach = 2 * np.pi * np.maximum(window, np.interp(np.abs(poles) / (2 * np.pi), used.freq, np.gradient(used.freq)))
    shapes = residues.reshape(poles.size, used.H[0].size)
    shapes = shapes / (np.linalg.norm(shapes, axis=1)[:, None] + 1e-300)
    is_alike = np.abs(shapes.conj() @ shapes.T) ** 2 > GHOST_MAC
    is_near = np.abs(poles.imag[:, None] - poles.imag) < reach[:, None]
    return np.any(is_alike & is_near & (gain > gain[:, None]), axis=1)


def _shapes(residues: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """Split residues (mode, output, input) into shapes (output, mode) and participation (input, mode)."""
    left, sigma, right = np.linalg.svd(residues, full_matrices=False)
    raw = left[:, :, 0].T
    largest = _largest(raw)
    return raw / largest, (right[:, 0, :] * (sigma[:, 0] * largest)[:, None]).T


def _largest(shapes: NDArray[Any]) -> NDArray[Any]:
    """Return the largest component of each column; of those alike to rounding, the first, so that signs repeat."""
    size = np.abs(shapes)
    return shapes[np.argmax(size > (1 - 1e-6) * size.max(axis=0), axis=0), np.arange(shapes.shape[1])]


def _stabilisation(chart: list[ComplexArray], orders: Sequence[int]) -> Stabilisation:
    """Mark the poles of each order that the order before had too."""
    order, poles, stable = [], [], []
    for i, found in enumerate(chart):
        s = found[np.argsort(np.abs(found))]
        before = chart[i - 1] if i else np.zeros(0, complex)
        freq, zeta = np.abs(s)[:, None], (-s.real / np.abs(s))[:, None]
        same = np.abs(np.abs(before) / freq - 1) < FREQ_TOLERANCE
        same &= np.abs(-before.real / np.abs(before) / zeta - 1) < ZETA_TOLERANCE
        order.append(np.full(s.size, orders[i]))
        poles.append(s)
        stable.append(np.any(same, axis=1))
    s = np.concatenate(poles)
    return Stabilisation(
        order=np.concatenate(order),
        freq=np.abs(s) / (2 * np.pi),
        zeta=-s.real / np.abs(s),
        is_stable=np.concatenate(stable),
    )
