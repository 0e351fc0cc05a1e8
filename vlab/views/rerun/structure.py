"""Structure in a Rerun scene: bending bars, deflecting points, coil forces."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from vlab.signals import Array, Recording
from vlab.structure.model import Cable, Structure
from vlab.views.figures import bar_curve
from vlab.views.rerun.frames import Motion
from vlab.views.rerun.rrd import BLUE, GREEN, GREY, LIGHT, ORANGE, PURPLE, extent_in_view, eye_view, send

SHOWN_SHARE = 0.2
"""SHOWN_SHARE [-]: approximate length of the largest deflection over the size of the structure."""
FORCE_SHARE = 0.2
"""FORCE_SHARE [-]: arrow length of the largest force over the size of the structure."""


def sensible_exaggeration(largest: float, size: float) -> float:
    """Return a factor that makes a deflection visible.

    Parameters
    ----------
    largest : float
        Largest deflection [m].
    size : float
        Size of the structure [m].

    Returns
    -------
    float
        Factor on the deflections [-].
    """
    if not largest > 0:
        return 1.0
    wanted = max(SHOWN_SHARE * size / largest, 1.0)
    decade = 10.0 ** np.floor(np.log10(wanted))
    return float(decade * max(m for m in (1.0, 2.0, 5.0) if m * decade <= wanted * (1 + 1e-9)))


class StructureScene:
    """Scene of the structure with its deflections.

    Parameters
    ----------
    motion : Motion
        Motion of its points.
    exaggeration : float or None
        Factor on the deflections [-]; a visible one by default.
    root : str
        Parent entity.
    colour : tuple or None
        Colour of all bars; different colours by default.
    """

    def __init__(
        self,
        structure: Structure,
        motion: Motion,
        exaggeration: float | None = None,
        *,
        root: str = "structure",
        colour: tuple[int, ...] | None = None,
    ) -> None:
        self.structure, self.motion, self.root, self.colour = structure, motion, root, colour
        self.names = list(motion.names)
        self.at = np.array([structure.position(name) for name in self.names])
        corners = np.array([structure.position(p.name) for p in structure.point])
        self.low, self.high = corners.min(axis=0), corners.max(axis=0)
        self.size = float(np.hypot(*(self.high - self.low)))
        self.factor = sensible_exaggeration(motion.largest, self.size) if exaggeration is None else float(exaggeration)
        self.y, self.indexes = motion.deflections * self.factor, motion.indexes

    def title(self) -> str:
        """Return the title of the view: structure and factor on the deflections."""
        factor = f"deflection × {self.factor:g}" if self.factor != 1 else "true deflection"
        return f"{self.structure.title}, {factor}"

    def log(self, stream: Any) -> None:
        """Log the structure and its motion."""
        stream.log(self.root, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        self._bars(stream)
        self._cables(stream)
        self._points(stream)

    def _path(self, *parts: str) -> str:
        return f"{self.root}{rr.new_entity_path(parts)}"

    def _bars(self, stream: Any) -> None:
        for k, bar in enumerate(self.structure.bar):
            points = [p for p in bar.points if p in self.names]
            if len(points) < 2:
                continue
            xz, matrix = bar_curve(self.structure, bar, points, count=8 * (len(points) - 1) + 1)
            width = self.structure.section[bar.section].width or 0.04 * self.size  # bar of unknown section
            rest = np.column_stack([xz[:, 0], np.zeros(len(xz)), xz[:, 1]])
            undeformed = rr.LineStrips3D([rest[[0, -1]]], colors=[GREY], radii=[0.1 * width])
            stream.log(self._path("undeformed", bar.name), undeformed, static=True)
            moving = np.repeat(rest[None].astype(np.float32), len(self.y), axis=0)
            moving[:, :, 1] = self.y[:, [self.names.index(p) for p in points]] @ matrix.T
            colour = self.colour or (BLUE, ORANGE, GREEN)[k % 3]
            look = rr.LineStrips3D.from_fields(colors=[colour], radii=[0.25 * width])
            send(stream, self._path("bars", bar.name), self.indexes, look, rr.LineStrips3D.columns(strips=moving))

    def _cables(self, stream: Any) -> None:
        thin = rr.LineStrips3D.from_fields(colors=[LIGHT], radii=[0.0012 * self.size])
        for cable in (c for c in self.structure.cable if c.at in self.names):
            moving = self.position(cable.at)
            for k, fixing in enumerate(self._fixings(cable)):
                strips = np.stack([moving, np.broadcast_to(fixing, moving.shape)], axis=1)
                name = f"{cable.name}:{k + 1}"
                send(stream, self._path("cables", name), self.indexes, thin, rr.LineStrips3D.columns(strips=strips))
                fixed = rr.Points3D([fixing], colors=[GREY], radii=[0.006 * self.size])
                stream.log(self._path("fixings", name), fixed, static=True)

    def _fixings(self, cable: Cable) -> NDArray[np.float32]:
        """Return the fixed ends of a group of cables, (n_cables, 3)."""
        x, z = self.structure.position(cable.at)
        sides = [cable.spread * (1 if k % 2 == 0 else -1) for k in range(cable.count)]
        return np.array([(x + side, 0.0, z + cable.height) for side in sides], dtype=np.float32).reshape(-1, 3)

    def _points(self, stream: Any) -> None:
        """Draw mounted parts, one labelled point per place."""
        things = self._things()
        for name, (_, colour, radius) in things.items():
            look = rr.Points3D.from_fields(colors=[colour], radii=[radius * self.size])
            send(
                stream,
                self._path("points", name),
                self.indexes,
                look,
                rr.Points3D.columns(positions=self.position(name)),
            )
        places, anchors = self._label_places(list(things))
        if len(places):
            words = [things[name][0] for name in things]
            labels = rr.Points3D(places, radii=[0.001 * self.size], colors=[LIGHT], labels=words, show_labels=True)
            stream.log(f"{self.root}/labels", labels, static=True)
            leaders = rr.LineStrips3D(np.stack([anchors, places], axis=1), colors=[GREY], radii=[0.0006 * self.size])
            stream.log(f"{self.root}/labels/leaders", leaders, static=True)

    def _label_places(self, names: list[str]) -> tuple[Array, Array]:
        """Return separate label places beside the structure, and their points."""
        anchors = np.array([(x, 0.0, z) for x, z in map(self.structure.position, names)]).reshape(-1, 3)
        middle, away, apart = (self.low[0] + self.high[0]) / 2, 0.27 * self.size, 0.075 * self.size
        left = anchors[:, 0] < middle - 1e-6 * self.size
        places = anchors + np.array([0.0, 0.0, 0.02 * self.size])
        places[:, 0] = np.where(left, self.low[0] - away, self.high[0] + away)
        for side in (left, ~left):
            last = -np.inf
            for k in sorted(np.flatnonzero(side).tolist(), key=lambda k: (anchors[k, 2], -anchors[k, 0])):
                places[k, 2] = last = max(places[k, 2], last + apart)
        return places, anchors

    def _things(self) -> dict[str, tuple[str, Any, float]]:
        out = {}
        for name in self.names:
            coil = any(c.at == name for c in self.structure.coil)
            sensors = [s.kind for s in self.structure.sensor if s.at == name]
            probes = [f"{s.kind} probe" for s in self.structure.probe if s.at == name]
            masses = [m.mass for m in self.structure.mass if m.at == name]
            words = [*(["coil"] if coil else []), *(f"{kind} sensor" for kind in sensors), *probes]
            if masses and not words:
                words = [f"{1000 * sum(masses):.0f} g"]
            if words:
                colour, radius = (GREEN, 0.011) if coil else (PURPLE, 0.009) if sensors or probes else (LIGHT, 0.012)
                out[name] = (f"{name}: {', '.join(words)}", colour, radius)
        return out

    def log_forces(self, stream: Any, recording: Recording, largest: Mapping[str, float]) -> None:
        """Log the force of every coil as an arrow along its axis.

        The largest force has the longest arrow.

        Parameters
        ----------
        stream : object
            Rerun stream.
        recording : Recording
            Recording of the run.
        largest : mapping
            Peak of every drawn force channel, by name.
        """
        coils = {c.name: c.at for c in self.structure.coil if c.at in self.names}
        scale = FORCE_SHARE * self.size / max(largest.values(), default=0.0) if any(largest.values()) else 0.0
        for channel in recording.channels:
            if channel.name in largest and channel.at in coils and scale:
                vectors = np.zeros((len(self.y), 3), dtype=np.float32)
                vectors[:, 1] = recording[channel.name][self.motion.steps] * scale
                columns = rr.Arrows3D.columns(vectors=vectors, origins=self.position(coils[channel.at]))
                look = rr.Arrows3D.from_fields(colors=[ORANGE], radii=[0.0035 * self.size])
                send(stream, self._path("forces", channel.at), self.indexes, look, columns)

    def position(self, point: str) -> NDArray[np.float32]:
        """Return the drawn position of a point over time, (n_frames, 3)."""
        k = self.names.index(point)
        out = np.zeros((len(self.y), 3), dtype=np.float32)
        out[:, 0], out[:, 1], out[:, 2] = self.at[k, 0], self.y[:, k], self.at[k, 1]
        return out

    def view(self, title: str | None = None, origin: str | None = None) -> Any:
        """Return the view of the structure, or of all entities under `origin`.

        Parameters
        ----------
        title : str or None
            Title of the view.
        origin : str or None
            Entity.

        Returns
        -------
        object
            View.
        """
        heights = [self.structure.position(c.at)[1] + c.height for c in self.structure.cable]
        bottom, top = min([self.low[1], *heights]), max([self.high[1], *heights])
        middle = np.array([(self.low[0] + self.high[0]) / 2, 0.0, (bottom + top) / 2])
        rest = [(x, 0.0, z) for x, z in (self.structure.position(p.name) for p in self.structure.point)]
        ends = [(y.min(initial=0.0), y.max(initial=0.0)) for y in self.y.T]
        swings = [(x, y, z) for (x, z), reached in zip(self.at, ends, strict=True) for y in reached]
        fixings = [place for cable in self.structure.cable for place in self._fixings(cable)]
        extent = max(top - bottom, extent_in_view(np.array([*rest, *swings, *fixings]), middle))
        return eye_view(
            self.title() if title is None else title, f"/{self.root}" if origin is None else origin, middle, extent
        )
