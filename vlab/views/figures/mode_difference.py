"""Figure of one mode of two models, with their difference."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from vlab.errors import BadRecording
from vlab.modal.mac import match_modes
from vlab.signals import Array, ModalModel
from vlab.structure.model import Structure
from vlab.views.figures.modes import at_points, bar_curve
from vlab.views.figures.style import COLOURS, GREY, INK, MARKERS, as_text, styled


@styled
def mode_difference_figure(
    structure: Structure,
    left: ModalModel,
    right: ModalModel,
    mode: int,
    *,
    labels: tuple[str, str] = ("experimental", "analytical"),
) -> Figure:
    """Draw one mode of two models and their difference.

    The figures are those of the dissertation. Axonometric drawings show the left model below on the left, the right
    model below on the right, and left minus right above. Both shapes have a unit largest deflection over their common
    points, and the closest signs.

    Parameters
    ----------
    structure : Structure
        Structure.
    left, right : ModalModel
        Shapes at points of the structure; the left model is paired with the right by MAC.
    mode : int
        Number of the mode in `right`, from 1 as printed.
    labels : (str, str)
        Names of the left and the right model.

    Returns
    -------
    Figure
        Figure.
    """
    pair = _paired_mode(at_points(structure, left), at_points(structure, right), mode)
    difference = pair.left - pair.right
    worst = int(np.abs(difference).argmax())
    titles = (
        f"{_cut(labels[0])}\nmode {pair.column + 1}, {left.freq[pair.column]:.3f} Hz",
        f"{_cut(labels[1])}\nmode {mode}, {right.freq[mode - 1]:.3f} Hz",
        f"difference, left minus right\nlargest {abs(difference[worst]):.3f}"
        + (f" at {_cut(pair.names[worst], 16)}" if difference[worst] else "")
        + f", MAC {pair.mac:.4f}",
    )
    drawing = _Axonometry(structure)
    panels = [drawing.lines(pair.names, shape) for shape in (pair.left, pair.right, difference)]
    drawn = [drawing.project(drawing.at, y) for y in (-0.5, 0.0, 0.5)] + [l for lines in panels for l in lines.curves]
    sheet = _Sheet(*(np.concatenate([line[k] for line in drawn]) for k in (0, 1)))
    for k, (lines, title, place) in enumerate(zip(panels, titles, sheet.places, strict=True)):
        axes = sheet.panel(*place, sheet.wide, sheet.high)
        drawing.draw(axes, lines, COLOURS[(1, 0, 2)[k]], MARKERS[(0, 1, 2)[k]])
        axes.set_title(as_text(title), pad=3.0)
        axes.set(xlim=sheet.box[:2], ylim=sheet.box[2:])
    sheet.draw_key(drawing)
    figure, height = sheet.figure, sheet.height
    heading = f"{_cut(structure.title or structure.name, 60)}, mode {mode}"
    figure.text(0.5, 1 - 0.07 / height, as_text(heading), ha="center", va="top", fontsize=10, weight="bold")
    note = "one scale for all panels; deflection y relative to the largest of each shape [-]; undeformed: grey, dashed"
    figure.text(0.5, 0.08 / height, note, ha="center", va="bottom", fontsize=8)
    return figure


class _PairedMode(NamedTuple):
    """One mode of two models, with shapes of unit largest deflection."""

    column: int
    names: Sequence[str]
    left: Array
    right: Array
    mac: float


def _paired_mode(left: ModalModel, right: ModalModel, mode: int) -> _PairedMode:
    """Return a mode of the right model with its partner."""
    count = right.freq.size
    if not 1 <= mode <= count:
        raise BadRecording(f"there is no mode {mode} on the right; it has the modes 1 to {count}")
    pairing = match_modes(left, right)
    partner = dict(zip(pairing.b.tolist(), range(len(pairing.b)), strict=True)).get(mode - 1)
    if partner is None:
        raise BadRecording(f"mode {mode} on the right has no partner among the {left.freq.size} modes on the left")
    column, names = int(pairing.a[partner]), pairing.coordinates
    b = _unit_maximum(np.array([right.shapes[right.coordinates.index(n), mode - 1] for n in names]))
    a = _unit_maximum(np.array([left.shapes[left.coordinates.index(n), column] for n in names]))
    return _PairedMode(column, names, -a if a @ b < 0 else a, b, float(pairing.mac[partner]))


class _Sheet:
    """Figure of three equal panels: two below, one above.

    Parameters
    ----------
    across, up : (n,) array
        Everything that one panel shows [m on paper].
    """

    HEAD, CAPTION, GAP = 0.42, 0.30, 0.12
    """HEAD, CAPTION, GAP [inch]: height of a panel's title and of a line of text, and distance of panels."""

    def __init__(self, across: Array, up: Array) -> None:
        margin = 0.03 * max(np.ptp(across), np.ptp(up))
        self.box = (across.min() - margin, across.max() + margin, up.min() - margin, up.max() + margin)
        across_m, up_m = self.box[1] - self.box[0], self.box[3] - self.box[2]
        self.inch = min(3.5 / across_m, 3.3 / up_m)  # inches per metre on paper, equal in every panel
        self.wide, self.high = self.inch * across_m, self.inch * up_m
        self.width = max(2 * self.wide + self.GAP, self.wide + 4.0, 7.2)
        self.height = 2 * (self.high + self.HEAD) + 2 * self.CAPTION + self.GAP
        self.figure = Figure(figsize=(self.width, self.height))

    @property
    def places(self) -> tuple[tuple[float, float], ...]:
        """Lower left corners of the panels [inch]: left, right, above."""
        lower, quarter = self.CAPTION, (self.width - 2 * self.wide) / 4
        upper = lower + self.high + self.HEAD + self.GAP
        return (quarter, lower), (self.width - quarter - self.wide, lower), ((self.width - self.wide) / 2, upper)

    def panel(self, x: float, y: float, wide: float, high: float) -> Any:
        """Return empty axes at a place of a size [inch]."""
        width, height = self.width, self.height
        axes = self.figure.add_axes((x / width, y / height, wide / width, high / height))
        axes.set_axis_off()
        return axes

    def draw_key(self, drawing: "_Axonometry") -> None:
        """Draw the directions with their scales beside the upper panel."""
        inch = self.inch
        key = self.panel(0.1, self.places[2][1] + self.high - 1.05, 1.6, 1.4)
        key.set(xlim=(-0.45 / inch, 1.15 / inch), ylim=(-0.45 / inch, 0.95 / inch))
        drawing.draw_key(key, inch)


