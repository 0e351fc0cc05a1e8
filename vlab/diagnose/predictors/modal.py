"""Channels of hypotheses on the reduced model."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from vlab.diagnose.data.runs import Signals
from vlab.diagnose.parameters.discrete import discretise
from vlab.diagnose.parameters.effort_channels import EffortChannels
from vlab.diagnose.parameters.reduced_model import ReducedModel
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.predictors.integration import acting_order, integrate, law_at_start
from vlab.diagnose.predictors.residual_flexibility import StartLaw, StaticStart, residual_vectors
from vlab.diagnose.settings import MODAL, RUNS
from vlab.physics.effect import SETTLING, ActuatorEffect, LinearPortEffect, PickUp, PortEffect, SensorEffect
from vlab.signals import Array


def channels(
    reduced_model: ReducedModel,
    highest_hz: float,
    runs: list[Signals],
    terms: Sequence[Term],
    theta: Array,
    values: Sequence[Mapping[str, Array]],
    starts: Array,
    is_rough: bool = False,
) -> Array:
    """Return the channels of runs before sensor effects.

    Parameters
    ----------
    reduced_model : ReducedModel
        Reduced model.
    highest_hz : float
        Highest frequency of the motion [Hz].
    runs : list of Signals
        Runs of one sample period.
    terms : sequence of Term
        Effects.
    theta : (n_sets, n_changes) array
        Log factors.
    values : sequence of mapping
        Parameter values (n_sets,) of every term.
    starts : (n_sets, n_runs, 2m) array
        Initial states.
    is_rough : bool
        Whether to omit finer steps for nonsmooth laws.

    Returns
    -------
    (n, n_sets, n_runs, p) array
        Channels.
    """
    h, n_sets, ports = runs[0].h, len(theta), acting_order(terms)
    finer = MODAL.finer if not is_rough and any(_needs_finer_steps(terms[i]) for i in ports) else 1
    substeps = finer * max(1, int(np.ceil(MODAL.steps_per_cycle * highest_hz * h))) if ports else 1
    M, C, K, actuator_gain, _ = reduced_model.matrices(theta)
    places = [term.place for term in terms if isinstance(term.effect, PortEffect | LinearPortEffect)]
    residual = residual_vectors(reduced_model, places, h / substeps)
    M, C, K = residual.matrices(M, C, K)
    for term, own in zip(terms, values, strict=True):
        if isinstance(term.effect, LinearPortEffect):
            mass, damping, stiffness = term.effect.impedance(own, term.place.stiffness_at(theta))
            for push, row in zip(residual.push(term.place), residual.motion(term.place), strict=True):
                outer = np.outer(push, row)
                M = M + np.broadcast_to(mass, n_sets)[:, None, None] * outer
                C = C + np.broadcast_to(damping, n_sets)[:, None, None] * outer
                K = K + np.broadcast_to(stiffness, n_sets)[:, None, None] * outer
    forces, ends = _inputs(runs, terms, values, n_sets, with_ends=reduced_model.efforts is not None)
    known = np.concatenate(
        [
            reduced_model.forces_at(theta),
            np.broadcast_to(reduced_model.loads, (n_sets, *reduced_model.loads.shape)),
        ],
        axis=2,
    )
    known = residual.inputs(known, actuator_gain)
    seen, pushes = ([at(terms[i].place)[0] for i in ports] for at in (residual.motion, residual.push))
    columns = np.array(pushes).reshape(len(ports), M.shape[1]).T
    inputs = np.concatenate([known, np.broadcast_to(columns, (n_sets, *columns.shape))], axis=2)
    starts = residual.states(starts)
    moving = np.array([not run.at_rest for run in runs])
    if residual.r and moving.any():
        still = StaticStart(K=K, m=reduced_model.m, is_moving=moving)
        held = np.broadcast_to(forces[0], (n_sets, *forces.shape[2:])) @ known.swapaxes(1, 2)
        with np.errstate(all="ignore"):  # a diverged trial
            laws = [law_at_start(terms[i], values[i], runs, n_sets) for i in ports]
            starts = _in_equilibrium(still, starts, held, list(zip(laws, seen, pushes, strict=True)), MODAL.brief * h)
    system = discretise(M, C, K, inputs, residual.channels(reduced_model.rows), h / substeps)
    if reduced_model.shifts or reduced_model.efforts is not None:
        system = replace(system, C=system.C + residual.states(reduced_model.shifted(theta)))
    with np.errstate(all="ignore"):  # a diverged trial keeps its large residual
        y = integrate(system, forces, known.shape[2], terms, values, (ports, seen), starts, runs, substeps)
        if reduced_model.efforts is not None:
            y = y + reduced_model.efforts.added(theta, *_commands_seen(reduced_model.efforts, runs, forces, ends))
    return y


def _needs_finer_steps(term: Term) -> bool:
    """Return whether a law needs finer steps.

    The law has edges, or force sensors read it at the end of a step.
    """
    is_read = term.effect.acts_in_drive and term.place.effort_in_drive is not None
    return term.effect.traits.is_nonsmooth or is_read


def _in_equilibrium(
    still: StaticStart, starts: Array, held: Array, laws: Sequence[tuple[StartLaw, Array, Array]], brief: float
) -> Array:
    """Return starts with the static deflection under inputs and laws.

    Parameters
    ----------
    still : StaticStart
        Residual coordinates.
    starts : (n_sets, n_runs, 2n) array
        States of the modes.
    held : (n_sets, n_runs, n) array
        Forces of the inputs on the coordinates.
    laws : sequence of tuple
        Laws, with the rows of their motion and of their push (n,).
    brief : float
        Time over which the rate of a law's force is taken [s].

    Returns
    -------
    (n_sets, n_runs, 2n) array
        States.
    """
    rates = np.zeros_like(held)
    first = still.under(starts, held, rates)
    displacement, velocity = np.split(first, 2, axis=-1)
    soon = np.concatenate([displacement + brief * velocity, velocity], axis=-1)
    for law, row, push in laws:
        now, then = (still.force(law, states, row, push)[..., None] for states in (first, soon))
        held, rates = held + now * push, rates + (then - now) / brief * push
    return still.under(starts, held, rates)


def _inputs(
    runs: list[Signals], terms: Sequence[Term], values: Sequence[Mapping[str, Array]], n_sets: int, *, with_ends: bool
) -> tuple[Array, Array]:
    """Return commands after actuator effects, and direct loads.

    The second array has the commands at the ends of the intervals, as behind a lag, if asked for.
    """
    n = max(len(run) for run in runs)
    out = np.zeros((n, 1, len(runs), runs[0].u.shape[1] + runs[0].load.shape[1]))
    for i, run in enumerate(runs):
        out[: len(run), 0, i] = np.hstack([run.u, run.load])
    ends, before = out, _led(runs)
    for term, own in zip(terms, values, strict=True):
        if isinstance(term.effect, ActuatorEffect):
            out = np.repeat(out, n_sets, axis=1) if out.shape[1] == 1 else out
            ends = np.repeat(ends, n_sets, axis=1) if ends.shape[1] == 1 else ends.copy()
            for s in range(n_sets):
                p = {k: float(v[s]) for k, v in own.items()}
                for i in term.place.indices:
                    given = out[:, s, :, i].copy()
                    out[:, s, :, i] = _acted(term.effect, p, runs, before[..., i], given)
                    ends[:, s, :, i] = out[:, s, :, i]
                    if with_ends and type(term.effect).ends is not ActuatorEffect.ends:
                        ends[:, s, :, i] = _acted(term.effect, p, runs, before[..., i], given, at_ends=True)
    return out, ends


def _commands_seen(efforts: EffortChannels, runs: list[Signals], forces: Array, ends: Array) -> tuple[Array, Array]:
    """Return recorded commands as force sensors see them, and their changes by effects.

    Where an effect lets a held command glide within the intervals, a reading sees the end of the last one.
    """
    count = runs[0].u.shape[1]
    recorded, seen = np.zeros((2, len(forces), len(runs), count))
    for i, run in enumerate(runs):
        recorded[: len(run), i], seen[: len(run), i] = run.u, run.seen
    moves = np.array([[not run.at_rest] for run in runs])
    changed = forces[..., :count] - recorded[:, None]
    before = np.concatenate([changed[:1] * moves, changed[:-1]])
    at_ends = np.concatenate([ends[:1, ..., :count] * moves, ends[:-1, ..., :count]]) - seen[:, None]
    glides = np.any(ends[..., :count] != forces[..., :count], axis=(0, 2)) & (efforts.seen != 0.5)
    return seen, np.where(glides[:, None], at_ends, (1.0 - efforts.seen) * before + efforts.seen * changed)


def _acted(
    effect: ActuatorEffect,
    p: Mapping[str, float],
    runs: list[Signals],
    before: Array,
    u: Array,
    *,
    at_ends: bool = False,
) -> Array:
    """Return an actuator's commands (n, n_runs) after an effect with memory."""
    h = runs[0].h
    if effect.keeps_time:
        return np.stack(
            [_on_clock(effect, p, run, lead, x) for run, lead, x in zip(runs, before.T, u.T, strict=True)], 1
        )
    needed = max(RUNS.preroll, int(np.ceil(effect.reach(p) / h)) + 1)
    led = before if effect.keeps_extremes else before[-needed:]
    whole = np.concatenate([led, u])
    rest = np.array([run.at_rest for run in runs])
    return effect.follow(whole, p, h, np.where(rest, 0.0, whole[0]), at_ends=at_ends)[len(led) :]


