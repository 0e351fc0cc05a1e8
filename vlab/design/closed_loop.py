"""Closed loop of direct rate feedback: poles, mode tracking, gradients.

The open loop's modes eta carry the equations: eta'' + (C + Psi D Psi^T) eta' + Omega^2 eta = 0, q = Phi eta, with the
modes Psi at the coils. With the state z = [eta', Omega eta] the system matrix satisfies A^T = S A S, S = diag(I, -I).
The left eigenvector of a right eigenvector v is therefore S v, and v alone gives every derivative by the gains.

All functions take one gain matrix or a stack of them. A stack costs one LAPACK call a matrix and no Python loop.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import linear_sum_assignment

from vlab.errors import BadDesign
from vlab.fe.second_order import SecondOrderModel
from vlab.signals import Array

TRUSTED = 0.25
"""TRUSTED [1]: largest distance of a pole from its prediction, relative to the distance to any other pole, of a clear
match."""
HALVINGS = 12
"""HALVINGS [1]: largest number of halvings of a continuation step. Closer modes cannot be distinguished."""
REAL = 1e-9
"""REAL [1]: imaginary part relative to |s| below which a pole is overdamped."""


@dataclass(frozen=True, eq=False)
class RateFeedbackLoop:
    """A structure with collocated coils under u = -D y.

    D is symmetric (equation 4.30).

    Parameters
    ----------
    model : SecondOrderModel
        Open loop with positive definite stiffness.
    coils : (n, n_coils) array
        Load distribution of the collocated pairs.

    Raises
    ------
    BadDesign
        The coils do not fit the model, or the stiffness is not positive definite.
    """

    model: SecondOrderModel
    coils: Array

    def __post_init__(self) -> None:
        coils = np.array(self.coils, dtype=float)
        if coils.ndim != 2 or coils.shape[0] != self.model.n or coils.shape[1] == 0:
            raise BadDesign(
                f"the coils' load distribution has shape {coils.shape}; {self.model.n} coordinates x at least one coil is needed"
            )
        if not np.all(np.isfinite(coils)):
            raise BadDesign("the coils' load distribution holds a number that is not finite")
        if self.model.eigen[0][0] <= 0:
            raise BadDesign(
                "the stiffness is not positive definite: rate feedback cannot hold a structure that drifts or falls"
            )
        object.__setattr__(self, "coils", coils)

    @property
    def omega(self) -> Array:
        """Circular frequencies of the open loop's undamped modes [rad/s]."""
        return self.model.eigen[0]

    @cached_property
    def at_coils(self) -> Array:
        """Mass-normalised open-loop modes at the coils, Psi, (n, n_coils)."""
        return self.model.eigen[1].T @ self.coils

    @cached_property
    def damping(self) -> Array:
        """Open-loop damping between the undamped modes, (n, n)."""
        shapes = self.model.eigen[1]
        return shapes.T @ self.model.C @ shapes

    @cached_property
    def to_states(self) -> Array:
        """Transform T from modal states to states, (2n, 2n).

        x = T z with z = [eta', Omega eta] and x = [q', q].
        """
        shapes, zero = self.model.eigen[1], np.zeros((self.model.n, self.model.n))
        return np.block([[shapes, zero], [zero, shapes / self.omega]])

    def from_states(self, x: Array) -> Array:
        """Return z for states x = [q', q], (2n, k)."""
        n, back = self.model.n, self.model.eigen[1].T @ self.model.M
        return np.vstack([back @ x[:n], self.omega[:, None] * (back @ x[n:])])

    def closed(self, gains: Array) -> "ClosedLoop":
        """Close the loop with given gains.

        Parameters
        ----------
        gains : (k, n_coils, n_coils) array or one matrix
            Symmetric gain matrices D [N s/m].

        Returns
        -------
        ClosedLoop
            Poles and eigenvectors.

        Raises
        ------
        BadDesign
            D has the wrong size, is not symmetric or not finite.
        """
        gains = np.asarray(gains, dtype=float)
        count = self.at_coils.shape[1]
        if gains.ndim not in (2, 3) or gains.shape[-2:] != (count, count):
            raise BadDesign(f"the gain matrix D has shape {gains.shape}; {count} x {count} is needed for {count} coils")
        gains = gains.reshape(-1, count, count)
        if not np.all(np.isfinite(gains)):
            raise BadDesign("the gain matrix D holds a number that is not finite")
        if np.abs(gains - gains.transpose(0, 2, 1)).max() > 1e-9 * np.abs(gains).max():
            raise BadDesign("the gain matrix D is not symmetric; collocated rate feedback is designed symmetric here")
        n = self.model.n
        A = np.zeros((len(gains), 2 * n, 2 * n))
        A[:, :n, :n] = -self.damping - self.at_coils @ gains @ self.at_coils.T
        A[:, range(n), range(n, 2 * n)] = -self.omega
        A[:, range(n, 2 * n), range(n)] = self.omega
        s, V = np.linalg.eig(A)
        return ClosedLoop(loop=self, gains=gains, s=s.astype(complex), V=V.astype(complex))

    def open_modes(self, count: int) -> "TrackedModes":
        """Return the first open-loop modes, the start of tracking.

        Parameters
        ----------
        count : int
            Number of modes by frequency.

        Returns
        -------
        TrackedModes
            Modes without feedback.

        Raises
        ------
        BadDesign
            The model has fewer modes.
        """
        if not 1 <= count <= self.model.n:
            raise BadDesign(f"{count} modes cannot be followed; the model has 1 to {self.model.n}")
        coils = self.at_coils.shape[1]
        closed = self.closed(np.zeros((coils, coils)))
        upper = np.flatnonzero(closed.s[0].imag >= 0)
        chosen = upper[np.argsort(np.abs(closed.s[0][upper]), kind="stable")][:count]
        return TrackedModes(closed=closed, index=chosen[None])

    def track(self, gains: Array, count: int) -> "TrackedModes":
        """Follow the first modes from the open loop to gains D.

        The path is t D with t from 0 to 1. A mode keeps its number.
        """
        closed = self.closed(gains)
        return self.open_modes(count).repeated(len(closed.gains)).follow(closed)


