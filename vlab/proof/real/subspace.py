"""Linear state-space models from recordings by a subspace method.

The method is MOESP with past inputs and outputs as instruments [1]_, over all recordings at once. The left singular
vectors of the projected future outputs span the observability matrix, from which A and C follow. B, D, the outputs at
rest and the initial states are then a linear least squares problem. The last step minimises the error of the free run in
all parameters (`vlab.proof.real.state_space.fit`).

References
----------
.. [1] M. Verhaegen, V. Verdult, Filtering and System Identification: A Least Squares Approach, Cambridge University
   Press, 2007, chapters 9 and 10.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vlab.proof.real.state_space import Fitted, Model, Samples, fit
from vlab.signals import Array

MOST_COLUMNS = 12000
"""MOST_COLUMNS [-]: most columns of the block Hankel matrices; longer recordings are thinned evenly."""
ON_CIRCLE = 0.99999
"""ON_CIRCLE [-]: modulus to which an unstable eigenvalue of a first estimate is reduced."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Observability:
    """Estimated extended observability matrix.

    Parameters
    ----------
    vectors : (s p, k) array
        Directions in falling order of their share.
    outputs : int
        Number p of outputs.
    inputs : int
        Number m of inputs.
    """

    vectors: Array
    outputs: int
    inputs: int

    @property
    def most(self) -> int:
        """Largest order of a model."""
        return min(self.vectors.shape[0] - self.outputs, self.vectors.shape[1])

    def model(self, order: int) -> Model:
        """Return the model of an order with A and C alone.

        Parameters
        ----------
        order : int
            Number of states.

        Returns
        -------
        Model
            Model with zero B, D and outputs at rest.
        """
        p, m = self.outputs, self.inputs
        seen = self.vectors[:, :order]
        A = np.linalg.lstsq(seen[:-p], seen[p:], rcond=None)[0]
        values, modes = np.linalg.eig(A)
        if np.any(np.abs(values) > 1.0):
            kept = np.where(np.abs(values) > 1.0, ON_CIRCLE * values / np.abs(values), values)
            A = np.real(modes @ np.diag(kept) @ np.linalg.pinv(modes))
        return Model(A=A, B=np.zeros((order, m)), C=seen[:p].copy(), D=np.zeros((p, m)), y0=np.zeros(p))


def observability(samples: Sequence[Samples], rows: int) -> Observability:
    """Estimate the observability matrix of all recordings.

    Parameters
    ----------
    samples : sequence of Samples
        Recordings; lost readings hold interpolated values.
    rows : int
        Block rows of past and of future.

    Returns
    -------
    Observability
        Directions of the extended observability matrix.
    """
    m, p = samples[0].u.shape[1], samples[0].y.shape[1]
    stacks = [_hankel(own, rows) for own in samples if len(own.y) >= 2 * rows]
    stack = np.hstack(stacks)
    if stack.shape[1] > MOST_COLUMNS:
        stack = stack[:, np.linspace(0, stack.shape[1] - 1, MOST_COLUMNS).astype(int)]
    lower = np.asarray(np.linalg.qr(stack.T, mode="r")).T
    future, last = rows * m, rows * p
    between = lower[-last:, future:-last]  # future outputs on the instruments, without the future inputs
    vectors, _, _ = np.linalg.svd(between, full_matrices=False)
    return Observability(vectors=vectors, outputs=p, inputs=m)


def _hankel(own: Samples, rows: int) -> Array:
    """Return future inputs, past inputs, past outputs and future outputs by columns."""
    count = len(own.y) - 2 * rows + 1

    def block(values: Array, first: int) -> Array:
        return np.vstack([values[first + i : first + i + count].T for i in range(rows)])

    return np.vstack([block(own.u, rows), block(own.u, 0), block(own.y, 0), block(own.y, rows)])


def fit_linear(seen: Observability, samples: Sequence[Samples], order: int, *, steps: int) -> Fitted:
    """Fit a linear model of an order.

    Parameters
    ----------
    seen : Observability
        Observability matrix of the recordings.
    samples : sequence of Samples
        Recordings.
    order : int
        Number of states.
    steps : int
        Most steps of the last fit, in which all parameters are free.

    Returns
    -------
    Fitted
        Model, with states of unit spread, and initial states.
    """
    start = seen.model(order)
    rest = [np.zeros(order) for _ in samples]
    found = fit(start, samples, rest, steps=4, only=("B", "D", "y0"))
    states = found.states(samples)
    spread = np.std(states[np.all(np.isfinite(states), axis=1)], axis=0)
    spread = np.where(spread > 0.0, spread, 1.0)
    starts = [x / spread for x in found.starts]
    return fit(found.model.scaled(spread), samples, starts, steps=steps)
