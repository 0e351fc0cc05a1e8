"""Elastic elements of a structure as ports.

The bend of a span between neighbouring points is the difference of the slopes at its ends. In uniform bending the
span's stiffness is EI/L. A loss of an element's stiffness acts on that motion. Tension acts on every span's change of
direction, with w' constant between neighbouring points, and on the cables' ends.
"""

import re
from collections.abc import Callable, Mapping
from itertools import pairwise

import numpy as np

from vlab.fe.one_mode import one_mode_bar
from vlab.fe.statics import cable_tensions, hanging_lines
from vlab.plants.base import Port
from vlab.signals import Array
from vlab.structure.model import Bar, Structure

Slope = Callable[[str, tuple[float, float]], Array | None]
"""Point and direction (x, z) of a bar to the row of the deflection's slope, (nv,); None if the plant has no such
slope."""


def element_ports(structure: Structure, variant: str, points: Mapping[str, Array], slope: Slope) -> dict[str, Port]:
    """Return the ports of a structure's elastic elements.

    Parameters
    ----------
    structure : Structure
        Structure with its points, bars and transducers.
    variant : str
        Name of the structure's variant.
    points : mapping of str to (nv,) array
        Deflection of every point per joint coordinate, at rest.
    slope : callable
        See `Slope`.

    Returns
    -------
    dict of str to Port
        Ports by name, as used in cases and diagnoses.
    """
    ports: dict[str, Port] = {}
    one_mode = structure.variant_named(variant).one_mode_bar
    for bar in structure.bar:
        if bar.name == one_mode:
            ports |= _one_mode(structure, bar, points)
            continue
        spans = _spans(structure, bar, slope)
        ports |= spans
        if bar.carries and spans:
            parts = [constant_port(bar.name, p.row(None) * np.sqrt(p.stiffness), "m", 1.0) for p in spans.values()]
            ports[bar.name] = _together(bar.name, parts, "bar")
    ports |= _clamps(structure, ports)
    tensions = cable_tensions(structure)
    for cable in structure.cable:
        if cable.at in points:
            ports[cable.name] = constant_port(
                cable.name, points[cable.at], "m", tensions[cable.name] / abs(cable.height)
            )
    for plate in structure.plate:
        if plate.name in points:
            ports[plate.name] = constant_port(
                plate.name, points[plate.name], "m", plate.weight_moment / plate.offset**2
            )
    return ports | _tension(structure, points)


def constant_port(name: str, row: Array, unit: str = "m", stiffness: float = 0.0, tag: str = "") -> Port:
    """Return the port of a linear combination of coordinates.

    The coordinates are zero at rest.

    Parameters
    ----------
    name : str
        Name of the port.
    row : (nv,) array
        Coefficients.
    unit : str
        Unit of the coordinate, m or rad.
    stiffness : float
        Stiffness of the port's element [N/m or N m/rad]; 0 without an element.
    tag : str
        Additional meaning of the place, see `Port`.

    Returns
    -------
    Port
        Port with a constant row.
    """
    return Port(
        name=name,
        unit=unit,
        row=lambda data: row.copy(),
        position=lambda data: float(row @ data.qpos),
        stiffness=stiffness,
        is_constant=True,
        tag=tag,
    )


def _together(name: str, parts: list[Port], tag: str) -> Port:
    first, *others = parts
    row = first.row(None)
    return Port(
        name=name,
        unit="m",
        row=lambda data: row.copy(),
        position=first.position,
        stiffness=first.stiffness,
        is_constant=True,
        more=tuple(others),
        tag=tag,
    )


def _spans(structure: Structure, bar: Bar, slope: Slope) -> dict[str, Port]:
    out = {}
    for a, b in pairwise(bar.points):
        (xa, za), (xb, zb) = structure.position(a), structure.position(b)
        length = float(np.hypot(xb - xa, zb - za))
        along = ((xb - xa) / length, (zb - za) / length)
        start, end = slope(a, along), slope(b, along)
        flexible = length - structure.clamp_length(a) - structure.clamp_length(b)
        if start is None or end is None or not np.any(end - start):
            continue
        name = _span_name(structure, bar, a, b)
        out[name] = constant_port(
            name, end - start, "rad", structure.section_between(bar, a, b).bending_stiffness / flexible
        )
    return out


def _span_name(structure: Structure, bar: Bar, a: str, b: str) -> str:
    """Return the name of a span.

    The form is ``bar:5-9`` between numbered points, ``crosspiece-left`` for an arm from a clamp, else
    ``beam:30in-40in``.
    """
    numbers = [re.fullmatch(r"[a-z]+(\d+)", point) for point in (a, b)]
    if all(numbers):
        low, high = sorted(int(match[1]) for match in numbers if match)
        return f"bar:{low}-{high}"
    clamps = [c.at for c in structure.clamp]
    if len(bar.points) == 3 and bar.points[1] in clamps:
        arm = b if a in clamps else a
        return f"{bar.name}-{'right' if structure.position(arm)[0] > structure.position(bar.points[1])[0] else 'left'}"
    return f"{bar.name}:{a}-{b}"


def _one_mode(structure: Structure, bar: Bar, points: Mapping[str, Array]) -> dict[str, Port]:
    """Return the ports of a bar with one mode.

    Both arms bend alike.
    """
    mode = one_mode_bar(structure, bar.name)
    row = points[bar.points[-1]] - points[mode.root]
    stiffness = float(mode.stiffness_matrix[1, 1])
    return {
        f"{bar.name}-{side}": constant_port(f"{bar.name}-{side}", row, "m", stiffness) for side in ("left", "right")
    }


def _clamps(structure: Structure, spans: Mapping[str, Port]) -> dict[str, Port]:
    """Return the bend through each clamp over both adjacent spans."""
    out = {}
    for clamp in structure.clamp:
        for bar in structure.bar:
            i = bar.points.index(clamp.at) if clamp.at in bar.points else 0
            names = [f"{bar.name}:{a}-{b}" for a, b in pairwise(bar.points[max(i - 1, 0) : i + 2])]
            if 0 < i < len(bar.points) - 1 and all(name in spans for name in names):
                parts = [spans[name] for name in names]
                series = 1.0 / sum(1.0 / part.stiffness for part in parts)
                out[clamp.name] = constant_port(
                    clamp.name, np.sum([part.row(None) for part in parts], axis=0), "rad", series
                )
    return out


def _tension(structure: Structure, points: Mapping[str, Array]) -> dict[str, Port]:
    """Return the place ``tension``.

    A change of tension dT adds dT times the sum of r^T r over its rows r to the stiffness matrix.
    """
    if not structure.cable:
        return {}
    rows = []
    for name in hanging_lines(structure):
        bar = next(b for b in structure.bar if b.name == name)
        for a, b in pairwise(bar.points):
            if a in points and b in points:
                length = np.hypot(*np.subtract(structure.position(a), structure.position(b)))
                rows.append((points[b] - points[a]) / np.sqrt(length))
    for cable in structure.cable:
        rows.append(points[cable.at] / np.sqrt(abs(cable.height)))
    return {
        "tension": _together("tension", [constant_port("tension", row, "m", tag="tension") for row in rows], "tension")
    }