@dataclass(frozen=True, kw_only=True, eq=False)
class ClosedLoop:
    """Closed loops, one for each gain matrix.

    Parameters
    ----------
    gains : (k, n_coils, n_coils) array
        D [N s/m].
    s : (k, 2n) complex array
        Poles [rad/s].
    V : (k, 2n, 2n) complex array
        Eigenvectors in z, one a column.
    """

    loop: RateFeedbackLoop
    gains: Array
    s: Array
    V: Array

    @cached_property
    def norm(self) -> Array:
        """Product v^T S v of left and right eigenvectors, (k, 2n)."""
        n = self.s.shape[1] // 2
        squares = self.V**2
        return squares[:, :n].sum(axis=1) - squares[:, n:].sum(axis=1)

    @cached_property
    def at_coils(self) -> Array:
        """Coil velocities of each eigenvector, (k, n_coils, 2n)."""
        return self.loop.at_coils.T @ self.V[:, : self.s.shape[1] // 2]

    def pole_gradients(self, index: Array) -> Array:
        """Return the derivatives ds/dD of chosen poles.

        With a unit left-right product the derivative is -v_i v_j of the velocities at the coils.

        Parameters
        ----------
        index : (k, m) int array
            Pole indices of each loop.

        Returns
        -------
        (k, m, n_coils, n_coils) complex array
            Entry (i, j) is the derivative by d_ij, with all entries independent.
        """
        moved = np.take_along_axis(self.at_coils, index[:, None, :], axis=2)
        return -np.einsum("kim,kjm->kmij", moved, moved) / np.take_along_axis(self.norm, index, axis=1)[..., None, None]

    def chosen(self, which: Array) -> "ClosedLoop":
        """Return a selection of loops."""
        return ClosedLoop(loop=self.loop, gains=self.gains[which], s=self.s[which], V=self.V[which])


@dataclass(frozen=True, kw_only=True, eq=False)
class TrackedModes:
    """Numbered modes in closed loops.

    Parameters
    ----------
    index : (k, m) int array
        Index of the pole of mode 1 ... m in each loop.
    """

    closed: ClosedLoop
    index: Array

    @cached_property
    def poles(self) -> Array:
        """Upper poles of the modes [rad/s], (k, m)."""
        return np.take_along_axis(self.closed.s, self.index, axis=1)

    @cached_property
    def overdamped(self) -> Array:
        """Whether the pole is real, (k, m)."""
        return np.abs(self.poles.imag) <= REAL * np.abs(self.poles)

    @property
    def freq(self) -> Array:
        """Frequencies |s| / 2 pi [Hz], (k, m)."""
        return np.abs(self.poles) / (2 * np.pi)

    @cached_property
    def zeta(self) -> Array:
        """Damping ratios -Re s/|s|, (k, m); one if overdamped."""
        return -self.poles.real / np.abs(self.poles)

    @cached_property
    def slopes(self) -> Array:
        """Derivatives ds/dD, (k, m, n_coils, n_coils)."""
        return self.closed.pole_gradients(self.index)

    @property
    def zeta_gradients(self) -> Array:
        """Derivatives of damping ratios by D, (k, m, n_coils, n_coils).

        The derivative of an overdamped mode is zero.
        """
        s, size = self.poles[..., None, None], np.abs(self.poles)[..., None, None]
        growth = (np.conj(s) * self.slopes).real / size  # d|s|
        gradient = -self.slopes.real / size + s.real * growth / size**2
        return np.where(self.overdamped[..., None, None], 0.0, gradient)

    def repeated(self, times: int) -> "TrackedModes":
        """Return a repetition of a single loop's modes."""
        which = np.zeros(times, dtype=int)
        return TrackedModes(closed=self.closed.chosen(which), index=self.index[which])

    @staticmethod
    def joined(parts: "Sequence[TrackedModes]") -> "TrackedModes":
        """Return the modes of several stacks as one stack.

        Parameters
        ----------
        parts : sequence of TrackedModes
            Modes of each stack.

        Returns
        -------
        TrackedModes
            Joined stack.
        """
        closed = ClosedLoop(
            loop=parts[0].closed.loop,
            gains=np.concatenate([part.closed.gains for part in parts]),
            s=np.concatenate([part.closed.s for part in parts]),
            V=np.concatenate([part.closed.V for part in parts]),
        )
        return TrackedModes(closed=closed, index=np.concatenate([part.index for part in parts]))

    def chosen(self, which: Array) -> "TrackedModes":
        """Return the modes of selected loops."""
        return TrackedModes(closed=self.closed.chosen(which), index=self.index[which])

    def follow(self, target: ClosedLoop, halvings: int = HALVINGS) -> "TrackedModes":
        """Follow the modes to another stack of gains.

        The path is the straight line between the gains, loop by loop. Slopes predict the poles, which are matched to
        the computed poles. An unclear match halves the step.

        Parameters
        ----------
        target : ClosedLoop
            Closed loops at the end.
        halvings : int
            Largest number of halvings.

        Returns
        -------
        TrackedModes
            Modes at the end.
        """
        change = target.gains - self.closed.gains
        predicted = self.poles + np.einsum("kmij,kij->km", self.slopes, change)
        pairs = [_match(*pair) for pair in zip(predicted, self.overdamped, target.s, strict=True)]
        index = np.array([pair[0] for pair in pairs])
        unclear = np.flatnonzero([not pair[1] for pair in pairs])
        if unclear.size and halvings > 0:
            start, end = self.chosen(unclear), target.chosen(unclear)
            middle = self.closed.loop.closed((start.closed.gains + end.gains) / 2)
            index[unclear] = start.follow(middle, halvings - 1).follow(end, halvings - 1).index
        return TrackedModes(closed=target, index=index)


def _match(predicted: Array, overdamped: Array, poles: Array) -> tuple[Array, bool]:
    """Return the pole of each prediction, and whether the match is clear."""
    upper = np.flatnonzero(poles.imag >= 0)
    s = poles[upper]
    predicted = np.where(predicted.imag < 0, np.conj(predicted), predicted)
    distance = np.abs(predicted[:, None] - s)
    rows, columns = linear_sum_assignment(distance)
    error = distance[rows, columns]
    real = np.abs(s.imag) <= REAL * np.abs(s)
    apart = np.abs(s[columns][:, None] - s)
    apart[rows, columns] = np.inf
    apart[np.ix_(real[columns], real)] = np.inf  # real poles are interchangeable: each counts as overdamped
    clear = (error <= TRUSTED * apart.min(axis=1)) & (
        (real[columns] == overdamped) | (error <= TRUSTED * np.abs(s[columns]))
    )
    return upper[columns], bool(clear.all())
