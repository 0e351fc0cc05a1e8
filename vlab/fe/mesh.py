"""Mesh of a structure: nodes and elements."""

from dataclasses import dataclass, replace

import numpy as np

from vlab.structure.discretisation import Variant
from vlab.structure.model import Bar, Section, Structure


@dataclass(frozen=True)
class Node:
    """A node of the mesh at (x, z) [m].

    `name` is the point's name, or bar@station between points.
    """

    name: str
    x: float
    z: float


@dataclass(frozen=True)
class Element:
    """A piece of a bar between two nodes.

    The piece is flexible between its rigid ends.

    Parameters
    ----------
    station : float
        Station of the first node along the bar [m].
    rigid_start, rigid_end : float
        Rigid lengths at the first and at the second node [m].
    """

    bar: str
    section: Section
    start: int
    end: int
    station: float
    length: float
    rigid_start: float
    rigid_end: float

    @property
    def flexible(self) -> float:
        """Length of the flexible part [m]."""
        return self.length - self.rigid_start - self.rigid_end


@dataclass(frozen=True)
class Mesh:
    """Nodes and elements of all bars."""

    nodes: tuple[Node, ...]
    elements: tuple[Element, ...]

    def node(self, name: str) -> int:
        """Return the index of a node by name."""
        return next(i for i, node in enumerate(self.nodes) if node.name == name)

    def direction(self, element: Element) -> tuple[float, float]:
        """Return an element's unit vector (x, z).

        The vector points from the first node to the second.
        """
        a, b = self.nodes[element.start], self.nodes[element.end]
        return (b.x - a.x) / element.length, (b.z - a.z) / element.length


def build_mesh(structure: Structure, variant: Variant, *, refine: int = 1) -> Mesh:
    """Divide every span of every bar into elements.

    Rigid ends at clamps belong to the adjacent elements. A bar with one mode in the variant has no elements.

    Parameters
    ----------
    structure : Structure
        Structure with its points, bars and transducers.
    variant : Variant
        Variant of the model.
    refine : int
        Factor on the elements per span.

    Returns
    -------
    Mesh
        Mesh.
    """
    nodes = [Node(p.name, p.x, p.z) for p in structure.point]
    index = {node.name: i for i, node in enumerate(nodes)}
    elements: list[Element] = []
    for bar in structure.bar:
        if bar.name != variant.one_mode_bar:
            elements += _mesh_bar(structure, bar, variant.elements_per_span * refine, nodes, index)
    used = sorted({e.start for e in elements} | {e.end for e in elements})
    renumber = {old: new for new, old in enumerate(used)}
    return Mesh(
        nodes=tuple(nodes[i] for i in used),
        elements=tuple(replace(e, start=renumber[e.start], end=renumber[e.end]) for e in elements),
    )


def _mesh_bar(structure: Structure, bar: Bar, per_span: int, nodes: list[Node], index: dict[str, int]) -> list[Element]:
    origin = np.array(structure.position(bar.points[0]))
    elements: list[Element] = []
    for first, last in zip(bar.points[:-1], bar.points[1:], strict=True):
        a, b = np.array(structure.position(first)), np.array(structure.position(last))
        span = float(np.hypot(*(b - a)))
        section = structure.section_between(bar, first, last)
        rigid = structure.clamp_length(first), structure.clamp_length(last)
        piece = (span - sum(rigid)) / per_span
        begin = float(np.hypot(*(a - origin)))
        stations = [0.0, *(rigid[0] + piece * k for k in range(1, per_span)), span]
        ends = [index[first]]
        for k in range(1, per_span):
            x, z = a + (b - a) * stations[k] / span
            nodes.append(Node(f"{bar.name}@{begin + stations[k]:.6f}", float(x), float(z)))
            ends.append(len(nodes) - 1)
        ends.append(index[last])
        for k in range(per_span):
            elements.append(
                Element(
                    bar=bar.name,
                    section=section,
                    start=ends[k],
                    end=ends[k + 1],
                    station=begin + stations[k],
                    length=stations[k + 1] - stations[k],
                    rigid_start=rigid[0] if k == 0 else 0.0,
                    rigid_end=rigid[1] if k == per_span - 1 else 0.0,
                )
            )
    return elements
