"""Trial values for the screening in frequency."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from vlab.diagnose.data.responses import Response
from vlab.diagnose.parameters.locations import Place, admissible
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.predictors.frequency_problem import FrequencyProblem
from vlab.diagnose.settings import TRIAL_VALUES
from vlab.physics.describing_function import has_describing_function
from vlab.physics.effect import Effect, Parameter
from vlab.physics.small_signal import is_linear
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Scales:
    """Reference mass, stiffness and damping at a port.

    Parameters
    ----------
    mass, stiffness, damping : float
        Reference values [kg, N/m, N s/m].
    """

    mass: float
    stiffness: float
    damping: float


def candidates(
    problem: FrequencyProblem, effects: Sequence[Effect], *, with_levels: bool = False
) -> list[tuple[Effect, Place]]:
    """Return every identifiable effect at every admissible location.

    Parameters
    ----------
    problem : FrequencyProblem
        Problem.
    effects : sequence of Effect
        Effects.
    with_levels : bool
        Whether the data have several known levels, which identify nonlinear effects.

    Returns
    -------
    list of (Effect, Place)
        Pairs.
    """
    has_responses = any(isinstance(d, Response) for d in problem.measured)
    out = []
    for effect in effects:
        if effect.kind != "port" and not has_responses:
            continue
        if not is_linear(effect) and not (with_levels and has_describing_function(effect)):
            continue
        out += [(effect, place) for place in problem.places if _fits(problem, effect, place)]
    return out


def _fits(problem: FrequencyProblem, effect: Effect, place: Place) -> bool:
    if not admissible(effect, place) or (len(place.rows) > 1 and not is_linear(effect)):
        return False
    if effect.kind == "actuator" or place.tag == "command":
        used = {d.input for d in problem.measured if isinstance(d, Response)}
        pairs = zip(problem.wires.inputs, problem.wires.actuators, strict=True)
        fitted = {actuator for name, actuator in pairs if name in used}
        return not fitted.isdisjoint(place.indices if effect.kind == "actuator" else (place.other,))
    if effect.kind == "sensor":
        name = problem.names[place.index]
        return any(isinstance(d, Response) and name in d.outputs for d in problem.measured)
    # at an elastic element a negative stiffness is a loss of stiffness
    return not (effect.name == "magnetic-negative-stiffness" and place.stiffness > 0)


def trials(problem: FrequencyProblem, effect: Effect, place: Place) -> list[Term]:
    """Return the trial terms of an effect at a location.

    Parameters
    ----------
    problem : FrequencyProblem
        Problem.
    effect : Effect
        Effect.
    place : Place
        Location.

    Returns
    -------
    list of Term
        Terms on a grid of values.
    """
    grids = [_grid(problem, effect, place, p) for p in effect.parameters]
    out = []
    for values in product(*grids):
        named = dict(zip((p.name for p in effect.parameters), (float(v) for v in values), strict=True))
        out.append(Term(effect=effect, place=place, values=named))
    return out


def _grid(problem: FrequencyProblem, effect: Effect, place: Place, p: Parameter) -> Array:
    low, high = problem.measured_hz
    is_alone = len(effect.parameters) == 1
    by_lines = any(isinstance(d, Response) for d in problem.measured)
    if effect.kind != "port":
        return np.array(_channel_grid(problem, effect, place, p, low, high))
    scales = reference_scales(problem, place)
    if p.unit.startswith("Hz"):
        below, above = TRIAL_VALUES.beside_band
        if effect.family == "damping":
            return np.array([np.sqrt(low * high)])
        return (
            _frequencies(problem, low, high)
            if by_lines
            else np.geomspace(below * low, above * high, TRIAL_VALUES.resonances)
        )
    if p.unit == "1":
        return np.array(TRIAL_VALUES.shares if is_alone else TRIAL_VALUES.ratios[:1])
    if p.unit.startswith("kg"):
        grid = scales.mass * np.array(TRIAL_VALUES.masses if is_alone else TRIAL_VALUES.oscillator_masses)
    elif p.unit.startswith("N s"):
        grid = scales.damping * np.array(TRIAL_VALUES.dampings)
    else:
        grid = scales.stiffness * np.array(TRIAL_VALUES.stiffnesses if is_alone else TRIAL_VALUES.stiffnesses[:7:2])
    grid = np.clip(grid, p.low, p.high) if not p.reference else grid
    return np.unique(np.concatenate([-grid, grid]) if p.signed else grid)


def _frequencies(problem: FrequencyProblem, low: float, high: float) -> Array:
    """Return frequencies over the band, with the model's own."""
    own = np.abs(problem.view.omega) / (2 * np.pi)
    own = own[(own > low) & (own < high)][: TRIAL_VALUES.own_frequencies]
    return np.unique(np.concatenate([np.geomspace(low, high, TRIAL_VALUES.frequencies), own]).round(9))


def _channel_grid(
    problem: FrequencyProblem, effect: Effect, place: Place, p: Parameter, low: float, high: float
) -> Sequence[float]:
    if p.unit == "s":
        if effect.family == "sensor-dynamics":
            return [t / (2 * np.pi * low) for t in TRIAL_VALUES.slow_times] + [
                t / (2 * np.pi * high) for t in TRIAL_VALUES.times[TRIAL_VALUES.fast_times :]
            ]
        longer = TRIAL_VALUES.long_lags if "lag" in effect.name else ()
        return [t / (2 * np.pi * high) for t in (*TRIAL_VALUES.times, *longer)]
    if p.unit == "Hz":
        first, last, count = TRIAL_VALUES.corners
        return list(np.geomspace(first * low, last * high, count))
    if effect.picks_up:
        if "command" not in effect.needs:
            return TRIAL_VALUES.picked
        size = np.median(
            np.concatenate(
                [
                    np.abs(d.H[:, d.outputs.index(problem.names[place.index])])
                    for d in problem.measured
                    if isinstance(d, Response) and problem.names[place.index] in d.outputs
                ]
            )
        )
        return [float(size) * s for s in TRIAL_VALUES.crosstalk]
    if p.unit == "1":
        return TRIAL_VALUES.gains if len(effect.parameters) == 1 else TRIAL_VALUES.ratios
    if p.grid and not p.reference:
        return p.grid
    return list(np.geomspace(p.low, p.high, TRIAL_VALUES.any_values))


def reference_scales(problem: FrequencyProblem, place: Place) -> Scales:
    """Return the reference values of a location in the band.

    Parameters
    ----------
    problem : FrequencyProblem
        Problem.
    place : Place
        Location.

    Returns
    -------
    Scales
        Smallest modal mass, stiffness and damping at the location.
    """
    high = problem.measured_hz[1]
    omega = np.abs(problem.view.omega)
    slowest, fastest = TRIAL_VALUES.scale_band
    near = (omega < 2 * np.pi * fastest * high) & (omega > 1e-6)
    near = near if near.any() else omega > 1e-6
    near = near if near.any() else np.ones(len(omega), dtype=bool)
    moved = np.sum(place.rows**2, axis=0)[near]
    w = np.maximum(omega[near], 2 * np.pi * slowest * high)
    seen = moved > TRIAL_VALUES.unseen * moved.max()
    moved, w = moved[seen], w[seen]
    return Scales(
        mass=float(1 / moved.max()), stiffness=float((w**2 / moved).min()), damping=float((2 * w / moved).min())
    )