@dataclass(frozen=True)
class _Lines:
    """Lines of one drawn shape."""

    curves: list[tuple[Array, Array]]
    ties: list[tuple[Array, Array]]


class _Axonometry:
    """Axonometric view of a structure.

    Deflections cross level, upright and diagonal bars at a wide angle.
    """

    X = np.array([np.cos(np.radians(-12.0)), np.sin(np.radians(-12.0))]) * 0.9
    Y = np.array([np.cos(np.radians(35.0)), np.sin(np.radians(35.0))])
    Z = np.array([0.0, 1.0])
    SHARE = 0.12
    """SHARE [-]: length of the largest deflection over the size of the structure."""

    def __init__(self, structure: Structure) -> None:
        self.structure = structure
        self.at = np.array([structure.position(p.name) for p in structure.point])
        self.size = float(np.hypot(*np.ptp(self.at, axis=0))) or 1.0
        ends = [np.array([structure.position(name) for name in bar.points]) for bar in structure.bar]
        self.bars = [self.project(points, 0.0) for points in ends]

    def project(self, xz: Array, y: Any) -> tuple[Array, Array]:
        """Return positions on paper of deflected points [m]."""
        offset = np.broadcast_to(np.asarray(y, dtype=float) * self.SHARE * self.size, len(xz))
        paper = xz[:, :1] * self.X + xz[:, 1:] * self.Z + offset[:, None] * self.Y
        return paper[:, 0], paper[:, 1]

    def lines(self, names: Sequence[str], shape: Array) -> _Lines:
        """Return splines and points of a shape."""
        value = dict(zip(names, shape.tolist(), strict=True))
        curves = []
        for bar in self.structure.bar:
            points = [p for p in bar.points if p in value]
            if len(points) > 1:
                xz, matrix = bar_curve(self.structure, bar, points)
                curves.append(self.project(xz, matrix @ np.array([value[p] for p in points])))
        at = np.array([self.structure.position(name) for name in names])
        rest, moved = self.project(at, 0.0), self.project(at, shape)
        ties = [(np.array([x, u]), np.array([y, v])) for x, y, u, v in zip(*rest, *moved, strict=True)]
        return _Lines([*curves, moved], ties)

    def draw(self, axes: Any, lines: _Lines, colour: str, marker: str) -> None:
        """Draw a shape over the undeformed bars."""
        for line in self.bars:
            axes.plot(*line, color=GREY, lw=0.9, linestyle=(0, (4, 1.5)), label="undeformed")
        for line in lines.ties:
            axes.plot(*line, color=GREY, lw=0.5, label="tie")
        for line in lines.curves[:-1]:
            axes.plot(*line, color=colour, lw=1.7, label="shape")
        axes.plot(*lines.curves[-1], marker, color=colour, markersize=3.2, label="points")

    def draw_key(self, axes: Any, inch: float) -> None:
        """Draw the directions with their scales."""
        length = next((n for n in _ROUND if n * inch * 0.9 >= 0.35), _ROUND[-1])
        arrows = (
            (length * self.X, f"x, {length:g} m", ("left", "top")),
            (self.SHARE * self.size * self.Y, "deflection y, 1 [-]", ("left", "center")),
            (length * self.Z, f"z, {length:g} m", ("center", "bottom")),
        )
        for tip, text, (ha, va) in arrows:
            axes.annotate(
                "", tip, (0, 0), arrowprops={"arrowstyle": "-|>", "color": INK, "lw": 0.9, "shrinkA": 0, "shrinkB": 0}
            )
            axes.text(*(tip * 1.06), text, ha=ha, va=va, fontsize=8)


_ROUND = tuple(m * 10.0**e for e in range(-4, 4) for m in (1, 2, 5))


def _unit_maximum(shape: Array) -> Array:
    """Scale a shape to a largest deflection of 1."""
    size = np.abs(shape)
    largest = size.max()
    return shape / np.copysign(largest, shape[np.flatnonzero(size >= largest * (1 - 1e-6))[0]])


def _cut(text: str, limit: int = 40) -> str:
    """Return a text shortened to the width of a panel."""
    return text if len(text) <= limit else text[: limit - 1] + "…"
