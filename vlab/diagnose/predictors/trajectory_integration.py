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
) -> tuple[tuple[Array, Array, Array, Array], tuple[Array, Array, Array, Array], tuple[Array, Array, Array]]:
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
def _integrate(
    system: tuple[Array, Array, Array],
    steps: int,
    paths: tuple[Array, Array, Array, Array],
    acting: tuple[Array, Array, Array, Array],
    impedance: Array,
    kinds: Array,
    clock: tuple[Array, Array, Array],
    graphs: ExpressionGraphs,
    results: Array,
    registers: Array,
    x: Array,
    states: Array,
    forces: Array,
) -> None:  # pragma: no cover - compiled
    A, drive, defect = system
    rows, at_z, at_v, weight = paths
    into, seen, gain, reach = acting
    lengths, times, commands = clock
    operations, bounds, firsts, stored, recalled = graphs
    n, n_sets, n_windows, size = drive.shape
    n_defects = defect.shape[1]
    m, n_laws, lines = size // 2, len(kinds), rows.shape[2]
    free, force = np.empty_like(x), np.zeros((n_sets, n_windows, lines))
    z0, z1, v0, v1 = np.zeros(lines), np.zeros(lines), np.zeros(lines), np.zeros(lines)
    matrix = np.zeros((lines, lines))
    for k in range(n):
        for s in range(n_sets):
            for w in range(n_windows):
                for a in range(size):
                    states[k, s, w, a] = x[s, w, a]
        for j in range(steps):
            for s in range(n_sets):
                for w in range(n_windows):
                    for a in range(size):
                        total = drive[k, s, w, a]
                        for b in range(size):
                            total += A[k, w, a, b] * x[s, w, b]
                        free[s, w, a] = total
            for law in range(n_laws):
                count, graph, twice = kinds[law]
                own = registers[bounds[graph, 0] : bounds[graph + 1, 0]] if graph >= 0 else registers[:0]
                for s in range(n_sets):
                    for w in range(n_windows):
                        h, e = lengths[law, k, w], s * n_windows + w
                        for i in range(count):
                            z0[i], z1[i] = at_z[law, j, i, k, w], at_z[law, j + 1, i, k, w]
                            v0[i], v1[i] = at_v[law, j, i, k, w], at_v[law, j + 1, i, k, w]
                            for a in range(m):
                                before, after = rows[law, j, i, k, w, a], rows[law, j + 1, i, k, w, a]
                                z0[i] += x[s, w, a] * before
                                v0[i] += x[s, w, m + a] * before
                                z1[i] += free[s, w, a] * after
                                v1[i] += free[s, w, m + a] * after
                        if graph >= 0:  # means over the step, with trapezoidal end correction
                            own[AT_Z, e] = 0.5 * (z0[0] + z1[0]) - h * (v1[0] - v0[0]) / 12.0
                            own[AT_V, e] = 0.5 * (v0[0] + v1[0])
                            own[AT_T, e] = times[law, k, w] + (j + 0.5) * h
                            own[AT_FREE, e], own[AT_COMMAND, e] = v1[0], commands[law, k, w]
                            own[AT_MOBILITY, e], own[AT_H, e] = gain[law, k, w, 0, 0], h
                            continue
                        mass, damping, stiffness = impedance[law, 0, s], impedance[law, 1, s], impedance[law, 2, s]
                        bend = h / 12.0 if count == 1 else 0.0
                        for i in range(count):
                            force[s, w, i] = (
                                -mass * ((v1[i] - v0[i]) / h - weight[law, i])
                                - 0.5 * damping * (v0[i] + v1[i])
                                - stiffness * (0.5 * (z0[i] + z1[i]) - bend * (v1[i] - v0[i]))
                            )
                            for a in range(count):
                                matrix[i, a] = (mass / h + 0.5 * damping) * gain[law, k, w, i, a]
                            matrix[i, i] += 1.0
                        if count == 1:
                            matrix[0, 0] += stiffness * (0.5 * reach[law, k, w] - h * gain[law, k, w, 0, 0] / 12.0)
                        for i in range(count):  # Gauss elimination without pivoting, since the matrix is near identity
                            for a in range(i + 1, count):
                                factor = matrix[a, i] / matrix[i, i]
                                for b in range(i, count):
                                    matrix[a, b] -= factor * matrix[i, b]
                                force[s, w, a] -= factor * force[s, w, i]
                        for i in range(count - 1, -1, -1):
                            for b in range(i + 1, count):
                                force[s, w, i] -= matrix[i, b] * force[s, w, b]
                            force[s, w, i] /= matrix[i, i]
                if graph >= 0:
                    evaluated = operations[bounds[graph, 1] : bounds[graph + 1, 1]]
                    if twice:  # second evaluation, since stiff stops change their own motion
                        evaluate(evaluated, firsts[graph], own)
                        for s in range(n_sets):
                            for w in range(n_windows):
                                e, own_gain = s * n_windows + w, gain[law, k, w, 0, 0]
                                first = own[results[graph], e]
                                own[AT_Z, e] += first * (0.5 * reach[law, k, w] - lengths[law, k, w] * own_gain / 12.0)
                                own[AT_V, e] += 0.5 * own_gain * first
                    evaluate(evaluated, firsts[graph], own)
                    for i in range(bounds[graph, 2], bounds[graph + 1, 2]):
                        for e in range(own.shape[1]):
                            own[recalled[i], e] = own[stored[i], e]
                    for s in range(n_sets):
                        for w in range(n_windows):
                            force[s, w, 0] = own[results[graph], s * n_windows + w]
                for s in range(n_sets):
                    for w in range(n_windows):
                        for i in range(count):
                            for a in range(size):
                                free[s, w, a] += force[s, w, i] * into[law, i, k, w, a]
                        if j == 0 and forces.shape[0] > 0:
                            for i in range(count):
                                for a in range(seen.shape[4]):
                                    forces[k, s, w, a] += force[s, w, i] * seen[law, i, k, w, a]
            for s in range(n_sets):
                for w in range(n_windows):
                    for a in range(size):
                        x[s, w, a] = free[s, w, a]
        for s in range(n_sets):
            for w in range(n_windows):
                for a in range(size):
                    x[s, w, a] -= defect[k, min(s, n_defects - 1), w, a]
                    if k % CHECK_EVERY == 0:
                        now = x[s, w, a]
                        x[s, w, a] = FAR if np.isnan(now) else min(max(now, -FAR), FAR)
