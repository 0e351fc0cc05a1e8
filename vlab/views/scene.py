"""Rerun scenes: an `.rrd` file that opens arranged, with the moving structure beside its traces.

Nothing is started and nothing is sent: the file is written and closed. Traces hold every sample; the picture moves at
the rate of the stored configurations. Timelines: ``sim_time`` [s] and ``step``, the number of the sample.
"""

import hashlib
import os
import re
import uuid
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray
from rerun.chunk import RrdReader

from vlab.errors import BadRecording, OutputRefused, unknown_name
from vlab.hardware.laboratory import Hardware
from vlab.lab.experiment import Result
from vlab.plants.base import Plant
from vlab.signals import Array, Channel, FrequencyResponse, Recording
from vlab.structure.model import Structure
from vlab.views.figures import (
    COLOURS,
    aligned,
    bar_curve,
    channel_label,
    frf_figure,
    pretty_unit,
    residual_percent,
    to_png,
)

APPLICATION = "vlab"
SHOWN_SHARE = 0.2
"""The largest deflection is drawn as about this share of the structure's size."""
FORCE_SHARE = 0.2
"""The largest force is drawn as an arrow of this share of the structure's size."""
PEAKS = rr.components.AggregationPolicy.MinMax
"""How the viewer thins a trace; its own default, the average, would hide the peaks."""
PICTURES = 4
"""Most pairs of output and input whose frequency response is drawn."""
LABELS = 12
"""Most bodies that are labelled by name."""
ROWS = 5
"""Channels on one page of a comparison."""
_BLUE, _ORANGE, _GREEN, _PURPLE = (tuple(int(c[i : i + 2], 16) for i in (1, 3, 5)) for c in COLOURS[:4])
_GREY, _LIGHT = (130, 130, 130), (225, 225, 225)
_KIND_ORDER = ("displacement", "velocity", "acceleration", "force", "command", "excitation")


# ---- a file -----------------------------------------------------------------------------------------------------------


@contextmanager
def _rrd(path: Path | str, name: str, blueprint: Any, identity: Any) -> Iterator[Any]:
    """Yield a recording stream whose file appears under its name only when everything is in it."""
    path = Path(path)
    part = path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}.part")
    try:
        part.touch(exist_ok=False)  # a folder that cannot be written shows here, before Rerun warns on its own
        # The same content gets the same identity, so that a viewer does not merge different runs; no wall clock goes in.
        stream = rr.RecordingStream(APPLICATION, recording_id=identity, send_properties=False)
        try:
            _save(stream, part, blueprint)
            stream.send_recording_name(name)
            yield stream
        finally:
            stream.disconnect()
        _check_whole(part)
        os.replace(part, path)
    except OSError as error:
        reason = getattr(error, "strerror", None) or str(error).splitlines()[0]
        raise OutputRefused(f"{path} cannot be written: {reason}; check the folder and its free space") from error
    finally:
        part.unlink(missing_ok=True)


def _save(stream: Any, part: Path, blueprint: Any) -> None:
    try:
        stream.save(part, default_blueprint=blueprint)
    except RuntimeError as error:  # what Rerun makes of a file that cannot be written
        raise OSError(str(error)) from error


