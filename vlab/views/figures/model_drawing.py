"""Drawing of a MuJoCo model or structure at rest, with marked places."""

import contextlib
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, Polygon
from scipy.spatial import ConvexHull, QhullError

from vlab.plants.base import Plant
from vlab.signals import Array
from vlab.structure.model import Structure
from vlab.views.figures.style import COLOURS, GREY, INK, as_text, styled

LABELS = 16
"""LABELS [-]: number of joints above which only marked places have names."""
LARGEST = 8.0
"""LARGEST [-]: size of a fixed geom, over that of all moving ones, above which it is not drawn."""
MOST_TICKS = 8
"""MOST_TICKS [1]: largest number of intervals between ticks of the horizontal axis, fewer on a narrow drawing."""
_UP = np.array([0.0, 0.0, 1.0])
_ROUND = np.linspace(0, 2 * np.pi, 24, endpoint=False)
_BALL = np.array(
    [[np.cos(a) * np.cos(b), np.sin(a) * np.cos(b), np.sin(b)] for a in _ROUND for b in (-1.3, -0.6, 0, 0.6, 1.3)]
)


@styled
def model_figure(plant: Plant, marks: Sequence[tuple[str, float]], *, structure: Structure | None = None) -> Figure:
    """Draw a model at rest with marked places.

    Parameters
    ----------
    plant : Plant
        Plant.
    marks : sequence of (place, probability)
        Places; the first is filled, the others are rings.
    structure : Structure or None
        Structure of the plant, drawn instead of the bodies.

    Returns
    -------
    Figure
        Figure.
    """
    figure = Figure(figsize=(7.2, 4.2), layout="constrained")
    axes = figure.subplots()
    data = plant.new_data()
    seen = _View(plant, data) if structure is None else _View.of_structure(structure)
    if structure is None:
        _draw_bodies(axes, plant.model, data, seen)
    else:
        _draw_structure(axes, structure)
    named: dict[str, tuple[Array, str]] = {}
    for k, (place, share) in enumerate(marks):
        at, towards = place_position(plant, data, place, structure)
        colour, point = COLOURS[1], seen.flat(at)
        if towards is not None:
            _arrow(axes, seen, at, towards, colour)
        axes.plot(
            *point,
            "o",
            ms=13 if k == 0 else 11,
            mfc=colour if k == 0 else "none",
            mec=colour,
            mew=1.8,
            alpha=0.85,
            zorder=9,
        )
        named[place] = (point, f"{place} ({100 * share:.0f} %)")
    _names(axes, seen, plant, data, named, structure)
    letters = seen.letters
    axes.set(xlabel=f"{letters[0]} [m]", ylabel=f"{letters[1]} [m]", aspect="equal")
    axes.set_xlim(*_padded(seen.low[0], seen.high[0], seen.size))
    axes.set_ylim(*_padded(seen.low[1], seen.high[1], seen.size))
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    axes.locator_params(axis="x", nbins=max(2, min(MOST_TICKS, round(MOST_TICKS * (right - left) / (top - bottom)))))
    return figure


def _padded(low: float, high: float, size: float) -> tuple[float, float]:
    middle, half = (low + high) / 2, max((high - low) / 2 * 1.15, 0.35 * size)  # room for names
    return middle - half, middle + half


class _View:
    """Plane of the drawing: two axes and a box."""

    def __init__(self, plant: Plant, data: Any) -> None:
        model = plant.model
        points = [data.xpos[1:], data.xipos[1:], data.site_xpos, data.xanchor]
        points += [p for g, p in outlines(model, data) if model.geom_bodyid[g] > 0]
        cloud = np.concatenate([np.asarray(p).reshape(-1, 3) for p in points])
        span = np.ptp(cloud, axis=0)
        motion = np.zeros(3)
        for body in range(1, model.nbody):
            jacobian = np.zeros((3, model.nv))
            mujoco.mj_jacBodyCom(model, data, jacobian, None, body)
            motion += np.sqrt(np.sum(jacobian**2, axis=1))
        score = span / max(span.max(), 1e-12) + 0.5 * motion / max(motion.max(), 1e-12) + np.array([0.02, 0.0, 0.03])
        self.axes = sorted(np.argsort(-score)[:2])
        self._box(cloud[:, self.axes])

    @classmethod
    def of_structure(cls, structure: Structure) -> "_View":
        """Return the plane of a structure's drawing."""
        self = cls.__new__(cls)
        self.axes = [0, 2]
        self._box(np.array([structure.position(p.name) for p in structure.point]))
        return self

    def _box(self, flat: Array) -> None:
        self.low, self.high = flat.min(axis=0), flat.max(axis=0)
        self.size = max(float(np.max(self.high - self.low)), 1e-3)

    @property
    def letters(self) -> list[str]:
        return ["xyz"[i] for i in self.axes]

    def widen(self) -> None:
        """Update the size from the box."""
        self.size = max(float(np.max(self.high - self.low)), 1e-3)

    def flat(self, points: Array) -> Array:
        """Return points in the plane of the drawing."""
        return np.asarray(points)[..., self.axes]


