"""Bar represented by its first symmetric mode, as in the published crosspiece."""

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from vlab.errors import BadStructure
from vlab.fe.elements import bending_stiffness, consistent_mass, hermite
from vlab.signals import Array
from vlab.structure.model import Structure

_ELEMENTS = 16
"""_ELEMENTS [1]: elements per arm. The first frequency is then exact to 1e-7 (fourth-order convergence)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class OneModeBar:
    """A spring-mass on the clamp point for two equal arms.

    The arms follow the clamp point and bend in their first fixed-base mode, as in component mode synthesis with one
    mode [1]_. The modal coordinate is scaled so that spring and mass act on the clamp as a plain oscillator. The
    absolute deflection of the tips is v + G (x - v), with v of the clamp point and x of the oscillator.

    Parameters
    ----------
    mass : float
        Effective mass of the oscillator [kg].
    stiffness : float
        Spring stiffness of the oscillator [N/m].
    tip_factor : float
        Tip factor G.
    total_mass : float
        Mass of both arms with attached parts [kg]. The mass beyond the oscillator's moves with the clamp point.
    arm : float
        Length from the clamp point to a tip [m].

    References
    ----------
    .. [1] R. R. Craig and M. C. C. Bampton, Coupling of substructures for dynamic analyses, AIAA Journal 6 (1968)
           1313-1319.
    """

    bar: str
    root: str
    mass: float
    stiffness: float
    tip_factor: float
    total_mass: float
    arm: float
    rigid: float
    nodal: Array

    @property
    def mass_matrix(self) -> Array:
        """2 x 2 mass in (clamp deflection, tip deflection)."""
        row = np.array([1 - 1 / self.tip_factor, 1 / self.tip_factor])
        return self.mass * np.outer(row, row) + np.diag([self.total_mass - self.mass, 0.0])

    @property
    def stiffness_matrix(self) -> Array:
        """2 x 2 stiffness in (clamp deflection, tip deflection)."""
        row = np.array([-1.0, 1.0]) / self.tip_factor
        return self.stiffness * np.outer(row, row)

    def shape(self, distance: float) -> float:
        """Return the mode's deflection relative to the tip.

        Parameters
        ----------
        distance : float
            Distance from the clamp point [m].
        """
        outside = max(distance - self.rigid, 0.0)
        piece = (self.arm - self.rigid) / _ELEMENTS
        k = min(int(outside / piece), _ELEMENTS - 1)
        return float(hermite(outside / piece - k, piece) @ self.nodal[2 * k : 2 * k + 4])


def one_mode_bar(structure: Structure, name: str) -> OneModeBar:
    """Condense a bar of two equal arms to its first symmetric mode.

    Parameters
    ----------
    structure : Structure
        Structure with its points, bars and transducers.
    name : str
        Name of the bar.

    Returns
    -------
    OneModeBar
        Oscillator and tip factor.

    Raises
    ------
    BadStructure
        The bar has no two equal arms with equal tips about a clamp.
    """
    bar = next(b for b in structure.bar if b.name == name)
    section = structure.section_between(bar, bar.points[0], bar.points[-1])
    clamps = [c for c in structure.clamp if c.at in bar.points[1:-1]]
    if len(bar.points) != 3 or len(clamps) != 1:
        raise BadStructure(
            f"bar {name!r} cannot be carried by one symmetric mode: it needs three points, the middle one clamped"
        )
    root = np.array(structure.position(bar.points[1]))
    arms = [float(np.hypot(*(root - structure.position(tip)))) for tip in (bar.points[0], bar.points[2])]
    tips = [structure.point_mass(tip) for tip in (bar.points[0], bar.points[2])]
    if not (np.isclose(arms[0], arms[1]) and np.isclose(tips[0], tips[1])):
        raise BadStructure(
            f"bar {name!r} cannot be carried by one symmetric mode: arms {arms} m, tips {tips} kg differ"
        )
    rigid, arm, tip = clamps[0].half_length, arms[0], tips[0]
    piece = (arm - rigid) / _ELEMENTS
    n = 2 * (_ELEMENTS + 1)
    M, K = np.zeros((n, n)), np.zeros((n, n))
    for k in range(_ELEMENTS):
        block = slice(2 * k, 2 * k + 4)
        M[block, block] += consistent_mass(section.mass_per_length, piece)
        K[block, block] += bending_stiffness(section.bending_stiffness, piece)
    M[-2, -2] += tip
    squared, shapes = linalg.eigh(K[2:, 2:], M[2:, 2:], subset_by_index=[0, 0])
    nodal = np.concatenate([[0.0, 0.0], shapes[:, 0] / shapes[-2, 0]])
    deflection = np.zeros(n)
    deflection[::2] = 1.0
    momentum, modal = float(nodal @ M @ deflection), float(nodal @ M @ nodal)
    mass = 2 * momentum**2 / modal
    return OneModeBar(
        bar=name,
        root=bar.points[1],
        mass=mass,
        stiffness=mass * float(squared[0]),
        tip_factor=momentum / modal,
        total_mass=2 * (section.mass_per_length * arm + tip),
        arm=arm,
        rigid=rigid,
        nodal=nodal,
    )
