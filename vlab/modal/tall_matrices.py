"""Blockwise products and orthogonalisation of tall matrices."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlab.signals import Array

PRODUCT_SIZE = 200_000
"""PRODUCT_SIZE [multiplications]: size of one matrix product. From 262 144 OpenBLAS starts a second thread. On a busy
machine the thread costs up to ten times its gain for such small matrices."""


def in_blocks(A: NDArray[Any], area: int) -> NDArray[Any]:
    """Cut a tall matrix into zero-padded blocks of rows.

    Products with `area` results then stay within `PRODUCT_SIZE`.
    """
    size = PRODUCT_SIZE // 4 if np.iscomplexobj(A) else PRODUCT_SIZE  # a complex product is four real ones
    rows = min(len(A), max(8, size // area))
    n_blocks = -(-len(A) // rows)
    return np.vstack([A, np.zeros((n_blocks * rows - len(A), A.shape[1]))]).reshape(n_blocks, rows, A.shape[1])


def product(A: NDArray[Any], B: NDArray[Any]) -> NDArray[Any]:
    """Return A^H B of matrices in blocks of rows."""
    return np.sum(np.swapaxes(A, 1, 2).conj() @ B, axis=0)


def stacked(a: NDArray[Any]) -> Array:
    """Return complex equations as real rows.

    Imaginary parts follow below the real parts.
    """
    return np.concatenate([a.real, a.imag], axis=-2)


def orthonormal(A: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return Q and R^-1 of A, in blocks of rows.

    Shifted Cholesky QR, applied twice [1]_. For columns that are not nearly dependent the accuracy is Householder's, at
    a fraction of the time for tall matrices. The shift handles coincident poles.

    Parameters
    ----------
    A : array
        Matrix in blocks of rows.

    Returns
    -------
    tuple of (array, array)
        Q in blocks of rows, and R^-1.

    References
    ----------
    .. [1] T. Fukaya, R. Kannan, Y. Nakatsukasa, Y. Yamamoto and Y. Yanagisawa, Shifted Cholesky QR for computing the QR
           factorization of ill-conditioned matrices, SIAM Journal on Scientific Computing 42 (2020) A477-A503.
    """
    inverse = np.diag(1 / (np.sqrt(np.sum(np.abs(A) ** 2, axis=(0, 1))) + 1e-300)).astype(A.dtype)
    Q = A @ inverse
    for shift in (1e-13, 1e-15):
        gram = product(Q, Q) + shift * np.eye(len(inverse))
        factor = np.linalg.inv(np.linalg.cholesky(gram)).conj().T
        Q, inverse = Q @ factor, inverse @ factor
    return Q, inverse
