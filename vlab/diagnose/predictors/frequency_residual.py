"""Normalised residual of frequency data, with derivatives.

A response's residual is divided by its noise and by a share of measured and modelled magnitude. That is the relative
error near a fit, and bounded between distant sharp resonances. A first coarse residual compares log power in bands, for
resonances without overlap. Modal tables are compared in log frequency, log damping and shapes up to scale. Modes are
paired by shape, or in order without shapes.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.optimize import linear_sum_assignment

from vlab.diagnose.data.responses import Measured, Modes, Response
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.predictors.frequency import Answer, Shared, State, at_port, is_port, stepped
from vlab.diagnose.predictors.frequency_model import View, Wires
from vlab.diagnose.predictors.frequency_modes import ModelModes, by_parameter, matrix_changes, model_modes, state_matrix
from vlab.diagnose.predictors.level_answer import answer_at_level
from vlab.diagnose.predictors.level_modes import acts_in_table, modes_at_amplitude
from vlab.diagnose.settings import FREQUENCY, FREQUENCY_RESIDUAL, RESPONSES
from vlab.signals import Array, ComplexArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Residual:
    """Normalised residual.

    Parameters
    ----------
    e : (n,) array
        Residual, whose squared sum is the cost; one is expected per effective value.
    by_theta, by_term : (n, n_parameters), (n, n_values) array
        Derivatives, where requested.
    effective_samples : float
        Effective sample size.
    penalty : float
        Part of the cost from modes missing in a table.
    """

    e: Array
    by_theta: Array
    by_term: Array
    effective_samples: float
    penalty: float = 0.0


def residual(
    view: View,
    state: State,
    data: Measured,
    wires: Wires,
    terms: Sequence[Term],
    *,
    gains: Sequence[tuple[int | None, int | None]] = (),
    bands: float = 0.0,
    with_derivatives: bool = False,
    shared: Shared | None = None,
) -> Residual:
    """Return the normalised residual of one data set.

    Parameters
    ----------
    view : View
        Linearised plant.
    state : State
        Matrices and gains.
    data : Response or Modes
        Data.
    wires : Wires
        Inputs and outputs.
    terms : sequence of Term
        Effects.
    gains : sequence of (column, output)
        Input or output whose gain each uncertain parameter is.
    bands : float
        Relative bandwidth of the coarse residual; 0 for single lines.
    with_derivatives : bool
        Whether to compute derivatives.
    shared : dict or None
        Cache of `vlab.diagnose.predictors.frequency.solve`.

    Returns
    -------
    Residual
        Residual with derivatives.
    """
    if isinstance(data, Modes):
        return modal_residual(view, state, data, terms, with_derivatives=with_derivatives)
    found = answer_at_level(
        view, state, data, wires, terms, gains=gains, with_derivatives=with_derivatives, shared=shared
    )
    return response_residual(data, found, bands)


# ---- responses ------------------------------------------------------------------------------------------------------


def response_residual(data: Response, found: Answer, bands: float = 0.0) -> Residual:
    """Return the normalised residual of a response.

    Parameters
    ----------
    data : Response
        Measured response.
    found : Answer
        Modelled response.
    bands : float
        Relative bandwidth of the coarse residual; 0 for single lines.

    Returns
    -------
    Residual
        Residual with derivatives.
    """
    if bands:
        return _in_bands(data, found, bands)
    effective_samples = min(FREQUENCY_RESIDUAL.independent, len(data.freq)) * len(data.outputs)
    weight = np.sqrt(effective_samples / data.H.size)
    measured: ComplexArray = data.H
    H = np.abs(found.H) if data.is_magnitude else found.H
    size = np.sqrt(data.spread**2 + RESPONSES.model_error**2 * 0.5 * (np.abs(measured) ** 2 + np.abs(found.H) ** 2))
    e = (measured - H) / size

    def moved(parts: ComplexArray) -> Array:
        if not len(parts):
            return np.zeros((_count(data), 0))
        along = np.real(np.conj(found.H) * parts)
        change = along / np.maximum(np.abs(found.H), 1e-300) if data.is_magnitude else parts
        rate = -change / size - e * (0.5 * RESPONSES.model_error**2 * along / size**2)
        return np.asarray(_real(rate, data).T * weight)

    return Residual(
        e=_real(e[None], data)[0] * weight,
        by_theta=moved(found.by_theta),
        by_term=moved(found.by_term),
        effective_samples=effective_samples,
    )


def _count(data: Response) -> int:
    return data.H.size * (1 if data.is_magnitude else 2)


def _real(parts: ComplexArray, data: Response) -> Array:
    """Return complex residuals as real ones."""
    flat = parts.reshape(len(parts), -1)
    return np.real(flat) if data.is_magnitude else np.concatenate([flat.real, flat.imag], axis=1)


def _in_bands(data: Response, found: Answer, width: float) -> Residual:
    """Return the residual of log power in overlapping bands."""
    window = _windows(data.freq.tobytes(), width)
    power, own = window @ np.abs(data.H) ** 2, window @ np.abs(found.H) ** 2
    floor = window @ data.noise**2
    effective_samples = min(FREQUENCY_RESIDUAL.independent, len(data.freq)) * len(data.outputs)
    weight = np.sqrt(effective_samples / power.size)
    e = np.log((power + floor) / (own + floor)) / (2 * FREQUENCY_RESIDUAL.band_error)

    def moved(parts: ComplexArray) -> Array:
        if not len(parts):
            return np.zeros((power.size, 0))
        change = 2 * np.real(np.conj(found.H) * parts)
        rate = -(window @ change) / (own + floor) / (2 * FREQUENCY_RESIDUAL.band_error)
        return np.asarray(rate.reshape(len(parts), -1).T * weight)

    return Residual(
        e=e.ravel() * weight,
        by_theta=moved(found.by_theta),
        by_term=moved(found.by_term),
        effective_samples=effective_samples,
    )


@lru_cache(maxsize=64)
def _windows(lines: bytes, width: float) -> Array:
    """Return weights (n_bands, n) of lines in half-overlapping bands."""
    freq = np.frombuffer(lines)
    line = np.log(freq)
    middles = np.arange(line[0], line[-1] + 0.5 * width, 0.5 * width)
    window = np.exp(-0.5 * ((line[None, :] - middles[:, None]) / (0.5 * width)) ** 2) * np.gradient(freq)[None, :]
    return np.asarray(window / window.sum(axis=1, keepdims=True))


# ---- modes ----------------------------------------------------------------------------------------------------------


def modal_residual(
    view: View, state: State, data: Modes, terms: Sequence[Term], *, with_derivatives: bool = False
) -> Residual:
    """Return the normalised residual of a modal table.

    Parameters
    ----------
    view : View
        Linearised plant.
    state : State
        Matrices.
    data : Modes
        Modal table.
    terms : sequence of Term
        Effects.
    with_derivatives : bool
        Whether to compute derivatives.

    Returns
    -------
    Residual
        Residual with derivatives.
    """
    if with_derivatives and acts_in_table(view, data, terms):
        return _modal_by_differences(view, state, data, terms)
    every = [*view.fixed, *terms]
    fastest = 2 * np.pi * 2 * float(data.freq[-1])
    A = state_matrix(state, every, fastest)
    modes = model_modes(A, view.m)
    rows = shape_rows(view, data)
    pairs = tracked(modes, data, rows)
    odd = _odd(modes, pairs)
    if acts_in_table(view, data, terms):
        modes, pairs = modes_at_amplitude(view, state, data, terms, modes, pairs)
    e = np.append(_modal_difference(modes, data, rows, pairs), np.sqrt(odd))
    effective_samples = float(data.entries)
    if not with_derivatives:
        none = np.zeros((len(e), 0))
        return Residual(e=e, by_theta=none, by_term=none, effective_samples=effective_samples, penalty=odd)
    by_theta = np.zeros((len(e), len(state.changes)))
    for i, change in enumerate(matrix_changes(state, A, every)):
        if change is not None:
            by_theta[:-1, i] = _modal_rate(modes, data, rows, pairs, change)
    by_term = []
    for k, term in enumerate(terms):
        for parameter in term.effect.parameters:
            moved, by = stepped(term, parameter.name, FREQUENCY.step)
            others = [*view.fixed, *terms[:k], moved, *terms[k + 1 :]]
            change = (state_matrix(state, others, fastest) - A) / by
            by_term.append(np.append(_modal_rate(modes, data, rows, pairs, change), 0.0))
    columns = np.array(by_term).T if by_term else np.zeros((len(e), 0))
    return Residual(e=e, by_theta=by_theta, by_term=columns, effective_samples=effective_samples, penalty=odd)


def _modal_by_differences(view: View, state: State, data: Modes, terms: Sequence[Term]) -> Residual:
    """Return a residual with amplitudes, and its finite differences."""

    def of(state: State, terms: Sequence[Term]) -> Residual:
        return modal_residual(view, state, data, terms)

    own, h = of(state, terms), FREQUENCY.step
    by_theta = np.zeros((len(own.e), len(state.changes)))
    for i, change in enumerate(state.changes):
        if any(part is not None for part in change):
            given = (state.M, state.C, state.K)
            M, C, K = (a if part is None else a + h * part for a, part in zip(given, change, strict=True))
            by_theta[:, i] = (of(replace(state, M=M, C=C, K=K), terms).e - own.e) / h
    by_term = []
    for k, term in enumerate(terms):
        for parameter in term.effect.parameters:
            moved, by = stepped(term, parameter.name, h)
            by_term.append((of(state, [*terms[:k], moved, *terms[k + 1 :]]).e - own.e) / by)
    return replace(own, by_theta=by_theta, by_term=np.array(by_term).T if by_term else own.by_term)


def quick_modal_residual(view: View, state: State, data: Modes, terms: Sequence[Term]) -> Array:
    """Return an approximate modal residual for trials.

    The method covers mass, damping and stiffness effects. Undamped modes with uncoupled damping err by the square of
    the damping ratios.

    Parameters
    ----------
    view : View
        Linearised plant.
    state : State
        Matrices.
    data : Modes
        Modal table.
    terms : sequence of Term
        Effects.

    Returns
    -------
    (n,) array
        Residual.
    """
    M, C, K = state.M, state.C, state.K
    for term in (*view.fixed, *terms):
        if is_port(term):
            law = at_port(term, term.values, 1.0)
            outer = term.place.rows.T @ term.place.rows
            M, C, K = M + law.mass * outer, C + law.damping * outer, K + law.stiffness * outer
    lower = np.linalg.inv(np.linalg.cholesky(M))
    squared, vectors = np.linalg.eigh(lower @ K @ lower.T)
    moving = squared > 1e-9 * max(float(squared[-1]), 1e-300)
    shapes = (lower.T @ vectors)[:, moving]
    omega = np.sqrt(squared[moving])
    decay = 0.5 * np.einsum("ij,ik,kj->j", shapes, C, shapes)
    none = np.zeros((0, 0), dtype=complex)
    modes = ModelModes(
        s=-decay + 1j * np.sqrt(np.maximum(omega**2 - decay**2, 1e-12)),
        left=none,
        right=shapes.astype(complex),
        poles=none[0:0].ravel(),
        index=np.arange(len(omega)),
        m=view.m,
        part=np.ones(len(omega)),
    )
    rows = shape_rows(view, data)
    pairs = tracked(modes, data, rows)
    return np.append(_modal_difference(modes, data, rows, pairs), np.sqrt(_odd(modes, pairs)))


def shape_rows(view: View, data: Modes) -> Array:
    """Return the rows (n_places, m) of a table's locations."""
    return np.array([view.at[name] for name in data.at]).reshape(-1, view.m)


