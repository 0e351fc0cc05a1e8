"""Names of places on a structure: points, heights, arms, cables."""

import math
import re
from dataclasses import dataclass

import numpy as np

from vlab import units
from vlab.errors import VlabError, unknown_name
from vlab.structure.model import Structure

_HEIGHT = re.compile(r"^([0-9]+(?:\.[0-9]+)?)\s*([a-zA-Z]+)$")


@dataclass(frozen=True)
class Location:
    """A place on a bar.

    Parameters
    ----------
    place : str
        Name as given.
    bar : str
        Bar of the place.
    station : float
        Distance from the bar's first point along the bar [m].
    x, z : float
        Position in the plane [m].
    """

    place: str
    bar: str
    station: float
    x: float
    z: float


def place_names(structure: Structure) -> list[str]:
    """Return the names of points and clamps.

    Heights such as ``37in`` are further valid names.
    """
    return [p.name for p in structure.point] + [c.name for c in structure.clamp]


def locate(structure: Structure, place: str) -> Location:
    """Return the location of a named place.

    A place is a point, a clamp, or a height above the lower end of the vertical bar, such as ``37in`` or ``0.5m``.

    Parameters
    ----------
    structure : Structure
        Structure with its points, bars and transducers.
    place : str
        Name of the place.

    Returns
    -------
    Location
        Bar, station and position.

    Raises
    ------
    UnknownName
        The name matches nothing on the structure.
    """
    point = next((c.at for c in structure.clamp if c.name == place), place)
    for bar in structure.bar:
        if point in bar.points:
            return _on_bar(structure, bar.name, place, _station(structure, bar.name, point))
    height = _height(place)
    if height is not None:
        for bar in structure.bar:
            (x0, z0), (x1, z1) = structure.position(bar.points[0]), structure.position(bar.points[-1])
            lower, upper = min(z0, z1), max(z0, z1)
            if math.isclose(x0, x1) and -1e-9 <= height <= upper - lower + 1e-9:
                station = height if z0 <= z1 else upper - lower - height
                return _on_bar(structure, bar.name, place, min(max(station, 0.0), upper - lower))
    raise unknown_name(
        "place", place, [*place_names(structure), "a height such as 37in"], where=f"structure {structure.name!r}"
    )


def _height(place: str) -> float | None:
    match = _HEIGHT.match(place)
    if not match:
        return None
    try:
        return float(match[1]) * units.factor(match[2], "m")
    except VlabError:
        return None


def _station(structure: Structure, bar: str, point: str) -> float:
    first = next(b for b in structure.bar if b.name == bar).points[0]
    return float(np.hypot(*np.subtract(structure.position(point), structure.position(first))))


def _on_bar(structure: Structure, bar: str, place: str, station: float) -> Location:
    points = next(b for b in structure.bar if b.name == bar).points
    start, end = np.array(structure.position(points[0])), np.array(structure.position(points[-1]))
    x, z = start + (end - start) * station / np.hypot(*(end - start))
    return Location(place, bar, station, float(x), float(z))
