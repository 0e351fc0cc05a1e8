"""In-plane statics of hanging bars: axial force, shear and moment from gravity.

The hanging bars are a plane frame with rigid joints under their distributed weight and the weights at their joints. At
a carrying bar the frame is pinned: held in translation, free to rotate in the plane. The stress resultants of each
element stiffen the out-of-plane motion.
"""

from dataclasses import dataclass

import numpy as np

from vlab.errors import BadStructure
from vlab.fe.elements import bending_stiffness
from vlab.fe.mesh import Element, Mesh
from vlab.signals import Array
from vlab.structure.model import Structure


@dataclass(frozen=True)
class Resultants:
    """Stress resultants along an element from its first node.

    The in-plane normal is n = (t_z, -t_x), with the direction t in (x, z). A positive moment pulls the fibres on the
    side of n.

    Parameters
    ----------
    axial, shear, moment : float
        N, V and M at the first node [N, N, N m].
    load_along, load_across : float
        Distributed weight along t and along n [N/m].
    """

    axial: float
    shear: float
    moment: float
    load_along: float
    load_across: float

    def axial_at(self, s: float) -> float:
        """Return N(s); tension is positive."""
        return self.axial - self.load_along * s

    def moment_at(self, s: float) -> float:
        """Return M(s) with M' = V and V' = -q."""
        return self.moment + self.shear * s - self.load_across * s**2 / 2


def in_plane_resultants(structure: Structure, mesh: Mesh) -> dict[int, Resultants]:
    """Return the stress resultants of hanging elements.

    Parameters
    ----------
    structure : Structure
        Structure with its points, bars and transducers.
    mesh : Mesh
        Mesh of the structure.

    Returns
    -------
    dict of int to Resultants
        Resultants by index of the element in the mesh.

    Raises
    ------
    BadStructure
        No bar carries the hanging bars, or they are a mechanism in the plane.
    """
    carriers = {bar.name for bar in structure.bar if bar.carries}
    hanging = [i for i, e in enumerate(mesh.elements) if e.bar not in carriers]
    pinned = {p for bar in structure.bar if bar.carries for p in bar.points}
    held = [k for k, node in enumerate(mesh.nodes) if node.name in pinned]
    if not carriers or not hanging:
        return {}
    n = 3 * len(mesh.nodes)  # x, z, rotation
    K, load = np.zeros((n, n)), np.zeros(n)
    for i in hanging:
        stiffness, weight, T = _frame_element(structure, mesh, mesh.elements[i])
        columns = end_columns(mesh.elements[i])
        K[np.ix_(columns, columns)] += T.T @ stiffness @ T
        load[columns] += T.T @ weight
    points = {p.name for p in structure.point}
    for k, node in enumerate(mesh.nodes):
        if node.name in points:
            load[3 * k + 1] -= structure.gravity * structure.point_mass(node.name)
    used = {c for i in hanging for c in end_columns(mesh.elements[i])}
    free = sorted(used - {3 * k for k in held} - {3 * k + 1 for k in held})
    block = K[np.ix_(free, free)]
    if np.linalg.cond(block) > 1e14:
        raise BadStructure(
            "the hanging bars are a mechanism in the plane: gravity cannot be carried; hang them from more points"
        )
    motion = np.zeros(n)
    motion[free] = np.linalg.solve(block, load[free])
    return {i: _recover(structure, mesh, mesh.elements[i], motion) for i in hanging}


def end_columns(element: Element) -> list[int]:
    """Return the columns of an element, three coordinates an end."""
    return [3 * element.start + i for i in range(3)] + [3 * element.end + i for i in range(3)]


def _frame_element(structure: Structure, mesh: Mesh, element: Element) -> tuple[Array, Array, Array]:
    """Return stiffness and weight of a frame element, with its map.

    Local coordinates are (a, b, theta) at both ends; the map starts from (x, z, theta).
    """
    L, section = element.length, element.section
    EA = section.axial_stiffness
    k = np.zeros((6, 6))
    k[np.ix_([0, 3], [0, 3])] = EA / L * np.array([[1.0, -1.0], [-1.0, 1.0]])
    k[np.ix_([1, 2, 4, 5], [1, 2, 4, 5])] = bending_stiffness(EA * section.in_plane_ratio, L)
    tx, tz = mesh.direction(element)
    end = np.array([[tx, tz, 0.0], [tz, -tx, 0.0], [0.0, 0.0, 1.0]])
    T = np.block([[end, np.zeros((3, 3))], [np.zeros((3, 3)), end]])
    along, across = _loads(structure, mesh, element)
    weight = np.array(
        [along * L / 2, across * L / 2, across * L**2 / 12, along * L / 2, across * L / 2, -across * L**2 / 12]
    )
    return k, weight, T


def _loads(structure: Structure, mesh: Mesh, element: Element) -> tuple[float, float]:
    tx, tz = mesh.direction(element)
    weight = structure.gravity * element.section.mass_per_length
    return -weight * tz, weight * tx


def _recover(structure: Structure, mesh: Mesh, element: Element, motion: Array) -> Resultants:
    k, weight, T = _frame_element(structure, mesh, element)
    force = k @ T @ motion[end_columns(element)] - weight
    along, across = _loads(structure, mesh, element)
    return Resultants(axial=-force[0], shear=-force[1], moment=force[2], load_along=along, load_across=across)
