"""Polyreference least squares (pLSCF): poles at many model orders, and those that persist over the orders."""

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
    """Return the damped, oscillating poles at each order of the right matrix fraction B(w) A(w)^-1, w = exp(-j omega T).

    A band from low frequencies fills the half circle and the coefficients are real. A band far from 0 is moved to its
    centre, fills most of the circle, and the coefficients are complex; its mirror image is then out of band. Poles
    known already divide the equations by what they make of A(w) [Sanathanan and Koerner, IEEE Trans. Autom. Control 8,
    1963], which takes out the bias and the dominance of sharp peaks that the linearisation brought in.
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
    # Column n of Q is what column n of B adds to those before: an order below the top leaves Y what later ones explain,
    # so that one orthogonalisation serves all orders.
    R = np.stack(explained, axis=1)
    chart: dict[int, ComplexArray] = {}
    below = top
    for n in sorted(orders, reverse=True):
        exposed = R[n + 1 : below + 1].reshape(-1, size)
        gram, below = gram + exposed.conj().T @ exposed, n
        m = n * n_in
        alpha = np.linalg.lstsq(gram[:m, :m], -gram[:m, m : m + n_in], rcond=None)[0]  # the highest coefficient is 1
        companion = np.eye(m, k=n_in, dtype=alpha.dtype)
        companion[-n_in:] = -np.hstack([alpha[j : j + n_in] for j in range(0, m, n_in)])
        roots = np.linalg.eigvals(companion).astype(complex)
        s = -np.log(roots[np.abs(roots) > 1]) / T + 1j * centre
        chart[n] = s[s.imag > 0]
    return [chart[n] for n in orders]


def persistent_poles(chart: list[ComplexArray], omega: Array) -> ComplexArray:
    """Follow poles from order to order and return one for each trail that lasts, in the band or just outside."""
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