def outlines(model: Any, data: Any) -> list[tuple[int, Array]]:
    """Return surface points of every finite geom.

    Parameters
    ----------
    model : object
        MuJoCo model.
    data : object
        MuJoCo data.

    Returns
    -------
    list of (int, array)
        Number and points of each geom, (n, 3) in the world [m].
    """
    types, out = mujoco.mjtGeom, []
    for i in range(model.ngeom):
        kind, size = int(model.geom_type[i]), model.geom_size[i]
        if kind in (types.mjGEOM_PLANE, types.mjGEOM_HFIELD):
            continue
        if kind == types.mjGEOM_SPHERE:
            local = size[0] * _BALL
        elif kind == types.mjGEOM_CAPSULE:
            local = np.concatenate([size[0] * _BALL + s * size[1] * _UP for s in (-1, 1)])
        elif kind == types.mjGEOM_CYLINDER:
            ring = size[0] * np.column_stack([np.cos(_ROUND), np.sin(_ROUND), 0 * _ROUND])
            local = np.concatenate([ring + s * size[1] * _UP for s in (-1, 1)])
        elif kind == types.mjGEOM_ELLIPSOID:
            local = size * _BALL
        else:
            box = model.geom_aabb[i]
            local = box[:3] + box[3:] * np.array([[a, b, c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)])
        out.append((i, data.geom_xpos[i] + local @ data.geom_xmat[i].reshape(3, 3).T))
    return out


def _draw_bodies(axes: Any, model: Any, data: Any, seen: _View) -> None:
    moving = seen.size
    for i, points in outlines(model, data):
        flat, is_fixed = seen.flat(points), model.geom_bodyid[i] == 0
        if is_fixed and np.ptp(flat, axis=0).max() > LARGEST * moving:
            continue
        with contextlib.suppress(QhullError):  # degenerate: all points on a line
            flat = flat[ConvexHull(flat).vertices]
        face = "#e4e4e4" if is_fixed else "#cfe3f1"
        axes.add_patch(
            Polygon(flat, closed=True, fc=face, ec=GREY if is_fixed else COLOURS[0], lw=0.8, alpha=0.8, zorder=1)
        )
        seen.low, seen.high = np.minimum(seen.low, flat.min(axis=0)), np.maximum(seen.high, flat.max(axis=0))
    seen.widen()
    for body in range(1, model.nbody):
        parent = model.body_parentid[body]
        if parent > 0:
            axes.plot(*seen.flat(np.array([data.xpos[parent], data.xpos[body]])).T, color=GREY, lw=0.8, zorder=2)
    for i in range(model.ntendon):
        axes.plot(*seen.flat(_tendon(model, data, i)).T, color=COLOURS[2], lw=1.2, linestyle=(0, (4, 1.5)), zorder=3)
    for j in range(model.njnt):
        point = seen.flat(data.xanchor[j])
        if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE:
            half = 0.05 * seen.size * seen.flat(data.xaxis[j])
            axes.add_patch(
                FancyArrowPatch(
                    tuple(point - half),
                    tuple(point + half),
                    arrowstyle="<->",
                    mutation_scale=9,
                    color=INK,
                    lw=0.9,
                    zorder=5,
                )
            )
        axes.plot(*point, "o", ms=4, mfc="white", mec=INK, zorder=6)


