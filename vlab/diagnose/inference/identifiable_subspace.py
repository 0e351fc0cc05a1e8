"""Identifiable and unidentifiable directions of uncertain parameters."""

import numpy as np
from scipy import linalg

from vlab.diagnose.settings import FIT
from vlab.signals import Array


def identifiable_subspace(gram: Array, samples: int, sd: Array, unknown: Array) -> tuple[Array, Array]:
    """Return the identifiable and the unidentifiable directions.

    Directions that move the channels little, relative to noise and model error, stay at the prior mean.

    Parameters
    ----------
    gram : (n, n) array
        Sum of squared normalised changes of the channels per prior standard deviation of the parameters.
    samples : int
        Number of summed values.
    sd : (n,) array
        Prior standard deviations.
    unknown : (k, n) array
        Directions that no recording can inform, in prior standard deviations.

    Returns
    -------
    identifiable : (n, r) array
        Directions of unit prior variance, the best informed first.
    unidentifiable : (n, n - r) array
        All others.
    """
    if len(unknown):  # apparent information there is derivative error
        known = linalg.null_space(unknown)
        gram = known @ (known.T @ gram @ known) @ known.T
    size, vectors = np.linalg.eigh(gram / samples)
    order = np.argsort(-size)[: FIT.most_directions]
    keep = order[np.sqrt(np.maximum(size[order], 0.0)) > FIT.informed]
    return np.asarray(sd[:, None] * vectors[:, keep]), sd[:, None] * np.delete(vectors, keep, axis=1)