def _on_clock(effect: ActuatorEffect, p: Mapping[str, float], run: Signals, before: Array, u: Array) -> Array:
    """Return commands (n,) after an effect whose clock starts with the recording.

    The lead begins at a tick of that clock.
    """
    first = round(run.t0 / run.h)
    lead = 0 if run.led is None else min(len(run.led), first)
    every = round(effect.reach(p) / run.h)
    start = first - lead
    if start and every:  # nearest later sample at a tick
        lead -= min(-start % every, lead)
    whole = np.concatenate([before[len(before) - lead :], u])
    return effect.follow(whole, p, run.h, 0.0 if run.at_rest else float(whole[0]))[lead:]


def _led(runs: list[Signals]) -> Array:
    """Return the commands before every run, (k, n_runs, n_actuators).

    Shorter leads continue backwards.
    """
    leads = [run.u[:0] if run.led is None else run.led for run in runs]
    most = max(len(lead) for lead in leads)
    first = [lead[0] if len(lead) else run.command_before for lead, run in zip(leads, runs, strict=True)]
    filled = [np.vstack([np.tile(x, (most - len(lead), 1)), lead]) for x, lead in zip(first, leads, strict=True)]
    return np.stack(filled, axis=1)


def mix(y: Array, term: Term, own: Mapping[str, Array], runs: Sequence[Signals]) -> None:
    """Add crosstalk to a channel, in place.

    Parameters
    ----------
    y : (n, n_sets, n_runs, p) array
        Channels, overwritten.
    term : Term
        Pick-up.
    own : mapping of str to (n_sets,) array
        Parameter values of the pick-up.
    runs : sequence of Signals
        Runs with commands.
    """
    assert isinstance(term.effect, PickUp)
    i, k = term.place.index, term.place.other
    if term.place.tag != "command":
        other = y[..., k]
    else:
        other = np.zeros((len(y), 1, len(runs)))
        for j, run in enumerate(runs):  # a sample is taken before its command takes effect
            other[1 : len(run), 0, j] = run.u[:-1, k]
            other[0, 0, j] = 0.0 if run.led is None or not len(run.led) else run.led[-1, k]
    p = {name: np.asarray(value)[:, None] for name, value in own.items()}
    with np.errstate(all="ignore"):  # a diverged trial
        y[..., i] = term.effect.mix(y[..., i], other, p)


