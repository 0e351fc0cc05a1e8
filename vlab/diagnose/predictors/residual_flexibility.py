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

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vlab.diagnose.parameters.locations import Place
from vlab.diagnose.parameters.observation import ChannelRows
from vlab.diagnose.parameters.reduced_model import ReducedModel
from vlab.diagnose.settings import MODAL
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class ResidualVectors:
    """Coordinates of residual vectors beside the dynamic modes.

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
    """

    omega: Array
    C: Array
    basis: Array
    rows: ChannelRows

    @property
    def r(self) -> int:
        """Number of coordinates."""
        return len(self.omega)

    def at(self, place: Place) -> Array:
        """Return a place's rows (k, m + r) per coordinate."""
        return np.hstack([place.rows, place.truncated @ self.basis]) if self.r else place.rows

    def matrices(self, M: Array, C: Array, K: Array) -> tuple[Array, Array, Array]:
        """Return modal matrices (n_sets, m + r, m + r) with the coordinates."""
        if not self.r:
            return M, C, K
        return self._beside(M, np.eye(self.r)), self._beside(C, self.C), self._beside(K, np.diag(self.omega**2))

    def _beside(self, own: Array, block: Array) -> Array:
        m = own.shape[1]
        out = np.zeros((len(own), m + self.r, m + self.r))
        out[:, :m, :m], out[:, m:, m:] = own, block
        return out

    def forces(self, own: Array) -> Array:
        """Return modal forces (..., m + r, k), zero at the coordinates."""
        return np.concatenate([own, np.zeros((*own.shape[:-2], self.r, own.shape[-1]))], axis=-2)

    def channels(self, own: ChannelRows) -> ChannelRows:
        """Return the channels per dynamic mode and coordinate."""
        pairs = ((name, getattr(own, name), getattr(self.rows, name)) for name in ("at_q", "at_v", "at_a"))
        return replace(own, **{name: np.hstack([modes, vectors]) for name, modes, vectors in pairs})

    def states(self, own: Array) -> Array:
        """Return states or rows (..., 2m + 2r), zero at the coordinates."""
        still = np.zeros((*own.shape[:-1], self.r))
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
    return ResidualVectors(omega=omega / slowed, C=basis.T @ modes.C @ basis, basis=basis, rows=modes.rows.onto(basis))


def _basis(forces: Sequence[Array], omega: Array) -> Array:
    """Return an orthonormal basis (t, r) of the residual vectors of forces (t,)."""
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
