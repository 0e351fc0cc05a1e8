"""Compiled integration along a motion, with port laws."""

from collections.abc import Sequence

import numpy as np

from vlab.diagnose.kernels.expression_graph import in_any_order
from vlab.diagnose.predictors.trajectory_laws import Law
from vlab.diagnose.settings import TRAJECTORY_INTEGRATION
from vlab.physics.compiled_expression import (
    AT_COMMAND,
    AT_FREE,
    AT_H,
    AT_MOBILITY,
    AT_T,
    AT_V,
    AT_Z,
    ExpressionGraphs,
    evaluate,
    loaded,
)
from vlab.physics.effect import PortEffect
from vlab.physics.expression import SIGNALS, ExpressionGraph, trace_expression
from vlab.signals import Array

CHECK_EVERY = TRAJECTORY_INTEGRATION.check_every
"""CHECK_EVERY [steps]: interval of the divergence check, a constant of the compiled loops."""
FAR = TRAJECTORY_INTEGRATION.far
"""FAR [1]: magnitude in SI units to which a diverged deviation is clipped, a constant of the compiled loops."""

Paths = tuple[Array, Array, Array, Array]
"""Rows (n_laws, steps + 1, lines, n, n_windows, m), displacements and velocities of ports, and weights of lines."""
Acting = tuple[Array, Array, Array, Array]
"""Effect of every law on states and readings, its gain (n_laws, n, n_windows, lines, lines) and its reach."""
Clock = tuple[Array, Array, Array]
"""Step length, time and command (n_laws, n, n_windows) of every law."""

_SEEN = tuple(name for name in SIGNALS if name != "first_velocity")


def trace_laws(laws: Sequence[Law]) -> list[ExpressionGraph | None] | None:
    """Return the expression graphs of laws, None for linear laws.

    Parameters
    ----------
    laws : sequence of Law
        Laws.

    Returns
    -------
    list or None
        Graphs; None where a law has no graph.
    """
    out: list[ExpressionGraph | None] = []
    for law in laws:
        if law.is_linear:
            out.append(None)
            continue
        assert isinstance(law.effect, PortEffect)
        graph = trace_expression(law.effect, law.path.even, _SEEN, law.numbers)
        if graph is None:
            return None
        out.append(graph)
    return out


def integrate_trajectory(
    laws: Sequence[Law],
    graphs: Sequence[ExpressionGraph | None],
    A: Array,
    drive: Array,
    defect: Array,
    starts: Array,
    forces: Array,
    steps: int,
) -> Array:
    """Integrate deviations along a motion with laws in the loop.

    The laws' first forces of every interval are added to `forces`.

    Parameters
    ----------
    laws, graphs : sequence
        Laws in their order of evaluation, and their graphs from `trace_laws`.
    A : (n, n_windows, 2 nv, 2 nv) array
        State matrices of a step.
    drive : (n, n_sets, n_windows, 2 nv) array
        Effect of the inputs in a step.
    defect : (n, n_sets or 1, n_windows, 2 nv) array
        Motion minus the model's prediction at the next sample.
    starts : (n_sets, n_windows, 2 nv) array
        Initial deviations.
    forces : (n, n_sets, n_windows, nv + p) array
        Generalised forces and direct readings, overwritten; empty without force-dependent channels.
    steps : int
        Steps per sample interval.

    Returns
    -------
    (n, n_sets, n_windows, 2 nv) array
        Deviations at all samples.
    """
    n, n_sets, n_windows, size = drive.shape
    traced = [(law, graph) for law, graph in zip(laws, graphs, strict=True) if graph is not None]
    own = [[law.p[name] for name in (*(p.name for p in law.effect.parameters), *law.numbers)] for law, _ in traced]
    memories = [law.memory or () for law, _ in traced]
    held, registers = loaded([graph for _, graph in traced], own, memories, (n_sets, n_windows))
    results = np.array([graph.force for _, graph in traced], dtype=np.int64)
    impedance = np.zeros((len(laws), 3, n_sets))
    for i, law in enumerate(laws):
        if law.is_linear:
            impedance[i] = np.array(law.impedance)[..., 0]
    which = iter(range(len(traced)))
    kinds = np.array(
        [
            (law.path.rows.shape[1], -1 if law.is_linear else next(which), law.memory is None and not law.is_last)
            for law in laws
        ],
        dtype=np.int64,
    ).reshape(-1, 3)
    paths, acting, clock = _tables(laws, n, n_windows, size, steps, forces.shape[-1])
    states, x = np.empty_like(drive), np.ascontiguousarray(starts)
    system = (np.ascontiguousarray(A), np.ascontiguousarray(drive), np.ascontiguousarray(defect))
    _integrate(
        system, steps, paths, acting, impedance, kinds, clock, held, results, registers, x.copy(), states, forces
    )
    return states


