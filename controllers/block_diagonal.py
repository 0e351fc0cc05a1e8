"""A discrete law in block-diagonal form: the same law with the fewest numbers (equations 5.6 to 5.13)."""

import numpy as np
from numpy.typing import NDArray
from scipy import linalg
from vlab.controllers.linear import LinearController, LinearLaw

from vlab.errors import BadController

Array = NDArray[np.float64]
REAL = 1e-9
"""Imaginary part of an eigenvalue, relative to its size, below which it is real."""
WORST_CONDITION = 1e10
"""Condition number of the eigenvectors (of unit length) beyond which their inverse keeps fewer than six digits."""


def block_diagonal(law: LinearController) -> LinearLaw:
    """Return the same law from samples to commands with a block-diagonal A, for x = T x'.

    A sampled observer exp(A~ dt) has the eigenvectors of the continuous A~, so that transforming the discrete law gives
    the matrices of (5.11)-(5.13), which transform before they discretise. As printed (5.13) has T F_R; it is F_R T.

    Raises
    ------
    BadController
        Eigenvectors that are nearly dependent: a law with equal eigenvalues has no such form.
    """
    A, B, C, D = law.matrices
    T, blocks = real_modal_form(A)
    return LinearLaw(
        linalg.block_diag(*blocks) if blocks else A,
        linalg.solve(T, B) if blocks else B,
        C @ T,
        D,
        sensors=law.sensors,
        actuators=law.actuators,
        rate=getattr(law, "rate", None),
    )


def real_modal_form(A: Array) -> tuple[Array, list[Array]]:
    """Return T and the blocks of T^-1 A T: [[a, b], [-b, a]] for a pair a +- i b, [[a]] for a real eigenvalue.

    T has the real and the imaginary part of one eigenvector of each pair side by side (5.6).

    Raises
    ------
    BadController
        Eigenvectors that are nearly dependent.
    """
    if not len(A):
        return np.zeros((0, 0)), []
    values, vectors = linalg.eig(A)
    columns: list[Array] = []
    blocks: list[Array] = []
    for i in np.lexsort((values.imag, values.real))[::-1]:
        value, vector = values[i], vectors[:, i]
        if abs(value.imag) <= REAL * abs(value):
            columns.append(vector.real)
            blocks.append(np.array([[value.real]]))
        elif value.imag > 0:
            columns += [vector.real, vector.imag]
            blocks.append(np.array([[value.real, value.imag], [-value.imag, value.real]]))
    T = np.column_stack(columns)
    condition = np.linalg.cond(vectors)
    if T.shape != A.shape or condition > WORST_CONDITION:
        raise BadController(
            f"the law's eigenvectors are nearly dependent (condition {condition:.1g}): it has no block-diagonal form; run it untransformed"
        )
    return T, blocks
