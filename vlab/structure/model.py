"""The parts of a laboratory structure, in SI units.

A structure hangs in the x-z plane (x horizontal, z up) and is observed in its out-of-plane motion along y. Each part is
a frozen record; `Structure` checks that the parts refer to each other.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from vlab.errors import BadStructure, unknown_name
from vlab.schema import Provenance, number


@dataclass(frozen=True, kw_only=True)
class Section:
    """Cross-section of a bar; `width` lies in the plane of the structure, `thickness` along y.

    Parameters
    ----------
    bending_stiffness : float
        EI of bending out of the plane [N m^2].
    torsion_stiffness : float
        GJ [N m^2]; zero where the model carries no torsion.
    """

    width: float = number("m", positive=True)
    thickness: float = number("m", positive=True)
    density: float = number("kg/m^3", positive=True)
    bending_stiffness: float = number("N m^2", positive=True)
    torsion_stiffness: float = number("N m^2", default=0.0, at_least=0.0)

    @property
    def mass_per_length(self) -> float:
        """Mass per unit length [kg/m]."""
        return self.density * self.width * self.thickness


@dataclass(frozen=True, kw_only=True)
class Point:
    """A named point of the drawing."""

    name: str
    x: float = number("m")
    z: float = number("m")
    label: str = ""


@dataclass(frozen=True, kw_only=True)
class Bar:
    """A straight bar through named points, in order."""

    name: str
    section: str
    points: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Clamp:
    """A rigid joint that stiffens every bar through `at` over `half_length` to each side."""

    name: str
    at: str
    half_length: float = number("m", at_least=0.0)
    mass: float = number("kg", at_least=0.0)


@dataclass(frozen=True, kw_only=True)
class Cable:
    """Cables in tension from a point to fixings above (height > 0) or below (height < 0).

    Parameters
    ----------
    height : float
        Vertical distance to the fixings [m], signed.
    spread : float
        Horizontal distance of each fixing from the vertical through the point [m], alternating in sign.
    count : int
        Number of cables.
    tension : float or None
        Vertical tension of all of them together [N]; exactly one cable of a hanging line states it, the others follow
        from equilibrium.
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
        """Mass that all cables of this set add at the point [kg]: one third of theirs, from the linear shape of a string."""
        return self.count * self.density * self.area * self.length / 3


@dataclass(frozen=True, kw_only=True)
class Mass:
    """A point mass."""

    name: str
    at: str
    mass: float = number("kg", at_least=0.0)


@dataclass(frozen=True, kw_only=True)
class Coil:
    """A force coil on the structure: a mass and a place where an actuator pushes along y."""

    name: str
    at: str
    mass: float = number("kg", at_least=0.0)


@dataclass(frozen=True, kw_only=True)
class Sensor:
    """A sensor of the motion along y at a place."""

    name: str
    at: str
    kind: Literal["velocity", "displacement"]


@dataclass(frozen=True, kw_only=True)
class Damping:
    """Inherent modal damping ratios: of the first modes, and of all above them."""

    ratios: tuple[float, ...] = number("1", at_least=0.0)
    higher: float = number("1", at_least=0.0)


@dataclass(frozen=True, kw_only=True)
class Variant:
    """How a model of the structure is discretised.

    Parameters
    ----------
    elements_per_span : int
        Beam elements between neighbouring points of a bar.
    one_mode_bar : str
        A bar that is carried by its first symmetric mode alone, with the deflection of its tips as the coordinate.
    in_plane_moments : bool
        Whether the in-plane bending moments of gravity act on the out-of-plane motion.
    """

    note: str = ""
    elements_per_span: int = 1
    one_mode_bar: str = ""
    in_plane_moments: bool = False

    def __post_init__(self) -> None:
        if not 1 <= self.elements_per_span <= 200:
            raise BadStructure(f"elements_per_span is {self.elements_per_span}; accepted: 1 to 200")


@dataclass(frozen=True, kw_only=True)
class Structure:
    """Everything on the bench, checked for consistency.

    Raises
    ------
    BadStructure, UnknownName
        Parts that refer to nothing, repeat a name, or leave the tension of a hanging line open.
    """

    format: Literal["vlab-structure-1"]
    name: str
    title: str
    gravity: float = number("m/s^2", at_least=0.0)
    section: dict[str, Section]
    point: tuple[Point, ...]
    bar: tuple[Bar, ...]
    clamp: tuple[Clamp, ...] = ()
    cable: tuple[Cable, ...] = ()
    mass: tuple[Mass, ...] = ()
    coil: tuple[Coil, ...] = ()
    sensor: tuple[Sensor, ...] = ()
    probe: tuple[Sensor, ...] = ()
    damping: Damping
    variant: dict[str, Variant]
    provenance: Mapping[str, Provenance] = field(default_factory=dict, init=False, compare=False)

    def __post_init__(self) -> None:
        points = [p.name for p in self.point]
        for kind in ("point", "bar", "clamp", "cable", "mass", "coil", "sensor", "probe"):
            names = [part.name for part in getattr(self, kind)]
            for name in names:
                if names.count(name) > 1:
                    raise BadStructure(
                        f"the {kind} name {name!r} stands {names.count(name)} times; names must be unique"
                    )
        for kind in ("clamp", "cable", "mass", "coil", "sensor", "probe"):
            for part in getattr(self, kind):
                if part.at not in points:
                    raise unknown_name("point", part.at, points, where=f"{kind} {part.name!r}")
        for bar in self.bar:
            if bar.section not in self.section:
                raise unknown_name("section", bar.section, self.section, where=f"bar {bar.name!r}")
            if len(bar.points) < 2:
                raise BadStructure(f"bar {bar.name!r} has {len(bar.points)} points; it needs at least 2")
            for name in bar.points:
                if name not in points:
                    raise unknown_name("point", name, points, where=f"bar {bar.name!r}")
            self._check_straight(bar)
        for name, variant in self.variant.items():
            if variant.one_mode_bar and variant.one_mode_bar not in [b.name for b in self.bar]:
                raise unknown_name("bar", variant.one_mode_bar, [b.name for b in self.bar], where=f"variant {name!r}")
        if not self.variant:
            raise BadStructure("no [variant.NAME] says how the structure is discretised")

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
    def transducer_places(self) -> list[str]:
        """Every point with a coil, a sensor or a probe, once."""
        places = [c.at for c in self.coil] + [s.at for s in (*self.sensor, *self.probe)]
        return list(dict.fromkeys(places))

    def position(self, point: str) -> tuple[float, float]:
        """Return (x, z) of a named point [m]."""
        for p in self.point:
            if p.name == point:
                return p.x, p.z
        raise unknown_name("point", point, [p.name for p in self.point])

    def clamp_length(self, point: str) -> float:
        """Return the half length over which bars through the point are rigid [m]; zero where there is no clamp."""
        return max((c.half_length for c in self.clamp if c.at == point), default=0.0)

    def point_mass(self, point: str) -> float:
        """Return the lumped mass at a point [kg]: masses, coils, clamps and the share of cables."""
        lumped: list[Mass | Coil | Clamp] = [*self.mass, *self.coil, *self.clamp]
        lumps = sum(part.mass for part in lumped if part.at == point)
        return lumps + sum(cable.end_mass for cable in self.cable if cable.at == point)

    def variant_named(self, name: str) -> Variant:
        """Return a variant, or raise `UnknownName` with the ones there are."""
        if name not in self.variant:
            raise unknown_name("variant", name, self.variant, where=f"structure {self.name!r}")
        return self.variant[name]