def tracked(modes: ModelModes, data: Modes, rows: Array) -> Array:
    """Pair the modes of a table with modes of the model.

    Parameters
    ----------
    modes : ModelModes
        Modes of the model.
    data : Modes
        Modal table.
    rows : (n_places, m) array
        Rows of the table's locations.

    Returns
    -------
    (n,) int array
        Index of the model's mode; -1 without one.
    """
    freq, zeta = modes.freq, np.maximum(modes.zeta, RESPONSES.smallest_zeta)
    if not len(freq):
        return np.full(data.n, -1)
    cost = (np.log(freq[None, :] / data.freq[:, None]) / data.freq_sd[:, None]) ** 2
    cost += _little(modes.part)[None, :] ** 2
    known = np.isfinite(data.zeta)
    cost[known] += (np.log(zeta[None, :] / data.zeta[known, None]) / (2 * data.zeta_sd[known, None])) ** 2
    if len(rows):
        shapes = rows @ modes.shapes
        alike = np.abs(data.shapes @ shapes) ** 2
        size = np.sum(data.shapes**2, axis=1)[:, None] * np.sum(np.abs(shapes) ** 2, axis=0)[None, :]
        mac = alike / np.maximum(size, 1e-300)
        # shapes identify a mode even at a large frequency error
        cost = (
            np.minimum(cost, FREQUENCY_RESIDUAL.far**2)
            + np.sum(data.shapes**2, axis=1)[:, None] * (1 - mac) / data.shape_sd[:, None] ** 2
        )
        out = np.full(data.n, -1)
        a, b = linear_sum_assignment(cost)
        out[a] = b
        return out
    return _in_order(np.minimum(cost, FREQUENCY_RESIDUAL.far**2))