def _check_whole(part: Path) -> None:
    """Refuse a file without its end: Rerun goes on in silence when the disk is full."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            RrdReader(part).recordings()
    except (RuntimeError, Warning) as error:
        raise OSError("the file came out incomplete") from error


def _identity(*recordings: Recording) -> uuid.UUID:
    content = hashlib.sha256()
    for recording in recordings:
        content.update(repr((recording.channels, dict(recording.meta))).encode())
        content.update(recording.time.tobytes() + recording.data.tobytes())
    return uuid.UUID(bytes=content.digest()[:16], version=4)


def _indexes(time: Array, steps: NDArray[np.int64]) -> list[Any]:
    return [rr.TimeColumn("sim_time", duration=time), rr.TimeColumn("step", sequence=steps)]


# ---- traces -----------------------------------------------------------------------------------------------------------


def _series(stream: Any, path: str, time: Array, values: Array, label: str, colour: Any, *, width: float = 1.5) -> None:
    stream.log(path, rr.SeriesLines(names=label, colors=[colour], widths=width, aggregation_policy=PEAKS), static=True)
    stream.send_columns(path, _indexes(time, np.arange(time.size, dtype=np.int64)), rr.Scalars.columns(scalars=values))


def _groups(recording: Recording) -> dict[tuple[str, str], list[Channel]]:
    """Return the channels by kind and unit, responses first."""
    known = {kind: i for i, kind in enumerate(_KIND_ORDER)}
    keys = sorted({(c.kind, c.unit) for c in recording.channels}, key=lambda key: (known.get(key[0], -1), key))
    return {key: [c for c in recording.channels if (c.kind, c.unit) == key] for key in keys}


def _log_traces(stream: Any, recording: Recording) -> None:
    for i, channels in enumerate(_groups(recording).values()):
        for k, channel in enumerate(channels):
            label = f"{channel_label(channel)} [{pretty_unit(channel.unit)}]"
            path = rr.new_entity_path(["traces", str(i), channel.name])
            _series(stream, path, recording.time, recording[channel.name], label, _rgb(k))


def _trace_views(recording: Recording) -> list[Any]:
    views = []
    for i, (kind, unit) in enumerate(_groups(recording)):
        views.append(_plot(f"{kind} [{pretty_unit(unit)}]", f"/traces/{i}"))
    return views


def _plot(name: str, origin: str, *, contents: Any = "$origin/**") -> Any:
    return rrb.TimeSeriesView(
        name=_plain(name),
        origin=origin,
        contents=contents,
        axis_x=rrb.TimeAxis(link=rrb.components.LinkAxis.LinkToGlobal),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop),
    )


def _rgb(index: int) -> tuple[int, ...]:
    colour = COLOURS[index % len(COLOURS)]
    return (120, 120, 120) if colour == "#000000" else tuple(int(colour[i : i + 2], 16) for i in (1, 3, 5))


# ---- the moving structure -------------------------------------------------------------------------------------------


def port_deflections(plant: Plant, frames: Array, names: Sequence[str]) -> Array:
    """Return the deflections (n_frames, n_names) [m] of ports from their equilibrium at stored configurations."""
    ports = [plant.port(name) for name in names]
    data = plant.new_data()
    mujoco.mj_forward(plant.model, data)
    rest = np.array([port.position(data) for port in ports])
    out = np.empty((len(frames), len(ports)))
    for row, _ in zip(out, _configurations(plant, data, frames), strict=True):
        row[:] = [port.position(data) for port in ports]
    return out - rest


def _configurations(plant: Plant, data: Any, frames: Array) -> Iterator[Array]:
    """Put `data` into one stored configuration after the other, as far as positions go."""
    model = plant.model
    if frames.ndim != 2 or frames.shape[1] != model.nq:
        raise BadRecording(
            f"stored configurations of shape {frames.shape} are not those of a plant with {model.nq} coordinates"
        )
    for configuration in frames:
        data.qpos[:] = configuration
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_tendon(model, data)
        yield configuration


def sensible_exaggeration(largest: float, size: float) -> float:
    """Return 1, 2 or 5 times a power of ten that makes a deflection visible beside a structure's size; at least 1."""
    if not largest > 0:
        return 1.0
    wanted = max(SHOWN_SHARE * size / largest, 1.0)
    decade = 10.0 ** np.floor(np.log10(wanted))
    return float(decade * max(m for m in (1.0, 2.0, 5.0) if m * decade <= wanted * (1 + 1e-9)))


