"""Quadratic index of direct rate feedback and its gradient by the gains.

The closed loop's modes A = V diag(s) V^-1 solve the Lyapunov equation (4.34) entry by entry, P^_jk = -Q^_jk / (s_j +
s_k). The adjoint equation is solved likewise. A stack of gain matrices costs no Python loop. Close to a double pole
digits are lost; reported results come from `vlab.design.performance`, with the Schur form [1]_.

References
----------
.. [1] R. H. Bartels and G. W. Stewart, Solution of the matrix equation AX + XB = C, Communications of the ACM 15 (1972)
       820-826.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vlab.design.closed_loop import ClosedLoop, RateFeedbackLoop
from vlab.design.weights import Weights
from vlab.errors import BadDesign
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class IndexGradients:
    """Index J of u = -D y from initial states: (4.33)-(4.36).

    Parameters
    ----------
    loop : RateFeedbackLoop
        Structure with coils.
    weights : Weights
        Weights Q and R.
    x0 : (2n, k) array
        Initial states [q', q], one a column.

    Raises
    ------
    BadDesign
        Weights or states have another size than the structure.
    """

    loop: RateFeedbackLoop
    weights: Weights
    x0: Array

    def __post_init__(self) -> None:
        states, coils = 2 * self.loop.model.n, self.loop.at_coils.shape[1]
        if self.weights.Q.shape != (states, states) or self.weights.R.shape != (coils, coils):
            raise BadDesign(
                f"weights Q {self.weights.Q.shape} and R {self.weights.R.shape} do not fit {states} states and {coils} coils; "
                "make them from the same model"
            )
        if self.x0.ndim != 2 or len(self.x0) != states:
            raise BadDesign(f"initial states of shape {self.x0.shape} do not fit {states} states")

    @cached_property
    def _Q(self) -> Array:
        return self.loop.to_states.T @ self.weights.Q @ self.loop.to_states

    @cached_property
    def _z0(self) -> Array:
        return self.loop.from_states(self.x0)

    def __call__(self, closed: ClosedLoop) -> tuple[Array, Array]:
        """Return J (k, n_x0) and its derivatives (k, n_x0, n_coils, n_coils).

        J is infinite for an unstable loop. Entry (i, j) of a derivative belongs to d_ij, with all entries independent.
        """
        n, (k, size), V = self.loop.model.n, closed.s.shape, closed.V
        stable = closed.s.real.max(axis=1) < 0
        R, D, at_coils = self.weights.R, closed.gains, closed.at_coils
        between = -1.0 / np.where(stable[:, None, None], closed.s[:, :, None] + closed.s[:, None, :], -1.0)
        signed = np.vstack([self._z0[:n], -self._z0[n:]])
        y = (V.transpose(0, 2, 1) @ signed) / closed.norm[:, :, None]
        force = D @ at_coils
        weight = V.transpose(0, 2, 1) @ (self._Q @ V) + force.transpose(0, 2, 1) @ (R @ force)
        P = between * weight
        J = np.einsum("kji,kjl,kli->ki", y, P, y).real
        # X^ W = y (between (y W)) for all initial states at once: X adjoint solution, W modes at the coils
        count, coils = y.shape[2], at_coils.shape[1]
        W = at_coils.transpose(0, 2, 1)
        XW = y[..., None] * (between @ (y[..., None] * W[:, :, None, :]).reshape(k, size, -1)).reshape(
            k, size, count, coils
        )
        flat = XW.reshape(k, size, count * coils)
        costate = ((at_coils / closed.norm[:, None, :]) @ (P @ flat)).reshape(k, coils, count, coils)
        moved = (R @ D @ (at_coils @ flat)).reshape(k, coils, count, coils)
        gradient = 2 * (moved - costate).real.transpose(0, 2, 1, 3)
        return np.where(stable[:, None], J, np.inf), gradient
