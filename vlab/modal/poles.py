"""Poles, damping ratios and mode shapes from frequency responses.

Polyreference least squares (`vlab.modal.plscf`) at many model orders gives a stabilisation chart without start values.
Persistent poles start a weighted least-squares fit of partial fractions (`vlab.modal.partial_fractions`), which is
maximum likelihood for a known variance. Residues are eliminated in closed form. The last step removes superfluous poles
and adds poles at peaks of the residual.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from vlab.errors import BadRecording
from vlab.modal.frf import MeasuredFrequencyResponse
from vlab.modal.noise import EXACT, known_variance
from vlab.modal.partial_fractions import (
    FitProblem,
    FitState,
    fit_partial_fractions,
    fits_several_lines,
    is_mode,
    pole_mac,
)
from vlab.modal.plscf import persistent_poles, plscf_chart
from vlab.signals import Array, ComplexArray, FrequencyResponse, ModalModel

FREQ_TOLERANCE, ZETA_TOLERANCE = 0.01, 0.05
"""FREQ_TOLERANCE [1]: relative frequency change up to which a pole is stable between orders.
ZETA_TOLERANCE [1]: same for the damping ratio. Both values are customary for stabilisation charts."""
TOP_POLES, MOST_POLES, PER_POLE, PROMINENCE = 60, 280, 4, 0.3
"""TOP_POLES [1]: poles at the highest order of the first chart, conjugates included.
MOST_POLES [1]: the same for data with many modes, enough for some 50. Raising the value takes longer.
PER_POLE [1]: poles of the chart per resonance, below which the order is raised; customary are 2 to 5 times.
PROMINENCE [decades]: least prominence of a resonance in a mode indicator, a factor of two."""
GHOST_MAC = 0.8
"""GHOST_MAC [1]: MAC above which two poles within one line are one mode and its leakage."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Stabilisation:
    """Damped, oscillating poles at each model order.

    Parameters
    ----------
    order : (n,) int array
        Order of the denominator.
    freq, zeta : (n,) array
        Natural frequency [Hz] and damping ratio.
    is_stable : (n,) bool array
        Whether the preceding order has the pole within `FREQ_TOLERANCE` and `ZETA_TOLERANCE`.
    """

    order: NDArray[np.int_]
    freq: Array
    zeta: Array
    is_stable: NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True, eq=False)