def _tendon(model: Any, data: Any, i: int) -> Array:
    """Return the path of a tendon."""
    first, count = int(model.tendon_adr[i]), int(model.tendon_num[i])
    if all(model.wrap_type[w] == mujoco.mjtWrap.mjWRAP_JOINT for w in range(first, first + count)):
        points = [data.xanchor[int(model.wrap_objid[w])] for w in range(first, first + count)]
        return np.array(points if len(points) > 1 else [points[0], points[0]])
    start, length = int(data.ten_wrapadr[i]), int(data.ten_wrapnum[i])
    return np.asarray(data.wrap_xpos.reshape(-1, 3)[start : start + length])


def _draw_structure(axes: Any, structure: Structure) -> None:
    for bar in structure.bar:
        points = np.array([structure.position(p) for p in bar.points])
        axes.plot(*points.T, color=COLOURS[0], lw=2.4, solid_capstyle="round", zorder=2)
    for clamp in structure.clamp:
        axes.plot(*structure.position(clamp.at), "s", ms=8, color=GREY, zorder=3)
    for point in structure.point:
        axes.plot(*structure.position(point.name), "o", ms=3.5, mfc="white", mec=INK, zorder=5)


def place_position(plant: Plant, data: Any, place: str, structure: Structure | None) -> tuple[Array, Array | None]:
    """Return position and direction of a place.

    Parameters
    ----------
    plant : Plant
        Plant.
    data : object
        MuJoCo data.
    place : str
        Name of the place.
    structure : Structure or None
        Structure of the plant, if it has one.

    Returns
    -------
    tuple
        Position [m], and direction or None.
    """
    kind, _, name = place.partition(":")
    name = name.partition("/")[0]
    if structure is not None:
        return _place_in_structure(plant, structure, place, name), None
    model = plant.model
    finders = {
        "joint": _at_joint,
        "tendon": _at_tendon,
        "body": _at_body,
        "site": _at_site,
        "actuator": _at_actuator,
        "sensor": _at_sensor,
    }
    try:
        if kind in finders:
            return finders[kind](model, data, name.split(".")[0])
    except KeyError:  # channel of a port: the sensor is at the port
        pass
    if kind == "sensor" and ":" in name:
        return place_position(plant, data, name, structure)
    return np.asarray(data.xipos[1:].mean(axis=0)), None


def _place_in_structure(plant: Plant, structure: Structure, place: str, name: str) -> Array:
    """Return the position of a structure's place."""
    points = {p.name for p in structure.point}
    parts: list[Any] = [*plant.actuators, *plant.sensors]
    at = {t.name.partition(":")[2] or t.name: t.at for t in parts}
    parts = [*structure.coil, *structure.sensor, *structure.probe, *structure.clamp, *structure.cable, *structure.plate]
    at.update({part.name: part.at for part in parts if part.name != part.at})

    def known(text: str) -> list[str]:
        found = at.get(at.get(text, text), at.get(text, text))
        return [n for n in (found, f"joint{found}", f"point{found}") if n in points][:1]

    found = known(place) or known(name)
    text = name or place
    for cut in [i for i, c in enumerate(text) if c == "-"] if not found else []:
        ends = [*known(text[:cut]), *known(text[cut + 1 :])]
        bar = next((b for b in structure.bar if b.name == text[:cut]), None)
        if bar is not None:  # arm of a bar, from its end to the next point
            ends = [n for n in bar.points if n.endswith(text[cut:])][:1]
            ends += [bar.points[1 if ends[0] == bar.points[0] else -2]] if ends else []
        found = ends if len(ends) == 2 else found
    if not found:
        bars = [b for b in structure.bar if b.name == text] or [b for b in structure.bar if b.carries] or structure.bar
        found = [n for b in bars for n in b.points]
    x, z = np.array([structure.position(n) for n in found]).mean(axis=0)
    return np.array([x, 0.0, z])


def _at_joint(model: Any, data: Any, name: str) -> tuple[Array, Array | None]:
    return data.xanchor[model.joint(name).id], None


def _at_tendon(model: Any, data: Any, name: str) -> tuple[Array, Array | None]:
    return _tendon(model, data, model.tendon(name).id).mean(axis=0), None


def _at_body(model: Any, data: Any, name: str) -> tuple[Array, Array | None]:
    return data.xipos[model.body(name).id], None


def _at_site(model: Any, data: Any, name: str) -> tuple[Array, Array | None]:
    return data.site_xpos[model.site(name).id], None


