"""FE model of a structure: matrices, and rows for places."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vlab.fe.damping import NO_SILENT, SilentModes, measured_modes
from vlab.fe.elements import hermite, rigid_end
from vlab.fe.mesh import Mesh
from vlab.fe.one_mode import OneModeBar
from vlab.fe.second_order import SecondOrderModel
from vlab.signals import Array
from vlab.structure.model import Structure
from vlab.structure.places import locate

TUNING = "tuning"
"""Name of the piece with the tuning stiffness; the piece involves all coordinates."""


@dataclass(frozen=True, eq=False)
class Piece:
    """A part of mass and stiffness: element, point or cable.

    Parameters
    ----------
    columns : tuple of int
        Coordinates of the part in the model.
    M, K : (k, k) array
        Mass and stiffness of the part in its coordinates.
    """

    name: str
    columns: tuple[int, ...]
    M: Array
    K: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class FeModel:
    """A structure's matrices and its map from mesh to coordinates.

    Parameters
    ----------
    linear : SecondOrderModel
        M, C, K in the generalised coordinates.
    expand : (3 n_nodes (+ 1), n) array
        Motion (v, rx, rz) of every node, and the tip of a one-mode bar, per generalised coordinate.
    one_mode : OneModeBar or None
        Bar represented by one mode.
    pieces : tuple of Piece
        Elements and points with sum M and K, in the generalised coordinates.
    silent : SilentModes
        Silent modes of the structure without its deviating spans; none without such spans.
    """

    structure: Structure
    variant: str
    mesh: Mesh
    linear: SecondOrderModel
    expand: Array
    one_mode: OneModeBar | None = None
    pieces: tuple[Piece, ...] = ()
    silent: SilentModes = NO_SILENT

    def with_coordinates(self, linear: SecondOrderModel, T: Array) -> "FeModel":
        """Return the structure in fewer coordinates p, q = T p.

        `linear` holds the reduced or corrected matrices.
        """
        return replace(self, linear=linear, expand=self.expand @ T, pieces=())

    def deflection(self, place: str) -> Array:
        """Return the row of the deflection along y at a place.

        The shape functions of the place's element give the row.

        Parameters
        ----------
        place : str
            Name of the place.

        Returns
        -------
        array
            Deflection [m] per coordinate, (n,).
        """
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
        """Return the rows of several places, (n_places, n)."""
        return np.array([self.deflection(place) for place in places]).reshape(len(places), self.linear.n)

    def slope(self, point: str, along: tuple[float, float] | None = None) -> Array | None:
        """Return the row of the deflection's slope at a point.

        Parameters
        ----------
        point : str
            Name of a point of the mesh.
        along : tuple of float, optional
            Direction (x, z); by default along the first bar through the point, from its first end to its last.

        Returns
        -------
        array or None
            Slope per coordinate, (n,); None without such a node.
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
    def points(self) -> list[str]:
        """Names of the structure's points."""
        return [point.name for point in self.structure.point]

    @property
    def measured(self) -> Array:
        """Indices of the modes that a test of the structure measures."""
        omega, shapes = self.linear.eigen
        at_points = self.deflections(self.points) @ shapes if self.silent.omega.size else np.zeros((0, len(omega)))
        return measured_modes(self.coils.T @ shapes, omega, at_points, self.silent)

    @property
    def coils(self) -> Array:
        """Load distribution of the coils, (n, n_coils), in file order."""
        return self.deflections(self.structure.coil_places).T


def bending_map(direction: tuple[float, float]) -> Array:
    """Return the 4 x 6 map from nodes to bending coordinates.

    The map takes (v, rx, rz) at both nodes to (v, slope) along a bar. A rotation (rx, rz) moves the point (x, z) by rz
    x - rx z along y. The slope is therefore rz t_x - rx t_z.

    Parameters
    ----------
    direction : tuple of (float, float)
        Direction (x, z) of the bar.
    """
    tx, tz = direction
    end = np.array([[1.0, 0.0, 0.0], [0.0, -tz, tx]])
    return np.block([[end, np.zeros((2, 3))], [np.zeros((2, 3)), end]])


def torsion_map(direction: tuple[float, float]) -> Array:
    """Return the 2 x 6 map from nodes to twist.

    The map takes (v, rx, rz) at both nodes to the rotation about the bar.
    """
    tx, tz = direction
    end = np.array([[0.0, tx, tz]])
    return np.block([[end, np.zeros((1, 3))], [np.zeros((1, 3)), end]])
