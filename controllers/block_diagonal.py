"""Block-diagonal form of a discrete law (equations 5.6 to 5.13).

The form has the fewest nonzero numbers.
"""

import numpy as np
from numpy.typing import NDArray
from scipy import linalg
from vlab.controllers.linear import LinearController, LinearLaw

from vlab.errors import BadController

Array = NDArray[np.float64]
REAL = 1e-9
"""REAL [1]: imaginary part relative to the eigenvalue's size below which an eigenvalue is real."""
WORST_CONDITION = 1e10
"""WORST_CONDITION [1]: largest condition number of the unit eigenvectors; beyond it their inverse keeps fewer than six
digits."""


def block_diagonal(law: LinearController) -> LinearLaw:
    """Return the law with a block-diagonal A, for x = T x'.

    The input-output behaviour stays. A sampled observer exp(A~ dt) has the eigenvectors of the continuous A~.
    Transforming the discrete law therefore gives the matrices of (5.11)-(5.13), which transform before they discretise.
    The printed (5.13) has T F_R in place of F_R T.

    Parameters
    ----------
    law : LinearController
        Discrete linear law.

    Returns
    -------
    LinearLaw
        Transformed law.

    Raises
    ------
    BadController
        The eigenvectors are nearly dependent; a law with equal eigenvalues has no such form.
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
    """Return T and the diagonal blocks of T^-1 A T.

    A pair a +- i b has the block [[a, b], [-b, a]], a real eigenvalue the block [[a]]. T has the real and imaginary
    parts of one eigenvector of each pair as columns (5.6).

    Parameters
    ----------
    A : array
        Matrix, (n, n).

    Returns
    -------
    tuple of (array, list of array)
        T and the blocks.

    Raises
    ------
    BadController
        The eigenvectors are nearly dependent.
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
