"""Physical plant of a hanging structure: nested rigid links in MuJoCo.

The vertical bar is a tree of links rooted at its clamp (x right, y out of the plane, z up). Every link has the inertia
of its piece of bar and of the point masses. Cables are spatial tendons with the stiffness of their wire, prestretched
so that the drawing is the equilibrium. The tension in the bar, its growth with the weight below and its effect on the
motion are native in MuJoCo. The damping is prescribed mode by mode, see `vlab.plants.mode_by_mode`.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import mujoco
import numpy as np

from vlab.errors import BadStructure
from vlab.fe.one_mode import one_mode_bar
from vlab.fe.statics import HangingLine, cable_tensions, hanging_lines, vertical_stiffness
from vlab.plants.base import ActuatorTap, Plant, Port, named_sensors, sensor_taps, set_options, travel_name
from vlab.plants.chain import Chain, build_chain
from vlab.plants.element_ports import element_ports
from vlab.plants.mode_by_mode import with_prescribed
from vlab.signals import Array
from vlab.structure.model import Bar, Clamp, Section, Structure

UP, ALONG = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
"""UP,
ALONG: unit vectors of z (upwards) and x (to the right)."""
OUT = 1
"""Index of the out-of-plane axis y."""


@dataclass(frozen=True, kw_only=True)
class CompositeOptions:
    """Resolution of the composite plant.

    Parameters
    ----------
    links : int
        Number of hinges on the whole vertical bar.
    arm_links : int
        Number of hinges on each arm of a crosspiece.
    timestep : float
        Integration step [s].
    """

    links: int = 16
    arm_links: int = 4
    timestep: float = 5e-4


@dataclass(eq=False)
class _Builder:
    """Builder of the composite plant's spec."""

    structure: Structure
    variant: str
    options: CompositeOptions
    spec: Any = field(default_factory=mujoco.MjSpec)
    curves: dict[str, dict[str, float]] = field(default_factory=dict)
    slopes: dict[str, tuple[Array, dict[str, float]]] = field(default_factory=dict)
    hung_mass: float = 0.0

    def build(self) -> Any:
        """Return the spec of the undamped structure."""
        self.bar, self.line = self._vertical_bar()
        self.clamp = self._root_clamp()
        title = f"{self.structure.name} composite ({self.variant})"
        set_options(self.spec, title, gravity=self.structure.gravity)
        self.spec.option.timestep = self.options.timestep
        x, z = self.structure.position(self.clamp.at)
        self.root = self.spec.worldbody.add_body(name="clamp", pos=[x, 0.0, z])
        self.spec.worldbody.add_site(name="world")
        self.root.add_joint(name="clamp:y", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 1, 0])
        self.root.add_joint(name="clamp:z", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 0, 1])
        self.root.add_joint(name="clamp:rx", type=mujoco.mjtJoint.mjJNT_HINGE, axis=[1, 0, 0])
        self.root_curve: dict[str, float] = {}
        self.root_parts: list[tuple[float, Array, Array]] = []
        self._vertical_links()
        self._crosspiece()
        self._set_inertia(self.root, self.root_parts)
        self._site(self.root, self.clamp.at, np.zeros(3), self.root_curve)
        self._cables()
        self._transducers()
        return self.spec

    def _root_clamp(self) -> Clamp:
        for clamp in self.structure.clamp:
            if clamp.at in self.bar.points:
                return clamp
        raise BadStructure(f"the composite needs a clamp on the vertical bar {self.bar.name!r} to root its links at")

    def _vertical_bar(self) -> tuple[Bar, HangingLine]:
        lines = hanging_lines(self.structure)
        if len(lines) != 1:
            raise BadStructure(
                f"the composite is built on one vertical bar; structure {self.structure.name!r} has {len(lines)}"
            )
        line = next(iter(lines.values()))
        return next(b for b in self.structure.bar if b.name == line.bar), line

    def _vertical_links(self) -> None:
        section = self.structure.section[self.bar.section]
        heights = {p: self.structure.position(p)[1] for p in self.bar.points}
        root = heights[self.clamp.at]
        total = max(heights.values()) - min(heights.values())
        for sign in (1.0, -1.0):
            points = {p: sign * (z - root) for p, z in heights.items() if sign * (z - root) > 0}
            if not points:
                continue
            reach, edge = max(points.values()), self.clamp.half_length
            kinks = [d - edge for p, d in points.items() if d < reach and self._loads(p)]
            chain = build_chain(
                reach - edge,
                section.bending_stiffness,
                links=max(2, round(self.options.links * reach / total)),
                kinks=kinks,
                tension=self._tension_along(root, sign),
            )
            prefix = "beam+" if sign > 0 else "beam-"
            self._add_chain(prefix, sign * UP, ALONG, chain, edge, self.bar, points)
            bend = float(np.cross(ALONG, sign * UP)[OUT])
            self.root_curve[f"{prefix}1"] = bend * chain.reading(0.0)[0] / 2  # mean of the chains above and below

    def _tension_along(self, root: float, sign: float) -> Callable[[float], float]:
        """Return the tension against distance from the clamp's edge."""
        edge = self.clamp.half_length
        return lambda s: self.line.tension(root + sign * (edge + s))

    def _loads(self, point: str) -> bool:
        """Return whether a point mass or force acts at a point."""
        return self.structure.point_mass(point) > 0 or any(c.at == point for c in self.structure.coil)

    def _crosspiece(self) -> None:
        variant = self.structure.variant_named(self.variant)
        for bar in self.structure.bar:
            if bar.name == self.bar.name:
                continue
            if self.clamp.at not in bar.points:
                raise BadStructure(f"bar {bar.name!r} does not cross {self.bar.name!r} at a clamp")
            if bar.name == variant.one_mode_bar:
                self._spring_mass(bar)
            else:
                self._arms(bar)
        if not variant.in_plane_moments:
            self._weight_to_clamp()

    def _spring_mass(self, bar: Bar) -> None:
        """Model a bar by its first symmetric mode."""
        mode = one_mode_bar(self.structure, bar.name)
        body = self.root.add_body(name=bar.name)
        body.add_joint(name=f"{bar.name}:mode", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 1, 0]).stiffness[0] = (
            mode.stiffness
        )
        self._set_inertia(body, [(mode.mass, np.zeros(3), np.zeros(3))])
        self.root_parts.append((mode.total_mass - mode.mass, np.zeros(3), np.zeros(3)))

    def _arms(self, bar: Bar) -> None:
        section, edge = self.structure.section[bar.section], self.clamp.half_length
        x0 = self.structure.position(self.clamp.at)[0]
        for sign, side in ((1.0, "right"), (-1.0, "left")):
            points = {p: d for p in bar.points if (d := sign * (self.structure.position(p)[0] - x0)) > 0}
            reach = max(points.values())
            kinks = [d - edge for p, d in points.items() if d < reach and self._loads(p)]
            chain = build_chain(reach - edge, section.bending_stiffness, links=self.options.arm_links, kinks=kinks)
            self._add_chain(f"{bar.name}-{side}:", sign * ALONG, UP, chain, edge, bar, points)

    def _weight_to_clamp(self) -> None:
        """Transfer the weight of laterally clamped bodies to the clamp.

        The weight then acts on no deflection: the tension stays and the in-plane moment vanishes, as in a plane model.
        """
        moved = 0.0
        for body in self.spec.bodies:
            if body.name.startswith(tuple(b.name for b in self.structure.bar if b.name != self.bar.name)):
                body.gravcomp = 1.0
                moved += body.mass
        self.hung_mass = moved

    def _add_chain(
        self,
        name: str,
        along: Array,
        axis: Array,
        chain: Chain,
        edge: float,
        bar: Bar,
        points: dict[str, float],
    ) -> None:
        pieces = self._pieces(bar, points)
        middles = (chain.hinges[:-1] + chain.hinges[1:]) / 2  # a hinge bends as the bar does to half its neighbours
        borders = edge + np.concatenate([[0.0], middles, [chain.length]])
        bend = float(np.cross(axis, along)[OUT])  # slope along the chain per hinge angle
        joints = [f"{name}{i + 1}" for i in range(len(chain.hinges))]

        def curve(distance: float) -> dict[str, float]:
            return dict(zip(joints, bend * chain.reading(distance - edge), strict=True))

        starts = np.concatenate([[0.0], edge + chain.hinges])
        ends = np.concatenate([edge + chain.hinges, [edge + chain.length]])
        body, parts = self.root, self.root_parts
        for i, (start, end) in enumerate(zip(starts, ends, strict=True)):
            origin = 0.0 if i == 0 else start
            if i > 0:
                body = body.add_body(name=f"{name}{i}", pos=along * (start - (starts[i - 1] if i > 1 else 0.0)))
                joint = body.add_joint(name=f"{name}{i}", type=mujoco.mjtJoint.mjJNT_HINGE, axis=axis)
                joint.stiffness[0] = chain.stiffness[i - 1] * self._stiffened(bar, pieces, borders[i - 1], borders[i])
                parts = []
            mass = sum(
                section.mass_per_length * (min(end, high) - max(start, low))
                for low, high, section in pieces
                if low < end and start < high
            )
            inertia = mass * (end - start) ** 2 / 12 * (1.0 - np.abs(along))
            parts.append((mass, along * ((start + end) / 2 - origin), inertia))
            for point, distance in points.items():
                if start < distance <= end or (np.isclose(distance, end) and i == len(ends) - 1):
                    parts.append((self.structure.point_mass(point), along * (distance - origin), np.zeros(3)))
                    self._site(body, point, along * (distance - origin), curve(distance))
                    turned = bend * chain.turned(distance - edge)
                    self.slopes[point] = along, dict(zip(joints, turned, strict=True))
            if i > 0:
                self._set_inertia(body, parts)

    def _pieces(self, bar: Bar, points: dict[str, float]) -> list[tuple[float, float, Section]]:
        """Return where every section begins and ends, from the clamp on."""
        if all(span.bar != bar.name for span in self.structure.span):
            return [(0.0, np.inf, self.structure.section[bar.section])]
        stops = [(0.0, self.clamp.at), *sorted((distance, point) for point, distance in points.items())]
        return [(low, high, self.structure.section_between(bar, a, b)) for (low, a), (high, b) in pairwise(stops)]

    def _stiffened(self, bar: Bar, pieces: list[tuple[float, float, Section]], low: float, high: float) -> float:
        """Return the bending stiffness between two distances over that of the bar's section."""
        lengths = [max(min(high, end) - max(low, start), 0.0) for start, end, _ in pieces]
        if len(pieces) == 1 or not any(lengths):
            return 1.0
        bent = sum(own / section.bending_stiffness for own, (_, _, section) in zip(lengths, pieces, strict=True))
        return sum(lengths) / bent / self.structure.section[bar.section].bending_stiffness

    def _set_inertia(self, body: Any, parts: list[tuple[float, Array, Array]]) -> None:
        """Set a body's inertia from its pieces.

        Each piece has mass, position and own inertia about the axes.
        """
        if body is self.root:
            parts = [*parts, (self.structure.point_mass(self.clamp.at), np.zeros(3), np.zeros(3))]
        masses = np.array([m for m, _, _ in parts])
        positions = np.array([p for _, p, _ in parts])
        total = masses.sum()
        centre = masses @ positions / total
        arms = positions - centre
        inertia = sum(own for _, _, own in parts) + masses @ (np.sum(arms**2, axis=1)[:, None] - arms**2)
        floor = (
            1e-3 * inertia.max() if inertia.max() > 0 else 1e-9 * total
        )  # MuJoCo requires a positive inertia about every axis
        inertia = np.maximum(inertia, floor)
        inertia[OUT] = min(inertia[OUT], inertia[0] + inertia[2])  # a flat body within rounding
        body.explicitinertial = True
        body.mass, body.ipos, body.inertia = total, centre, inertia
        if body is self.root and self.hung_mass:
            body.gravcomp = -self.hung_mass / total

    def _site(self, body: Any, name: str, pos: Array, curve: dict[str, float]) -> None:
        """Add a site with its correction to the smooth curve.

        The correction is a length per hinge angle.
        """
        body.add_site(name=name, pos=pos)
        self.curves[name] = {joint: length for joint, length in curve.items() if length != 0.0}

    def _cables(self) -> None:
        tensions = cable_tensions(self.structure)
        for cable in self.structure.cable:
            x, z = self.structure.position(cable.at)
            pull = tensions[cable.name] / cable.count * cable.length / abs(cable.height)
            stiffness = vertical_stiffness(cable)
            for k in range(cable.count):
                fixing = f"{cable.name}:{k + 1}"
                side = cable.spread * (1 if k % 2 == 0 else -1)
                self.spec.worldbody.add_site(name=fixing, pos=[x + side, 0.0, z + cable.height])
                tendon = self.spec.add_tendon(name=fixing)
                tendon.stiffness[0] = stiffness
                tendon.springlength = [cable.length - pull / stiffness] * 2
                tendon.wrap_site(fixing)
                tendon.wrap_site(cable.at)

    def _transducers(self) -> None:
        for place in self.structure.transducer_places:
            tendon = self.spec.add_tendon(name=_curve(place))
            for joint, length in self.curves[place].items():
                tendon.wrap_joint(joint, length)
        for coil in self.structure.coil:  # all sites before all curves: each force appears twice in the controls
            at_site = self.spec.add_actuator(
                name=f"coil:{coil.name}", target=coil.at, refsite="world", trntype=mujoco.mjtTrn.mjTRN_SITE
            )
            at_site.gear = [0, 1, 0, 0, 0, 0]
        for coil in self.structure.coil:
            curve = _curve(f"coil:{coil.name}")
            self.spec.add_actuator(name=curve, target=_curve(coil.at), trntype=mujoco.mjtTrn.mjTRN_TENDON)
        for name, sensor in named_sensors(self.structure):
            self._sensor(
                name,
                "FRAMELINVEL" if sensor.kind == "velocity" else "FRAMEPOS",
                "TENDONVEL" if sensor.kind == "velocity" else "TENDONPOS",
                sensor.at,
            )
            if sensor.kind == "displacement":
                self._sensor(f"{name}:rate", "FRAMELINVEL", "TENDONVEL", sensor.at)

        for sensor in self.structure.sensor:  # last, so that their values are contiguous
            self.spec.add_sensor(
                name=travel_name(sensor),
                type=mujoco.mjtSensor.mjSENS_FRAMEPOS,
                objtype=mujoco.mjtObj.mjOBJ_SITE,
                objname=sensor.at,
            )

    def _sensor(self, name: str, site_kind: str, curve_kind: str, place: str) -> None:
        site, tendon = mujoco.mjtObj.mjOBJ_SITE, mujoco.mjtObj.mjOBJ_TENDON
        entries: list[tuple[str, Any, str, str]] = [
            (site_kind, site, place, name),
            (curve_kind, tendon, _curve(place), _curve(name)),
        ]
        for kind, objtype, target, full in entries:
            self.spec.add_sensor(
                name=full, type=getattr(mujoco.mjtSensor, f"mjSENS_{kind}"), objtype=objtype, objname=target
            )


