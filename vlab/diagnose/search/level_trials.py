"""Trials of nonlinear effects on responses and modal tables at several levels.

A calibration of each level alone smooths its data and gives the motion at every place. In that motion a nonlinear law is
a known complex stiffness, so that its screening is as simple as that of a linear law.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from vlab.diagnose.data.amplitude_dependence import Trend
from vlab.diagnose.data.responses import Measured, Response
from vlab.diagnose.inference.frequency_least_squares import Fitter
from vlab.diagnose.parameters.locations import Place
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.predictors.equivalent_table import equivalent
from vlab.diagnose.predictors.frequency import State, chain_of, output_rows, solve
from vlab.diagnose.predictors.frequency_modes import ModelModes, model_modes, state_matrix
from vlab.diagnose.predictors.frequency_problem import FrequencyProblem
from vlab.diagnose.predictors.frequency_residual import shape_rows, tracked
from vlab.diagnose.predictors.level_response import Excitation, excitation_of
from vlab.diagnose.search.trial_values import reference_scales
from vlab.diagnose.settings import FREQUENCY_FIT, LEVEL_TRIALS
from vlab.physics.describing_function import dependence
from vlab.physics.effect import Effect, Parameter, PortEffect
from vlab.signals import Array, ComplexArray


def knows_levels(measured: Sequence[Measured]) -> bool:
    """Return whether all data state their level or amplitudes."""
    return bool(measured) and all(
        data.level is not None if isinstance(data, Response) else data.amplitude is not None for data in measured
    )


def levels_of(measured: Sequence[Measured]) -> list[float]:
    """Return the distinct levels of data in ascending order.

    Parameters
    ----------
    measured : sequence of Response or Modes
        Data of known level.

    Returns
    -------
    list of float
        Levels.
    """
    return sorted({level_of(data) for data in measured})


def level_of(data: Measured) -> float:
    """Return the level of data.

    Parameters
    ----------
    data : Response or Modes
        Data of known level.

    Returns
    -------
    float
        Level of a response, or geometric mean of a table's amplitudes.
    """
    if isinstance(data, Response):
        assert data.level is not None
        return data.level
    assert data.amplitude is not None
    return float(np.exp(np.mean(np.log(data.amplitude))))


def has_levels(problem: FrequencyProblem) -> bool:
    """Return whether the data have at least two known levels."""
    return knows_levels((*problem.measured, *problem.held_out)) and len(levels_of(problem.measured)) > 1


@dataclass(frozen=True, kw_only=True, eq=False)
class LevelMotion:
    """Motion at one level from a calibration of that level.

    Parameters
    ----------
    data : Response or Modes
        Data.
    excitation : Excitation or None
        Excitation of a response.
    modal : (n, m) complex array
        Modal motion in every line, or in every mode of a table.
    outputs : (n, n_all) complex array
        Responses of all outputs per unit command, before gains; empty for a table.
    """

    data: Measured
    excitation: Excitation | None
    modal: ComplexArray
    outputs: ComplexArray

    def amplitude(self, row: Array) -> Array:
        """Return the amplitude (n,) at a port [m or rad]."""
        motion = self.modal @ row
        return np.maximum(np.abs(motion) if self.excitation is None else self.excitation.size(motion), 1e-300)

    def omega(self, row: Array) -> Array:
        """Return the circular frequency (n,) of the motion at a port [rad/s]."""
        if self.excitation is None:
            return 2 * np.pi * np.asarray(self.data.freq)
        return self.excitation.frequency(self.modal @ row)


@dataclass(frozen=True, kw_only=True, eq=False)
class Levels:
    """Calibrations of the single levels.

    Parameters
    ----------
    motions : tuple of LevelMotion
        Motion in every data set, in the order of the data.
    theta : tuple of (n_parameters,) array
        Log factors of the calibrations at the lowest and the highest level, within the prior range.
    trends : tuple of Trend
        Natural frequency and damping of the modes in the band, over the levels.
    """

    motions: tuple[LevelMotion, ...]
    theta: tuple[Array, ...]
    trends: tuple[Trend, ...]


def calibrate_levels(fitter: Fitter, start: Array) -> Levels:
    """Calibrate every level alone.

    The prior of the uncertain parameters is widened, because the calibration only smooths the data.

    Parameters
    ----------
    fitter : Fitter
        Data and problem.
    start : (n_parameters,) array
        Initial log factors.

    Returns
    -------
    Levels
        Motion and calibrations.
    """
    problem, levels = fitter.problem, levels_of(fitter.measured)
    found = {}
    for level in levels:
        own = Fitter(problem, [d for d in fitter.measured if level_of(d) == level])
        own.sd = LEVEL_TRIALS.freedom * fitter.sd
        found[level] = min((own.fit((), s).theta for s in (start, np.zeros_like(start))), key=lambda t: _left(own, t))
    motions = tuple(_motion(problem, problem.state(found[level_of(d)]), d) for d in fitter.measured)
    bound = FREQUENCY_FIT.prior_bound * fitter.sd
    ends = [found[levels[0]], found[levels[-1]]]
    trends = _trends(problem, [(level, problem.state(found[level])) for level in levels])
    return Levels(motions=motions, theta=tuple(np.clip(theta, -bound, bound) for theta in ends), trends=trends)


def _trends(problem: FrequencyProblem, states: Sequence[tuple[float, State]]) -> tuple[Trend, ...]:
    """Return the paired modes of the calibrations in the measured band."""
    low, high = problem.measured_hz
    rows = []
    for _, state in states:
        modes = model_modes(state_matrix(state, problem.view.fixed, 4 * np.pi * high), problem.view.m)
        rows.append((modes.freq, modes.zeta))
    count = min(len(freq) for freq, _ in rows)
    levels = np.array([level for level, _ in states])
    out = []
    for k in range(count):
        freq, zeta = np.array([f[k] for f, _ in rows]), np.array([z[k] for _, z in rows])
        if np.all((freq >= low) & (freq <= high)):
            out.append(Trend(levels=levels, freq=freq, zeta=np.maximum(zeta, 1e-6)))
    return tuple(out)


def _left(fitter: Fitter, theta: Array) -> float:
    return fitter.fit((), theta, iterations=0).chi2


def _motion(problem: FrequencyProblem, state: State, data: Measured) -> LevelMotion:
    view, wires = problem.view, problem.wires
    if not isinstance(data, Response):
        modes: ModelModes = model_modes(state_matrix(state, view.fixed, 4 * np.pi * float(data.freq[-1])), view.m)
        pairs = tracked(modes, data, shape_rows(view, data))
        shapes = modes.shapes[:, np.where(pairs >= 0, pairs, 0)].T
        assert data.amplitude is not None
        scale = data.amplitude / np.maximum(np.abs(shapes @ view.at[data.amplitude_at]), 1e-300)
        return LevelMotion(data=data, excitation=None, modal=shapes * scale[:, None], outputs=np.zeros((data.n, 0)))
    excitation = excitation_of(data)
    column = view.columns[wires.inputs.index(data.input)]
    solved = solve(view, state, data, column, view.fixed)
    chain = chain_of(view, state, data, wires, view.fixed)
    rows = output_rows(view.rows, view.orders, data.order, data.omega)
    outputs = (rows @ solved.motion[..., None])[..., 0] * chain.source[:, None]
    return LevelMotion(
        data=data,
        excitation=excitation,
        modal=solved.motion * (chain.source * excitation.amplitude)[:, None],
        outputs=outputs,
    )


def level_trials(problem: FrequencyProblem, levels: Levels, effect: Effect, place: Place) -> list[Term]:
    """Return trial terms of a nonlinear effect.

    Shape parameters take their grid in units of the largest motion or signal. The first amplitude parameter makes the
    equivalent stiffness in that motion a share of the stiffness of the place. Further amplitude parameters take a share
    of the first one's force.

    Parameters
    ----------
    problem : FrequencyProblem
        Problem.
    levels : Levels
        Motion at all levels.
    effect : Effect
        Nonlinear effect.
    place : Place
        Location.

    Returns
    -------
    list of Term
        Terms.
    """
    size, omega = _largest(problem, levels, effect, place)
    references = {
        "displacement": size,
        "travel": size,
        "velocity": size * omega,
        "input": size,
        "output": size,
        "step": 1.0,
    }
    references["input-slope"] = size * omega
    scale = {p.name: references.get(p.reference, 1.0) if p.reference else 1.0 for p in effect.parameters}
    shapes = [[(p.name, g * scale[p.name]) for g in p.grid or (1.0,)] for p in effect.shapes]
    out = []
    for chosen in product(*shapes):
        own = dict(chosen)
        if not isinstance(effect, PortEffect) or not effect.amplitudes:
            out.append(Term(effect=effect, place=place, values=own))
            continue
        out += [
            Term(effect=effect, place=place, values=values)
            for values in _amplitudes(problem, effect, place, own, size, omega)
        ]
    return out


def _amplitudes(
    problem: FrequencyProblem, effect: PortEffect, place: Place, shapes: dict[str, float], size: float, omega: float
) -> list[dict[str, float]]:
    unit = {}
    for p in effect.amplitudes:
        values = {q.name: 0.0 for q in effect.amplitudes} | shapes | {p.name: 1.0}
        z = equivalent(effect, values, np.array([size]), np.array([omega])).value[0]
        unit[p.name] = 1.0 / max(abs(z), 1e-300)
    stiffness = reference_scales(problem, place).stiffness
    first, *others = effect.amplitudes
    grids = [_signed(first, np.array(LEVEL_TRIALS.shares) * stiffness * unit[first.name])]
    out = []
    for value in grids[0]:
        share = abs(value) / unit[first.name]
        rest = [_signed(p, np.array(LEVEL_TRIALS.further) * share * unit[p.name]) for p in others]
        for further in product(*rest):
            named = {p.name: float(v) for p, v in zip(others, further, strict=True)}
            out.append({**shapes, first.name: float(value), **named})
    return out


def _signed(p: Parameter, values: Array) -> Array:
    return np.concatenate([-values, values]) if p.signed else values


def _largest(problem: FrequencyProblem, levels: Levels, effect: Effect, place: Place) -> tuple[float, float]:
    """Return the largest signal at a place, and its circular frequency."""
    sizes, omegas = [0.0], [1.0]
    for motion in levels.motions:
        if effect.kind == "port":
            a, w = motion.amplitude(place.rows[0]), motion.omega(place.rows[0])
        elif motion.excitation is None:
            continue
        elif effect.kind == "actuator":
            a, w = motion.excitation.amplitude, motion.excitation.omega
        else:
            data = motion.data
            assert isinstance(data, Response)
            w = data.omega
            power = float(problem.wires.orders[place.index] - data.order)
            a = motion.excitation.size(motion.outputs[:, place.index] * w**power * motion.excitation.amplitude)
        best = a * w if dependence(effect) == "velocity" else a
        k = int(np.argmax(best))
        sizes.append(float(a[k]))
        omegas.append(float(w[k]))
    k = int(np.argmax(sizes))
    return sizes[k], omegas[k]
