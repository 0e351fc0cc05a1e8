"""Rigid links with elastic hinges against closed forms: frequencies and readings of the smooth curve."""

import numpy as np
import pytest
from scipy import linalg

from vlab.errors import BadStructure
from vlab.plants.chain import build_chain

EI, MU, L = 26.0, 1.26, 1.5


def matrices(chain, *, tip: float = 0.0, tension: float = 0.0, kink: tuple[float, float] | None = None):
    """M and K of a clamped chain in its hinge angles, from the geometry of the links alone."""
    joints = np.concatenate([chain.hinges, [chain.length]])
    n = len(chain.hinges)

    def slope(link):  # of link i (after hinge i) per bend
        return np.array([1.0 if j <= link else 0.0 for j in range(n)])

    def deflection(s):
        return np.clip(s - chain.hinges, 0, None)

    M, K = np.zeros((n, n)), np.diag(chain.stiffness)
    for i in range(n):
        length = joints[i + 1] - joints[i]
        middle, turn = deflection((joints[i] + joints[i + 1]) / 2), slope(i)
        M += MU * length * (np.outer(middle, middle) + length**2 / 12 * np.outer(turn, turn))
        K += tension * length * np.outer(turn, turn)
    M += tip * np.outer(deflection(L), deflection(L))
    if kink:
        M += kink[1] * np.outer(deflection(kink[0]), deflection(kink[0]))
    return M, K, deflection


def test_cantilever_frequencies_converge_at_third_order():
    # the clamp's hinge at 11/24 h removes the second-order term of Rayleigh's quotient (module docstring)
    exact = np.array([1.875104068711961, 4.694091132974174]) ** 2 * np.sqrt(EI / MU) / L**2
    n = np.array([12, 24, 48])
    error = []
    for links in n:
        M, K, _ = matrices(build_chain(L, EI, links=int(links)))
        error.append(np.sqrt(linalg.eigh(K, M, eigvals_only=True)[:2]) / exact - 1)
    orders = -np.polyfit(np.log(n), np.log(np.abs(error)), 1)[0]
    assert orders == pytest.approx([3.0, 3.0], abs=0.15)


def test_a_point_mass_costs_no_more_than_second_order():
    mass, place = 0.5, 0.6
    M, K, _ = matrices(build_chain(L, EI, links=400, kinks=[place]), kink=(place, mass))
    exact = np.sqrt(linalg.eigh(K, M, eigvals_only=True)[:2])
    error = {}
    for n in (32, 64):
        chain = build_chain(L, EI, links=n, kinks=[place])
        assert np.abs(chain.hinges - place).min() < 1e-12
        M, K, _ = matrices(chain, kink=(place, mass))
        error[n] = np.abs(np.sqrt(linalg.eigh(K, M, eigvals_only=True)[:2]) / exact - 1).max()
    assert error[32] / error[64] > 3.5  # 4 for second order


def test_tension_needs_its_correction():
    tension = 350.0
    M, K, _ = matrices(build_chain(L, EI, links=400, tension=lambda s: tension), tension=tension)
    exact = np.sqrt(linalg.eigh(K, M, eigvals_only=True)[:3])

    def error(corrected: bool) -> float:
        chain = build_chain(L, EI, links=12, tension=(lambda s: tension) if corrected else (lambda s: 0.0))
        M, K, _ = matrices(chain, tension=tension)
        return np.abs(np.sqrt(linalg.eigh(K, M, eigvals_only=True)[:3]) / exact - 1).max()

    assert error(True) < error(False) / 2


def second_mode(where: float) -> float:
    """Second cantilever mode, mass-normalised: cosh - cos - sigma (sinh - sin), over sqrt(mu L)."""
    beta = 4.694091132974174
    sigma = (np.cosh(beta) + np.cos(beta)) / (np.sinh(beta) + np.sin(beta))
    x = beta * where / L
    return abs(np.cosh(x) - np.cos(x) - sigma * (np.sinh(x) - np.sin(x))) / np.sqrt(MU * L)


@pytest.mark.parametrize("where", [0.3, 0.75, 1.2, 1.5])
def test_the_reading_gives_the_mode_shape_at_any_place(where):
    chain = build_chain(L, EI, links=14)
    M, K, deflection = matrices(chain)
    angles = linalg.eigh(K, M)[1][:, 1]
    largest = second_mode(L)
    # the angles themselves are third order near the clamp: 1.5e-3 of the largest deflection with 14 links
    assert abs((deflection(where) + chain.reading(where)) @ angles) == pytest.approx(
        second_mode(where), abs=2e-3 * largest
    )


def test_the_reading_is_better_than_the_polygon_by_an_order():
    errors = []
    for links in (14, 28):
        chain = build_chain(L, EI, links=links)
        M, K, deflection = matrices(chain)
        angles = linalg.eigh(K, M)[1][:, 1]
        polygon, curve = deflection(0.75) @ angles, (deflection(0.75) + chain.reading(0.75)) @ angles
        errors.append((abs(abs(polygon) - second_mode(0.75)), abs(abs(curve) - second_mode(0.75))))
    (coarse_polygon, coarse_curve), (fine_polygon, fine_curve) = errors
    assert coarse_curve < coarse_polygon / 10
    assert coarse_polygon / fine_polygon == pytest.approx(4.0, abs=0.5)  # second order
    assert coarse_curve / fine_curve > 5.5  # third, between 4 and 8


def test_a_tension_that_links_cannot_carry_is_refused():
    with pytest.raises(BadStructure, match="use more links"):
        build_chain(L, EI, links=3, tension=lambda s: 5000.0)
