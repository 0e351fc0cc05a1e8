"""Free decays in a signal, fitted by total least squares.

The windows of a sum of m free decays sum_i c_i z_i^t fill an m-dimensional subspace. A shift by one sample maps the
subspace onto itself, by a matrix with the eigenvalues z_i [1]. The coefficients c_i follow by least squares, m from
Schwarz's criterion.

References
----------
.. [1] S. Van Huffel, H. Chen, C. Decanniere, P. Van Hecke, Algorithm for time-domain NMR data fitting based on total
       least squares, Journal of Magnetic Resonance A 110 (1994) 228-237.
"""

import numpy as np

from vlab.diagnose.settings import NOISE
from vlab.signals import Array, ComplexArray


def without_decays(x: Array) -> Array:
    """Return a signal without mean and free decays.

    Parameters
    ----------
    x : (n,) array
        Signal.

    Returns
    -------
    (n,) array
        Rest of the signal.
    """
    n = len(x)
    rest = x - x.mean()
    window = min(n // 3, NOISE.decay_window)
    if window <= NOISE.most_decays or not np.any(rest):
        return rest
    rows = np.lib.stride_tricks.sliding_window_view(rest, window)[:: _step(n)]
    basis = np.linalg.eigh(rows.T @ rows)[1][:, ::-1]
    best, least = rest, n * np.log(np.sum(rest**2))
    for order in range(2, NOISE.most_decays + 1, 2):
        left = _left(rest, basis[:, :order])
        criterion = n * np.log(max(float(np.sum(left**2)), 1e-300)) + 2 * order * np.log(n)
        if criterion < least:
            best, least = left, criterion
    return best


def _left(x: Array, subspace: Array) -> Array:
    """Return a signal (n,) without the decays of a subspace (window, order)."""
    poles = np.linalg.eigvals(np.linalg.lstsq(subspace[:-1], subspace[1:])[0])
    poles = poles[np.abs(poles) > 0]
    poles = poles / np.maximum(np.abs(poles), 1.0)  # a transient does not grow
    decays: ComplexArray = np.exp(np.outer(np.arange(len(x)), np.log(poles.astype(complex))))
    part = slice(None, None, _step(len(x)))
    fitted = decays @ np.linalg.lstsq(decays[part], x[part].astype(complex))[0]
    return np.asarray(x - fitted.real)


def _step(n: int) -> int:
    """Return the step between fitted samples of a long signal."""
    return max(1, n // NOISE.most_samples)
