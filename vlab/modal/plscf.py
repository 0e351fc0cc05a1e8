"""Polyreference least squares (pLSCF): poles over model orders, and persistent poles.

The estimator is the one of [1]_.

References
----------
.. [1] P. Guillaume, P. Verboven, S. Vanlanduit, H. Van der Auweraer and B. Peeters, A poly-reference implementation of
       the least-squares complex frequency-domain estimator, IMAC XXI, 2003.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from vlab.modal.noise import common_weight
from vlab.modal.partial_fractions import FitProblem, pole_mac
from vlab.modal.tall_matrices import in_blocks, orthonormal, product, stacked
from vlab.signals import Array, ComplexArray


def plscf_chart(problem: FitProblem, orders: Sequence[int], known: ComplexArray | None = None) -> list[ComplexArray]:
    """Return damped, oscillating poles at each model order.

    The model is the right matrix fraction B(w) A(w)^-1 with w = exp(-j omega T). A band from low frequencies fills the
    half circle, and the coefficients are real. A band far from 0 is moved to its centre and fills most of the circle;
    the coefficients are complex, and its mirror image is out of band. Known poles divide the equations by their A(w)
    [1]_, which removes the bias and the dominance of sharp peaks due to linearisation.

    Parameters
    ----------
    problem : FitProblem
        Weighted data.
    orders : sequence of int
        Model orders.
    known : complex array or None
        Known poles [rad/s].

    Returns
    -------
    list of complex array
        Poles at each order [rad/s].

    References
    ----------
    .. [1] C. K. Sanathanan and J. Koerner, Transfer function synthesis as a ratio of two complex polynomials, IEEE
           Transactions on Automatic Control 8 (1963) 56-58.
    """
    omega, (n_lines, n_out, n_in) = problem.omega, problem.shape
    top = max(orders)
    is_real = omega[0] < 0.5 * omega[-1]
    centre = 0.0 if is_real else 0.5 * (omega[0] + omega[-1])
    T = np.pi / omega[-1] if is_real else 0.8 * 2 * np.pi / (omega[-1] - omega[0])
    w = np.exp(-1j * (omega - centre) * T)
    line, factor = common_weight(problem.variance)
    H = problem.H.reshape(problem.shape) / np.sqrt(np.mean(factor.reshape(n_out, n_in) ** -2, axis=1))[:, None]
    if known is not None:
        roots = np.exp(-(np.concatenate([known, known.conj()]) if is_real else known - 1j * centre) * T)
        line = line / np.prod(np.abs(w[:, None] - roots), axis=1)
    powers = line[:, None] * w[:, None] ** np.arange(top + 1)
    size = (top + 1) * n_in

    def blocks(a: NDArray[Any]) -> NDArray[Any]:
        return in_blocks(stacked(a) if is_real else a, size**2)

    Q, _ = orthonormal(blocks(powers))
    gram, explained = np.zeros((size, size)), []
    for o in range(n_out):
        Y = blocks((-powers[:, :, None] * H[:, o, None, :]).reshape(n_lines, size))
        explained.append(product(Q, Y))
        rest = Y - Q @ explained[-1]
        gram = gram + product(rest, rest)
    # Column n of Q is the increment of column n of B: an order below the top leaves in Y the share of later columns,
    # so that one orthogonalisation serves all orders.
    R = np.stack(explained, axis=1)
    chart: dict[int, ComplexArray] = {}
    below = top
    for n in sorted(orders, reverse=True):
        exposed = R[n + 1 : below + 1].reshape(-1, size)
        gram, below = gram + exposed.conj().T @ exposed, n
        m = n * n_in
        alpha = np.linalg.lstsq(gram[:m, :m], -gram[:m, m : m + n_in], rcond=None)[0]  # highest coefficient 1
        companion = np.eye(m, k=n_in, dtype=alpha.dtype)
        companion[-n_in:] = -np.hstack([alpha[j : j + n_in] for j in range(0, m, n_in)])
        roots = np.linalg.eigvals(companion).astype(complex)
        s = -np.log(roots[np.abs(roots) > 1]) / T + 1j * centre
        chart[n] = s[s.imag > 0]
    return [chart[n] for n in orders]


def persistent_poles(chart: list[ComplexArray], omega: Array) -> ComplexArray:
    """Return one pole for each persistent trail over the orders.

    The poles are in the band or just outside.

    Parameters
    ----------
    chart : list of complex array
        Poles at each order [rad/s].
    omega : array
        Lines [rad/s].

    Returns
    -------
    complex array
        Poles [rad/s].
    """
    low, high = omega[0] - 0.1 * np.ptp(omega), omega[-1] + 0.1 * np.ptp(omega)
    trails: list[list[complex]] = []
    born: list[int] = []
    for i, found in enumerate(chart):
        poles = found[(np.abs(found) >= low) & (np.abs(found) <= high)]
        taken = np.zeros(poles.size, bool)
        if trails and poles.size:
            alike = pole_mac(np.array([trail[-1] for trail in trails]), poles)
            for row, column in zip(*linear_sum_assignment(alike, maximize=True), strict=True):
                if alike[row, column] > 0.3:
                    trails[row].append(poles[column])
                    taken[column] = True
        trails += [[p] for p in poles[~taken]]
        born += [i] * int(np.sum(~taken))
    chosen = []
    for trail, first in zip(trails, born, strict=True):
        if len(trail) >= max(3, len(chart) / 6, 0.4 * (len(chart) - first)):
            late = np.array(trail[len(trail) // 2 :])
            chosen.append(late[np.argmax(pole_mac(late, late).sum(axis=0))])
    return np.array(chosen, complex)
