"""Compiled time integration with nonlinear laws as expression graphs.

Parameter sets and recordings are integrated as one batch. Forces act explicitly: a law receives the midpoint of the
free step, with the last force as estimate of its own.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from vlab.compilation import compiled
from vlab.diagnose.settings import KERNELS
from vlab.physics.compiled_expression import (
    AT_COMMAND,
    AT_FIRST,
    AT_FREE,
    AT_T,
    AT_V,
    AT_Z,
    evaluate,
    loaded,
)
from vlab.physics.expression import ExpressionGraph
from vlab.signals import Array

CHECKED = KERNELS.checked
"""CHECKED [samples]: interval of the divergence check, a constant of the compiled loops."""
MOST = KERNELS.most
"""MOST [1]: magnitude in SI units to which a diverged state is clipped, a constant of the compiled loops."""
RUNAWAY = KERNELS.runaway
"""RUNAWAY [1]: magnitude in SI units from which a state has diverged, a constant of the compiled loops."""


in_any_order = compiled(error_model="numpy", fastmath={"reassoc", "contract"})
"""Decorator for loops whose sums may be reordered and vectorised."""


@in_any_order
def _add(force: Array, effect: Array, out: Array) -> None:  # pragma: no cover - compiled
    """Add a force's effect (n, n_lanes)."""
    for j in range(len(out)):
        for e in range(len(force)):
            out[j, e] += force[e] * effect[j, e]


@in_any_order
def _share(force: Array, effect: Array, share: float, out: Array) -> None:  # pragma: no cover - compiled
    """Add a share of a force's effect (n, n_lanes)."""
    if share != 0.0:
        for j in range(len(out)):
            for e in range(len(force)):
                out[j, e] += share * force[e] * effect[j, e]


@in_any_order
def _multiply(rows: Array, state: Array, out: Array) -> None:  # pragma: no cover - compiled
    """Write rows (n, 2m, n_lanes) times the state by lane."""
    for c in range(len(out)):
        for e in range(out.shape[1]):
            out[c, e] = 0.0
        for j in range(len(state)):
            for e in range(out.shape[1]):
                out[c, e] += state[j, e] * rows[c, j, e]


