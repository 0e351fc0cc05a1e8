"""The FE model against closed forms."""

import numpy as np
import pytest
from scipy import linalg

from vlab.fe import elements as el

EI, MU, L = 26.0, 1.26, 2.0


def assemble(n: int, *, tension_start: float = 0.0, tension_end: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    h, size = L / n, 2 * (n + 1)
    M, K = np.zeros((size, size)), np.zeros((size, size))
    for i in range(n):
        block = slice(2 * i, 2 * i + 4)
        a, b = (tension_start + (tension_end - tension_start) * k / n for k in (i, i + 1))
        M[block, block] += el.consistent_mass(MU, h)
        K[block, block] += el.bending_stiffness(EI, h) + el.geometric_stiffness(a, b, h)
    return M, K


def frequencies(M, K, held):
    keep = [i for i in range(len(M)) if i not in held]
    return np.sqrt(linalg.eigh(K[np.ix_(keep, keep)], M[np.ix_(keep, keep)], eigvals_only=True))


def test_cantilever_frequency_converges_at_fourth_order():
    # Hermite cubics on a fourth-order problem: eigenvalue error ~ h^(2(p+1-m)) = h^4  [Strang & Fix 1973, ch. 6]
    exact = 4.694091132974174**2 * np.sqrt(EI / MU) / L**2  # second mode: cos x cosh x = -1
    n = np.array([4, 8, 16])
    error = [abs(frequencies(*assemble(k), {0, 1})[1] / exact - 1) for k in n]
    order = -np.polyfit(np.log(n), np.log(error), 1)[0]
    assert order == pytest.approx(4.0, abs=0.2)


def test_pinned_beam_in_uniform_tension_has_the_closed_form():
    # (k pi/L)^2 sqrt((EI + T (L/k pi)^2)/mu)
    tension, n = 350.0, 16
    M, K = assemble(n, tension_start=tension, tension_end=tension)
    omega = frequencies(M, K, {0, 2 * n})
    k = np.arange(1, 5) * np.pi / L
    exact = k**2 * np.sqrt((EI + tension / k**2) / MU)
    tolerance = (k * L / n) ** 4 / 1440  # Hermite beam: the eigenvalue is (kh)^4/720 too high, omega half of it
    assert np.all(np.abs(omega[:4] / exact - 1) < tolerance)


def test_hanging_chain_limit_has_bessel_zeros():
    # EI -> 0, tension mu g s: omega_j = (j_0j/2) sqrt(g/L), the hanging chain
    n, g = 64, 9.81
    size, h = 2 * (n + 1), L / n
    M, K = np.zeros((size, size)), np.zeros((size, size))
    for i in range(n):  # station 0 is the free lower end
        block = slice(2 * i, 2 * i + 4)
        M[block, block] += el.consistent_mass(MU, h)
        K[block, block] += el.geometric_stiffness(MU * g * i * h, MU * g * (i + 1) * h, h) + el.bending_stiffness(
            1e-9, h
        )
    omega = frequencies(M, K, {2 * n})
    exact = np.array([2.404825557695773, 5.520078110286311]) / 2 * np.sqrt(g / L)
    assert omega[:2] == pytest.approx(
        exact, rel=1e-3
    )  # the chain's slope is singular in curvature at the free end: slow convergence


def test_geometric_stiffness_of_constant_tension_is_the_textbook_matrix():
    # Przemieniecki (15.15): T/30L [[36, 3L, -36, 3L], ...]
    T, h = 7.0, 0.3
    expected = T / (30 * h) * np.array(
        [[36, 3 * h, -36, 3 * h], [3 * h, 4 * h**2, -3 * h, -(h**2)], [-36, -3 * h, 36, -3 * h], [3 * h, -(h**2), -3 * h, 4 * h**2]]
    )  # fmt: skip
    assert el.geometric_stiffness(T, T, h) == pytest.approx(expected, rel=1e-12, abs=1e-12)


def test_rigid_segment_turns_about_its_node():
    # kinetic energy of a rigid rod about its end: m l^2/3 for rotation, m for translation
    M, K = el.rigid_segment(2.0, 5.0, -0.1)
    assert M[0, 0] == pytest.approx(0.2)
    assert M[1, 1] == pytest.approx(0.2 * 0.1**2 / 3)
    assert M[0, 1] == pytest.approx(-0.2 * 0.05)  # behind the node: a positive slope moves it down
    assert K[1, 1] == pytest.approx(5.0 * 0.1)