class PoleEstimate:
    """Modes estimated from frequency responses, with evidence.

    Parameters
    ----------
    s : (n_modes,) complex array
        Poles [rad/s] with positive imaginary part, by ascending natural frequency.
    freq, zeta : (n_modes,) array
        Natural frequency abs(s) / 2 pi [Hz] and damping ratio.
    shapes : (n_outputs, n_modes) complex array
        Residues, scaled so that the largest component of each mode is 1.
    participation : (n_inputs, n_modes) complex array
        Participation; shape times participation (transposed) is a mode's residue matrix.
    freq_sd, zeta_sd : (n_modes,) array
        Standard deviations from the residual [Hz], [1], without leakage and nonlinearity.
    confidence : (n_modes,) array
        Repeatability of the pole over the upper half of the model orders, 0 to 1.
    stabilisation : Stabilisation
        Poles of the chart.
    fitted : FrequencyResponse
        Partial fractions at the lines of the data.
    residual : float
        Relative misfit, norm(H - fitted) / norm(H).
    n_nuisance : int
        Number of fitted but unreported poles: outside the band, overdamped, or of low confidence.
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
        """Return the real parts of optimally rotated shapes.

        The largest component is 1.
        """
        return _real(self.shapes)

    def real_participation(self) -> Array:
        """Return real, optimally rotated participations, (n_inputs, n_modes).

        The largest component is 1. By reciprocity, participations to forces are the shape at the places of the forces.
        """
        return _real(self.participation)

    def on_lines(self, freq: Array) -> FrequencyResponse:
        """Return the fit at given lines [Hz].

        The modes are exact. Modes outside the band and further slow parts of the fit are interpolated linearly.

        Parameters
        ----------
        freq : array
            Lines within the data's band [Hz].

        Returns
        -------
        FrequencyResponse
            Fitted responses.
        """
        lines, f = self.fitted.freq, np.asarray(freq, dtype=float)
        if f.size and not (lines[0] <= f[0] and f[-1] <= lines[-1]):
            raise BadRecording(f"the fit covers {lines[0]:g} to {lines[-1]:g} Hz; {f[0]:g} to {f[-1]:g} Hz goes beyond")
        rest = (self.fitted.H - self._modal(lines)).reshape(lines.size, -1)
        between = np.stack([np.interp(f, lines, c.real) + 1j * np.interp(f, lines, c.imag) for c in rest.T], axis=1)
        return replace(self.fitted, freq=f, H=self._modal(f) + between.reshape(f.size, *self.fitted.H.shape[1:]))

    def _modal(self, freq: Array) -> ComplexArray:
        """Return the responses of the modes alone, (line, output, input)."""
        s = 2j * np.pi * freq[:, None]
        residues = np.einsum("ok,ik->oik", self.shapes, self.participation)
        direct = np.einsum("fk,oik->foi", 1 / (s - self.s), residues)
        return direct + np.einsum("fk,oik->foi", 1 / (s - self.s.conj()), residues.conj())

    def to_modal_model(self, *, is_real: bool = True) -> ModalModel:
        """Return frequencies, damping ratios and shapes at the outputs.

        Shapes are real by default.
        """
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

    Lines need not be evenly spaced [1]_ [2]_ [3]_. Damping ratios from 0.0005 to 0.6 may occur together. Residues
    belong to a real system (conjugate pairs), and poles are stable.

    Parameters
    ----------
    frf : FrequencyResponse
        Receptance, mobility or accelerance. The variance of a `MeasuredFrequencyResponse` gives the weights. Otherwise
        the residual gives an additive and a proportional noise of each response.
    sample_rate : float
        Sample rate of sampled responses [Hz]; the partial fractions are then exact up to half the rate. None for
        continuous responses. Far below half the rate the choice has no effect.
    band_hz : (low, high)
        Band of used lines and reported modes [Hz]; all by default.
    orders : sequence of int
        Model orders of the chart, about 2 to 5 times the number of modes; by default every second from 4 to 60. Data with
        many modes raise the default to 280.
    n_modes : int
        Largest number of reported modes: the first ones in the band. Less confident poles fill the number, by
        significance. None for as many as the data support.
    min_confidence : float
        Smallest confidence of a mode. With `n_modes`, less confident poles are reported only if modes are too few.
    residual_powers : sequence of int
        Powers of j omega that represent all modes outside the band.

    Returns
    -------
    PoleEstimate
        Modes with standard deviations.

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
    problem = FitProblem(used, step, residual_powers, known_variance(used))

    if orders is not None:
        wanted = _checked_orders(orders, used)
    else:
        is_crowded = PER_POLE * count_resonances(used) > TOP_POLES
        wanted = _default_orders(used, MOST_POLES if is_crowded else TOP_POLES)
    chart = plscf_chart(problem, wanted)
    poles = persistent_poles(chart, problem.omega)
    state = fit_partial_fractions(problem, poles, n_modes)
    charts = [chart, plscf_chart(problem, wanted, state.poles)]
    return _report(used, problem, state, charts, wanted, n_modes, min_confidence)


def count_resonances(frf: FrequencyResponse) -> int:
    """Return the number of resonances by the complex mode indicator functions.

    Parameters
    ----------
    frf : FrequencyResponse
        Frequency responses.

    Returns
    -------
    int
        Peaks of all singular values over frequency.

    References
    ----------
    C. Y. Shih, Y. G. Tsuei, R. J. Allemang and D. L. Brown, Complex mode indication function and its applications to spatial
    domain parameter estimation, Mechanical Systems and Signal Processing 2 (1988) 367-377.
    """
    sizes = np.log10(np.maximum(np.linalg.svd(frf.H, compute_uv=False), 1e-300))
    return sum(len(signal.find_peaks(column, prominence=PROMINENCE)[0]) for column in sizes.T)


def _checked(
    frf: FrequencyResponse, sample_rate: float | None, band_hz: tuple[float, float] | None
) -> tuple[FrequencyResponse, float]:
    """Return the used lines and the sampling interval.

    The interval is 0 for continuous responses.
    """
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
            "at least 8 are needed: search a wider band or measure longer"
        )
    if not np.any(used.H):
        raise BadRecording("all responses in the band are zero")
    return used, 0.0 if sample_rate is None else 1 / sample_rate


def _most_order(used: FrequencyResponse) -> int:
    return (2 * used.freq.size - 2) // (2 * (len(used.inputs) + 1))


def _default_orders(used: FrequencyResponse, top: int) -> list[int]:
    """Return the orders up to a number of poles of all inputs."""
    n_in = len(used.inputs)
    last = max(6, min(top // n_in, _most_order(used)))
    return list(range(2 if n_in > 1 else 4, last + 1, 2 if n_in < 4 else 1))


def _checked_orders(orders: Sequence[int], used: FrequencyResponse) -> list[int]:
    """Return ascending orders within the number of lines."""
    limit = _most_order(used)
    chosen = sorted({int(n) for n in orders})
    if not chosen or chosen[0] < 2 or chosen[-1] > limit:
        raise BadRecording(f"orders {list(orders)} must be from 2 to {limit}, which {used.freq.size} lines can carry")
    return chosen


def _report(
    used: FrequencyResponse,
    problem: FitProblem,
    state: FitState,
    charts: list[list[ComplexArray]],
    orders: Sequence[int],
    n_modes: int | None,
    min_confidence: float,
) -> PoleEstimate:
    """Select the reported poles of the fit.

    Shapes, standard deviations and confidence are added.
    """
    poles = state.poles
    each = np.array([_confidence(poles, chart) for chart in charts])
    for k in np.flatnonzero((each[0] < min_confidence) & (each[1] >= min_confidence)):
        if not fits_several_lines(problem, state, int(k)):  # its own weight repeats the pole in the second chart
            each[1, k] = each[0, k]
    confidence, chart = each.max(axis=0), charts[int(np.argmax(each.sum(axis=1)))]
    residues = problem.residues(state)
    H = (problem.basis(state.theta) @ state.coefficients.T).reshape(used.H.shape)
    residual = float(np.linalg.norm(H - used.H) / np.linalg.norm(used.H))
    keep = is_mode(problem, state)
    if residual > 100 * EXACT:  # in exact data two poles are two modes, however close
        keep &= ~_is_ghost(state, residues, used)
    modes = np.flatnonzero(keep & ((confidence >= min_confidence) | (n_modes is not None)))
    is_unsure = confidence[modes] < min_confidence
    order = np.where(is_unsure, -state.gain[modes], np.abs(poles[modes]))  # sure modes upwards, then the largest others
    modes = modes[np.lexsort((order, is_unsure))][:n_modes]
    modes = modes[np.argsort(np.abs(poles[modes]))]
    if modes.size == 0:
        raise BadRecording(
            f"no mode found from {used.freq[0]:g} to {used.freq[-1]:g} Hz ({len(poles)} uncertain poles); look at coherence "
            "and leakage, measure longer, search a wider band, or state the number of modes"
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
    """Return the repeatability of poles over the chart.

    The value is the mean, over the upper half of the orders, of the largest MAC with an order's poles.
    """
    upper = chart[len(chart) // 2 :]
    best = [pole_mac(poles, found).max(axis=1) if found.size else np.zeros(poles.size) for found in upper]
    return np.mean(best, axis=0) if poles.size else np.zeros(0)


def _is_ghost(state: FitState, residues: ComplexArray, used: FrequencyResponse) -> NDArray[np.bool_]:
    """Return a mask of poles that repeat a stronger one.

    Leakage or a bent peak gives a similar shape within one line.
    """
    poles, gain = state.poles, state.gain
    window = used.resolution_hz if isinstance(used, MeasuredFrequencyResponse) else 0.0
    reach = 2 * np.pi * np.maximum(window, np.interp(np.abs(poles) / (2 * np.pi), used.freq, np.gradient(used.freq)))
    shapes = residues.reshape(poles.size, used.H[0].size)
    shapes = shapes / (np.linalg.norm(shapes, axis=1)[:, None] + 1e-300)
    is_alike = np.abs(shapes.conj() @ shapes.T) ** 2 > GHOST_MAC
    is_near = np.abs(poles.imag[:, None] - poles.imag) < reach[:, None]
    return np.any(is_alike & is_near & (gain > gain[:, None]), axis=1)


def _shapes(residues: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """Split residues into shapes and participation.

    Shapes: residues (mode, output, input), shapes (output, mode), participation (input, mode).
    """
    left, sigma, right = np.linalg.svd(residues, full_matrices=False)
    raw = left[:, :, 0].T
    largest = _largest(raw)
    return raw / largest, (right[:, 0, :] * (sigma[:, 0] * largest)[:, None]).T


def _real(shapes: ComplexArray) -> Array:
    turned = shapes * np.exp(-0.5j * np.angle(np.sum(shapes**2, axis=0)))
    return np.asarray(turned.real / _largest(turned.real))


def _largest(shapes: NDArray[Any]) -> NDArray[Any]:
    """Return the largest component of each column.

    The first of equal components is chosen, so that signs repeat.
    """
    size = np.abs(shapes)
    return shapes[np.argmax(size > (1 - 1e-6) * size.max(axis=0), axis=0), np.arange(shapes.shape[1])]


def _stabilisation(chart: list[ComplexArray], orders: Sequence[int]) -> Stabilisation:
    """Mark the poles that the preceding order also has."""
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
