"""MuJoCo spec of a grillage: bodies at nodes, struts, fixed tendons, preload.

Every node of a hanging bar is a body with three slides and three hinges. Half of each neighbouring element's mass
belongs to the node. An element has four struts (spatial tendons) between sites on its two bodies. Two struts along the
bar carry stretch and in-plane bending; one in the plane and one across carry shear. The struts turn with the bodies, so
their weight load stiffens out-of-plane motion as in the real bar. Out-of-plane bending and twist carry no weight and
are springs between the hinges (fixed tendons). The nodes of the top beam slide along y and turn about x and z; fixed
tendons are its shear-flexible elements. Plates hang from the top beam as bodies.
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import mujoco
import numpy as np

from vlab.errors import BadStructure
from vlab.fe.mesh import Element, build_mesh
from vlab.plants.base import named_sensors, set_options, travel_name
from vlab.signals import Array
from vlab.structure.model import Bar, Section, Structure

IN_PLANE = ("x", "z", "ry")
"""Coordinates of motion in the plane."""
AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
"""Unit vector by axis."""
ACROSS = np.array(AXES["y"])
"""Unit vector across the plane."""

ARM = 0.254
"""ARM [m]: length of the struts across a bar. The length exceeds any motion, so the struts keep their direction."""

STRUT_INSET = 1 / 6
"""STRUT_INSET [1]: distance of a strut's end from the element's end, as a share of its length. The value makes tension
exact for a uniformly bent bar."""

LUMP_SHARE = 0.4
"""LUMP_SHARE [1]: share of the real second moment about its node that the lump of half an element keeps. Slender beams
have no such rotary inertia, but without it the time step would vanish. Softer shear in the beam and stiffer shear in
the bars compensate."""

SHEAR_FACTOR = 13.75
"""SHEAR_FACTOR [EI/L^3]: out-of-plane shear stiffness of a bar's element; 12 for a massless beam. Chosen with
LUMP_SHARE on the grid with two elements a span against the refined FE model. Tests validate the value on further
grids."""


@dataclass(frozen=True, kw_only=True)
class GrillageOptions:
    """Resolution and in-plane stiffness of the grillage.

    Parameters
    ----------
    elements_per_span : int
        Elements of a hanging bar between neighbouring points; at least two are needed.
    beam_element : float
        Longest element of the top beam [m]. Points without load are skipped up to this length.
    axial_share, in_plane_share : float
        Shares of EA and of the in-plane EI in the struts. The real values reduce the step and do not affect small
        out-of-plane motion. For motion beyond a few millimetres use `stiff`.
    timestep : float or None
        Integration step [s]. The default is the longest divisor of 0.5 ms with a margin of one fifth to the stability
        limit.
    """

    elements_per_span: int = 2
    beam_element: float = 0.6
    axial_share: float = 0.005
    in_plane_share: float = 0.05
    timestep: float | None = None

    def __post_init__(self) -> None:
        if self.elements_per_span < 2:
            raise BadStructure(f"elements_per_span is {self.elements_per_span}; the struts need at least 2")
        for name in ("beam_element", "axial_share", "in_plane_share"):
            if not getattr(self, name) > 0:
                raise BadStructure(f"{name} is {getattr(self, name)}; it must be positive")

    @classmethod
    def stiff(cls) -> "GrillageOptions":
        """Return options with the real in-plane stiffness.

        Such a plant needs nine times as many steps.
        """
        return cls(axial_share=1.0, in_plane_share=1.0)


@dataclass(frozen=True)
class _Strut:
    """Struts of one element with the stiffness of the real section."""

    names: tuple[str, ...]
    real: Array


@dataclass(eq=False)
class GrillageBuilder:
    """Builder of a grillage spec.

    The builder places bodies, struts, springs, lumps and transducers; `build` returns the spec.
    """

    structure: Structure
    options: GrillageOptions
    spec: Any = field(default_factory=mujoco.MjSpec)
    bodies: dict[str, Any] = field(default_factory=dict)
    places: dict[str, Array] = field(default_factory=dict)
    joints: set[str] = field(default_factory=set)
    parts: dict[str, list[tuple[float, Array, Array]]] = field(default_factory=lambda: defaultdict(list))
    readings: dict[str, dict[str, float]] = field(default_factory=dict)
    struts: list[_Strut] = field(default_factory=list)

    def build(self) -> Any:
        """Return the spec of the undamped structure at equilibrium."""
        self.carrier = self._carrier()
        set_options(self.spec, f"{self.structure.name} grillage", gravity=self.structure.gravity)
        self._beam()
        self._bars()
        self._lumps()
        for name, parts in self.parts.items():
            _set_inertia(self.bodies[name], parts)
        self._transducers()
        self._preload()
        return self.spec

    def _carrier(self) -> Bar:
        carriers = [bar for bar in self.structure.bar if bar.carries]
        if len(carriers) != 1 or len({self.structure.position(p)[1] for b in carriers for p in b.points}) != 1:
            raise BadStructure(
                f"a grillage hangs from one level bar that carries; structure {self.structure.name!r} has {len(carriers)}"
            )
        if self.structure.cable or self.structure.clamp:
            raise BadStructure(f"a grillage has no cables or clamps; structure {self.structure.name!r} does")
        for support in self.structure.support:
            if support.at not in carriers[0].points:
                raise BadStructure(f"support {support.name!r} is not on the bar that carries, {carriers[0].name!r}")
        return carriers[0]

    # -- the top beam ------------------------------------------------------------------------------------------------

    def _beam(self) -> None:
        bar = self.carrier
        nodes = self._beam_nodes()
        held = {m for s in self.structure.support if s.at in bar.points for m in (f"{s.at}:{h}" for h in s.holds)}
        for name in nodes:
            self._body(name, *self.structure.position(name))
            for motion, held_as in (("y", "v"), ("rx", "rx"), ("rz", "rz")):
                if f"{name}:{held_as}" not in held:
                    self._joint(name, motion)
            self.readings[name] = {f"{name}:y": 1.0} if f"{name}:v" not in held else {}
        x = {p: self.structure.position(p)[0] for p in bar.points}
        for a, b in pairwise(nodes):
            length, section = x[b] - x[a], self.structure.section_between(bar, a, b)
            forward = np.array([np.copysign(1.0, length), 0.0, 0.0])
            for node, towards in ((a, forward), (b, -forward)):
                self._half_element(node, section, abs(length), towards)
            self._beam_springs(a, b, section, length)
            for point in bar.points[bar.points.index(a) + 1 : bar.points.index(b)]:
                self.readings[point] = self._between(a, b, section, length, (x[point] - x[a]) / length)

    def _beam_nodes(self) -> list[str]:
        """Return the points of the top beam that become bodies.

        Loaded points become bodies, with enough points between.
        """
        s, points = self.structure, self.carrier.points
        kinds = (s.mass, s.support, s.plate, s.coil, s.sensor, s.probe)
        needed = {part.at for kind in kinds for part in kind} | {points[0], points[-1]}
        needed |= {p for bar in s.bar if bar is not self.carrier for p in bar.points}
        x = [abs(s.position(p)[0] - s.position(points[0])[0]) for p in points]
        nodes = [0]
        for i in range(1, len(points)):
            if points[i] in needed or x[i + 1] - x[nodes[-1]] > self.options.beam_element:
                nodes.append(i)
        return [points[i] for i in nodes]

    def _beam_springs(self, a: str, b: str, section: Section, length: float) -> None:
        """Add a shear-flexible beam element.

        The element has torsion, bending and shear. For long waves the lumps' rotary inertia lowers omega^2 by
        LUMP_SHARE (k L)^2/12. The shear flexibility L^3/(12 EI) + L/GA of the exact element is reduced by the same
        amount.
        """
        EI, reach = section.bending_stiffness, abs(length)
        self._spring(f"{a}-{b}:twist", section.torsion_stiffness / reach, {f"{b}:rx": 1.0, f"{a}:rx": -1.0})
        self._spring(f"{a}-{b}:bend", EI / reach, {f"{b}:rz": 1.0, f"{a}:rz": -1.0})
        turned = {f"{b}:y": 1.0, f"{a}:y": -1.0, f"{a}:rz": -length / 2, f"{b}:rz": -length / 2}
        self._spring(f"{a}-{b}:shear", 12 * EI / (reach**3 * (1 - LUMP_SHARE + _shear_ratio(section, length))), turned)

    def _spring(self, name: str, stiffness: float, coefficients: dict[str, float]) -> None:
        taken = {joint: c for joint, c in coefficients.items() if joint in self.joints and c != 0.0}
        if not taken or stiffness == 0.0:
            return
        tendon = self.spec.add_tendon(name=name)
        tendon.stiffness[0] = stiffness
        tendon.springlength = [0.0, 0.0]
        for joint, coefficient in taken.items():
            tendon.wrap_joint(joint, coefficient)

    def _between(self, a: str, b: str, section: Section, length: float, xi: float) -> dict[str, float]:
        """Return the deflection inside a beam element per end joint.

        The static shape includes shear; `xi` is the share of the length.
        """
        phi = _shear_ratio(section, length)
        rise = (3 * xi**2 - 2 * xi**3 + phi * xi) / (1 + phi)
        shear = phi / 2 * (xi - xi**2)
        row = {
            f"{a}:y": 1 - rise,
            f"{a}:rz": length * (xi - 2 * xi**2 + xi**3 + shear) / (1 + phi),
            f"{b}:y": rise,
            f"{b}:rz": length * (-(xi**2) + xi**3 - shear) / (1 + phi),
        }
        return {joint: value for joint, value in row.items() if joint in self.joints}

    # -- the hanging bars --------------------------------------------------------------------------------------------

    def _bars(self) -> None:
        spans = tuple(span for span in self.structure.span if span.bar != self.carrier.name)
        bars = tuple(b for b in self.structure.bar if b is not self.carrier)
        hanging = replace(self.structure, bar=bars, span=spans)
        choice = replace(next(iter(self.structure.variant.values())), elements_per_span=self.options.elements_per_span)
        mesh = build_mesh(hanging, replace(choice, one_mode_bar=""))
        names = []
        for node in mesh.nodes:
            if node.name in self.bodies:  # pinned to the top beam: free rotation in the plane, else the beam's
                name = f"{node.name}:pin"
                self.bodies[name] = self.bodies[node.name].add_body(name=name)
                self.places[name] = self.places[node.name]
                self._joint(name, "ry")
            else:
                name = node.name
                self._body(name, node.x, node.z)
                for motion in ("x", "y", "z", "rx", "ry", "rz"):
                    self._joint(name, motion)
                self.readings[name] = {f"{name}:y": 1.0}
            names.append(name)
        for i, element in enumerate(mesh.elements):
            tx, tz = mesh.direction(element)
            along = np.array([tx, 0.0, tz])
            a, b = names[element.start], names[element.end]
            self._half_element(a, element.section, element.length, along)
            self._half_element(b, element.section, element.length, -along)
            self._struts(f"{element.bar}/{i}", a, b, element, along, 1 if i % 2 else -1)

    def _struts(self, name: str, a: str, b: str, element: Element, along: Array, turn: int) -> None:
        """Join two bodies by an element's struts.

        The owner of the in-plane strut's arm (turn 1 or -1) alternates along a bar.
        """
        section, L = element.section, element.length
        normal = np.cross(ACROSS, along)
        EI, EA, EIz = (
            section.bending_stiffness,
            section.axial_stiffness,
            section.axial_stiffness * section.in_plane_ratio,
        )
        soft_EA, soft_EIz = EA * self.options.axial_share, EIz * self.options.in_plane_share
        names, apart = [], np.sqrt(soft_EIz / soft_EA) * np.array([1.0, -1.0])
        for k, y in enumerate(apart):
            ends = y * normal + STRUT_INSET * L * along, y * normal - STRUT_INSET * L * along
            names.append(self._strut(f"{name}:along{k + 1}", soft_EA / (2 * L), (a, ends[0]), (b, ends[1])))
        ends = L / 2 * along + (ARM * normal if turn > 0 else 0.0), -L / 2 * along + (ARM * normal if turn < 0 else 0.0)
        names.append(self._strut(f"{name}:in-plane", 12 * soft_EIz / L**3, (a, ends[0]), (b, ends[1])))
        ends = L / 2 * along - ARM / 2 * ACROSS, -L / 2 * along + ARM / 2 * ACROSS
        self._strut(f"{name}:across", SHEAR_FACTOR * EI / L**3, (a, ends[0]), (b, ends[1]))
        for kind, stiffness, axis in (("bend", EI, normal), ("twist", section.torsion_stiffness, along)):
            self._spring(f"{name}:{kind}", stiffness / L, _turn(b, axis) | _turn(a, -axis))
        to_strain = np.linalg.inv(np.column_stack([np.ones(2), apart]))  # stretch of both = strain + y bend
        real = np.zeros((3, 3))
        real[:2, :2] = to_strain.T @ np.diag([EA, EIz]) @ to_strain / L
        real[2, 2] = 12 * EIz / L**3
        self.struts.append(_Strut(tuple(names), real))

    def _strut(self, name: str, stiffness: float, *ends: tuple[str, Array]) -> str:
        tendon = self.spec.add_tendon(name=name)
        tendon.stiffness[0] = stiffness
        for (body, offset), letter in zip(ends, "ab", strict=True):
            self.bodies[body].add_site(name=f"{name}:{letter}", pos=offset)
            tendon.wrap_site(f"{name}:{letter}")
        length = np.linalg.norm(self.places[ends[0][0]] + ends[0][1] - self.places[ends[1][0]] - ends[1][1])
        tendon.springlength = [length, length]
        return name

    # -- masses ------------------------------------------------------------------------------------------------------

    def _body(self, name: str, x: float, z: float) -> None:
        self.places[name] = np.array([x, 0.0, z])
        self.bodies[name] = self.spec.worldbody.add_body(name=name, pos=self.places[name])

    def _joint(self, name: str, motion: str) -> None:
        kind = mujoco.mjtJoint.mjJNT_HINGE if motion[0] == "r" else mujoco.mjtJoint.mjJNT_SLIDE
        self.bodies[name].add_joint(name=f"{name}:{motion}", type=kind, axis=AXES[motion[-1]])
        self.joints.add(f"{name}:{motion}")

    def _half_element(self, node: str, section: Section, length: float, towards: Array) -> None:
        """Add half an element's mass to an end body.

        The lump has the roll inertia of the bar.
        """
        normal = np.cross(ACROSS, towards)
        lump = np.sqrt(LUMP_SHARE / 12) * length * towards
        roll = section.polar_inertia_per_length * length / 2
        own = sum(s * roll * np.outer(e, e) for s, e in ((1.0, towards), (0.1, normal), (0.91, ACROSS)))
        self.parts[node].append((section.mass_per_length * length / 2, lump, np.asarray(own)))

    def _lumps(self) -> None:
        """Add masses, coils and plates to their bodies."""
        s = self.structure
        for point in s.point:
            if mass := s.point_mass(point.name):
                rotary = sum(m.rotary_inertia for m in s.mass if m.at == point.name)
                self.parts[point.name].append((mass, np.zeros(3), rotary * np.eye(3)))
        for plate in s.plate:
            mass = plate.weight_moment / plate.offset / s.gravity if s.gravity else 0.0
            about_beam = plate.inertia_about_beam - mass * plate.offset**2
            if about_beam <= 0:
                raise BadStructure(
                    f"plate {plate.name!r}: its mass {mass:.4g} kg hanging {plate.offset:.4g} m below the beam alone has more "
                    f"than the inertia_about_beam of {plate.inertia_about_beam:.4g} kg m^2"
                )
            own = np.diag([about_beam, max(about_beam, plate.inertia_about_vertical), plate.inertia_about_vertical])
            self.parts[plate.at].append((mass, np.array([0.0, 0.0, -plate.offset]), own))

    # -- equilibrium -------------------------------------------------------------------------------------------------

    def _preload(self) -> None:
        """Prestretch the struts to carry the weight in the drawing.

        The real stiffness determines the share of each strut.
        """
        model = self.spec.compile()
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        inside = in_plane_mask([model.joint(j).name for j in range(model.njnt)])
        rows = [[model.tendon(name).id for name in strut.names] for strut in self.struts]
        jacobian = _tendon_jacobian(model, data)
        stiffness = np.zeros((model.nv, model.nv))
        for strut, ids in zip(self.struts, rows, strict=True):
            stiffness += jacobian[ids].T @ strut.real @ jacobian[ids]
        stiffness, sag = stiffness[np.ix_(inside, inside)], np.zeros(model.nv)
        if stiffness.size and np.linalg.cond(stiffness) > 1e14:
            raise BadStructure("the hanging bars are a mechanism in the plane; hang them from more points")
        sag[inside] = np.linalg.solve(stiffness, data.qfrc_bias[inside])
        for strut, ids in zip(self.struts, rows, strict=True):
            for name, pull in zip(strut.names, -strut.real @ (jacobian[ids] @ sag), strict=True):
                tendon = self.spec.tendon(name)
                tendon.springlength = [tendon.springlength[0] - pull / tendon.stiffness[0]] * 2

    # -- transducers -------------------------------------------------------------------------------------------------

    def _transducers(self) -> None:
        for plate in self.structure.plate:
            self.readings[plate.name] = {f"{plate.at}:rx": plate.offset}
        for place in self.structure.transducer_places:
            reading = self.readings.get(place, {})
            if not reading:
                raise BadStructure(f"a coil or sensor at {place!r} sees no motion: the point is held or on no bar")
            tendon = self.spec.add_tendon(name=f"at:{place}")
            for joint, coefficient in reading.items():
                tendon.wrap_joint(joint, coefficient)
        for coil in self.structure.coil:
            target, kind = f"at:{coil.at}", mujoco.mjtTrn.mjTRN_TENDON
            self.spec.add_actuator(name=f"coil:{coil.name}", target=target, trntype=kind)
        for name, sensor in named_sensors(self.structure):
            self._sensor(name, "TENDONVEL" if sensor.kind == "velocity" else "TENDONPOS", sensor.at)
            if sensor.kind == "displacement":
                self._sensor(f"{name}:rate", "TENDONVEL", sensor.at)
        for sensor in self.structure.sensor:  # last, so that their values are contiguous
            self._sensor(travel_name(sensor), "TENDONPOS", sensor.at)

    def _sensor(self, name: str, kind: str, place: str) -> None:
        kind_code, objtype = getattr(mujoco.mjtSensor, f"mjSENS_{kind}"), mujoco.mjtObj.mjOBJ_TENDON
        self.spec.add_sensor(name=name, type=kind_code, objtype=objtype, objname=f"at:{place}")


def _shear_ratio(section: Section, length: float) -> float:
    """Return Phi = 12 EI/(GA L^2), zero for rigid shear."""
    return 12 * section.bending_stiffness / (section.shear_stiffness * length**2) if section.shear_stiffness else 0.0


def _turn(body: str, axis: Array) -> dict[str, float]:
    """Return a body's rotation about an in-plane axis, per joint.

    A pin turns with the top beam.
    """
    node = body.removesuffix(":pin")
    return {f"{node}:rx": axis[0], f"{node}:rz": axis[2]}


def _set_inertia(body: Any, parts: list[tuple[float, Array, Array]]) -> None:
    """Set a body's inertia from its pieces.

    Each piece has mass, position and own inertia.
    """
    total = sum(m for m, _, _ in parts)
    centre = sum(m * p for m, p, _ in parts) / total
    inertia = sum(own + m * (np.dot(r, r) * np.eye(3) - np.outer(r, r)) for m, p, own in parts for r in (p - centre,))
    body.explicitinertial = True
    body.mass, body.ipos = total, centre
    body.fullinertia = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]


def _tendon_jacobian(model: Any, data: Any) -> Array:
    """Return the Jacobian of all tendon lengths, (n_tendons, nv)."""
    jacobian = np.zeros((model.ntendon, model.nv))
    for row, first, count in zip(jacobian, model.ten_J_rowadr, model.ten_J_rownnz, strict=True):
        entries = slice(first, first + count)
        row[model.ten_J_colind[entries]] = data.ten_J[entries]
    return jacobian


def in_plane_mask(joints: Sequence[str]) -> Array:
    """Return a mask of the joints that move in the plane."""
    return np.array([joint.rsplit(":", 1)[1] in IN_PLANE for joint in joints], dtype=bool)
