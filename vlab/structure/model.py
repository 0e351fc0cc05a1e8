"""Parts of a laboratory structure in SI units.

A structure hangs in the x-z plane (x horizontal, z up); the observed motion is out of the plane, along y. Each part is
a frozen record. `Structure` checks the references between parts.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from vlab.errors import BadStructure, unknown_name
from vlab.files.toml import Provenance, number
from vlab.structure.discretisation import Reduction, Tuning, Variant


@dataclass(frozen=True, kw_only=True)
class Section:
    """Cross-section of a bar.

    `width` lies in the plane of the structure, `thickness` along y. A rectangular section states width, thickness and
    density. A section of unknown build-up states its mass per length instead.

    Parameters
    ----------
    bending_stiffness : float
        EI of bending out of the plane [N m^2].
    torsion_stiffness : float
        GJ [N m^2]; zero without torsion in the model.
    shear_stiffness : float
        Shear stiffness of bending out of the plane, shear coefficient included [N]; zero for rigid in shear.
    mass_per_length : float
        Mass per length [kg/m]; by default from the rectangle.
    polar_inertia_per_length : float
        Rotary inertia about the bar's axis [kg m]; by default from the rectangle.
    """

    width: float | None = number("m", default=None, positive=True)
    thickness: float | None = number("m", default=None, positive=True)
    density: float | None = number("kg/m^3", default=None, positive=True)
    bending_stiffness: float = number("N m^2", positive=True)
    torsion_stiffness: float = number("N m^2", default=0.0, at_least=0.0)
    shear_stiffness: float = number("N", default=0.0, at_least=0.0)
    mass_per_length: float = number("kg/m", default=0.0, at_least=0.0)
    polar_inertia_per_length: float = number("kg m", default=0.0, at_least=0.0)

    def __post_init__(self) -> None:
        if self.width and self.thickness and self.density:
            mass = self.density * self.width * self.thickness
            if self.mass_per_length == 0.0:
                object.__setattr__(self, "mass_per_length", mass)
            if self.polar_inertia_per_length == 0.0:
                object.__setattr__(self, "polar_inertia_per_length", mass * (self.width**2 + self.thickness**2) / 12)
        if self.mass_per_length == 0.0:
            missing = [name for name in ("width", "thickness", "density") if getattr(self, name) is None]
            raise BadStructure(
                f"the key {missing[0]!r} is missing; state width, thickness and density, or mass_per_length"
            )

    def scaled(self, *, stiffness: float = 1.0, mass: float = 1.0) -> "Section":
        """Return the section with stiffnesses and mass multiplied.

        Parameters
        ----------
        stiffness, mass : float
            Factors.

        Returns
        -------
        Section
            Section.
        """
        return replace(
            self,
            bending_stiffness=self.bending_stiffness * stiffness,
            torsion_stiffness=self.torsion_stiffness * stiffness,
            shear_stiffness=self.shear_stiffness * stiffness,
            mass_per_length=self.mass_per_length * mass,
            polar_inertia_per_length=self.polar_inertia_per_length * mass,
        )

    @property
    def in_plane_ratio(self) -> float:
        """Ratio EI_z/EA of in-plane bending [m^2].

        The ratio is the squared radius of gyration, width^2/12 for a rectangle.
        """
        if self.width is None:
            raise BadStructure("a section without width has no in-plane stiffness; state width and thickness")
        return self.width**2 / 12

    @property
    def axial_stiffness(self) -> float:
        """Axial stiffness EA = 12 EI/thickness^2 [N].

        EI is the measured one of the rectangle.
        """
        if self.thickness is None:
            raise BadStructure("a section without thickness has no axial stiffness; state width and thickness")
        return 12 * self.bending_stiffness / self.thickness**2


@dataclass(frozen=True, kw_only=True)
class Point:
    """A named point of the drawing."""

    name: str
    x: float = number("m")
    z: float = number("m")
    label: str = ""


@dataclass(frozen=True, kw_only=True)
class Bar:
    """A straight bar through named points, in order.

    Parameters
    ----------
    carries : bool
        Whether the bar is held in the plane and carries hanging bars.
    """

    name: str
    section: str
    points: tuple[str, ...]
    carries: bool = False


@dataclass(frozen=True, kw_only=True)
class Span:
    """Deviation of a bar from its section between two neighbouring points.

    No rolled strip has the same thickness everywhere: stiffness and mass vary along a bar.

    Parameters
    ----------
    between : tuple of (str, str)
        Neighbouring points of the bar.
    stiffness, mass : float
        Factors on the stiffnesses and on the mass of the section.
    """

    name: str
    bar: str
    between: tuple[str, str]
    stiffness: float = number("1", default=1.0, positive=True)
    mass: float = number("1", default=1.0, positive=True)


@dataclass(frozen=True, kw_only=True)
class Clamp:
    """A rigid joint of bars at a point.

    Every bar through `at` is rigid over `half_length` to each side.
    """

    name: str
    at: str
    half_length: float = number("m", at_least=0.0)
    mass: float = number("kg", at_least=0.0)


@dataclass(frozen=True, kw_only=True)
class Cable:
    """Tensioned cables from a point to fixings.

    The fixings are above (height > 0) or below (height < 0).

    Parameters
    ----------
    height : float
        Vertical distance to the fixings [m], signed.
    spread : float
        Horizontal distance of each fixing from the vertical through the point [m], alternating in sign.
    count : int
        Number of cables.
    tension : float or None
        Total vertical tension [N]. Exactly one cable of a hanging line states a tension; equilibrium gives the rest.
    """

    name: str
    at: str
    height: float = number("m")
    spread: float = number("m", at_least=0.0)
    count: int = 2
    diameter: float = number("m", positive=True)
    density: float = number("kg/m^3", positive=True)
    youngs_modulus: float = number("Pa", positive=True)
    tension: float | None = number("N", default=None, positive=True)

    @property
    def length(self) -> float:
        """Length of one cable [m]."""
        return float(np.hypot(self.height, self.spread))

    @property
    def area(self) -> float:
        """Cross-section of one cable [m^2]."""
        return float(np.pi * self.diameter**2 / 4)

    @property
    def end_mass(self) -> float:
        """Mass of the cable set at the point [kg].

        The linear shape of a string gives one third of the cables' mass.
        """
        return self.count * self.density * self.area * self.length / 3


@dataclass(frozen=True, kw_only=True)
class Mass:
    """A point mass with rotary inertia [kg m^2].

    The inertia is the same about both in-plane axes.
    """

    name: str
    at: str
    mass: float = number("kg", at_least=0.0)
    rotary_inertia: float = number("kg m^2", default=0.0, at_least=0.0)


@dataclass(frozen=True, kw_only=True)
class Support:
    """A bearing that holds motions of a point.

    The motions are ``v`` along y, ``rx`` and ``rz`` about x and z.
    """

    name: str
    at: str
    holds: tuple[Literal["v", "rx", "rz"], ...]


@dataclass(frozen=True, kw_only=True)
class Plate:
    """A rigid plate hanging from a bar's end.

    The plate swings with the bar's rotation about x.

    Parameters
    ----------
    weight_moment : float
        Weight times the distance of the centre below the axis [N m], a pendulous rotational stiffness.
    offset : float
        Distance of the centre below the axis [m].
    inertia_about_beam, inertia_about_vertical : float
        Inertia about the bar's axis and about the vertical [kg m^2].
    """

    name: str
    at: str
    weight_moment: float = number("N m", positive=True)
    offset: float = number("m", positive=True)
    inertia_about_beam: float = number("kg m^2", positive=True)
    inertia_about_vertical: float = number("kg m^2", positive=True)


@dataclass(frozen=True, kw_only=True)
class Coil:
    """A force coil: mass and actuator along y."""

    name: str
    at: str
    mass: float = number("kg", at_least=0.0)


@dataclass(frozen=True, kw_only=True)
class Sensor:
    """A sensor of motion along y at a place."""

    name: str
    at: str
    kind: Literal["velocity", "displacement"]


@dataclass(frozen=True, kw_only=True)
class Damping:
    """Modal damping ratios of the first and all higher modes."""

    ratios: tuple[float, ...] = number("1", at_least=0.0)
    higher: float = number("1", at_least=0.0)


ATTACHED = ("clamp", "cable", "mass", "support", "plate", "coil", "sensor", "probe")
"""Kinds of parts at a point."""


@dataclass(frozen=True, kw_only=True)
class Structure:
    """A complete structure, checked for consistency.

    Parameters
    ----------
    exciter : str
        Default coil for excitation.

    Raises
    ------
    BadStructure, UnknownName
        A part has an unknown reference or a repeated name, two spans have the same place, or the tension of a hanging
        line is open.
    """

    format: Literal["vlab-structure-1"]
    name: str
    title: str
    exciter: str
    gravity: float = number("m/s^2", at_least=0.0)
    section: dict[str, Section]
    point: tuple[Point, ...]
    bar: tuple[Bar, ...]
    span: tuple[Span, ...] = ()
    clamp: tuple[Clamp, ...] = ()
    cable: tuple[Cable, ...] = ()
    mass: tuple[Mass, ...] = ()
    support: tuple[Support, ...] = ()
    plate: tuple[Plate, ...] = ()
    coil: tuple[Coil, ...] = ()
    sensor: tuple[Sensor, ...] = ()
    probe: tuple[Sensor, ...] = ()
    damping: Damping
    tuning: Tuning | None = None
    reduction: Reduction | None = None
    variant: dict[str, Variant]
    provenance: Mapping[str, Provenance] = field(default_factory=dict, init=False, compare=False)

    def __post_init__(self) -> None:
        points = [p.name for p in self.point]
        for kind in ("point", "bar", "span", *ATTACHED):
            names = [part.name for part in getattr(self, kind)]
            for name in names:
                if names.count(name) > 1:
                    raise BadStructure(
                        f"the {kind} name {name!r} stands {names.count(name)} times; names must be unique"
                    )
        plates = [plate.name for plate in self.plate]
        for kind in ATTACHED:
            for part in getattr(self, kind):
                known = [*points, *plates] if kind == "probe" else points
                if part.at not in known:
                    raise unknown_name("point", part.at, known, where=f"{kind} {part.name!r}")
        for bar in self.bar:
            if bar.section not in self.section:
                raise unknown_name("section", bar.section, self.section, where=f"bar {bar.name!r}")
            if len(bar.points) < 2:
                raise BadStructure(f"bar {bar.name!r} has {len(bar.points)} points; it needs at least 2")
            for name in bar.points:
                if name not in points:
                    raise unknown_name("point", name, points, where=f"bar {bar.name!r}")
            self._check_straight(bar)
        self._check_spans()
        for name, variant in self.variant.items():
            if variant.one_mode_bar and variant.one_mode_bar not in [b.name for b in self.bar]:
                raise unknown_name("bar", variant.one_mode_bar, [b.name for b in self.bar], where=f"variant {name!r}")
        if self.exciter not in [c.name for c in self.coil]:
            raise unknown_name("coil", self.exciter, [c.name for c in self.coil], where="exciter")
        if not self.variant:
            raise BadStructure("no [variant.NAME] says how the structure is discretised")

    def _check_spans(self) -> None:
        bars = {bar.name: bar for bar in self.bar}
        taken: dict[tuple[str, frozenset[str]], str] = {}
        for span in self.span:
            if span.bar not in bars:
                raise unknown_name("bar", span.bar, bars, where=f"span {span.name!r}")
            neighbours = [f"{a}-{b}" for a, b in pairwise(bars[span.bar].points)]
            if not {"-".join(span.between), "-".join(reversed(span.between))} & set(neighbours):
                raise unknown_name("span", "-".join(span.between), neighbours, where=f"span {span.name!r}")
            first = taken.setdefault((span.bar, frozenset(span.between)), span.name)
            if first != span.name:
                raise BadStructure(
                    f"spans {first!r} and {span.name!r} are both between {' and '.join(map(repr, span.between))} of bar "
                    f"{span.bar!r}; a place has at most one [[span]], so write one with the product of their factors"
                )

    def _check_straight(self, bar: Bar) -> None:
        at = np.array([self.position(name) for name in bar.points])
        along = at[-1] - at[0]
        length = float(np.hypot(*along))
        if length == 0.0:
            raise BadStructure(f"bar {bar.name!r} has no length")
        offset = (at - at[0]) @ np.array([-along[1], along[0]]) / length
        station = (at - at[0]) @ along / length
        if np.any(np.abs(offset) > 1e-9 * length) or np.any(np.diff(station) <= 0):
            raise BadStructure(f"bar {bar.name!r} is not straight with its points in order: {', '.join(bar.points)}")

    @property
    def has_modes_of_fe(self) -> bool:
        """Whether the physical plant has modes of the FE model."""
        return self.tuning is not None and self.tuning.of_fe > 0

    @property
    def coil_places(self) -> list[str]:
        """Point of every coil in order."""
        return [coil.at for coil in self.coil]

    @property
    def transducer_places(self) -> list[str]:
        """Every point with a coil, sensor or probe, once."""
        places = self.coil_places + [s.at for s in (*self.sensor, *self.probe)]
        return list(dict.fromkeys(places))

    def section_between(self, bar: Bar, a: str, b: str) -> Section:
        """Return the section of a bar between two of its points.

        Spans with a deviation count by their length: masses add up, and so do flexibilities.

        Parameters
        ----------
        bar : Bar
            Bar.
        a, b : str
            Points of the bar, in any order.

        Returns
        -------
        Section
            Section of the mean stiffness and mass.
        """
        section = self.section[bar.section]
        if all(span.bar != bar.name for span in self.span):
            return section
        low, high = sorted((bar.points.index(a), bar.points.index(b)))
        pieces = list(pairwise(bar.points[low : high + 1]))
        lengths = [float(np.hypot(*np.subtract(self.position(q), self.position(p)))) for p, q in pieces]
        spans = [self.deviation(bar.name, p, q) for p, q in pieces]
        mass = sum(length * span.mass for length, span in zip(lengths, spans, strict=True))
        flexibility = sum(length / span.stiffness for length, span in zip(lengths, spans, strict=True))
        return section.scaled(stiffness=sum(lengths) / flexibility, mass=mass / sum(lengths))

    def deviation(self, bar: str, a: str, b: str) -> Span:
        """Return the deviation between two neighbouring points; factors of one for none."""
        own = (span for span in self.span if span.bar == bar and set(span.between) == {a, b})
        return next(own, Span(name=f"{bar}:{a}-{b}", bar=bar, between=(a, b)))

    def position(self, point: str) -> tuple[float, float]:
        """Return the position (x, z) of a point or plate [m].

        Parameters
        ----------
        point : str
            Name of a point, or of a plate (its centre).

        Returns
        -------
        tuple of (float, float)
            x and z [m].

        Raises
        ------
        UnknownName
            No such point.
        """
        for p in self.point:
            if p.name == point:
                return p.x, p.z
        for plate in self.plate:
            if plate.name == point:
                x, z = self.position(plate.at)
                return x, z - plate.offset
        raise unknown_name("point", point, [p.name for p in self.point])

    def clamp_length(self, point: str) -> float:
        """Return the rigid half length at a point [m].

        The length is zero without a clamp.
        """
        return max((c.half_length for c in self.clamp if c.at == point), default=0.0)

    def point_mass(self, point: str) -> float:
        """Return the lumped mass at a point [kg].

        Masses, coils, clamps and the share of cables count.
        """
        lumped: list[Mass | Coil | Clamp] = [*self.mass, *self.coil, *self.clamp]
        lumps = sum(part.mass for part in lumped if part.at == point)
        return lumps + sum(cable.end_mass for cable in self.cable if cable.at == point)

    def variant_named(self, name: str) -> Variant:
        """Return a variant by name.

        Parameters
        ----------
        name : str
            Name of the variant.

        Raises
        ------
        UnknownName
            No such variant.
        """
        if name not in self.variant:
            raise unknown_name("variant", name, self.variant, where=f"structure {self.name!r}")
        return self.variant[name]