def _little(part: Array) -> Array:
    """Return the cost [sd] of modes with little structural participation."""
    return np.asarray(
        FREQUENCY_RESIDUAL.part_cost * np.maximum(np.log(FREQUENCY_RESIDUAL.own_part / np.maximum(part, 1e-9)), 0.0)
    )


def _in_order(cost: Array) -> Array:
    """Return the cheapest order-preserving pairing of modes."""
    n, k = cost.shape
    if k < n:
        out = np.full(n, -1)
        out[:k] = np.arange(k)
        return out
    skip, number = FREQUENCY_RESIDUAL.skipped**2, np.arange(k)
    best = cost[0] + skip * number
    came = np.zeros((n, k), dtype=int)
    for i in range(1, n):
        level = best - skip * number
        lowest = np.minimum.accumulate(level)
        where = np.maximum.accumulate(np.where(level == lowest, number, 0))
        came[i, 1:] = where[:-1]
        best = np.concatenate([[np.inf], lowest[:-1] + skip * number[:-1] + cost[i, 1:]])
    out = np.zeros(n, dtype=int)
    out[-1] = int(np.argmin(best))
    for i in range(n - 1, 0, -1):
        out[i - 1] = came[i, out[i]]
    return out


def _modal_difference(modes: ModelModes, data: Modes, rows: Array, pairs: Array) -> Array:
    """Return the residuals of frequencies, damping and shapes."""
    found = pairs >= 0
    at = np.where(found, pairs, 0)
    has = len(modes.freq) > 0
    freq = modes.freq[at] if has else np.ones(data.n)
    zeta = np.maximum(modes.zeta[at], RESPONSES.smallest_zeta) if has else np.ones(data.n)
    parts = [np.where(found, np.log(data.freq / freq) / data.freq_sd, FREQUENCY_RESIDUAL.far)]
    known = np.isfinite(data.zeta)
    parts.append(
        np.where(found, np.log(np.where(known, data.zeta, 1.0) / zeta) / data.zeta_sd, FREQUENCY_RESIDUAL.far)[known]
    )
    if len(rows):
        own = rows @ modes.shapes[:, at] if has else np.zeros((len(rows), data.n))  # no mode oscillates
        parts.append(
            np.where(
                found[:, None], _apart(data.shapes, own.T) / data.shape_sd[:, None], FREQUENCY_RESIDUAL.far
            ).ravel()
        )
    return np.concatenate(parts)