class _Scene:
    """The structure with its deflections, ready to be logged."""

    def __init__(self, structure: Structure, plant: Plant, result: Result, exaggeration: float | None) -> None:
        self.structure, self.result = structure, result
        self.names = [p.name for p in structure.point if p.name in plant.ports]
        self.at = np.array([structure.position(name) for name in self.names])
        corners = np.array([structure.position(p.name) for p in structure.point])
        self.low, self.high = corners.min(axis=0), corners.max(axis=0)
        self.size = float(np.hypot(*(self.high - self.low)))
        deflections = port_deflections(plant, result.frames, self.names)
        largest = float(np.abs(deflections).max(initial=0.0))
        self.factor = sensible_exaggeration(largest, self.size) if exaggeration is None else float(exaggeration)
        self.largest, self.y = largest, deflections * self.factor
        self.steps, self.indexes = _frame_steps(result), _frame_indexes(result)

    def title(self) -> str:
        factor = f"deflection × {self.factor:g}" if self.factor != 1 else "true deflection"
        return f"{self.structure.title}, {factor}"

    def log(self, stream: Any) -> None:
        stream.log("structure", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        self._bars(stream)
        self._cables(stream)
        self._points(stream)
        self._forces(stream)

    def _bars(self, stream: Any) -> None:
        for k, bar in enumerate(self.structure.bar):
            points = [p for p in bar.points if p in self.names]
            if len(points) < 2:
                continue
            xz, matrix = bar_curve(self.structure, bar, points, count=8 * (len(points) - 1) + 1)
            width = self.structure.section[bar.section].width or 0.04 * self.size  # a bar whose build-up is not known
            rest = np.column_stack([xz[:, 0], np.zeros(len(xz)), xz[:, 1]])
            undeformed = rr.LineStrips3D([rest[[0, -1]]], colors=[_GREY], radii=[0.1 * width])
            stream.log(rr.new_entity_path(["structure", "undeformed", bar.name]), undeformed, static=True)
            moving = np.repeat(rest[None].astype(np.float32), len(self.y), axis=0)
            moving[:, :, 1] = self.y[:, [self.names.index(p) for p in points]] @ matrix.T
            path = rr.new_entity_path(["structure", "bars", bar.name])
            look = rr.LineStrips3D.from_fields(colors=[(_BLUE, _ORANGE, _GREEN)[k % 3]], radii=[0.25 * width])
            _send(stream, path, self.indexes, look, rr.LineStrips3D.columns(strips=moving))

    def _cables(self, stream: Any) -> None:
        thin = rr.LineStrips3D.from_fields(colors=[_LIGHT], radii=[0.0012 * self.size])
        for cable in (c for c in self.structure.cable if c.at in self.names):
            moving = self.position(cable.at)
            for k in range(cable.count):
                side = cable.spread * (1 if k % 2 == 0 else -1)
                x, z = self.structure.position(cable.at)
                fixing = np.array([x + side, 0.0, z + cable.height], dtype=np.float32)
                strips = np.stack([moving, np.broadcast_to(fixing, moving.shape)], axis=1)
                name = f"{cable.name}:{k + 1}"
                _send(
                    stream,
                    rr.new_entity_path(["structure", "cables", name]),
                    self.indexes,
                    thin,
                    rr.LineStrips3D.columns(strips=strips),
                )
                fixed = rr.Points3D([fixing], colors=[_GREY], radii=[0.006 * self.size])
                stream.log(rr.new_entity_path(["structure", "fixings", name]), fixed, static=True)

    def _points(self, stream: Any) -> None:
        """Draw what is mounted, one point a place, with its label at the side."""
        things = self._things()
        for name, (_, colour, radius) in things.items():
            look = rr.Points3D.from_fields(colors=[colour], radii=[radius * self.size])
            path = rr.new_entity_path(["structure", "points", name])
            _send(stream, path, self.indexes, look, rr.Points3D.columns(positions=self.position(name)))
        places, anchors = self._label_places(list(things))
        if len(places):
            words = [things[name][0] for name in things]
            labels = rr.Points3D(places, radii=[0.001 * self.size], colors=[_LIGHT], labels=words, show_labels=True)
            stream.log("structure/labels", labels, static=True)
            leaders = rr.LineStrips3D(np.stack([anchors, places], axis=1), colors=[_GREY], radii=[0.0006 * self.size])
            stream.log("structure/labels/leaders", leaders, static=True)

    def _label_places(self, names: list[str]) -> tuple[Array, Array]:
        """Return where labels stand beside the structure, none on another, and the points they belong to."""
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
                colour, radius = (_GREEN, 0.011) if coil else (_PURPLE, 0.009) if sensors or probes else (_LIGHT, 0.012)
                out[name] = (f"{name}: {', '.join(words)}", colour, radius)
        return out

    def _forces(self, stream: Any) -> None:
        """Draw the force of every coil as an arrow along its axis."""
        recording = self.result.recording
        coils = {c.name: c.at for c in self.structure.coil if c.at in self.names}
        found = [c for c in recording.channels if c.kind == "force" and c.at in coils]
        largest = max((float(np.abs(recording[c.name]).max()) for c in found), default=0.0)
        for channel in found if largest > 0 else []:
            vectors = np.zeros((len(self.y), 3), dtype=np.float32)
            vectors[:, 1] = recording[channel.name][self.steps] * FORCE_SHARE * self.size / largest
            columns = rr.Arrows3D.columns(vectors=vectors, origins=self.position(coils[channel.at]))
            look = rr.Arrows3D.from_fields(colors=[_ORANGE], radii=[0.0035 * self.size])
            _send(stream, rr.new_entity_path(["structure", "forces", channel.at]), self.indexes, look, columns)

    def position(self, point: str) -> NDArray[np.float32]:
        """Return where a point is drawn over time, (n_frames, 3)."""
        k = self.names.index(point)
        out = np.zeros((len(self.y), 3), dtype=np.float32)
        out[:, 0], out[:, 1], out[:, 2] = self.at[k, 0], self.y[:, k], self.at[k, 1]
        return out

    def view(self) -> Any:
        heights = [self.structure.position(c.at)[1] + c.height for c in self.structure.cable]
        bottom, top = min([self.low[1], *heights]), max([self.high[1], *heights])
        middle = np.array([(self.low[0] + self.high[0]) / 2, 0.0, (bottom + top) / 2])
        return _eye(self.title(), "/structure", middle, max(top - bottom, self.high[0] - self.low[0]))


class _Bodies:
    """The bodies of any model, ready to be logged."""

    def __init__(self, plant: Plant, result: Result) -> None:
        self.model, self.name = plant.model, _model_name(plant)
        self.indexes = _frame_indexes(result)
        n, model = len(result.frames), plant.model
        endless = {int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_HFIELD)}
        self.geoms = np.array([i for i in range(model.ngeom) if int(model.geom_type[i]) not in endless], dtype=int)
        box = model.geom_aabb.reshape(-1, 6)[self.geoms]
        halves = np.sort(box[:, 3:], axis=1)
        self.radii = np.sqrt(halves[:, 0] * halves[:, 1])  # of a rod of the same section
        reach = np.maximum(halves[:, 2] - self.radii, 1e-3 * halves[:, 2])
        along = np.eye(3)[np.argmax(box[:, 3:], axis=1)] * reach[:, None]
        ends = np.stack([box[:, :3] - along, box[:, :3] + along], axis=1)
        self.bodies = np.empty((n, model.nbody, 3), dtype=np.float32)
        self.centres, self.sites = np.empty_like(self.bodies), np.empty((n, model.nsite, 3), dtype=np.float32)
        self.rods = np.empty((n, len(self.geoms), 2, 3), dtype=np.float32)
        data = plant.new_data()
        for k, _ in enumerate(_configurations(plant, data, result.frames)):
            self.bodies[k], self.centres[k], self.sites[k] = data.xpos, data.xipos, data.site_xpos
            turn = data.geom_xmat[self.geoms].reshape(-1, 3, 3)
            self.rods[k] = data.geom_xpos[self.geoms][:, None] + np.einsum("gij,gej->gei", turn, ends)
        shown = np.concatenate([a.reshape(-1, 3) for a in (self.bodies[:, 1:], self.centres[:, 1:], self.rods)])
        self.low, self.high = shown.min(axis=0, initial=np.inf), shown.max(axis=0, initial=-np.inf)
        self.size = float(np.linalg.norm(self.high - self.low)) or 1.0

    def log(self, stream: Any) -> None:
        stream.log("bodies", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        parents = self.model.body_parentid
        inner = [b for b in range(1, self.model.nbody) if parents[b] > 0]
        links = np.stack([self.bodies[:, parents[inner]], self.bodies[:, inner]], axis=2)
        arms = np.stack([self.bodies[:, 1:], self.centres[:, 1:]], axis=2)
        self._lines(stream, "links", np.concatenate([links, arms], axis=1), _LIGHT, 0.003 * self.size)
        colours = (255 * self.model.geom_rgba[self.geoms]).astype(np.uint8)
        self._lines(stream, "geoms", self.rods, colours, self.radii)
        labels = [mujoco.mj_id2name(self.model, mujoco.mjtObj.mjOBJ_BODY, b) or "" for b in range(1, self.model.nbody)]
        self._dots(stream, "joints", self.bodies[:, 1:], _LIGHT, 0.008, labels if len(labels) <= LABELS else None)
        self._dots(stream, "sites", self.sites, _PURPLE, 0.005, None)

    def _lines(self, stream: Any, name: str, strips: NDArray[np.float32], colours: Any, radii: Any) -> None:
        n, count = strips.shape[:2]
        if count:
            look = rr.LineStrips3D.from_fields(colors=colours, radii=radii)
            columns = rr.LineStrips3D.columns(strips=strips.reshape(n * count, 2, 3)).partition([count] * n)
            _send(stream, f"bodies/{name}", self.indexes, look, columns)

    def _dots(
        self, stream: Any, name: str, positions: NDArray[np.float32], colour: Any, share: float, labels: Any
    ) -> None:
        n, count = positions.shape[:2]
        if count:
            look = rr.Points3D.from_fields(colors=[colour], radii=[share * self.size], labels=labels)
            columns = rr.Points3D.columns(positions=positions.reshape(-1, 3)).partition([count] * n)
            _send(stream, f"bodies/{name}", self.indexes, look, columns)

    def view(self) -> Any:
        return _eye(f"{self.name}, true motion", "/bodies", (self.low + self.high) / 2, self.size)


def _model_name(plant: Plant) -> str:
    return str(getattr(plant.spec, "modelname", "") or plant.name)


def _send(stream: Any, path: str, indexes: list[Any], look: Any, columns: Any) -> None:
    stream.log(path, look, static=True)
    stream.send_columns(path, indexes, columns)


def _frame_indexes(result: Result) -> list[Any]:
    return _indexes(result.frame_times, _frame_steps(result))


def _frame_steps(result: Result) -> NDArray[np.int64]:
    """Return the sample that each stored configuration belongs to."""
    steps = np.searchsorted(result.recording.time, result.frame_times - 1e-9)
    return np.asarray(np.clip(steps, 0, len(result.recording) - 1), dtype=np.int64)


def _eye(name: str, origin: str, middle: Array, extent: float) -> Any:
    """Return a view from the front right, where a deflection along y shows to the side."""
    position = middle + 1.13 * extent * np.array([0.72, -0.66, 0.16])
    eye = rrb.EyeControls3D(kind=rrb.Eye3DKind.Orbital, position=position, look_target=middle, eye_up=[0, 0, 1])
    return rrb.Spatial3DView(
        name=_plain(name),
        origin=origin,
        eye_controls=eye,
        line_grid=rrb.LineGrid3D(visible=False),
    )


# ---- documents --------------------------------------------------------------------------------------------------------


def _plain(words: object) -> str:
    """Return text on one line, without control characters."""
    return "".join(c if c.isprintable() else " " for c in str(words))


def _cell(words: object) -> str:
    """Return text that Markdown shows as it stands: no link, no image, no HTML."""
    return re.sub(r"([\\`*_{}\[\]()<>#+!|~$&])", r"\\\1", _plain(words))


def _facts(title: str, facts: Mapping[str, object]) -> str:
    lines = [f"- **{_cell(key)}**: {_cell(value)}" for key, value in facts.items() if str(value)]
    return "\n".join([f"## {_cell(title)}", "", *lines, ""])


def _levels(recording: Recording) -> str:
    lines = ["", "| channel | unit | rms | largest |", "|---|---|---|---|"]
    for channel in recording.channels:
        values = recording[channel.name]
        numbers = f"{np.sqrt(np.mean(values**2)):.3g} | {np.abs(values).max():.3g}"
        lines.append(f"| {_cell(channel.name)} | {_cell(pretty_unit(channel.unit))} | {numbers} |")
    return "\n".join(lines)


def _run_facts(plant: Plant, recording: Recording, law: str, hardware: Hardware | None) -> dict[str, object]:
    meta = recording.meta
    converter = hardware.converter if hardware is not None else None
    duration = recording.time[-1] - recording.time[0] + (recording.time[1] - recording.time[0])
    return {
        "plant": plant.name,
        "not in the plant": "; ".join(plant.left_out),
        "law": law or "none (open loop)",
        "seed": meta.get("seed", "not stated"),
        "rate": f"{meta.get('rate_hz', recording.rate):g} Hz",
        "delay": f"{converter.delay_samples:g} samples, then the hold" if converter else "not stated",
        "output filter": f"{converter.filter_corner:g} Hz" if converter and converter.filter_corner else "",
        "duration": f"{duration:.6g} s, {len(recording)} samples of {len(recording.channels)} channels",
        "step of the plant": f"{1000 * plant.timestep:g} ms",
    }


def _log_document(stream: Any, text: str) -> None:
    stream.log("facts", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)


def _pictures(measured: FrequencyResponse | None, analytical: FrequencyResponse | None) -> list[tuple[str, Any, bytes]]:
    """Return entity, view and image of the first pairs of output and input."""
    first = measured if measured is not None else analytical
    if first is None:
        return []
    pairs = [(output, into) for into in first.inputs for output in first.outputs][:PICTURES]
    out = []
    for k, (output, into) in enumerate(pairs):
        view = rrb.Spatial2DView(name=_plain(f"{output} from {into}"), origin=f"/frf/{k}", background=[255, 255, 255])
        out.append((f"frf/{k}", view, to_png(frf_figure(measured, analytical, output, into))))
    return out


def _arranged(scene: Any, traces: Sequence[Any], papers: Sequence[Any]) -> Any:
    """Arrange the moving picture, the traces and what is read, from left to right."""
    return _blueprint(rrb.Horizontal(scene, rrb.Vertical(*traces), rrb.Vertical(*papers), column_shares=[3, 4, 3]))


def _blueprint(views: Any) -> Any:
    return rrb.Blueprint(
        views,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline="sim_time", loop_mode="all", play_state="playing"),
    )