def _curve(name: str) -> str:
    """Return the name of a place's curve correction."""
    return f"{name}:curve"


def build_composite(
    structure: Structure, variant: str = "published", *, options: CompositeOptions | None = None, damped: bool = True
) -> Plant:
    """Build the composite plant of a hanging structure.

    Parameters
    ----------
    structure : Structure
        Structure with its points, bars and transducers.
    variant : str
        ``"published"``: the crosspiece has one mode and its weight on the clamp. ``"physical"``: flexible arms with
        weight acting on their deflection.
    options : CompositeOptions or None
        Resolution.
    damped : bool
        Whether to prescribe the structure's modal damping.

    Returns
    -------
    Plant
        Plant at equilibrium.

    Raises
    ------
    BadStructure
        The structure is not one vertical bar with bars clamped across it.
    """
    builder = _Builder(structure, variant, options or CompositeOptions())
    spec = builder.build()
    model = spec.compile()
    one_mode = structure.variant_named(variant).one_mode_bar
    plant = Plant(
        name="composite",
        model=model,
        spec=spec,
        actuators=tuple(
            ActuatorTap(name=name, at=c.name, controls=(model.actuator(name).id, model.actuator(_curve(name)).id))
            for c in structure.coil
            for name in (f"coil:{c.name}",)
        ),
        sensors=sensor_taps(structure, lambda name: _addresses(model, name)),
        ports=_ports(model, structure, variant, builder.curves) | _element_ports(model, builder),
        travel=slice(model.sensor(travel_name(structure.sensor[0])).adr[0] + OUT, model.nsensordata, 3)
        if structure.sensor
        else slice(0, 0),
        left_out=(
            "cables carry a third of their mass at the end and have no modes of their own",
            "torsion of the vertical bar and roll inertia of the crosspiece",
            *(("the crosspiece has its first symmetric mode only",) if one_mode else ()),
        ),
    )
    return with_prescribed(plant, structure, variant, damped=damped)


