"""Residual flexibility of truncated modes at the ports of laws.

A reduced model without its other modes is too stiff against a local force: most of the flexibility of one elastic element
lies in truncated modes. The static displacement of these modes under a unit force at the port is the residual vector
[1]_ [2]_. The next vectors are displacements under the inertia of the last one (Krylov vectors [3]_): n vectors match the
first 2n coefficients of the port's receptance over powers of frequency. Modes that no sensor sees are truncated, too, and
move with a law at one end.

References
----------
.. [1] R. H. MacNeal, A hybrid method of component mode synthesis, Computers and Structures 1 (1971) 581-601.
.. [2] S. Rubin, Improved component-mode representation for structural dynamic analysis, AIAA Journal 13 (1975) 995-1006.
.. [3] T.-J. Su and R. R. Craig, Krylov model reduction algorithm for undamped structural dynamics systems, Journal of
       Guidance, Control, and Dynamics 14 (1991) 1311-1313.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from vlab.diagnose.parameters.locations import Place
from vlab.diagnose.parameters.observation import ChannelRows
from vlab.diagnose.parameters.reduced_model import ReducedModel
from vlab.diagnose.settings import MODAL
from vlab.signals import Array

StartLaw = Callable[[Array, Array], Array]
"""StartLaw: force of a law over displacement and velocity (n_sets, n_runs) of its port."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ResidualVectors:
    """Coordinates of residual vectors beside the dynamic modes.

    The first r coordinates move under the laws, and the channels see them. The recorded inputs move a second set at the
    ports alone: the channels of the search are without the static response to inputs, see `Feedthrough`.

    Parameters
    ----------
    omega : (r,) array
        Frequencies [rad/s] of the coordinates, of unit mass.
    C : (r, r) array
        Damping matrix.
    basis : (t, r) array
        Residual vectors in truncated modes.
    rows : ChannelRows
        Channels per coordinate.
    forces : (r, n_actuators) array
        Force of a unit command on the coordinates.
    loads : (r, n_loads) array
        Force of a unit force at directly driven ports.
    """

    omega: Array
    C: Array
    basis: Array
    rows: ChannelRows
    forces: Array
    loads: Array

    @property
    def r(self) -> int:
        """Number of coordinates of one set."""
        return len(self.omega)

    def motion(self, place: Place) -> Array:
        """Return a place's displacement (k, m + 2r) per coordinate."""
        if not self.r:
            return place.rows
        own = place.truncated @ self.basis
        return np.hstack([place.rows, own, own])

    def push(self, place: Place) -> Array:
        """Return modal forces (k, m + 2r) of a unit force."""
        if not self.r:
            return place.rows
        own = place.truncated @ self.basis
        return np.hstack([place.rows, own, np.zeros_like(own)])

    def matrices(self, M: Array, C: Array, K: Array) -> tuple[Array, Array, Array]:
        """Return modal matrices (n_sets, m + 2r, m + 2r)."""
        if not self.r:
            return M, C, K
        return self._beside(M, np.eye(self.r)), self._beside(C, self.C), self._beside(K, np.diag(self.omega**2))

    def _beside(self, own: Array, block: Array) -> Array:
        m, r = own.shape[1], self.r
        out = np.zeros((len(own), m + 2 * r, m + 2 * r))
        out[:, :m, :m], out[:, m : m + r, m : m + r], out[:, m + r :, m + r :] = own, block, block
        return out

    def inputs(self, own: Array, gains: Array) -> Array:
        """Return the forces of unit commands and loads.

        Parameters
        ----------
        own : (n_sets, m, n_actuators + n_loads) array
            Modal forces.
        gains : (n_sets, n_actuators) array
            Gains of the actuators.

        Returns
        -------
        (n_sets, m + 2r, n_actuators + n_loads) array
            Forces.
        """
        if not self.r:
            return own
        loads = np.broadcast_to(self.loads, (len(own), *self.loads.shape))
        driven = np.concatenate([self.forces * gains[:, None, :], loads], axis=2)
        return np.concatenate([own, np.zeros_like(driven), driven], axis=1)

    def channels(self, own: ChannelRows) -> ChannelRows:
        """Return the channels per dynamic mode and coordinate."""
        pairs = ((name, getattr(own, name), getattr(self.rows, name)) for name in ("at_q", "at_v", "at_a"))
        return replace(own, **{k: np.hstack([modes, vectors, 0.0 * vectors]) for k, modes, vectors in pairs})

    def states(self, own: Array) -> Array:
        """Return states or rows (..., 2m + 4r), zero at the coordinates."""
        still = np.zeros((*own.shape[:-1], 2 * self.r))
        displacement, velocity = np.split(own, 2, axis=-1)
        return np.concatenate([displacement, still, velocity, still], axis=-1)


