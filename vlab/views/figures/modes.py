"""Figures of modes: shapes of a structure, MAC matrices, natural frequencies."""

import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray
from scipy import interpolate

from vlab.errors import BadRecording, unknown_name
from vlab.modal.mac import match_modes
from vlab.signals import Array, ModalModel
from vlab.structure.model import Bar, Structure
from vlab.views.figures.style import COLOURS, GREY, INK, MARKERS, as_text, draw_legend, styled


def bar_curve(structure: Structure, bar: Bar, points: Sequence[str], *, count: int = 41) -> tuple[Array, Array]:
    """Return points along a bar with their interpolation matrix.

    The curve is the natural cubic spline, the shape of a bar loaded at its points. An upright bar does not twist in
    its clamp, so bars across it start straight on both sides.

    Parameters
    ----------
    structure : Structure
        Structure.
    bar : Bar
        Bar.
    points : sequence of str
        Names of points with known deflections.
    count : int
        Number of points along the bar.

    Returns
    -------
    tuple
        Points, (count, 2) [m], and matrix, (count, n_points).
    """
    at = np.array([structure.position(name) for name in points])
    stations = np.hypot(*(at - at[0]).T)
    fine = np.unique(np.concatenate([np.linspace(0.0, stations[-1], count), stations]))
    clamps = {clamp.at for clamp in structure.clamp}
    held = [] if is_upright(structure, bar) else [i for i, name in enumerate(points) if name in clamps]
    cuts = sorted({0, len(points) - 1, *held})
    free, straight = (2, np.zeros(len(points))), (1, np.zeros(len(points)))
    matrix = np.zeros((fine.size, len(points)))
    for a, b in itertools.pairwise(cuts):
        ends = tuple(straight if i in held else free for i in (a, b))
        spline = interpolate.CubicSpline(stations[a : b + 1], np.eye(len(points))[a : b + 1], bc_type=ends)
        inside = (fine >= stations[a]) & (fine <= stations[b])
        matrix[inside] = spline(fine[inside])
    return at[0] + fine[:, None] * (at[-1] - at[0]) / stations[-1], matrix


def is_upright(structure: Structure, bar: Bar) -> bool:
    """Return whether a bar is closer to the vertical."""
    (x0, z0), (x1, z1) = structure.position(bar.points[0]), structure.position(bar.points[-1])
    return abs(z1 - z0) >= abs(x1 - x0)


