"""Reduced models in discrete time."""

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from vlab.diagnose.parameters.observation import ChannelRows
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Discrete:
    """Discrete-time parameter sets of a reduced model.

    With x = [p, p'] and f held over the step

        x+ = A x + B f,  y = C x + D f.

    Parameters
    ----------
    A : (n_sets, 2m, 2m) array
        State matrices.
    B : (n_sets, 2m, k) array
        Input matrices.
    C : (n_sets, n_channels, 2m) array
        Output matrices.
    D : (n_sets, n_channels, k) array
        Feedthrough matrices.
    """

    A: Array
    B: Array
    C: Array
    D: Array


def discretise(M: Array, C: Array, K: Array, inputs: Array, rows: ChannelRows, h: float) -> Discrete:
    """Discretise parameter sets exactly for a zero-order hold.

    Parameters
    ----------
    M, C, K : (n_sets, m, m) array
        Modal matrices.
    inputs : (n_sets, m, k) or (m, k) array
        Modal force of each input.
    rows : ChannelRows
        Channels per modal coordinate.
    h : float
        Sample period [s].

    Returns
    -------
    Discrete
        Discrete-time systems.
    """
    n_sets, m = M.shape[0], M.shape[1]
    inputs = np.broadcast_to(inputs, (n_sets, m, inputs.shape[-1]))
    k = inputs.shape[-1]
    solved = np.linalg.solve(M, np.concatenate([K, C, inputs], axis=2))
    block = np.zeros((n_sets, 2 * m + k, 2 * m + k))
    block[:, :m, m : 2 * m] = np.eye(m)
    block[:, m : 2 * m, :m], block[:, m : 2 * m, m : 2 * m] = -solved[:, :, :m], -solved[:, :, m : 2 * m]
    block[:, m : 2 * m, 2 * m :] = solved[:, :, 2 * m :]
    whole = linalg.expm(block * h)
    out = np.concatenate(
        [
            rows.at_q - rows.at_a @ solved[:, :, :m],
            rows.at_v - rows.at_a @ solved[:, :, m : 2 * m],
        ],
        axis=2,
    )
    return Discrete(
        A=whole[:, : 2 * m, : 2 * m], B=whole[:, : 2 * m, 2 * m :], C=out, D=rows.at_a @ solved[:, :, 2 * m :]
    )
