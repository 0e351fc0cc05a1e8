"""Sparse regression on states, as in SINDy [1]_.

Sequentially thresholded least squares over a library of terms.

References
----------
.. [1] S. L. Brunton, J. L. Proctor, J. N. Kutz, "Discovering governing equations from data by sparse identification of
   nonlinear dynamical systems", *PNAS* 113 (2016) 3932-3937.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from vlab.signals import Array

TERMS: dict[str, Callable[[Array, Array], Array]] = {
    "quadratic-stiffness": lambda z, v: z**2,
    "cubic-stiffness": lambda z, v: z**3,
    "quadratic-drag": lambda z, v: v * np.abs(v),
    "coulomb-friction": lambda z, v: np.tanh(v / (0.05 * v.std() + 1e-300)),
}
THRESHOLD = 0.01
"""THRESHOLD [-]: share of the acceleration's rms below which a term is dropped."""
CYCLES = 10


@dataclass(frozen=True)
class Named:
    """Strongest nonlinear term: effect, place, share of the acceleration."""

    effect: str
    place: str
    share: float


def sparse_terms(q: Array, v: Array, a: Array, u: Array, rows: Mapping[str, Array]) -> Named | None:
    """Return the strongest nonlinear term of the equations of motion.

    Parameters
    ----------
    q, v, a : (n, joints) array
        States and accelerations.
    u : (n, inputs) array
        Inputs.
    rows : mapping of str to (joints,) array
        Places of nonlinear forces.

    Returns
    -------
    Named or None
        Term; None if only linear ones remain.
    """
    linear = np.hstack([q, v, u])
    labels: list[tuple[str, str] | None] = [None] * linear.shape[1]
    columns = [linear]
    for place, row in rows.items():
        for effect, term in TERMS.items():
            columns.append(term(q @ row, v @ row)[:, None])
            labels.append((effect, place))
    X = np.hstack(columns)
    scale = np.maximum(X.std(axis=0), 1e-300)
    X = X / scale
    best: Named | None = None
    for target in a.T:
        size = target.std()
        keep = np.ones(X.shape[1], dtype=bool)
        for _ in range(CYCLES):
            theta = np.zeros(X.shape[1])
            theta[keep] = np.linalg.lstsq(X[:, keep], target, rcond=1e-8)[0]
            small = (np.abs(theta) < THRESHOLD * size) & keep
            if not small.any():
                break
            keep &= ~small
        for i in np.flatnonzero(keep):
            label, share = labels[i], float(abs(theta[i]) / size)
            if label is not None and (best is None or share > best.share):
                best = Named(*label, share)
    return best