@styled
def mode_shapes_figure(
    structure: Structure,
    fe_modes: ModalModel,
    plant_modes: ModalModel | None = None,
    *,
    labels: tuple[str, str] = ("FE", "plant"),
    columns: int = 6,
) -> Figure:
    """Draw the modes of a structure as in Figure 3.

    Deflections point to the right. Horizontal bars recede obliquely from lower left to upper right. Undeformed bars
    are grey.

    Parameters
    ----------
    structure : Structure
        Structure.
    fe_modes, plant_modes : ModalModel
        Shapes at points of the structure; the second model is paired with the first by MAC.
    labels : (str, str)
        Names of the two models.
    columns : int
        Panels per row.

    Returns
    -------
    Figure
        Figure.
    """
    rows_of = {name: fe_modes.coordinates.index(c) for c in fe_modes.coordinates if (name := _point(structure, c))}
    bars = [(bar, [p for p in bar.points if p in rows_of]) for bar in structure.bar]
    bars = [(bar, points) for bar, points in bars if len(points) > 1]
    if not bars:
        raise unknown_name("coordinate", ", ".join(fe_modes.coordinates[:5]), [p.name for p in structure.point])
    partners = {} if plant_modes is None else _partners(structure, fe_modes, plant_modes)
    n = fe_modes.freq.size
    columns = max(1, min(columns, n))
    rows = -(-n // columns)
    figure = Figure(figsize=(max(1.25 * columns, 3.0) + 0.7, 3.7 * rows + 0.5), layout="constrained")
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    project = _oblique(structure)
    handles: dict[str, Any] = {}
    for mode, axes in enumerate(panels.flat):
        if mode >= n:
            axes.set_visible(False)
            continue
        shape = _real(fe_modes.shapes[:, mode])
        scale = np.abs(shape[list(rows_of.values())]).max() or 1.0
        partner = partners.get(mode)
        for bar, points in bars:
            xz, matrix = bar_curve(structure, bar, points)
            deflection = shape[[rows_of[p] for p in points]] / scale
            handles["undeformed"] = axes.plot(*project(xz, 0.0), color=GREY, lw=0.8)[0]
            handles[labels[0]] = axes.plot(*project(xz, matrix @ deflection), color=COLOURS[0], lw=1.6)[0]
            if partner is not None:
                there = [(p, partner[1][p]) for p in points if p in partner[1]]
                at = np.array([structure.position(p) for p, _ in there]).reshape(-1, 2)
                values = np.array([v for _, v in there])
                style = {"marker": "o", "linestyle": "none", "markerfacecolor": "none", "color": COLOURS[1]}
                handles[labels[1]] = axes.plot(*project(at, values), **style)[0]
        title = f"mode {mode + 1}\n{fe_modes.freq[mode]:.3f} Hz"
        if plant_modes is not None:
            title += "\nno partner" if partner is None else f"\n({plant_modes.freq[partner[0]]:.3f} Hz)"
        axes.set(title=title, xticks=(-1, 0, 1))
        axes.tick_params(
            labelbottom=mode + columns >= n
        )  # below the lowest panel of a column, also in an incomplete last row
    drawn = np.array([axes.dataLim.intervalx for axes in panels.flat[:n]])
    panels[0, 0].set_xlim(
        min(-1.75, drawn.min() - 0.1), max(1.75, drawn.max() + 0.1)
    )  # once, for all panels share the axis
    for axes in panels[:, 0]:
        axes.set_ylabel("height z [m]")
    figure.supxlabel("deflection y relative to the largest [-]", fontsize=9)
    draw_legend(figure, list(handles.values()), list(handles))
    return figure


def at_points(structure: Structure, model: ModalModel) -> ModalModel:
    """Return the real modal model at points of the structure.

    Parameters
    ----------
    structure : Structure
        Structure.
    model : ModalModel
        Shapes, real or complex, at coordinates such as ``v:base``.

    Returns
    -------
    ModalModel
        Shapes at the named points; rotations are left out.
    """
    names = {name: i for i, c in enumerate(model.coordinates) if (name := _point(structure, c))}
    shapes = np.array([[_real(column)[i] for column in model.shapes.T] for i in names.values()])
    shapes = shapes.reshape(len(names), model.freq.size)
    return ModalModel(freq=model.freq, zeta=model.zeta, shapes=shapes, coordinates=tuple(names))


def _point(structure: Structure, coordinate: str) -> str:
    """Return the point of a coordinate such as ``v:base``."""
    names = {p.name for p in structure.point}
    tail = coordinate.rpartition(":")[2]
    return coordinate if coordinate in names else tail if tail in names and coordinate[:2] not in ("rx", "rz") else ""


def _real(shape: NDArray[Any]) -> Array:
    """Rotate a complex shape to be as real as possible."""
    return np.real(shape * np.exp(-0.5j * np.angle(np.sum(shape**2)))) if np.iscomplexobj(shape) else shape


def _partners(structure: Structure, first: ModalModel, second: ModalModel) -> dict[int, tuple[int, dict[str, float]]]:
    """Return paired columns and shapes of the second model."""
    first, second = at_points(structure, first), at_points(structure, second)
    common = [name for name in first.coordinates if name in second.coordinates]
    out = {}
    pairing = match_modes(first, second)
    for i, j in zip(pairing.a.tolist(), pairing.b.tolist(), strict=True):
        a = np.array([first.shapes[first.coordinates.index(name), i] for name in common])
        b = np.array([second.shapes[second.coordinates.index(name), j] for name in common])
        factor = (a @ b) / (b @ b) / (np.abs(first.shapes[:, i]).max() or 1.0)
        out[i] = (j, {name: float(factor * v) for name, v in zip(second.coordinates, second.shapes[:, j], strict=True)})
    return out


def _oblique(structure: Structure) -> Callable[[Array, Any], tuple[Array, Array]]:
    """Return the oblique projection onto paper."""
    at = np.array([structure.position(p.name) for p in structure.point])
    low, high = at.min(axis=0), at.max(axis=0)
    half = max((high[0] - low[0]) / 2, 1e-9)
    upright = [structure.position(b.points[0])[0] for b in structure.bar if is_upright(structure, b)]
    middle = float(np.mean(upright)) if upright else (low[0] + high[0]) / 2
    rise = 0.12 * max(high[1] - low[1], half)
    return lambda xz, y: ((xz[:, 0] - middle) / half * 0.6 + y, xz[:, 1] + (xz[:, 0] - middle) / half * rise)


@styled
def mac_figure(
    mac_matrix: ArrayLike,
    *,
    rows: str = "measured",
    columns: str = "model",
    row_freq: Sequence[float] | None = None,
    column_freq: Sequence[float] | None = None,
) -> Figure:
    """Draw a MAC matrix with its values.

    Parameters
    ----------
    mac_matrix : ArrayLike
        MAC values [-].
    rows, columns : str
        Names of the row and column models.
    row_freq, column_freq : sequence of float or None
        Natural frequencies [Hz], written beside the mode numbers.

    Returns
    -------
    Figure
        Figure.
    """
    values = np.atleast_2d(np.asarray(mac_matrix, dtype=float))
    n, m = values.shape
    figure = Figure(figsize=(1.6 + 0.55 * max(m, 3), 1.3 + 0.45 * max(n, 3)), layout="constrained")
    axes = figure.subplots()
    mesh = axes.pcolormesh(values, cmap="Blues", vmin=0, vmax=1, edgecolors="white", linewidth=1)
    for (i, j), value in np.ndenumerate(values):
        colour = "white" if value > 0.6 else INK
        axes.text(j + 0.5, i + 0.5, f"{value:.2f}", ha="center", va="center", color=colour, fontsize=8)

    def ticks(count: int, freq: Sequence[float] | None, between: str) -> list[str]:
        return [f"{k + 1}" + (f"{between}{freq[k]:.2f}" if freq is not None else "") for k in range(count)]

    axes.set_xticks(np.arange(m) + 0.5, ticks(m, column_freq, "\n"))
    axes.set_yticks(np.arange(n) + 0.5, ticks(n, row_freq, ": "))
    axes.set(
        xlabel=as_text(f"{columns} mode {'[Hz]' if column_freq is not None else '[-]'}"),
        ylabel=as_text(f"{rows} mode {'[Hz]' if row_freq is not None else '[-]'}"),
    )
    axes.invert_yaxis()
    axes.grid(visible=False)
    axes.tick_params(length=0)
    figure.colorbar(mesh, ax=axes, label="MAC [-]", shrink=0.8)
    return figure


@styled
def frequencies_figure(
    frequencies: Mapping[str, ArrayLike], *, reference: str = "published", title: str = ""
) -> Figure:
    """Draw natural frequencies as deviations from a reference.

    Parameters
    ----------
    frequencies : mapping of label to (n_modes,) array
        Frequencies [Hz] in one order of modes; NaN without a value.
    reference : str
        Label of the reference.
    title : str
        Title of the figure.

    Returns
    -------
    Figure
        Figure.
    """
    if reference not in frequencies:
        raise unknown_name("reference", reference, frequencies)
    base = np.asarray(frequencies[reference], dtype=float)
    others = {label: np.asarray(f, dtype=float) for label, f in frequencies.items() if label != reference}
    for label, freq in others.items():
        if freq.shape != base.shape:
            raise BadRecording(
                f"{label!r} has {freq.size} frequencies and {reference!r} {base.size}; pair the modes first"
            )
    figure = Figure(figsize=(7.2, 1.3 + 0.36 * base.size), layout="constrained")
    axes = figure.subplots()
    axes.axvline(0.0, color=INK, lw=0.8)
    offsets = np.linspace(-0.22, 0.22, len(others)) if len(others) > 1 else np.zeros(1)
    rows = np.arange(1, base.size + 1)
    handles = []
    for k, (freq, offset) in enumerate(zip(others.values(), offsets, strict=False)):
        handles.append(
            axes.plot(
                100 * (freq / base - 1), rows + offset, MARKERS[k % len(MARKERS)], color=COLOURS[k % len(COLOURS)]
            )[0]
        )
    axes.set(
        xlabel=as_text(f"deviation from {reference} [%]"),
        ylabel=as_text(f"mode, {reference} [Hz]"),
        ylim=(base.size + 0.5, 0.5),
        title=as_text(title),
    )
    axes.set_yticks(rows, [f"{k}: {f:.3f}" for k, f in zip(rows, base, strict=True)])
    axes.grid(visible=True, axis="y", linewidth=9, color="#f4f4f4")
    axes.margins(x=0.08)
    draw_legend(figure, handles, list(others))
    return figure
