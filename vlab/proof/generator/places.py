"""Names and neighbours of the places of a structure."""

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise

from vlab.proof.generator.bench import Place
from vlab.structure.model import Bar, Structure


def span_name(structure: Structure, bar: Bar, a: str, b: str) -> str:
    """Return the name of the span of a bar between two neighbouring points.

    Parameters
    ----------
    structure : Structure
        Structure.
    bar : Bar
        Bar of the span.
    a, b : str
        Points of the span, in the order of the bar.

    Returns
    -------
    str
        Name as in the ports of a plant.
    """
    if bar.name == "crosspiece":
        return f"crosspiece-{'left' if a == 'tip-left' else 'right'}"
    if structure.name == "grid":
        low, high = sorted(int("".join(c for c in p if c.isdigit())) for p in (a, b))
        return f"bar:{low}-{high}"
    return f"{bar.name}:{a}-{b}"


def beside(places: Mapping[str, Place]) -> dict[str, Place]:
    """Return places with those one element away added to their neighbours.

    Parameters
    ----------
    places : mapping of str to Place
        Points and spans; a span is near its ends.

    Returns
    -------
    dict of str to Place
        Places by name.
    """
    ends = {name: set(p.near) for name, p in places.items() if ":" in name or name.startswith("crosspiece")}
    out = {}
    for name, place in places.items():
        own = ends.get(name, {name})
        more = tuple(other for other, points in ends.items() if other != name and own & points)
        out[name] = replace(place, near=(*place.near, *more))
    return out


def neighbours(structure: Structure, point: str) -> tuple[str, ...]:
    """Return the points one span away from a point.

    Parameters
    ----------
    structure : Structure
        Structure.
    point : str
        Name of the point.

    Returns
    -------
    tuple of str
        Names of points.
    """
    out = []
    for bar in structure.bar:
        for a, b in pairwise(bar.points):
            if point in (a, b):
                out.append(b if point == a else a)
    return tuple(out)
