"""Ridge regression: least squares with priors of unit variance."""

import numpy as np

from vlab.signals import Array


def ridge_inverse(R: Array) -> Array:
    """Return the ridge regression (R^T R + 1)^-1 R^T of a response.

    Responses of unstable motion are so large that normal equations would lose the priors.

    Parameters
    ----------
    R : (n, k) array
        Response of the data to k unknowns of unit prior variance, over the noise.

    Returns
    -------
    (k, n) array
        Matrix from data to estimates.
    """
    left, size, right = np.linalg.svd(R, full_matrices=False)
    return np.asarray((right.T * (size / (size**2 + 1.0))) @ left.T)