def _addresses(model: Any, name: str) -> tuple[int, ...]:
    """Return the indices of a site's deflection and curve correction."""
    return int(model.sensor(name).adr[0]) + OUT, int(model.sensor(_curve(name)).adr[0])


def _ports(model: Any, structure: Structure, variant: str, curves: dict[str, dict[str, float]]) -> dict[str, Port]:
    ports = {name: _port(model, name, curve) for name, curve in curves.items()}
    one_mode = structure.variant_named(variant).one_mode_bar
    if one_mode:
        mode = one_mode_bar(structure, one_mode)
        root = ports[mode.root]
        dof = int(model.joint(f"{one_mode}:mode").dofadr[0])

        def row(data: Any, shape: float) -> Array:
            out = root.row(data)
            out[dof] += mode.tip_factor * shape
            return out

        bar = next(b for b in structure.bar if b.name == one_mode)
        for tip in (bar.points[0], bar.points[-1]):
            ports[tip] = Port(
                name=tip,
                unit="m",
                row=lambda data: row(data, 1.0),
                position=lambda data: root.position(data) + mode.tip_factor * float(data.qpos[dof]),
                is_constant=True,
            )
    return {p.name: ports[p.name] for p in structure.point}


def _element_ports(model: Any, builder: _Builder) -> dict[str, Port]:
    structure, variant, curves = builder.structure, builder.variant, builder.curves
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    points = {name: port.row(data) for name, port in _ports(model, structure, variant, curves).items()}

    def slope(point: str, along: tuple[float, float]) -> Array | None:
        if point not in curves:
            return None
        row = np.zeros(model.nv)
        row[model.joint("clamp:rx").dofadr[0]] = -along[1]
        chain, joints = builder.slopes.get(point, (ALONG, {}))
        for joint, turned in joints.items():
            row[model.joint(joint).dofadr[0]] = turned * np.sign(chain @ (along[0], 0.0, along[1]))
        return row

    return element_ports(structure, variant, points, slope)


def _port(model: Any, name: str, curve: dict[str, float]) -> Port:
    site = model.site(name).id
    dofs = np.array(
        [int(model.joint(joint).dofadr[0]) for joint in curve], dtype=int
    )  # hinge joints: as many positions as velocities
    entries = np.array([int(model.joint(joint).qposadr[0]) for joint in curve], dtype=int)
    lengths = np.array(list(curve.values()))

    def row(data: Any) -> Array:
        jacobian = np.zeros((3, model.nv))
        mujoco.mj_jacSite(model, data, jacobian, None, site)
        jacobian[OUT, dofs] += lengths
        return jacobian[OUT]

    return Port(
        name=name,
        unit="m",
        row=row,
        position=lambda data: float(data.site_xpos[site, OUT] + lengths @ data.qpos[entries]),
        is_constant=True,  # up to the square of the rotations, 1e-5 at one inch
    )
