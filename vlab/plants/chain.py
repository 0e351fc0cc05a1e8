"""Bars as chains of rigid links with elastic hinges.

A bar of bending stiffness EI becomes rigid links of length h. Each link has the mass and inertia of its piece of bar,
and hinges of stiffness EI/h join the links. Inside a uniform bar the chain is fourth-order accurate. With c = cos(kh)
the hinges give the factor (2 - 2c)^2/(kh)^4 = 1 - (kh)^2/6 + ... The links' linear deflection multiplies the mass by (2
+ c)/3 = 1 - (kh)^2/6 + ..., and the two errors cancel. Three places break the balance at second order. A perturbation
of Rayleigh's quotient gives the corrections; the remaining error is of third order, as the convergence test asserts:

- At a clamp the curvature does not vanish: the first hinge is at 11/24 h instead of h/2.
- Under a point mass or a point force the curvature has a kink: a hinge is placed there. Links of unequal length on its
  two sides leave a small term of second order.
- A tension T acts on straight links, which overstates its effect by T (kh)^2/12: the hinge gets (EI - T h^2/12)/h. The
  tension itself stays native.

The links form a polygon beside the smooth curve. With the curvature k = angle/h of the hinges, the smooth deflection w
follows from the polygon W to fourth order. At a hinge w = W + k h^2/12 (Numerov's weights). Between two hinges at
distances d1 and d2, w is lower by k d1 d2/2. At a clamp between two chains w is lower by 25/1152 k h^2, with k their
mean. Sensors and coils act through the corrected deflection.
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from vlab.errors import BadStructure
from vlab.signals import Array


@dataclass(frozen=True)
class Chain:
    """Hinges along a flexible length from clamp to free end.

    Parameters
    ----------
    hinges : (n,) array
        Distances from the clamp's edge [m], ascending.
    stiffness : (n,) array
        Hinge stiffness [N m/rad].
    length : float
        Flexible length [m].
    pieces : (n,) array
        Length of bar that each hinge represents [m].
    """

    hinges: Array
    stiffness: Array
    length: float
    pieces: Array

    def reading(self, distance: float) -> Array:
        """Return the correction from polygon to smooth deflection.

        The correction is per bend, the change of slope along the chain at a hinge [rad].

        Parameters
        ----------
        distance : float
            Distance from the clamp's edge [m].

        Returns
        -------
        array
            Coefficients [m], (n,).
        """
        h, out = self.pieces, np.zeros(len(self.hinges))
        if distance < self.hinges[0]:
            # at the clamp s1 = 11/24 h gives s1^2/2 - h^2/12 = 25/1152 h^2, at the first hinge +h^2/12
            share = max(distance, 0.0) / self.hinges[0]
            out[0] = h[0] * (share / 12 - (1 - share) * 25 / 1152)
            return out
        i = int(np.searchsorted(self.hinges, distance + 1e-9) - 1)
        if i == len(self.hinges) - 1:  # towards the free end the curvature falls to zero
            d = distance - self.hinges[i]
            out[i] = (d**2 / 3 + h[i] ** 2 / 12 - h[i] * d / 2) / h[i] if d > 1e-9 else h[i] / 12
            return out
        before, after = distance - self.hinges[i], self.hinges[i + 1] - distance
        for j, share in ((i, after / (before + after)), (i + 1, before / (before + after))):
            out[j] = share * (h[j] / 12 - before * after / (2 * h[j]))
        return out

    def turned(self, distance: float) -> Array:
        """Return the share of every bend before a distance.

        Each bend is spread over its piece of bar.
        """
        return np.clip((distance - self.hinges) / self.pieces + 0.5, 0.0, 1.0)


def build_chain(
    length: float,
    EI: float,
    *,
    links: int,
    kinks: Sequence[float] = (),
    tension: Callable[[float], float] = lambda s: 0.0,
) -> Chain:
    """Place about `links` hinges on a flexible length.

    Parameters
    ----------
    length : float
        Distance from the clamp's edge to the free end [m].
    EI : float
        Bending stiffness [N m^2].
    links : int
        Wanted number of hinges; kinks may add or drop one.
    kinks : sequence of float
        Distances of point masses and point forces before the free end [m]; each gets a hinge.
    tension : callable
        Tension [N] at a distance from the clamp's edge.

    Returns
    -------
    Chain
        Hinges and their stiffness.

    Raises
    ------
    BadStructure
        The tension is compressive or so large that links of this length cannot carry it.
    """
    stations = [0.0, *sorted(kinks), length]
    wanted = length / links
    hinges: list[float] = []
    pieces: list[float] = []
    for a, b in itertools.pairwise(stations):
        at_clamp, at_end = a == 0.0, b == length
        shortfall = 0.5 * at_clamp - 0.5 * at_end  # half a piece before the first hinge, half after the last
        count = max(1, round((b - a) / wanted + shortfall))
        h = (b - a) / (count - shortfall)
        if pieces:
            pieces[-1] = (pieces[-1] + h) / 2
        hinges += [a + (i + (0.5 if at_clamp else 1.0)) * h for i in range(count)]
        pieces += [h] * count
    hinges[0] -= pieces[0] / 24
    pull = np.array([tension(s) for s in hinges])
    size = np.array(pieces)
    effective = EI - pull * size**2 / 12
    if np.any(effective <= 0):
        raise BadStructure(
            f"a tension of {pull.max():.4g} N needs links shorter than {size.max():.4g} m on EI = {EI:.4g} N m^2; use more links"
        )
    return Chain(np.array(hinges), effective / size, length, size)
