"""Finite elements of a laboratory structure with varying bars.

The elements are hierarchic Timoshenko beams, one to a span, see `vlab.proof.generator.beam_elements`. Cables are strings
under their own weight. Gravity acts through the tension of vertical bars, through the resultants of a hung frame, and
through the weight of bars across a clamp. No line is shared with `vlab.fe`, from which the diagnosed plants come.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import linalg

from vlab.errors import BadStructure
from vlab.proof.generator.beam_elements import (
    POINTS,
    Along,
    element_matrices,
    hanging_string,
    inner_count,
    shape_fields,
)
from vlab.proof.generator.frame_statics import Resultants, Span, hung_frame
from vlab.signals import Array
from vlab.structure.model import Bar, Cable, Section, Structure

POISSON, SHEAR_COEFFICIENT = 0.3, 5.0 / 6.0
"""POISSON, SHEAR_COEFFICIENT [-]: of a rectangular section whose shear stiffness is not stated."""
MASSLESS = 1e-14
"""MASSLESS [-]: share of the largest mass on the diagonal below which a coordinate is dropped."""
STATIONS = 801
"""STATIONS [-]: stations of the cumulated weight of a bar, more than ten to an element."""


@dataclass(frozen=True)
class Variation:
    """Deviations of a structure as built, by name.

    Parameters
    ----------
    values : mapping of str to float
        Log-factors, and coefficients of the cosines ``along:KIND:BAR:J``.
    """

    values: Mapping[str, float]

    def factor(self, *names: str) -> float:
        """Return the product of named factors; a missing name counts as 1."""
        return float(np.exp(sum(self.values.get(name, 0.0) for name in names)))

    def along(self, kind: str, bar: str, share: Array) -> Array:
        """Return factors along a bar, exp of the sum of c_j cos(j pi share).

        Parameters
        ----------
        kind : str
            ``stiffness`` or ``density``.
        bar : str
            Name of the bar.
        share : array
            Stations over the length of the bar.

        Returns
        -------
        array
            Factor at every station.
        """
        head = f"along:{kind}:{bar}:"
        total = np.zeros_like(share)
        for name, value in self.values.items():
            if name.startswith(head):
                total = total + value * np.cos(int(name.removeprefix(head)) * np.pi * share)
        return np.asarray(np.exp(total))


@dataclass(frozen=True, kw_only=True, eq=False)
class SpanPart:
    """Span between two points with its coordinates and its bending stiffness.

    Parameters
    ----------
    bar : Bar
        Bar of the span.
    start, end : str
        Points at its ends.
    columns : (k,) array of int
        Coordinates of the structure that move the span.
    bending : (k, k) array
        Stiffness from EI alone in these coordinates.
    stiffness : float
        EI over the flexible length, without variations along the bar [N m/rad].
    """

    bar: Bar
    start: str
    end: str
    columns: Array
    bending: Array
    stiffness: float


@dataclass(frozen=True, kw_only=True, eq=False)
class BuiltStructure:
    """Mass and stiffness of a structure as built.

    Parameters
    ----------
    M, K : (n, n) array
        Matrices in the moving coordinates.
    rows : mapping of str to (3, n) array
        Deflection v, rotation about x and rotation about z of every point.
    spans : tuple of SpanPart
        Spans of all bars.
    cable_stiffness : mapping of str to float
        Lateral stiffness of every cable set [N/m].
    """

    structure: Structure
    M: Array
    K: Array
    rows: Mapping[str, Array]
    spans: tuple[SpanPart, ...]
    cable_stiffness: Mapping[str, float]

    def slope(self, bar: Bar, point: str) -> Array:
        """Return the row of the rotation along a bar at a point, (n,)."""
        tx, tz, _ = direction(self.structure, bar.points[0], bar.points[-1])
        return np.asarray(tx * self.rows[point][2] - tz * self.rows[point][1])

    def modes(self, highest_hz: float) -> tuple[Array, Array]:
        """Return the lowest modes from M x = K x / omega^2.

        This form resolves the lowest frequencies although shear makes the highest ones a million times larger.

        Parameters
        ----------
        highest_hz : float
            Highest frequency [Hz].

        Returns
        -------
        ((m,) array, (n, m) array)
            Circular frequencies [rad/s], ascending, and shapes of unit modal mass.

        Raises
        ------
        BadStructure
            The structure is not stable under its weight.
        """
        try:
            inverse, shapes = linalg.eigh(self.M, self.K)
        except linalg.LinAlgError as error:
            raise BadStructure(
                f"{self.structure.name} is not stable under its weight; lower the masses or raise the tension"
            ) from error
        keep = np.flatnonzero(inverse > (2 * np.pi * highest_hz) ** -2.0)[::-1]
        return inverse[keep] ** -0.5, shapes[:, keep] / np.sqrt(inverse[keep])


def direction(structure: Structure, start: str, end: str) -> tuple[float, float, float]:
    """Return unit vector (x, z) and distance [m] between two points."""
    (x0, z0), (x1, z1) = structure.position(start), structure.position(end)
    length = float(np.hypot(x1 - x0, z1 - z0))
    return (x1 - x0) / length, (z1 - z0) / length, length


def assemble(structure: Structure, variation: Variation) -> BuiltStructure:
    """Assemble the matrices of a structure as built.

    Parameters
    ----------
    structure : Structure
        Nominal structure.
    variation : Variation
        Deviations.

    Returns
    -------
    BuiltStructure
        Matrices and rows.
    """
    return _Assembly(structure, variation).built()


class _Assembly:
    """Assembly in the motions of all points and the inner functions of all spans."""

    def __init__(self, structure: Structure, variation: Variation) -> None:
        self._s, self._vary = structure, variation
        used = dict.fromkeys(point for bar in structure.bar for point in bar.points)
        self._node = {point: 3 * i for i, point in enumerate(used)}
        self._spans = [(bar, a, b) for bar in structure.bar for a, b in pairwise(bar.points)]
        self._inner = sum(inner_count())
        self._n = 3 * len(used) + self._inner * len(self._spans)
        self._M, self._K = np.zeros((self._n, self._n)), np.zeros((self._n, self._n))
        self._lifted = {clamp.at: np.zeros(self._n) for clamp in structure.clamp}
        vertical = [bar for bar in structure.bar if self._is_vertical(bar)]
        self._lines = {bar.name: _Line(self, bar) for bar in vertical}
        self._frame = self._hung()
        self._cables: dict[str, float] = {}

    def built(self) -> BuiltStructure:
        """Return the structure in its moving coordinates."""
        parts = [self._span(i) for i in range(len(self._spans))]
        for point in self._node:
            self._point(point)
        for clamp in self._s.clamp:
            self._lift(clamp.at)
        keep = self._moving()
        block, eye = np.ix_(keep, keep), np.eye(self._n)[:, keep]
        new = np.full(self._n, -1)
        new[keep] = np.arange(len(keep))
        spans = []
        for (bar, a, b), (columns, bending, stiffness) in zip(self._spans, parts, strict=True):
            moves = np.flatnonzero(new[columns] >= 0)
            inside, at = bending[np.ix_(moves, moves)], new[columns][moves]
            spans.append(SpanPart(bar=bar, start=a, end=b, columns=at, bending=inside, stiffness=stiffness))
        return BuiltStructure(
            structure=self._s,
            M=self._M[block],
            K=self._K[block],
            rows={point: eye[node : node + 3] for point, node in self._node.items()},
            spans=tuple(spans),
            cable_stiffness=self._cables,
        )

    # ---- properties -------------------------------------------------------------------------------------------------

    def lump(self, point: str) -> tuple[float, float]:
        """Return mass [kg] and rotary inertia [kg m^2] of the parts at a point.

        Cables and plates do not count.
        """
        mass = inertia = 0.0
        for kind, parts in (("mass", self._s.mass), ("coil", self._s.coil), ("clamp", self._s.clamp)):
            for part in parts:
                if part.at == point:
                    factor = self._vary.factor("mass:fittings", f"lump:{kind}:{part.name}")
                    mass += factor * part.mass
                    inertia += factor * getattr(part, "rotary_inertia", 0.0)
        return mass, inertia

    def cable_mass(self, cable: Cable) -> float:
        """Return the mass of a cable set per length of cable [kg/m]."""
        return self._vary.factor("mass:cables") * cable.count * cable.density * cable.area

    def density(self, bar: Bar, station: Array) -> Array:
        """Return the mass per length at stations of a bar [kg/m]."""
        section, length = self._s.section[bar.section], self._length(bar)
        mu = section.mass_per_length * self._vary.factor(f"mass:{bar.section}")
        return np.asarray(mu * self._vary.along("density", bar.name, station / length))

    def bar_mass(self, bar: Bar) -> float:
        """Return the mass of a bar without its parts [kg]."""
        station = np.linspace(0.0, self._length(bar), STATIONS)
        return float(np.trapezoid(self.density(bar, station), station))

    def _length(self, bar: Bar) -> float:
        return direction(self._s, bar.points[0], bar.points[-1])[2]

    def _is_vertical(self, bar: Bar) -> bool:
        return abs(direction(self._s, bar.points[0], bar.points[-1])[0]) < 1e-9

    def _station(self, bar: Bar, point: str) -> float:
        return direction(self._s, bar.points[0], point)[2] if point != bar.points[0] else 0.0

    # ---- spans ------------------------------------------------------------------------------------------------------

    def _span(self, index: int) -> tuple[Array, Array, float]:
        """Add a span; return coordinates, bending stiffness and EI over length."""
        bar, a, b = self._spans[index]
        section = self._s.section[bar.section]
        tx, tz, length = direction(self._s, a, b)
        rigid = (self._s.clamp_length(a), self._s.clamp_length(b))
        flexible = length - sum(rigid)
        if flexible <= 0:
            raise BadStructure(f"bar {bar.name!r}: the clamps leave nothing of the span of {length:g} m")
        fields, begin = shape_fields(flexible), self._station(bar, a)
        s = rigid[0] + fields.s  # from the point
        along = self._along(bar, section, begin + s, index, s)
        frame = self._frame.get(index)
        ends = (0.0, 0.0) if frame is None else tuple(float(frame.moment(np.array(x))) for x in (0.0, length))
        mass, stiffness, bending = element_matrices(fields, along, (ends[0], ends[1]))
        inner = 3 * len(self._node) + self._inner * index
        columns = np.concatenate([self._at(a), self._at(b), np.arange(inner, inner + self._inner)])
        T = np.eye(len(columns))
        T[:3, :3], T[3:6, 3:6] = _to_bar((tx, tz), rigid[0]), _to_bar((tx, tz), -rigid[1])
        self._M[np.ix_(columns, columns)] += T.T @ mass @ T
        self._K[np.ix_(columns, columns)] += T.T @ stiffness @ T
        self._weigh(bar, columns, T.T @ (fields.w.T @ (fields.weight * along.mu)))
        for point, size, start in ((a, rigid[0], begin), (b, -rigid[1], begin + length)):
            if size:
                self._rigid(bar, point, (tx, tz), start, size)
        stiff = section.bending_stiffness * self._vary.factor(f"stiffness:{bar.section}") / flexible
        return columns, T.T @ bending @ T, stiff

    def _at(self, point: str) -> Array:
        return self._node[point] + np.arange(3)

    def _along(self, bar: Bar, section: Section, station: Array, index: int, s: Array) -> Along:
        share = station / self._length(bar)
        soft = self._vary.factor(f"stiffness:{bar.section}") * self._vary.along("stiffness", bar.name, share)
        mu = self.density(bar, station)
        per_mass = mu / section.mass_per_length
        torsion = section.torsion_stiffness
        line, frame = self._lines.get(bar.name), self._frame.get(index)
        nothing = np.zeros_like(station)
        tension = nothing if line is None else line.tension(station)
        return Along(
            EI=section.bending_stiffness * soft,
            GA=_shear_stiffness(section) * soft,
            GJ=torsion * soft,
            mu=mu,
            rotary=_rotary_inertia(section) * per_mass,
            polar=(section.polar_inertia_per_length if torsion else 0.0) * per_mass,
            tension=tension if frame is None else tension + frame.axial(s),
            moment=nothing if frame is None else frame.moment(s),
        )

    def _rigid(self, bar: Bar, point: str, axis: tuple[float, float], station: float, size: float) -> None:
        """Add the rigid piece of a bar inside a clamp.

        A piece of negative size lies before the point.
        """
        columns, (_, slope, _) = self._at(point), _to_bar(axis, 0.0)
        xi, weight = np.polynomial.legendre.leggauss(POINTS)
        arm, weight = (xi + 1.0) * size / 2.0, weight * abs(size) / 2.0
        mu, line = self.density(bar, station + arm), self._lines.get(bar.name)
        w = np.array([_to_bar(axis, x)[0] for x in arm])
        self._M[np.ix_(columns, columns)] += w.T @ (w * (weight * mu)[:, None])
        self._weigh(bar, columns, w.T @ (weight * mu))
        if line is not None:
            self._K[np.ix_(columns, columns)] += float(weight @ line.tension(station + arm)) * np.outer(slope, slope)

    # ---- points and gravity -----------------------------------------------------------------------------------------

    def _point(self, point: str) -> None:
        node = self._node[point]
        mass, inertia = self.lump(point)
        self._M[node, node] += mass
        for i in (1, 2):
            self._M[node + i, node + i] += inertia
        for cable in (c for c in self._s.cable if c.at == point):
            stiffness, moving = self._string(cable)
            self._K[node, node] += stiffness
            self._M[node, node] += moving
            self._cables[cable.name] = stiffness
        heavy, hung = self._vary.factor("mass:plates"), self._vary.factor("tension:plates")
        for plate in (p for p in self._s.plate if p.at == point):
            self._K[node + 1, node + 1] += hung * plate.weight_moment
            self._M[node + 1, node + 1] += heavy * plate.inertia_about_beam
            self._M[node + 2, node + 2] += heavy * plate.inertia_about_vertical

    def _string(self, cable: Cable) -> tuple[float, float]:
        """Return stiffness and mass of a cable set at its point."""
        height = abs(cable.height) * self._vary.factor(f"height:{cable.name}")
        per_height = self.cable_mass(cable) * cable.length / abs(cable.height)
        line = next(line for line in self._lines.values() if cable.at in line.bar.points)
        above = cable.height > 0
        start = line.base if not above else line.top
        weight = self._s.gravity * per_height * (1.0 if above else -1.0)
        return hanging_string(lambda s: start + weight * s, height, per_height)

    def _weigh(self, bar: Bar, columns: Array, moved: Array) -> None:
        """Note the mass of a bar across a clamp by its deflection."""
        for at, row in self._lifted.items():
            if at in bar.points and bar.name not in self._lines:
                row[columns] += moved

    def _lift(self, at: str) -> None:
        """Add the lift of crossing bars at a rolling clamp.

        The potential is g rx (sum of m (v - v_clamp)).
        """
        node, row = self._node[at], self._lifted[at].copy()
        for bar in self._s.bar:
            if at in bar.points and bar.name not in self._lines:
                for point in bar.points:
                    row[self._node[point]] += self.lump(point)[0] if point != at else 0.0
        row[node : node + 3] = 0.0
        row[node] = -sum(row[i] for i in self._node.values())
        self._K[node + 1] += self._s.gravity * row
        self._K[:, node + 1] += self._s.gravity * row

    def _hung(self) -> dict[int, Resultants]:
        """Return the resultants of the spans that hang from a carrying bar."""
        carried = {i: part for i, part in enumerate(self._spans) if not part[0].carries}
        pinned = {point for bar in self._s.bar if bar.carries for point in bar.points}
        if not pinned or not carried:
            return {}
        g, spans = self._s.gravity, []
        for bar, a, b in carried.values():
            section = self._s.section[bar.section]
            weight = g * section.mass_per_length * self._vary.factor(f"mass:{bar.section}")
            if section.width is None or section.thickness is None:
                raise BadStructure(f"section {bar.section!r} needs a width and a thickness to hang in a frame")
            axial = 12.0 * section.bending_stiffness / section.thickness**2
            spans.append(Span(start=a, end=b, axial=axial, bending=axial * section.width**2 / 12, weight=weight))
        found = hung_frame(tuple(spans), self._s.position, {p: g * self.lump(p)[0] for p in self._node}, pinned)
        return dict(zip(carried, found, strict=True))

    def _moving(self) -> list[int]:
        """Return the coordinates that have mass and are not held."""
        diagonal = self._M.diagonal()
        held = {self._node[s.at] + ("v", "rx", "rz").index(motion) for s in self._s.support for motion in s.holds}
        for clamp in self._s.clamp:  # no torsion holds the arms about a bar without torsional stiffness
            for bar in (b for b in self._s.bar if clamp.at in b.points and b.name in self._lines):
                if not self._s.section[bar.section].torsion_stiffness:
                    held.add(self._node[clamp.at] + 2)
        return [i for i in range(self._n) if diagonal[i] > MASSLESS * diagonal.max() and i not in held]


class _Line:
    """Tension along a vertical bar, from the cable and all weights below."""

    def __init__(self, assembly: _Assembly, bar: Bar) -> None:
        structure, self.bar = assembly._s, bar
        z = np.array([structure.position(p)[1] for p in bar.points])
        order = np.argsort(z)
        length = float(np.ptp(z))
        lowest, highest = bar.points[order[0]], bar.points[order[-1]]
        stated = [c.tension for c in structure.cable if c.at == lowest and c.tension is not None]
        if any(c.tension is not None for c in structure.cable if c.at == highest):
            raise BadStructure(f"the tension above {highest!r} follows from equilibrium; state that below {lowest!r}")
        self.base = sum(stated) * assembly._vary.factor("tension:all")
        up = np.linspace(0.0, length, STATIONS)
        self._is_up = bool(z[-1] > z[0])
        mu = assembly.density(bar, up if self._is_up else length - up)
        own = np.concatenate([[0.0], np.cumsum(0.5 * (mu[1:] + mu[:-1]) * np.diff(up))])
        self._up, self._own, self._length = up, structure.gravity * own, length
        weights = [structure.gravity * _carried(assembly, bar, bar.points[i]) for i in order]
        self._heights, self._below = z[order] - z[order[0]], np.cumsum(weights)
        self.top = float(self.base + self._own[-1] + self._below[-1])

    def tension(self, station: Array) -> Array:
        """Return the tension at stations between the points [N]."""
        up = station if self._is_up else self._length - station
        below = np.searchsorted(self._heights, up, side="right") - 1
        return np.asarray(self.base + np.interp(up, self._up, self._own) + self._below[below])


def _carried(assembly: _Assembly, bar: Bar, point: str) -> float:
    """Return the mass that hangs on a point of a vertical bar [kg]."""
    structure = assembly._s
    mass = assembly.lump(point)[0]
    mass += sum(assembly.cable_mass(c) * c.length / 3 for c in structure.cable if c.at == point)
    for other in structure.bar:
        if other.name != bar.name and point in other.points:
            mass += assembly.bar_mass(other)
            mass += sum(assembly.lump(p)[0] for p in other.points if p not in bar.points)
    return mass


def _to_bar(axis: tuple[float, float], arm: float) -> Array:
    """Return the 3 x 3 map from a point to a rigid arm.

    The map takes (v, rx, rz) of the point to deflection, slope and twist at the end of the arm.
    """
    tx, tz = axis
    return np.array([[1.0, -arm * tz, arm * tx], [0.0, -tz, tx], [0.0, tx, tz]])


def _shear_stiffness(section: Section) -> float:
    """Return the shear stiffness of bending out of the plane [N]."""
    if section.shear_stiffness:
        return section.shear_stiffness
    if section.thickness is None:
        raise BadStructure("a section without thickness must state its shear stiffness")
    modulus_area = 12.0 * section.bending_stiffness / section.thickness**2
    return SHEAR_COEFFICIENT * modulus_area / (2.0 * (1.0 + POISSON))


def _rotary_inertia(section: Section) -> float:
    """Return the rotary inertia of bending per length [kg m].

    A section without thickness has half its polar inertia.
    """
    if section.thickness is None:
        return section.polar_inertia_per_length / 2
    return section.mass_per_length * section.thickness**2 / 12