# ---- what the other rooms call -----------------------------------------------------------------------------------------


def write_run(
    path: Path | str,
    structure: Structure,
    plant: Plant,
    result: Result,
    *,
    frf: FrequencyResponse | None = None,
    analytical: FrequencyResponse | None = None,
    exaggeration: float | None = None,
    law: str = "",
    hardware: Hardware | None = None,
    facts: Mapping[str, object] | None = None,
) -> Path:
    """Write an experiment on a structure as a Rerun file that opens arranged.

    Parameters
    ----------
    path : path
        Of the ``.rrd`` file; it appears whole or not at all.
    frf, analytical : FrequencyResponse or None
        Drawn over each other, one image for each pair of output and input.
    exaggeration : float or None
        Factor on the deflections in the picture; by default one that shows them, stated in the title of the view.
    law : str
        The control law in words.
    hardware : Hardware or None
        Where the delay and the filter are read from.
    facts : mapping or None
        More lines of the document.

    Raises
    ------
    OutputRefused
        The file cannot be written.
    BadRecording
        The stored configurations are not those of this plant.
    """
    recording = result.recording
    scene = _Scene(structure, plant, result, exaggeration)
    about = {"structure": structure.title, **_run_facts(plant, recording, law, hardware)}
    about["picture"] = f"{scene.title()}; largest deflection {1000 * scene.largest:.3g} mm; arrows: forces of the coils"
    text = _facts(f"{structure.title}: {plant.name}", {**about, **(facts or {})}) + "\n" + _levels(recording)
    return _write(path, f"{structure.name} {plant.name}", scene, recording, text, (frf, analytical))