@in_any_order
def _drive(inputs: Array, into: Array, acting: Array, drive: Array) -> None:  # pragma: no cover - compiled
    """Write the inputs of a step and their effect.

    The inputs have shape (1 or n_sets, n_runs, n_inputs).
    """
    n_sets, n_runs, n_inputs = inputs.shape
    for e in range(drive.shape[1]):
        of = min(e // n_runs, n_sets - 1)
        for i in range(n_inputs):
            acting[i, e] = inputs[of, e % n_runs, i]
    drive[:] = 0.0
    for i in range(n_inputs):
        _add(acting[i], into[i], drive)


@in_any_order
def _read(rows: Array, direct: Array, state: Array, acting: Array, y: Array) -> None:  # pragma: no cover - compiled
    """Write the channels without laws."""
    _multiply(rows, state, y)
    for i in range(len(acting)):
        _add(acting[i], direct[i], y)


@in_any_order
def _step(turn: Array, dense: Array, drive: Array, held: Array, state: Array) -> None:  # pragma: no cover - compiled
    """Step the state in place.

    The step is modal unless step matrices are given.
    """
    size, lanes = state.shape
    m = size // 2
    if dense.shape[0] > 0:
        for j in range(m):
            for e in range(lanes):
                held[j, e] = state[j, e]
                state[j, e] = 0.0
        for i in range(m):
            for j in range(m):
                for e in range(lanes):
                    state[j, e] += held[i, e] * dense[i, j, e]
    else:
        for j in range(m):
            for e in range(lanes):
                x = state[j, e]
                state[j, e] = x * turn[0, j, e] - state[m + j, e] * turn[1, j, e]
                state[m + j, e] = x * turn[1, j, e] + state[m + j, e] * turn[0, j, e]
    for j in range(size):
        for e in range(lanes):
            state[j, e] += drive[j, e]


@in_any_order
def _see(
    observed_rows: Array, state: Array, last: Array, after: Array, known: Array
) -> None:  # pragma: no cover - compiled
    """Write the port motion of the free step.

    The estimated effect of all laws stands beside it. A force changes little in a step, so the last one estimates the unknown one.
    """
    _multiply(observed_rows, state, after)
    known[:] = 0.0
    for law in range(len(last)):
        for i in range(len(known)):
            for e in range(known.shape[1]):
                known[i, e] += last[law, i, e]


@in_any_order
def _keep_finite(state: Array) -> None:  # pragma: no cover - compiled
    """Clip a diverged state."""
    size, lanes = state.shape
    for j in range(size):
        for e in range(lanes):
            x = state[j, e]
            state[j, e] = MOST if np.isnan(x) else min(max(x, -MOST), MOST)


@in_any_order
def integrate_lanes(
    turn: Array,
    dense: Array,
    into: Array,
    rows: Array,
    direct: Array,
    inputs: Array,
    state: Array,
    observed_rows: Array,
    seen: Array,
    clock: tuple[int, float, Array],
    laws: tuple[Array, Array, Array, Array, Array, Array, Array, Array],
    graphs: tuple[Array, Array, Array, Array, Array],
    registers: Array,
    y: Array,
) -> None:  # pragma: no cover - compiled
    """Integrate linear states under inputs and laws, in place.

    The last axis of every array holds the lanes: parameter set times recording, recordings first. All inner loops run
    over lanes and are vectorised.

    Parameters
    ----------
    turn : (2, m, n_lanes) array
        Real and imaginary parts of the step's eigenvalues.
    dense : (m, m, n_lanes) array
        Step matrices, acting on rows from the right; empty in modal form.
    into : (n_inputs, 2m, n_lanes) array
        Effect of a unit input on the state.
    rows : (p, 2m, n_lanes) array
        Output rows.
    direct : (n_inputs, p, n_lanes) array
        Feedthrough.
    inputs : (n, 1 or substeps, 1 or n_sets, n_runs, n_inputs) array
        Inputs [SI].
    state : (2m, n_lanes) array
        Initial states, overwritten by the final ones.
    observed_rows : (2 n_ports, 2m, n_lanes) array
        Rows of port displacements and velocities.
    seen : (2 n_ports, n_lanes) array
        Port motion at the start of the step, overwritten.
    clock : tuple of int, float and (n_runs,) array
        Steps per sample, step [s] and time of every run's first sample [s].
    laws : tuple of array
        Port, command, state, port-motion and feedthrough maps of every law, and the register of its force. Then the map to
        the readings of force sensors, empty for none, and the share of a sample's own interval in these.
    graphs : tuple of array
        Expression graphs of the laws.
    registers : (n_registers, n_lanes) array
        Registers of all laws, overwritten.
    y : (n, p, n_lanes) array
        Channels [SI], overwritten.

    See Also
    --------
    vlab.diagnose.predictors.modal_integration : the modal form of the step.
    """
    substeps, h, late = clock
    ports, coils, push, felt, direct_law, results, effort, seen_share = laws
    operations, bounds, firsts, stored, recalled = graphs
    n, _, lanes = y.shape
    n_runs, sees, n_laws = inputs.shape[3], seen.shape[0], len(ports)
    after, known, held = np.empty_like(seen), np.empty_like(seen), np.empty_like(state)
    last, drive = np.zeros((n_laws, sees, lanes)), np.empty_like(state)
    acting, before = np.empty((inputs.shape[4], lanes)), np.zeros(y.shape[1:])
    for k in range(n):
        for sub in range(substeps):
            if sub < inputs.shape[1]:
                _drive(inputs[k, sub], into, acting, drive)
            if sub == 0:
                _read(rows, direct, state, acting, y[k])
                y[k] += before
                before[:] = 0.0
            _step(turn, dense, drive, held, state)
            _see(observed_rows, state, last, after, known)
            for law in range(n_laws):
                z, v, coil = ports[law], sees // 2 + ports[law], coils[law]
                own = registers[bounds[law, 0] : bounds[law + 1, 0]]
                for e in range(lanes):
                    own[AT_Z, e] = 0.5 * (seen[z, e] + (after[z, e] + known[z, e]))
                    own[AT_V, e] = 0.5 * (seen[v, e] + (after[v, e] + known[v, e]))
                    own[AT_FREE, e], own[AT_FIRST, e] = after[v, e], seen[v, e]
                for e in range(lanes):
                    own[AT_T, e] = late[e % n_runs] + (k * substeps + sub + 0.5) * h
                    own[AT_COMMAND, e] = (
                        inputs[k, 0, min(e // n_runs, inputs.shape[2] - 1), e % n_runs, coil] if coil >= 0 else 0.0
                    )
                evaluate(operations[bounds[law, 1] : bounds[law + 1, 1]], firsts[law], own)
                for i in range(bounds[law, 2], bounds[law + 1, 2]):
                    for e in range(lanes):
                        own[recalled[i], e] = own[stored[i], e]
                force = own[results[law]]
                _add(force, push[law], state)
                for i in range(sees):
                    for e in range(lanes):
                        known[i, e] -= last[law, i, e]
                        last[law, i, e] = force[e] * felt[law, i, e]
                        after[i, e] += last[law, i, e]
                if sub == 0:
                    _add(force, direct_law[law], y[k])
                if effort.shape[0] > 0:  # extrapolated from the middles of two substeps to the ends of the interval
                    first = 1.0 if substeps == 1 else 1.5 if sub == 0 else -0.5 if sub == 1 else 0.0
                    left = substeps - 1 - sub
                    past = 1.0 if substeps == 1 else 1.5 if left == 0 else -0.5 if left == 1 else 0.0
                    _share(force, effort[law], first * (1.0 if k == 0 else seen_share[law]), y[k])
                    _share(force, effort[law], past * (1.0 - seen_share[law]), before)
            for i in range(sees):
                for e in range(lanes):
                    seen[i, e] = after[i, e]
        if k % CHECKED == 0 and not np.abs(state).max() < RUNAWAY:
            _keep_finite(state)
            last[:] = 0.0


@compiled(error_model="numpy")
def _series(
    operations: Array, first: int, registers: Array, signals: Array, stored: Array, recalled: Array, result: int
) -> Array:  # pragma: no cover - compiled
    """Return a law's force (n, m) along given signals (n, n_signals, m)."""
    n, count, m = signals.shape
    out = np.empty((n, m))
    for k in range(n):
        for i in range(count):
            for e in range(m):
                registers[i, e] = signals[k, i, e]
        evaluate(operations, first, registers)
        for i in range(len(recalled)):
            for e in range(m):
                registers[recalled[i], e] = registers[stored[i], e]
        for e in range(m):
            out[k, e] = registers[result, e]
    return out


def series(graph: ExpressionGraph, z: Array, v: Array, t: Array, values: Sequence[Any], memory: Sequence[Any]) -> Array:
    """Return a law's force along a given motion.

    Parameters
    ----------
    graph : ExpressionGraph
        Graph of the law.
    z, v, t : (n, ...) array
        Displacement, velocity [SI] and time [s].
    values : sequence of array
        Parameters of the law.
    memory : sequence of array
        Initial memory.

    Returns
    -------
    (n, ...) array
        Force [SI].
    """
    return driven_series(graph, z, v, t, values, memory, ())[0]


def driven_series(
    graph: ExpressionGraph,
    z: Array,
    v: Array,
    t: Array,
    values: Sequence[Any],
    memory: Sequence[Any],
    others: Sequence[Any],
) -> tuple[Array, list[Array]]:
    """Return a law's force along a motion, and its final memory.

    Parameters
    ----------
    graph : ExpressionGraph
        Graph of the law.
    z, v, t : (n, ...) array
        Displacement, velocity [SI] and time [s].
    values : sequence of array
        Parameters of the law.
    memory : sequence of array
        Initial memory.
    others : sequence of array
        Further signals of a step, in the order of `vlab.physics.expression.SIGNALS`.

    Returns
    -------
    force : (n, ...) array
        Force [SI].
    memory : list of (...) array
        Memory after the last sample.
    """
    (operations, _, (first,), stored, recalled), registers = loaded([graph], [values], [memory], z.shape[1:])
    signals = np.stack([np.broadcast_to(x, z.shape).reshape(len(z), -1) for x in (z, v, t, *others)], axis=1)
    out = _series(operations, first, registers, signals, stored, recalled, graph.force)
    return np.asarray(out.reshape(z.shape)), [registers[i].reshape(z.shape[1:]) for i in recalled]
