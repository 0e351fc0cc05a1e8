"""The parts of a laboratory structure, in SI units.

A structure hangs in the x-z plane (x horizontal, z up) and is observed in its out-of-plane motion along y. Each part is
a frozen record; `Structure` checks that the parts refer to each other.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from vlab.errors import BadStructure, unknown_name
from vlab.files.toml import Provenance, number


@dataclass(frozen=True, kw_only=True)
class Section:
    """Cross-section of a bar; `width` lies in the plane of the structure, `thickness` along y.

    A rectangular section states width, thickness and density; one whose build-up is not known states its mass per
    length instead.

    Parameters
    ----------
    bending_stiffness : float
        EI of bending out of the plane [N m^2].
    torsion_stiffness : float
        GJ [N m^2]; zero where the model carries no torsion.
    shear_stiffness : float
        Shear stiffness of bending out of the plane, shear coefficient included [N]; zero for rigid in shear.
    mass_per_length : float
        [kg/m]; follows from the rectangle where not stated.
    polar_inertia_per_length : float
        Rotary inertia about the bar's axis [kg m]; follows from the rectangle where not stated.
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

    @property
    def in_plane_ratio(self) -> float:
        """EI_z/EA of bending in the plane, the square of the radius of gyration [m^2]: width^2/12 of a rectangle."""
        if self.width is None:
            raise BadStructure("a section without width has no in-plane stiffness; state width and thickness")
        return self.width**2 / 12

    @property
    def axial_stiffness(self) -> float:
        """EA [N], from the measured EI of the rectangle: 12 EI/thickness^2."""
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
        Whether it is held in the plane, so that other bars hang from it.
    """

    name: str
    section: str
    points: tuple[str, ...]
    carries: bool = False


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
    """A point mass, with the same rotary inertia about both axes in the plane [kg m^2]."""

    name: str
    at: str
    mass: float = number("kg", at_least=0.0)
    rotary_inertia: float = number("kg m^2", default=0.0, at_least=0.0)


@dataclass(frozen=True, kw_only=True)
class Support:
    """A bearing that holds some motions of a point: ``v`` along y, ``rx`` and ``rz`` about x and z."""

    name: str
    at: str
    holds: tuple[Literal["v", "rx", "rz"], ...]


@dataclass(frozen=True, kw_only=True)
class Plate:
    """A rigid plate that hangs from a bar's end and swings with the bar's rotation about x.

    Parameters
    ----------
    weight_moment : float
        Weight times the distance of its centre below the axis [N m]: a pendulous rotational stiffness.
    offset : float
        That distance [m].
    inertia_about_beam, inertia_about_vertical : float
        About the bar's axis and about the vertical [kg m^2].
    """

    name: str
    at: str
    weight_moment: float = number("N m", positive=True)
    offset: float = number("m", positive=True)
    inertia_about_beam: float = number("kg m^2", positive=True)
    inertia_about_vertical: float = number("kg m^2", positive=True)


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
class Tuning:
    """What a plant's first modes are made to be, of those that the coils drive.

    No mesh has every frequency to a part in a thousand, and light damping makes much of that; a coarse one turns shapes of modes
    that lie close together into each other.

    Parameters
    ----------
    frequencies : tuple of float
        Factors on the frequencies of the first modes, as a test of the structure itself gives them; the shapes stay.
    of_fe : int
        So many of the first modes of the physical plant have frequencies and shapes of the FE model, before these factors.
    at_step : float
        Integration step [s] in which they have these frequencies: steps of a length h raise one of omega by (omega h)^2/24, by more
        than its resonance is wide where that is light damping. 0 for the equations of motion themselves.
    beside : tuple of float
        How far along their bars the sensors stand beside their points [m], in channel order (coil sensors, then probes), as far as
        the modes of the FE model show it.
    """

    frequencies: tuple[float, ...] = number("1", positive=True, default=())
    of_fe: int = 0
    at_step: float = number("s", default=0.0, at_least=0.0)
    beside: tuple[float, ...] = number("m", default=())

    def __post_init__(self) -> None:
        if self.of_fe < 0:
            raise BadStructure(f"of_fe = {self.of_fe} is no number of modes; it must be 0 or more")
        if self.beside and not self.of_fe:
            raise BadStructure(
                "beside tells sensors' places in the FE model's modes; say with of_fe how many these are"
            )


@dataclass(frozen=True, kw_only=True)
class Reduction:
    """The coordinates that reduced models of the structure keep.

    Parameters
    ----------
    retained : tuple of str
        FE coordinates such as ``"v:joint1"`` or ``"rx:point13"``.
    source : str
        Where the choice comes from.
    exact : tuple of str
        Other coordinates for the exact reduction; empty for the same.
    exact_modes : tuple of int
        The modes that the exact reduction keeps, from 1; empty for the lowest.
    exact_source : str
        Where these choices come from.
    """

    retained: tuple[str, ...]
    source: str
    exact: tuple[str, ...] = ()
    exact_modes: tuple[int, ...] = ()
    exact_source: str = ""


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
    moment_boundary_factor : float
        Factor of the boundary term of their geometric stiffness; 0.5 is what a rigid rotation demands (semitangential
        end moments), 1 a plate strip.
    """

    note: str = ""
    elements_per_span: int = 1
    one_mode_bar: str = ""
    in_plane_moments: bool = False
    moment_boundary_factor: float = 0.5

    def __post_init__(self) -> None:
        if not 1 <= self.elements_per_span <= 200:
            raise BadStructure(f"elements_per_span is {self.elements_per_span}; accepted: 1 to 200")


ATTACHED = ("clamp", "cable", "mass", "support", "plate", "coil", "sensor", "probe")
"""The kinds of parts that sit at a point."""


@dataclass(frozen=True, kw_only=True)
class Structure:
    """Everything on the bench, checked for consistency.

    Parameters
    ----------
    exciter : str
        The coil that excites besides controlling, where an experiment names none.

    Raises
    ------
    BadStructure, UnknownName
        Parts that refer to nothing, repeat a name, or leave the tension of a hanging line open.
    """

    format: Literal["vlab-structure-1"]
    name: str
    title: str
    exciter: str
    gravity: float = number("m/s^2", at_least=0.0)
    section: dict[str, Section]
    point: tuple[Point, ...]
    bar: tuple[Bar, ...]
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
        for kind in ("point", "bar", *ATTACHED):
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
        for name, variant in self.variant.items():
            if variant.one_mode_bar and variant.one_mode_bar not in [b.name for b in self.bar]:
                raise unknown_name("bar", variant.one_mode_bar, [b.name for b in self.bar], where=f"variant {name!r}")
        if self.exciter not in [c.name for c in self.coil]:
            raise unknown_name("coil", self.exciter, [c.name for c in self.coil], where="exciter")
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
    def coil_places(self) -> list[str]:
        """The point of every coil, in their order."""
        return [coil.at for coil in self.coil]

    @property
    def transducer_places(self) -> list[str]:
        """Every point with a coil, a sensor or a probe, once."""
        places = self.coil_places + [s.at for s in (*self.sensor, *self.probe)]
        return list(dict.fromkeys(places))

    def position(self, point: str) -> tuple[float, float]:
        """Return (x, z) of a named point, or of the centre of a plate [m]."""
        for p in self.point:
            if p.name == point:
                return p.x, p.z
        for plate in self.plate:
            if plate.name == point:
                x, z = self.position(plate.at)
                return x, z - plate.offset
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