def write_bodies(
    path: Path | str,
    plant: Plant,
    result: Result,
    *,
    frf: FrequencyResponse | None = None,
    analytical: FrequencyResponse | None = None,
    law: str = "",
    hardware: Hardware | None = None,
    facts: Mapping[str, object] | None = None,
) -> Path:
    """Write an experiment on any MuJoCo model: bodies as points, lines from parent to child, geoms as their long axes.

    The parameters are those of `write_run`; nothing is exaggerated.
    """
    recording = result.recording
    scene = _Bodies(plant, result)
    about = {**_run_facts(plant, recording, law, hardware), "picture": "bodies, centres of mass and geoms, to scale"}
    text = _facts(_model_name(plant), {**about, **(facts or {})}) + "\n" + _levels(recording)
    return _write(path, _model_name(plant), scene, recording, text, (frf, analytical))


def _write(
    path: Path | str,
    name: str,
    scene: Any,
    recording: Recording,
    text: str,
    responses: tuple[FrequencyResponse | None, FrequencyResponse | None],
) -> Path:
    papers = [rrb.TextDocumentView(name="facts", origin="/facts")]
    pictures = _pictures(*responses)
    if pictures:
        papers.insert(0, rrb.Tabs(*(view for _, view, _ in pictures), name="frequency responses"))
    with _rrd(path, name, _arranged(scene.view(), _trace_views(recording), papers), _identity(recording)) as stream:
        scene.log(stream)
        _log_traces(stream, recording)
        for origin, _, image in pictures:
            stream.log(origin, rr.EncodedImage(contents=image, media_type="image/png"), static=True)
        _log_document(stream, text)
    return Path(path)


