"""Products and orthogonalisation of tall matrices, block by block of rows."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlab.signals import Array

PRODUCT_SIZE = 200_000
"""Multiplications in one matrix product. From 262 144 OpenBLAS wakes a second thread, which for matrices this small
costs up to ten times what it saves wherever another program keeps a core busy."""


def in_blocks(A: NDArray[Any], area: int) -> NDArray[Any]:
    """Cut a tall matrix (padded with zeros) into blocks of rows of which products with `area` results stay small."""
    size = PRODUCT_SIZE // 4 if np.iscomplexobj(A) else PRODUCT_SIZE  # a complex product is four real ones
    rows = min(len(A), max(8, size // area))
    n_blocks = -(-len(A) // rows)
    return np.vstack([A, np.zeros((n_blocks * rows - len(A), A.shape[1]))]).reshape(n_blocks, rows, A.shape[1])


def product(A: NDArray[Any], B: NDArray[Any]) -> NDArray[Any]:
    """Return A^H B of matrices in blocks of rows."""
    return np.sum(np.swapaxes(A, 1, 2).conj() @ B, axis=0)


def stacked(a: NDArray[Any]) -> Array:
    """Return the real rows of complex equations, the imaginary parts below."""
    return np.concatenate([a.real, a.imag], axis=-2)


def orthonormal(A: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return Q and R^-1 of A = Q R for a tall matrix in blocks of rows.

    Cholesky QR twice: as accurate as Householder's for columns that are not nearly dependent, and several times faster
    for tall matrices; the shift keeps it going where poles coincide.
    """
    inverse = np.diag(1 / (np.sqrt(np.sum(np.abs(A) ** 2, axis=(0, 1))) + 1e-300)).astype(A.dtype)
    Q = A @ inverse
    for shift in (1e-13, 1e-15):
        gram = product(Q, Q) + shift * np.eye(len(inverse))
        factor = np.linalg.inv(np.linalg.cholesky(gram)).conj().T
        Q, inverse = Q @ factor, inverse @ factor
    return Q, inverse
