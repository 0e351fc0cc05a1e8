"""Statics of vertical bars: tension from gravity and cables."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from vlab.errors import BadStructure
from vlab.structure.model import Bar, Cable, Structure


@dataclass(frozen=True)
class HangingLine:
    """Tension along one vertical bar and its end cables.

    Parameters
    ----------
    bar : str
        The vertical bar.
    heights : tuple of float
        Ascending heights of the lumped weights [m].
    weights : tuple of float
        Lumped weights [N]: masses, and carried bars.
    weight_per_length : float
        Weight of the bar [N/m].
    base : float
        Height of the bar's lower end [m].
    base_tension : float
        Tension below the lower end [N].
    deviations : tuple of tuple of float
        Spans with another weight: lower and upper height [m], and additional weight per length [N/m].
    """

    bar: str
    heights: tuple[float, ...]
    weights: tuple[float, ...]
    weight_per_length: float
    base: float
    base_tension: float
    deviations: tuple[tuple[float, float, float], ...] = ()

    def tension(self, z: float) -> float:
        """Return the tension just above height z [N].

        The tension balances everything below.
        """
        lumps = sum(w for h, w in zip(self.heights, self.weights, strict=True) if h <= z + 1e-9)
        return self.base_tension + lumps + self.weight(self.base, z)

    def weight(self, low: float, high: float) -> float:
        """Return the weight of the bar between two heights [N]."""
        more = sum(w * max(min(high, top) - max(low, bottom), 0.0) for bottom, top, w in self.deviations)
        return self.weight_per_length * (high - low) + more


def hanging_lines(structure: Structure) -> dict[str, HangingLine]:
    """Return the tension along every vertical bar.

    Parameters
    ----------
    structure : Structure
        Structure with its points, bars and transducers.

    Returns
    -------
    dict of str to HangingLine
        Tension by bar name.
    """
    lines = {}
    for bar in structure.bar:
        first, last = structure.position(bar.points[0]), structure.position(bar.points[-1])
        if np.isclose(first[0], last[0], atol=1e-9):
            lines[bar.name] = _line(structure, bar)
    return lines


def cable_tensions(structure: Structure) -> dict[str, float]:
    """Return the vertical tension of each cable set [N].

    The value is stated, or follows from equilibrium of the held bar.

    Parameters
    ----------
    structure : Structure
        Structure with its points, bars and transducers.

    Returns
    -------
    dict of str to float
        Tension [N] by cable name.
    """
    lines = hanging_lines(structure)
    tensions = {}
    for cable in structure.cable:
        if cable.tension is not None:
            tensions[cable.name] = cable.tension
            continue
        bar = next(b for b in structure.bar if cable.at in b.points and b.name in lines)
        tensions[cable.name] = lines[bar.name].tension(structure.position(cable.at)[1])
    return tensions


def _line(structure: Structure, bar: Bar) -> HangingLine:
    g = structure.gravity
    z = {name: structure.position(name)[1] for name in bar.points}
    lower, upper = min(bar.points, key=z.__getitem__), max(bar.points, key=z.__getitem__)
    for end, other in ((lower, "below"), (upper, "above")):
        stated = [c.tension for c in structure.cable if c.at == end]
        if end == lower and None in stated:
            raise BadStructure(f"the cable {other} point {end!r} states no tension; the lower cable must state it")
        if end == upper and any(t is not None for t in stated):
            raise BadStructure(
                f"the cable {other} point {end!r} states a tension that follows from equilibrium; state the lower one only"
            )
    carried = {name: structure.point_mass(name) for name in bar.points}
    for other_bar in structure.bar:
        if other_bar.name != bar.name:
            _hang_on(structure, other_bar, bar, carried)
    section = structure.section[bar.section]
    return HangingLine(
        bar=bar.name,
        heights=tuple(z[name] for name in sorted(bar.points, key=z.__getitem__)),
        weights=tuple(g * carried[name] for name in sorted(bar.points, key=z.__getitem__)),
        weight_per_length=g * section.mass_per_length,
        base=z[lower],
        base_tension=sum(c.tension or 0.0 for c in structure.cable if c.at == lower),
        deviations=tuple((low, high, g * more) for low, high, more in _deviations(structure, bar)),
    )


def _deviations(structure: Structure, bar: Bar) -> list[tuple[float, float, float]]:
    """Return heights [m] and additional mass per length [kg/m] of spans."""
    own, out = structure.section[bar.section].mass_per_length, []
    for a, b in pairwise(bar.points):
        more = structure.section_between(bar, a, b).mass_per_length - own
        if more:
            low, high = sorted((structure.position(a)[1], structure.position(b)[1]))
            out.append((low, high, more))
    return out


def _hang_on(structure: Structure, other: Bar, bar: Bar, carried: dict[str, float]) -> None:
    """Add a crossing bar's weight at its crossing point.

    Masses on the crossing bar are included.
    """
    shared = [name for name in other.points if name in bar.points]
    if not shared:
        return
    ends = structure.position(other.points[0]), structure.position(other.points[-1])
    length = float(np.hypot(*np.subtract(ends[1], ends[0])))
    mass = structure.section_between(other, other.points[0], other.points[-1]).mass_per_length * length
    mass += sum(structure.point_mass(name) for name in other.points if name not in bar.points)
    carried[shared[0]] += mass


def vertical_stiffness(cable: Cable) -> float:
    """Return the axial stiffness of one cable, EA/L [N/m]."""
    return cable.youngs_modulus * cable.area / cable.length