def write_comparison(
    path: Path | str,
    measured: Recording,
    simulated: Recording,
    *,
    channels: Sequence[str] | None = None,
    title: str = "measured beside simulated",
    facts: Mapping[str, object] | None = None,
) -> Path:
    """Write two recordings over each other with their difference, channel by channel, as a Rerun file.

    Parameters
    ----------
    channels : sequence of str or None
        Which; by default all that both recordings have.

    Raises
    ------
    BadRecording
        No overlap in time, or a channel with two units.
    OutputRefused
        The file cannot be written.
    """
    names = [n for n in measured.names if n in simulated.names] if channels is None else list(channels)
    if not names:
        raise unknown_name("common channel", ", ".join(measured.names), simulated.names)
    found = [(measured.channels[measured.index(name)], *aligned(measured, simulated, name)) for name in names]
    rows, lines = [], ["", "| channel | unit | rms measured | rms residual | residual |", "|---|---|---|---|---|"]
    for i, (channel, _, truth, model) in enumerate(found):
        label = f"{channel_label(channel)} [{pretty_unit(channel.unit)}]"
        over = _plot(label, f"/comparison/{i}", contents=["$origin/measured", "$origin/simulated"])
        rest = _plot(f"residual [{pretty_unit(channel.unit)}]", f"/comparison/{i}", contents=["$origin/residual"])
        rows.append(rrb.Horizontal(over, rest, column_shares=[3, 2], name=_plain(channel.name)))
        levels = f"{np.sqrt(np.mean(truth**2)):.3g} | {np.sqrt(np.mean((truth - model) ** 2)):.3g}"
        percent = f"{residual_percent(truth, model):.3g} %"
        lines.append(f"| {_cell(channel.name)} | {_cell(pretty_unit(channel.unit))} | {levels} | {percent} |")
    pages = [
        rrb.Vertical(*rows[i : i + ROWS], name=f"channels {i + 1} to {min(i + ROWS, len(rows))}")
        for i in range(0, len(rows), ROWS)
    ]
    document = rrb.TextDocumentView(name="facts", origin="/facts")
    blueprint = _blueprint(
        rrb.Horizontal(rrb.Tabs(*pages) if len(pages) > 1 else pages[0], document, column_shares=[3, 1])
    )
    with _rrd(path, title, blueprint, _identity(measured, simulated)) as stream:
        for i, (_, time, truth, model) in enumerate(found):
            curves = (("measured", truth, _BLUE), ("simulated", model, _ORANGE), ("residual", truth - model, _GREEN))
            for what, values, colour in curves:
                _series(stream, f"comparison/{i}/{what}", time, values, what, colour)
        _log_document(stream, _facts(title, facts or {}) + "\n" + "\n".join(lines))
    return Path(path)
