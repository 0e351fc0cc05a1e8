"""Complex modes of a plant with effects, with derivatives."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.predictors.frequency import State, at_port, is_level_dependent, is_port
from vlab.diagnose.settings import FREQUENCY_MODES
from vlab.physics.small_signal import SmallSignal
from vlab.signals import Array, ComplexArray


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelModes:
    """Oscillating modes of a model, by frequency.

    Parameters
    ----------
    s : (k,) complex array
        Poles in the upper half plane [rad/s].
    left, right : (n, n), (n, n) complex array
        Left and right eigenvectors of the state matrix.
    poles : (n,) complex array
        All poles [rad/s].
    index : (k,) int array
        Indices of `s` among all poles.
    m : int
        Structural modes; the first 2 m states are their displacements and velocities.
    part : (k,) array
        Participation of the structure in each mode [1].
    """

    s: ComplexArray
    left: ComplexArray
    right: ComplexArray
    poles: ComplexArray
    index: Array
    m: int
    part: Array

    @property
    def freq(self) -> Array:
        """Natural frequencies [Hz]."""
        return np.abs(self.s) / (2 * np.pi)

    @property
    def zeta(self) -> Array:
        """Damping ratios [1]."""
        return -self.s.real / np.abs(self.s)

    @property
    def shapes(self) -> ComplexArray:
        """Mode shapes (m, k) in modal coordinates."""
        return self.right[: self.m, self.index]


def state_matrix(state: State, terms: Sequence[Term], fastest: float) -> Array:
    """Return the state matrix of modes and internal effect states.

    Parameters
    ----------
    state : State
        Matrices.
    terms : sequence of Term
        Effects.
    fastest : float
        Highest frequency [rad/s] for the linearised laws.

    Returns
    -------
    (n, n) array
        A of x' = A x: displacements, velocities, effect states.
    """
    m = len(state.M)
    M, C, K = state.M, state.C, state.K
    own: list[tuple[Array, SmallSignal]] = []
    for term in terms:
        if not is_port(term) or is_level_dependent(term):
            continue
        law = at_port(term, term.values, fastest)
        outer = term.place.rows.T @ term.place.rows
        M, C, K = M + law.mass * outer, C + law.damping * outer, K + law.stiffness * outer
        if len(law.A):
            own += [(row, law) for row in term.place.rows]
    size = 2 * m + sum(len(law.A) for _, law in own)
    A = np.zeros((size, size))
    A[:m, m : 2 * m] = np.eye(m)
    A[m : 2 * m, : 2 * m] = -np.linalg.solve(M, np.hstack([K, C]))
    at = 2 * m
    for row, law in own:
        states = slice(at, at + len(law.A))
        A[m : 2 * m, states] = -np.linalg.solve(M, np.outer(row, law.C))
        A[states, :m] = np.outer(law.B[:, 0], row)
        A[states, m : 2 * m] = np.outer(law.B[:, 1], row)
        A[states, states] = law.A
        at += len(law.A)
    return A


def model_modes(A: Array, m: int) -> ModelModes:
    """Return the oscillating modes in which the structure participates.

    Participation is the sum of a mode's response residues: one for a structural mode, near zero for a light attachment,
    which no modal test lists.

    Parameters
    ----------
    A : (n, n) array
        State matrix.
    m : int
        Structural modes.

    Returns
    -------
    ModelModes
        Modes.
    """
    poles, right = np.linalg.eig(A)
    left = np.linalg.inv(right)
    part = np.abs(2 * poles * np.einsum("im,mi->i", left[:, m : 2 * m], right[:m]))
    index = np.flatnonzero((poles.imag > 1e-6 * np.abs(poles) + 1e-9) & (part > FREQUENCY_MODES.least_part))
    index = index[np.argsort(np.abs(poles[index]))]
    return ModelModes(s=poles[index], left=left, right=right, poles=poles, index=index, m=m, part=part[index])


def matrix_changes(state: State, A: Array, terms: Sequence[Term]) -> list[Array | None]:
    """Return the derivatives of the state matrix.

    Parameters
    ----------
    state : State
        Matrices with derivatives.
    A : (n, n) array
        State matrix.
    terms : sequence of Term
        Effects.

    Returns
    -------
    list of (n, n) array or None
        Derivatives; None where zero.
    """
    m = len(state.M)
    M = state.M
    for term in terms:
        if is_port(term) and not is_level_dependent(term):
            M = M + at_port(term, term.values, 1.0).mass * (term.place.rows.T @ term.place.rows)
    out: list[Array | None] = []
    for dM, dC, dK in state.changes:
        if dM is None and dC is None and dK is None:
            out.append(None)
            continue
        push = np.zeros((m, len(A)))
        if dK is not None:
            push[:, :m] += dK
        if dC is not None:
            push[:, m : 2 * m] += dC
        if dM is not None:
            push += dM @ A[m : 2 * m]
        change = np.zeros_like(A)
        change[m : 2 * m] = -np.linalg.solve(M, push)
        out.append(change)
    return out


def by_parameter(modes: ModelModes, which: Array, change: Array) -> tuple[ComplexArray, ComplexArray]:
    """Return the derivatives of poles and shapes.

    The method is first-order perturbation of simple eigenvalues; contributions of nearly equal poles are omitted.

    Parameters
    ----------
    modes : ModelModes
        Modes.
    which : (k,) int array
        Modes to differentiate.
    change : (n, n) array
        Derivative of the state matrix.

    Returns
    -------
    poles : (k,) complex array
        Derivatives of the poles.
    shapes : (m, k) complex array
        Derivatives of the shapes.
    """
    at = modes.index[which]
    mixed = modes.left @ (change @ modes.right[:, at])  # (n, k)
    rate = mixed[at, np.arange(len(at))]
    apart = modes.poles[at][None, :] - modes.poles[:, None]
    close = np.abs(apart) < 1e-6 * np.abs(modes.poles[at])[None, :]
    share = np.where(close, 0.0, mixed / np.where(close, 1.0, apart))
    return rate, modes.right[: modes.m] @ share