def _at_actuator(model: Any, data: Any, name: str) -> tuple[Array, Array | None]:
    i = model.actuator(name).id
    target = int(model.actuator_trnid[i, 0])
    kind = int(model.actuator_trntype[i])
    if kind in (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT):
        return data.xanchor[target], data.xaxis[target]
    if kind == mujoco.mjtTrn.mjTRN_TENDON:
        path = _tendon(model, data, target)
        return path.mean(axis=0), path[-1] - path[0]
    if kind == mujoco.mjtTrn.mjTRN_SITE:
        return data.site_xpos[target], data.site_xmat[target].reshape(3, 3) @ model.actuator_gear[i, :3]
    return data.xipos[min(max(target, 0), model.nbody - 1)], None


def _at_sensor(model: Any, data: Any, name: str) -> tuple[Array, Array | None]:
    i = model.sensor(name).id
    target, kind = int(model.sensor_objid[i]), int(model.sensor_objtype[i])
    if kind == mujoco.mjtObj.mjOBJ_JOINT:
        return data.xanchor[target], data.xaxis[target]
    if kind == mujoco.mjtObj.mjOBJ_SITE:
        return data.site_xpos[target], None
    if kind == mujoco.mjtObj.mjOBJ_TENDON:
        path = _tendon(model, data, target)
        return path.mean(axis=0), path[-1] - path[0]
    if kind == mujoco.mjtObj.mjOBJ_ACTUATOR:
        return _at_actuator(model, data, model.actuator(target).name)
    return data.xipos[min(max(target, 0), model.nbody - 1)], None


def _arrow(axes: Any, seen: _View, at: Array, towards: Array, colour: str) -> None:
    flat = seen.flat(towards)
    length = float(np.linalg.norm(flat))
    step = flat / length if length > 1e-9 else np.array([0.0, 1.0])
    point = seen.flat(at)
    patch = FancyArrowPatch(
        tuple(point),
        tuple(point + 0.17 * seen.size * step),
        arrowstyle="-|>",
        mutation_scale=16,
        color=colour,
        lw=2.2,
        zorder=8,
    )
    axes.add_patch(patch)


def _names(
    axes: Any, seen: _View, plant: Plant, data: Any, marked: dict[str, tuple[Array, str]], structure: Structure | None
) -> None:
    """Name the marked places, and others if they fit."""
    labels: dict[tuple[float, ...], list[str]] = {}
    for point, text in marked.values():
        labels.setdefault(_key(point, seen), []).append(text)
    bold = set(labels)
    others = [(p.name, np.array([structure.position(p.name)[0], 0.0, structure.position(p.name)[1]])) for p in structure.point] if structure else [
        (f"joint:{plant.model.joint(j).name}", data.xanchor[j]) for j in range(plant.model.njnt) if plant.model.joint(j).name
    ]  # fmt: skip
    for name, at in others if len(others) <= LABELS else []:
        key = _key(seen.flat(at), seen)
        if name not in marked and key not in bold:
            labels.setdefault(key, []).append(name)
    is_tall = (seen.high - seen.low)[1] > 1.2 * (seen.high - seen.low)[0]
    for k, (key, texts) in enumerate(labels.items()):
        is_marked, text = key in bold, as_text("\n".join(texts[:6]))
        if is_marked:
            offset, place = (
                ((30, 16), ("left", "center")) if is_tall else ((0, 20 + 15 * (k % 3)), ("center", "bottom"))
            )
            axes.annotate(
                text, key, offset, textcoords="offset points", ha=place[0], va=place[1], fontsize=9, color=COLOURS[1], weight="bold",
                zorder=10, arrowprops={"arrowstyle": "-", "color": COLOURS[1], "lw": 0.8, "shrinkB": 7},
                bbox={"fc": "white", "ec": "none", "alpha": 0.75, "pad": 0.6},
            )  # fmt: skip
        else:
            offset, place = ((-9, 0), ("right", "center")) if is_tall else ((0, -12 - 9 * (k % 2)), ("center", "top"))
            axes.annotate(
                text,
                key,
                offset,
                textcoords="offset points",
                ha=place[0],
                va=place[1],
                fontsize=7,
                color="#555555",
                zorder=9,
            )


def _key(point: Array, seen: _View) -> tuple[float, ...]:
    step = 0.02 * seen.size
    return tuple(float(v) for v in np.round(np.asarray(point) / step) * step)
