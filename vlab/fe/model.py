"""The FE model of a structure: matrices, and what each place of the structure means in them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vlab.fe.elements import hermite, rigid_end
from vlab.fe.mesh import Mesh
from vlab.fe.one_mode import OneModeBar
from vlab.fe.second_order import SecondOrderModel
from vlab.signals import Array
from vlab.structure.model import Structure
from vlab.structure.places import locate

TUNING = "tuning"
"""Name of the piece that gives a structure the frequencies that it is tuned to; it holds all coordinates."""


@dataclass(frozen=True, eq=False)
class Piece:
    """One of the parts whose sum mass and stiffness are: an element, a point, a cable.

    Parameters
    ----------
    columns : tuple of int
        Its coordinates in the model.
    M, K : (k, k) array
        Its mass and stiffness in them.
    """

    name: str
    columns: tuple[int, ...]
    M: Array
    K: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class FeModel:
    """A structure's matrices with the map from mesh to generalised coordinates.

    Parameters
    ----------
    linear : SecondOrderModel
        M, C, K in the generalised coordinates.
    expand : (3 n_nodes (+ 1), n) array
        Motion (v, rx, rz) of every node, and the tip of a one-mode bar, per generalised coordinate.
    one_mode : OneModeBar or None
        The bar that is carried by one mode.
    pieces : tuple of Piece
        Elements and points that add up to M and K, in the generalised coordinates.
    """

    structure: Structure
    variant: str
    mesh: Mesh
    linear: SecondOrderModel
    expand: Array
    one_mode: OneModeBar | None = None
    pieces: tuple[Piece, ...] = ()

    def with_coordinates(self, linear: SecondOrderModel, T: Array) -> "FeModel":
        """Return the same structure in fewer coordinates p, q = T p, with their matrices: a reduced or corrected model."""
        return replace(self, linear=linear, expand=self.expand @ T, pieces=())

    def deflection(self, place: str) -> Array:
        """Return the (n,) row that gives the deflection along y [m] at a place, from the shape functions of its element."""
        for plate in (p for p in self.structure.plate if p.name == place):  # swings about x, below the axis
            node = 3 * self.mesh.node(plate.at)
            return self.expand[node] + plate.offset * self.expand[node + 1]
        location = locate(self.structure, place)
        if self.one_mode is not None and location.bar == self.one_mode.bar:
            share = self.one_mode.shape(abs(location.station - self.one_mode.arm))
            return (1 - share) * self.expand[3 * self.mesh.node(self.one_mode.root)] + share * self.expand[-1]
        for element in self.mesh.elements:
            if (
                element.bar == location.bar
                and element.station - 1e-9 <= location.station <= element.station + element.length + 1e-9
            ):
                break
        along = location.station - element.station
        end_map = bending_map(self.mesh.direction(element))
        if along <= element.rigid_start:
            row, nodes = np.array([1.0, along, 0, 0]), end_map
        elif along >= element.length - element.rigid_end:
            row, nodes = np.array([0, 0, 1.0, along - element.length]), end_map
        else:
            shape = hermite((along - element.rigid_start) / element.flexible, element.flexible)
            row, nodes = shape @ rigid_end(element.rigid_start, element.rigid_end), end_map
        columns = [*range(3 * element.start, 3 * element.start + 3), *range(3 * element.end, 3 * element.end + 3)]
        return (row @ nodes) @ self.expand[columns]

    def deflections(self, places: Sequence[str]) -> Array:
        """Return the (n_places, n) rows of several places."""
        return np.array([self.deflection(place) for place in places]).reshape(len(places), self.linear.n)

    def slope(self, point: str, along: tuple[float, float] | None = None) -> Array | None:
        """Return the (n,) row that gives the deflection's slope at a point of the mesh; None where there is none.

        Parameters
        ----------
        along : tuple of float, optional
            Direction (x, z); that of the first bar through the point, from its first end to its last, by default.
        """
        if point not in [node.name for node in self.mesh.nodes]:
            return None
        if along is None:
            bar = next(b for b in self.structure.bar if point in b.points)
            (x0, z0), (x1, z1) = (self.structure.position(bar.points[i]) for i in (0, -1))
            along = ((x1 - x0) / np.hypot(x1 - x0, z1 - z0), (z1 - z0) / np.hypot(x1 - x0, z1 - z0))
        node = 3 * self.mesh.node(point)
        return np.asarray(self.expand[node + 2] * along[0] - self.expand[node + 1] * along[1])

    @property
    def coils(self) -> Array:
        """Load distribution of the coils, (n, n_coils), in the order of the structure file."""
        return self.deflections(self.structure.coil_places).T


def bending_map(direction: tuple[float, float]) -> Array:
    """Return the 4 x 6 map from (v, rx, rz) at both nodes to (v, slope) along a bar with this direction (x, z).

    A rotation (rx, rz) moves the point at (x, z) by rz x - rx z along y, hence the slope rz t_x - rx t_z.
    """
    tx, tz = direction
    end = np.array([[1.0, 0.0, 0.0], [0.0, -tz, tx]])
    return np.block([[end, np.zeros((2, 3))], [np.zeros((2, 3)), end]])


def torsion_map(direction: tuple[float, float]) -> Array:
    """Return the 2 x 6 map from (v, rx, rz) at both nodes to the twist about the bar."""
    tx, tz = direction
    end = np.array([[0.0, tx, tz]])
    return np.block([[end, np.zeros((1, 3))], [np.zeros((1, 3)), end]])