def residual_vectors(reduced_model: ReducedModel, places: Sequence[Place], h: float) -> ResidualVectors:
    """Return the residual vectors of places with forces.

    The coordinates are quasi-static: frequencies above one radian per step become one radian at equal flexibility.

    Parameters
    ----------
    reduced_model : ReducedModel
        Reduced model.
    places : sequence of Place
        Places of the forces.
    h : float
        Integration step [s].

    Returns
    -------
    ResidualVectors
        Residual vectors; none without truncated modes that a place moves.
    """
    modes = reduced_model.truncated
    basis = _basis([row for place in places for row in place.truncated], modes.omega)
    squares, turned = np.linalg.eigh(basis.T @ (modes.omega[:, None] ** 2 * basis))
    omega = np.sqrt(squares)
    slowed = np.maximum(omega * h, 1.0)
    basis = basis @ turned / slowed
    return ResidualVectors(
        omega=omega / slowed,
        C=basis.T @ modes.C @ basis,
        basis=basis,
        rows=modes.rows.onto(basis),
        forces=basis.T @ modes.forces,
        loads=basis.T @ modes.loads,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class StaticStart:
    """Static equilibrium of the residual coordinates at the start of a run.

    A run that starts in motion has had its static deflection before: from zero, the coordinates would ring.

    Parameters
    ----------
    K : (n_sets, n, n) array
        Stiffness with linear effects.
    m : int
        Number of dynamic modes, before the residual coordinates.
    is_moving : (n_runs,) array of bool
        Runs that start in motion.
    """

    K: Array
    m: int
    is_moving: Array

    def under(self, starts: Array, held: Array, rates: Array) -> Array:
        """Return the states in equilibrium with given forces.

        Parameters
        ----------
        starts : (n_sets, n_runs, 2n) array
            States of the modes.
        held, rates : (n_sets, n_runs, n) array
            Forces on the coordinates, and their time derivatives.

        Returns
        -------
        (n_sets, n_runs, 2n) array
            States.
        """
        n, m = self.K.shape[1], self.m
        out = starts.copy()
        for first, forces in ((0, held), (n, rates)):
            pull = starts[..., first : first + m] @ self.K[:, m:, :m].swapaxes(1, 2)
            moved = np.linalg.solve(self.K[:, m:, m:], (forces[..., m:] - pull).swapaxes(1, 2)).swapaxes(1, 2)
            out[..., first + m : first + n] = np.where(self.is_moving[:, None], moved, 0.0)
        return out

    def force(self, law: StartLaw, starts: Array, row: Array, push: Array) -> Array:
        """Return a law's force in equilibrium with its deflection.

        Regula falsi finds the force of a restoring law, exactly in one step for a linear one.

        Parameters
        ----------
        law : callable
            Force from displacement and velocity (n_sets, n_runs) of the port.
        starts : (n_sets, n_runs, 2n) array
            States without the force.
        row, push : (n,) array
            Displacement of the port per coordinate, and the coordinates' forces under a unit force.

        Returns
        -------
        (n_sets, n_runs) array
            Forces.
        """
        n, m = self.K.shape[1], self.m
        yields = np.linalg.solve(self.K[:, m:, m:], np.broadcast_to(push[m:, None], (len(self.K), n - m, 1)))
        flexibility = yields[..., 0] @ row[m:]
        z, v = starts[..., :n] @ row, starts[..., n:] @ row
        low, high = np.zeros(z.shape), np.array(law(z, v), dtype=float)
        over, under = high, law(z + flexibility[:, None] * high, v) - high
        has_root = over * under < 0.0  # a restoring law lies between no deflection and the force without deflection
        out = high
        for _ in range(MODAL.equilibrium_steps):  # regula falsi, Illinois variant
            slope = np.where(over == under, 1.0, over - under)
            out = np.where(has_root, low + over * (high - low) / slope, high)
            left = law(z + flexibility[:, None] * out, v) - out
            is_far = left * under < 0.0
            low, over = np.where(is_far, high, low), np.where(is_far, under, 0.5 * over)
            high, under = np.where(has_root, out, high), np.where(has_root, left, under)
        return np.where(self.is_moving & np.isfinite(out), out, 0.0)


def _basis(forces: Sequence[Array], omega: Array) -> Array:
    """Return an orthonormal basis (t, r) under forces (t,)."""
    out = np.zeros((len(omega), 0))
    if not (forces and omega.size):
        return out
    vectors = np.array(forces).T
    for _ in range(MODAL.residual_vectors):
        vectors = vectors / omega[:, None] ** 2
        vectors = vectors / np.maximum(np.linalg.norm(vectors, axis=0), np.finfo(float).tiny)
        for _ in range(2):  # once more against rounding
            vectors = vectors - out @ (out.T @ vectors)
        left, size, _ = np.linalg.svd(vectors, full_matrices=False)
        vectors = left[:, size > MODAL.independent]
        out = np.hstack([out, vectors])
    return out