def sense(
    y: Array,
    effect: SensorEffect,
    index: int,
    gains: Array,
    given: Mapping[str, Array],
    runs: Sequence[Signals],
) -> None:
    """Apply a sensor effect to its channel, in place.

    A window needs the motion before its start for a sensor with dynamics. An odd extension replaces unknown motion.

    Parameters
    ----------
    y : (n, n_sets, n_runs, p) array
        Channels, overwritten.
    effect : SensorEffect
        Effect.
    index : int
        Channel.
    gains : (n_sets, p) array
        Gains of the sensors.
    given : mapping of str to (n_sets,) array
        Parameter values.
    runs : sequence of Signals
        Runs.
    """
    for s in range(y.shape[1]):
        p = {k: float(v[s]) for k, v in given.items()}
        for j, run in enumerate(runs):
            column, before = y[:, s, j, index], y[:0, s, j, index]
            if run.shown is not None and len(run.shown):
                before = gains[s, index] * run.shown[-effect.settling_samples(p, run.h) :, index]
            elif not run.at_rest:
                before = 2.0 * column[0] - column[SETTLING:0:-1]
            lead = len(before)
            t = run.t0 + np.arange(-lead, len(y)) * run.h
            y[:, s, j, index] = effect.sense(np.concatenate([before, column]), p, run.h, t)[lead:]