def _tables(
    laws: Sequence[Law], n: int, n_windows: int, size: int, steps: int, n_forces: int
) -> tuple[Paths, Acting, Clock]:
    """Return paths, effects and clock of all laws, equally padded."""
    lines = max((law.path.rows.shape[1] for law in laws), default=1)

    def padded(x: Array, axes: tuple[int, ...]) -> Array:
        return np.pad(x, [(0, lines - x.shape[a] if a in axes else 0) for a in range(x.ndim)])

    def together(parts: list[Array], *shape: int) -> Array:
        return np.ascontiguousarray(parts) if parts else np.zeros((0, *shape))

    paths = (
        together([padded(law.path.rows, (1,)) for law in laws], steps + 1, lines, n, n_windows, size // 2),
        together([padded(law.path.z, (1,)) for law in laws], steps + 1, lines, n, n_windows),
        together([padded(law.path.v, (1,)) for law in laws], steps + 1, lines, n, n_windows),
        together([padded(law.path.weight, (0,)) for law in laws], lines),
    )
    acting = (
        together([padded(law.into, (0,)) for law in laws], lines, n, n_windows, size),
        together([padded(law.seen, (0,)) for law in laws], lines, n, n_windows, n_forces),
        together([padded(law.gain, (2, 3)) for law in laws], n, n_windows, lines, lines),
        together([law.reach[..., 0, 0] for law in laws], n, n_windows),
    )
    still = np.zeros((n, n_windows))
    clock = (
        together([law.path.h for law in laws], n, n_windows),
        together([law.t for law in laws], n, n_windows),
        together([still if law.command is None else law.command for law in laws], n, n_windows),
    )
    return paths, acting, clock


@in_any_order
def _step_freely(A: Array, drive: Array, k: int, x: Array, free: Array) -> None:  # pragma: no cover - compiled
    """Write the states after a step of sample `k` without laws."""
    n_sets, n_windows, size = x.shape
    for s in range(n_sets):
        for w in range(n_windows):
            for a in range(size):
                total = drive[k, s, w, a]
                for b in range(size):
                    total += A[k, w, a, b] * x[s, w, b]
                free[s, w, a] = total


@in_any_order
def _see_port(
    paths: Paths, law: int, k: int, j: int, count: int, x: Array, free: Array, motion: Array
) -> None:  # pragma: no cover - compiled
    """Write the port motion at both ends of a step.

    The rows of `motion` (4, n_lines, n_sets * n_windows) are z0, z1, v0 and v1.
    """
    rows, at_z, at_v, _ = paths
    n_sets, n_windows, size = x.shape
    m = size // 2
    for i in range(count):
        for s in range(n_sets):
            for w in range(n_windows):
                z0, z1 = at_z[law, j, i, k, w], at_z[law, j + 1, i, k, w]
                v0, v1 = at_v[law, j, i, k, w], at_v[law, j + 1, i, k, w]
                for a in range(m):
                    before, after = rows[law, j, i, k, w, a], rows[law, j + 1, i, k, w, a]
                    z0 += x[s, w, a] * before
                    v0 += x[s, w, m + a] * before
                    z1 += free[s, w, a] * after
                    v1 += free[s, w, m + a] * after
                e = s * n_windows + w
                motion[0, i, e], motion[1, i, e], motion[2, i, e], motion[3, i, e] = z0, z1, v0, v1


@in_any_order
def _show_law(
    motion: Array, clock: Clock, gain: Array, law: int, k: int, j: int, own: Array
) -> None:  # pragma: no cover - compiled
    """Write a law's signals.

    Motions are means over the step, with trapezoidal end correction.
    """
    lengths, times, commands = clock
    n_windows = lengths.shape[2]
    for e in range(own.shape[1]):
        w = e % n_windows
        h = lengths[law, k, w]
        z0, z1, v0, v1 = motion[0, 0, e], motion[1, 0, e], motion[2, 0, e], motion[3, 0, e]
        own[AT_Z, e] = 0.5 * (z0 + z1) - h * (v1 - v0) / 12.0
        own[AT_V, e] = 0.5 * (v0 + v1)
        own[AT_T, e] = times[law, k, w] + (j + 0.5) * h
        own[AT_FREE, e], own[AT_COMMAND, e] = v1, commands[law, k, w]
        own[AT_MOBILITY, e], own[AT_H, e] = gain[law, k, w, 0, 0], h


@in_any_order
def _solve_impedance(
    impedance: Array,
    motion: Array,
    weight: Array,
    acting: Acting,
    lengths: Array,
    law: int,
    k: int,
    count: int,
    matrix: Array,
    force: Array,
) -> None:  # pragma: no cover - compiled
    """Write the mean force (n_lines, n_sets * n_windows) of an impedance at a port.

    The force is implicit in its own effect. The mean displacement is of the trapezoidal rule with end correction, on a port of one line. Gauss elimination needs no
    pivoting, since the matrix is near identity.
    """
    _, _, gain, reach = acting
    n_windows = lengths.shape[2]
    for e in range(force.shape[1]):
        s, w = e // n_windows, e % n_windows
        h = lengths[law, k, w]
        mass, damping, stiffness = impedance[law, 0, s], impedance[law, 1, s], impedance[law, 2, s]
        bend = h / 12.0 if count == 1 else 0.0
        for i in range(count):
            z0, z1, v0, v1 = motion[0, i, e], motion[1, i, e], motion[2, i, e], motion[3, i, e]
            force[i, e] = (
                -mass * ((v1 - v0) / h - weight[law, i])
                - 0.5 * damping * (v0 + v1)
                - stiffness * (0.5 * (z0 + z1) - bend * (v1 - v0))
            )
            for a in range(count):
                matrix[i, a] = (mass / h + 0.5 * damping) * gain[law, k, w, i, a]
            matrix[i, i] += 1.0
        if count == 1:
            matrix[0, 0] += stiffness * (0.5 * reach[law, k, w] - h * gain[law, k, w, 0, 0] / 12.0)
        for i in range(count):
            for a in range(i + 1, count):
                factor = matrix[a, i] / matrix[i, i]
                for b in range(i, count):
                    matrix[a, b] -= factor * matrix[i, b]
                force[a, e] -= factor * force[i, e]
        for i in range(count - 1, -1, -1):
            for b in range(i + 1, count):
                force[i, e] -= matrix[i, b] * force[b, e]
            force[i, e] /= matrix[i, i]


@in_any_order
def _correct_port(
    own: Array, result: int, acting: Acting, lengths: Array, law: int, k: int
) -> None:  # pragma: no cover - compiled
    """Add a law's own effect to its port's mean motion."""
    _, _, gain, reach = acting
    n_windows = lengths.shape[2]
    for e in range(own.shape[1]):
        w = e % n_windows
        first = own[result, e]
        own[AT_Z, e] += first * (0.5 * reach[law, k, w] - lengths[law, k, w] * gain[law, k, w, 0, 0] / 12.0)
        own[AT_V, e] += 0.5 * gain[law, k, w, 0, 0] * first


@in_any_order
def _apply(force: Array, into: Array, law: int, k: int, out: Array, count: int) -> None:  # pragma: no cover - compiled
    """Add a law's effect to states or readings.

    The force has shape (n_lines, n_sets * n_windows).
    """
    n_windows = out.shape[1]
    for s in range(out.shape[0]):
        for w in range(n_windows):
            for i in range(count):
                own = force[i, s * n_windows + w]
                for a in range(out.shape[2]):
                    out[s, w, a] += own * into[law, i, k, w, a]


@in_any_order
def _close_gap(x: Array, defect: Array, k: int, is_checked: bool) -> None:  # pragma: no cover - compiled
    """Subtract the gap between motion and prediction.

    Diverged states are clipped where they are checked.
    """
    n_sets, n_windows, size = x.shape
    for s in range(n_sets):
        of = min(s, defect.shape[1] - 1)
        for w in range(n_windows):
            for a in range(size):
                x[s, w, a] -= defect[k, of, w, a]
                if is_checked:
                    now = x[s, w, a]
                    x[s, w, a] = FAR if np.isnan(now) else min(max(now, -FAR), FAR)


@in_any_order
def _integrate(
    system: tuple[Array, Array, Array],
    steps: int,
    paths: Paths,
    acting: Acting,
    impedance: Array,
    kinds: Array,
    clock: Clock,
    graphs: ExpressionGraphs,
    results: Array,
    registers: Array,
    x: Array,
    states: Array,
    forces: Array,
) -> None:  # pragma: no cover - compiled
    """Write the states at all samples.

    The functions of a step take whole arrays, since views cost more than their loops.
    """
    A, drive, defect = system
    (rows, _, _, weight), (into, seen, gain, _) = paths, acting
    operations, bounds, firsts, stored, recalled = graphs
    n, n_sets, n_windows, _ = drive.shape
    n_laws, lines, lanes = len(kinds), rows.shape[2], n_sets * n_windows
    free, force = np.empty_like(x), np.zeros((lines, lanes))
    motion, matrix = np.zeros((4, lines, lanes)), np.zeros((lines, lines))
    for k in range(n):
        states[k] = x
        for j in range(steps):
            _step_freely(A, drive, k, x, free)
            for law in range(n_laws):
                count, graph, twice = kinds[law]
                _see_port(paths, law, k, j, count, x, free, motion)
                if graph < 0:
                    _solve_impedance(impedance, motion, weight, acting, clock[0], law, k, count, matrix, force)
                else:
                    own = registers[bounds[graph, 0] : bounds[graph + 1, 0]]
                    evaluated = operations[bounds[graph, 1] : bounds[graph + 1, 1]]
                    _show_law(motion, clock, gain, law, k, j, own)
                    evaluate(evaluated, firsts[graph], own)
                    if twice:  # second evaluation, since stiff stops change their own motion
                        _correct_port(own, results[graph], acting, clock[0], law, k)
                        evaluate(evaluated, firsts[graph], own)
                    for i in range(bounds[graph, 2], bounds[graph + 1, 2]):
                        for e in range(lanes):
                            own[recalled[i], e] = own[stored[i], e]
                    for e in range(lanes):
                        force[0, e] = own[results[graph], e]
                _apply(force, into, law, k, free, count)
                if j == 0 and forces.shape[0] > 0:
                    _apply(force, seen, law, k, forces[k], count)
            x[:] = free
        _close_gap(x, defect, k, k % CHECK_EVERY == 0)