def _odd(modes: ModelModes, pairs: Array) -> float:
    """Return the squared cost of skipped modes and attachment resonances."""
    found = pairs[pairs >= 0]
    if not len(found):
        return 0.0
    passed_over = max(int(found.max()) + 1 - len(found), 0)
    return float(
        min(
            FREQUENCY_RESIDUAL.skipped**2 * passed_over + np.sum(_little(modes.part[found]) ** 2),
            FREQUENCY_RESIDUAL.far**2,
        )
    )


def _apart(measured: Array, own: ComplexArray) -> Array:
    """Return measured minus modelled shapes (n, places) at their best scale."""
    scale = np.sum(np.conj(own) * measured, axis=1) / np.maximum(np.sum(np.abs(own) ** 2, axis=1), 1e-300)
    return np.asarray(np.real(measured - scale[:, None] * own))


def _modal_rate(modes: ModelModes, data: Modes, rows: Array, pairs: Array, change: Array) -> Array:
    found = pairs >= 0
    at = np.where(found, pairs, 0)
    rate, moved = by_parameter(modes, at, change)
    s = modes.s[at]
    size = np.abs(s)
    grown = np.real(np.conj(s) * rate) / size**2  # derivative of log |s|
    damped = -rate.real / size - modes.zeta[at] * grown
    parts = [np.where(found, -grown / data.freq_sd, 0.0)]
    known = np.isfinite(data.zeta)
    ratio = np.maximum(modes.zeta[at], RESPONSES.smallest_zeta)
    parts.append(np.where(found, -damped / ratio / data.zeta_sd, 0.0)[known])
    if len(rows):
        own, shift = (rows @ modes.shapes[:, at]).T, (rows @ moved).T
        power = np.maximum(np.sum(np.abs(own) ** 2, axis=1), 1e-300)[:, None]
        scale = np.sum(np.conj(own) * data.shapes, axis=1)[:, None] / power
        across = shift - own * np.sum(np.conj(own) * shift, axis=1)[:, None] / power
        parts.append(np.where(found[:, None], -np.real(scale * across) / data.shape_sd[:, None], 0.0).ravel())
    return np.concatenate(parts)
