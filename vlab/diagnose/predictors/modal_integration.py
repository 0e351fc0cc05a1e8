"""Time integration of linear systems in modal form.

Diagonal steps make the cost proportional to the number of modes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from vlab.diagnose.kernels.expression_graph import integrate_lanes
from vlab.diagnose.kernels.linear_system import integrate_linear
from vlab.diagnose.settings import MODAL_INTEGRATION
from vlab.physics.compiled_expression import AT_MOBILITY, loaded
from vlab.physics.expression import ExpressionGraph
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Modes:
    """Modal form of a step, with conjugate pairs merged.

    Parameters
    ----------
    turn : (2, n_sets, m) array
        Real and imaginary parts of the eigenvalues.
    dense : (n_sets, m, m) array
        Step matrices where the eigenvectors are ill-conditioned, as for a free undamped mass; otherwise empty.
    into, back : (n_sets, width, m) and (n_sets, m, width) complex array
        Maps from states x to modal coordinates x @ into, and back to Re(z @ back).
    """

    turn: Array
    dense: Array
    into: Array
    back: Array

    def states_into(self, rows: Array) -> Array:
        """Return states in modal coordinates.

        Parameters
        ----------
        rows : (n_sets, n, width) array
            States on rows.

        Returns
        -------
        (n_sets, n, 2m) array
            Real parts, then imaginary parts.
        """
        there = rows @ self.into
        return np.ascontiguousarray(np.concatenate([there.real, there.imag], axis=-1))

    def rows_from(self, columns: Array) -> Array:
        """Return output matrices of modal coordinates.

        Parameters
        ----------
        columns : (n_sets, width, p) array
            Output matrices of states.

        Returns
        -------
        (n_sets, 2m, p) array
            Rows of the real parts, then of the imaginary parts.
        """
        there = self.back @ columns
        return np.ascontiguousarray(np.concatenate([there.real, -there.imag], axis=1))


def modes_of(step: Array) -> Modes:
    """Return the modal form of steps acting on rows.

    Parameters
    ----------
    step : (n_sets, width, width) array
        Step matrices.

    Returns
    -------
    Modes
        Modal form, or the dense steps.
    """
    n_sets, width, _ = step.shape
    can = bool(np.isfinite(step).all())  # a diverged trial may overflow
    values, vectors = np.linalg.eig(step) if can else (step[:, 0], step)
    if not (can and np.linalg.cond(vectors).max() < MODAL_INTEGRATION.most_alike):
        one = np.broadcast_to(np.eye(width, dtype=complex), step.shape)
        return Modes(turn=np.zeros((2, n_sets, width)), dense=np.ascontiguousarray(step), into=one, back=one)
    inverse = np.linalg.inv(vectors)
    weight = np.where(values.imag > 0, 2.0, np.where(values.imag < 0, 0.0, 1.0))  # one pole per pair
    order = np.argsort(weight == 0, axis=1, kind="stable")[:, : int(np.count_nonzero(weight, axis=1).max())]
    values, weight = (np.take_along_axis(x, order, axis=1) for x in (values, weight))
    return Modes(
        turn=np.stack([values.real, values.imag]),
        dense=np.zeros((0, width, width)),
        into=np.take_along_axis(vectors, order[:, None, :], axis=2),
        back=np.take_along_axis(inverse, order[:, :, None], axis=1) * weight[:, :, None],
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopLaw:
    """Law in the integration loop.

    Parameters
    ----------
    graph : ExpressionGraph
        Graph for the length of a substep.
    values : sequence of (n_sets, 1) array
        Parameters in the order of the law's class.
    memory : sequence of array
        Initial memory, broadcastable to (n_sets, n_runs).
    push : (n_sets, width) array
        Effect of a unit force over a substep on the states.
    direct : (n_sets, p) array
        Feedthrough of the force to the channels.
    effort : (p,) array or None
        Readings of force sensors per unit force; None for none.
    seen : float
        Share of a sample's own interval in these readings.
    port : int
        Index of the port.
    coil : int or None
        Known input with the command at the port.
    """

    graph: ExpressionGraph
    values: Sequence[Array]
    memory: Sequence[Any]
    push: Array
    direct: Array
    port: int
    coil: int | None
    effort: Array | None = None
    seen: float = 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Marched:
    """Discrete-time linear system with states on rows.

    Parameters
    ----------
    step : (n_sets, width, width) array
        Step matrices of a substep.
    into : (n_sets, n_inputs, width) array
        Effect of unit inputs over a substep on the states.
    channels : (n_sets, width, p) array
        Output matrices.
    direct : (n_sets, n_inputs, p) array
        Feedthrough.
    seen : (width, 2 n_ports) array
        Displacements, then velocities, of the ports.
    """

    step: Array
    into: Array
    channels: Array
    direct: Array
    seen: Array


def integrate_modes(
    system: Marched,
    laws: Sequence[LoopLaw],
    part: Array,
    given: Array,
    starts: Array,
    late: Array,
    h: float,
) -> Array:
    """Integrate a linear system with laws in the loop.

    Parameters
    ----------
    system : Marched
        Linear system.
    laws : sequence of LoopLaw
        Laws in the loop; none for a linear system.
    part : (n, n_sets or 1, n_runs, known) array
        Inputs held over a sample.
    given : (n, substeps, n_sets, n_runs, n_inputs - known) array
        Inputs held over a substep.
    starts : (n_sets, n_runs, width) array
        Initial states.
    late : (n_runs,) array
        Times of the runs' first samples [s].
    h : float
        Length of a substep [s].

    Returns
    -------
    (n, n_sets, n_runs, p) array
        Channels.
    """
    modes, inputs = modes_of(system.step), part[:, None]
    if given.shape[-1]:
        inputs = np.concatenate([np.broadcast_to(inputs, (*given.shape[:-1], inputs.shape[-1])), given], axis=-1)
    if laws:
        return _with_laws(
            system, modes, laws, inputs, starts, (given.shape[1], h, np.ascontiguousarray(late, dtype=float))
        )
    y = np.empty((*starts.shape[:2], len(part), system.channels.shape[2]))
    integrate_linear(
        np.ascontiguousarray(np.moveaxis(modes.turn, 1, 0)),
        modes.dense if modes.dense.size else np.zeros((0, 0, 0)),
        modes.states_into(system.into),
        modes.rows_from(system.channels),
        np.ascontiguousarray(system.direct),
        np.ascontiguousarray(inputs.transpose(2, 3, 0, 1, 4)),
        modes.states_into(starts),
        given.shape[1],
        y,
    )
    return y.transpose(2, 0, 1, 3)


def _with_laws(
    system: Marched,
    modes: Modes,
    laws: Sequence[LoopLaw],
    inputs: Array,
    starts: Array,
    clock: tuple[int, float, Array],
) -> Array:
    """Integrate a linear system with laws in the loop, on lanes.

    Parameters
    ----------
    system : Marched
        Linear system.
    modes : Modes
        Modal form of its step.
    laws : sequence of LoopLaw
        Laws.
    inputs : (n, 1 or substeps, 1 or n_sets, n_runs, n_inputs) array
        Inputs.
    starts : (n_sets, n_runs, width) array
        Initial states.
    clock : tuple of int, float and (n_runs,) array
        Substeps, their length [s], and the times of the runs' first samples [s].
    """
    n_sets, n_runs, n, p = *starts.shape[:2], len(inputs), system.channels.shape[2]
    push, direct = np.stack([law.push for law in laws], axis=1), np.stack([law.direct for law in laws], axis=1)
    felt = push @ system.seen
    efforts = np.zeros((0, p))
    if any(law.effort is not None for law in laws):
        efforts = np.array([np.zeros(p) if law.effort is None else law.effort for law in laws])
    graphs, registers = loaded(
        [law.graph for law in laws], [law.values for law in laws], [law.memory for law in laws], (n_sets, n_runs)
    )
    for i, law in enumerate(laws):
        registers[graphs[1][i, 0] + AT_MOBILITY] = np.repeat(felt[:, i, felt.shape[2] // 2 + law.port], n_runs)

    def lanes(x: Array) -> Array:
        """Return sets (n_sets, ...) with the lanes on the last axis."""
        return np.ascontiguousarray(np.repeat(np.moveaxis(x, 0, -1), n_runs, axis=-1))

    def runs(x: Array) -> Array:
        """Return states (n_sets, n_runs, width) with the lanes on the last axis."""
        return np.ascontiguousarray(x.reshape(n_sets * n_runs, -1).T)

    acting = (
        np.array([law.port for law in laws], dtype=np.int64),
        np.array([-1 if law.coil is None else law.coil for law in laws], dtype=np.int64),
        lanes(modes.states_into(push)),
        lanes(felt),
        lanes(direct),
        np.array([law.graph.force for law in laws], dtype=np.int64),
        np.repeat(efforts[..., None], n_sets * n_runs, axis=2),
        np.array([law.seen for law in laws]),
    )
    y = np.empty((n, p, n_sets * n_runs))
    integrate_lanes(
        lanes(np.moveaxis(modes.turn, 1, 0)),
        lanes(modes.dense) if modes.dense.size else np.zeros((0, 0, n_sets * n_runs)),
        lanes(modes.states_into(system.into)),
        lanes(np.swapaxes(modes.rows_from(system.channels), 1, 2)),
        lanes(system.direct),
        np.ascontiguousarray(inputs),
        runs(modes.states_into(starts)),
        lanes(np.swapaxes(modes.rows_from(np.broadcast_to(system.seen, (n_sets, *system.seen.shape))), 1, 2)),
        runs(starts @ system.seen),
        clock,
        acting,
        graphs,
        registers,
        y,
    )
    return y.reshape(n, p, n_sets, n_runs).transpose(0, 2, 3, 1)
