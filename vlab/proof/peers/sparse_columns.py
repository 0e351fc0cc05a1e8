"""Columns of a sparse regression, and free runs of its equations."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vlab.proof.peers.measured_states import States
from vlab.signals import Array

SMOOTH = ("quadratic-stiffness", "cubic-stiffness", "quadratic-drag", "coulomb-friction")
"""SMOOTH: laws of the first columns of a place; the last one is a clearance."""
SUBSTEPS = 2
"""SUBSTEPS [-]: Runge-Kutta steps per sample of a free run."""
FAR = 1e6
"""FAR [SI]: states beyond which a free run has diverged."""


@dataclass(frozen=True, kw_only=True)
class Library:
    """Shapes of the nonlinear columns.

    Parameters
    ----------
    rise : float
        Speed over which friction reverses, over the rms speed of the place [-]; infinite for linear columns alone.
    below, above : float
        Free travel to both sides, over the rms deflection of the place [-]; infinite without a clearance.
    clearance : str
        Effect of the clearance; "" without one.
    """

    rise: float = np.inf
    below: float = np.inf
    above: float = np.inf
    clearance: str = ""

    @property
    def is_linear(self) -> bool:
        """Whether the library has no nonlinear columns."""
        return bool(np.isinf(self.rise))

    @property
    def effects(self) -> tuple[str, ...]:
        """Effects of the columns of a place."""
        return (*SMOOTH, self.clearance)

    @property
    def shapes(self) -> Array:
        """Shapes (3,) for `Columns.of`."""
        return np.array([self.rise, self.below, self.above])


@dataclass(frozen=True, kw_only=True, eq=False)
class Columns:
    """Columns of the regression on the states of a rig.

    Parameters
    ----------
    places : tuple of str
        Joints and tendons.
    rows : (n_places, nv) array
        Deflections of the places per joint.
    deflection, speed : (n_places,) array
        Rms deflections and speeds of the places.
    """

    places: tuple[str, ...]
    rows: Array
    deflection: Array
    speed: Array

    @classmethod
    def scaled(cls, places: tuple[str, ...], rows: Array, states: Sequence[States]) -> "Columns":
        """Return the columns with the scales of some recordings."""
        z, w = (np.vstack([getattr(s, name) for s in states]) @ rows.T for name in ("q", "v"))
        deflection, speed = (np.maximum(x.std(axis=0), 1e-300) for x in (z, w))
        return cls(places=places, rows=rows, deflection=deflection, speed=speed)

    def of(self, q: Array, v: Array, u: Array, shapes: Array) -> Array:
        """Return the columns.

        Parameters
        ----------
        q, v : (..., nv) array
            States.
        u : (..., n_inputs) array
            Inputs.
        shapes : (..., 3) array
            Shapes of a library.

        Returns
        -------
        (..., n_columns) array
            Constant, positions, velocities, inputs, then the laws of every place.
        """
        z, w = q @ self.rows.T, v @ self.rows.T
        rise, below, above = (shapes[..., i, None] for i in range(3))
        friction = np.tanh(w / (rise * self.speed))
        travel = z - np.clip(z, -below * self.deflection, above * self.deflection)
        laws = np.stack([z * z, z * z * z, w * np.abs(w), friction, travel], axis=-1)
        flat = laws.reshape(*laws.shape[:-2], -1)
        return np.concatenate([np.ones((*q.shape[:-1], 1)), q, v, u, flat], axis=-1)

    def nonlinear(self, count: int) -> slice:
        """Return the nonlinear ones of a number of columns."""
        return slice(count - (len(SMOOTH) + 1) * len(self.places), count)


def free_runs(columns: Columns, equations: Array, shapes: Array, states: States) -> tuple[Array, Array]:
    """Integrate identified equations over a recording.

    Classical Runge-Kutta steps with held inputs, for several sets of equations at once.

    Parameters
    ----------
    columns : Columns
        Columns.
    equations : (n_sets, n_columns, nv) array
        Coefficients of the accelerations.
    shapes : (n_sets, 3) array
        Shapes of the libraries.
    states : States
        Recording; the run starts from the first smoothed state.

    Returns
    -------
    q, v : (n, n_sets, nv) array
        States; not a number after divergence.
    """
    sets, n, nv = len(equations), len(states.q), states.q.shape[1]
    x = np.empty((sets, 2, nv))
    x[:, 0], x[:, 1] = states.q[0], states.v[0]
    out = np.empty((n, sets, 2, nv))
    h = states.step_s / SUBSTEPS

    def slope(y: Array, u: Array) -> Array:
        a = np.matmul(columns.of(y[:, 0], y[:, 1], u, shapes)[:, None], equations)[:, 0]
        return np.stack([y[:, 1], a], axis=1)

    for k in range(n):
        out[k] = x
        u = np.broadcast_to(states.u[k], (sets, states.u.shape[1]))
        for _ in range(SUBSTEPS):
            k1 = slope(x, u)
            k2 = slope(x + 0.5 * h * k1, u)
            k3 = slope(x + 0.5 * h * k2, u)
            x = x + h / 6.0 * (k1 + 2.0 * (k2 + k3) + slope(x + h * k3, u))
        x = np.where(np.abs(x) < FAR, x, np.nan)
    return out[:, :, 0], out[:, :, 1]
