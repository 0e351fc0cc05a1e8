"""Figures: functions of data that return a matplotlib `Figure`, never shown, with a unit on every axis.

The colours are those of Okabe and Ito [1]_, told apart by the colour-blind, and every curve has its own line style too,
so that a black-and-white print can be read. Long traces are thinned to the extremes of short stretches: no peak is lost.

References
----------
.. [1] M. Okabe, K. Ito, *Color Universal Design*, 2008, https://jfly.uni-koeln.de/color/.
"""

import functools
import hashlib
import io
import itertools
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ParamSpec

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray
from scipy import interpolate, signal

from vlab.errors import BadRecording, unknown_name
from vlab.modal.mac import match_modes
from vlab.signals import Array, Channel, FrequencyResponse, ModalModel, Recording
from vlab.structure.model import Bar, Structure
from vlab.units import same_dimension

INK, GREY = "#000000", "#9a9a9a"
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#000000", "#56B4E9", "#E69F00")
"""Okabe-Ito without its yellow, which is too light for a line on white."""
DASHES: tuple[Any, ...] = ("-", (0, (5, 1.6)), (0, (1.2, 1.2)), (0, (6, 1.5, 1.2, 1.5)), (0, (9, 2)), (0, (3, 1)), "-")
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
POINTS = 2000
"""Most points of a line in a figure."""
SVG_SALT = "vlab"

_STYLE = {
    "font.family": "sans-serif",
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.1,
    "lines.markersize": 4.5,
    "legend.frameon": False,
    "legend.handlelength": 3.0,
    "figure.facecolor": "white",
}
_KIND_WORDS = {"other": "", "angular-velocity": "angular velocity", "angular-acceleration": "angular acceleration"}

Options = ParamSpec("Options")


def _styled(draw: Callable[Options, Figure]) -> Callable[Options, Figure]:
    """Draw in the style of this module without changing matplotlib's own settings."""

    @functools.wraps(draw)
    def styled(*args: Options.args, **kwargs: Options.kwargs) -> Figure:
        with mpl.rc_context(_STYLE):
            return draw(*args, **kwargs)

    return styled


# ---- what curves are made of ----------------------------------------------------------------------------------------


def decimate(x: ArrayLike, y: ArrayLike, *, limit: int = POINTS) -> tuple[Array, Array]:
    """Return at most `limit` of the samples: the smallest and the largest of each stretch, and both ends."""
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    if len(x) <= limit:
        return x, y
    edges = np.linspace(0, len(x), max(1, (limit - 2) // 2) + 1).astype(int)
    extremes = [a + f(y[a:b]) for a, b in itertools.pairwise(edges) for f in (np.argmin, np.argmax)]
    keep = np.unique([0, *extremes, len(x) - 1])
    return x[keep], y[keep]


def aligned(measured: Recording, simulated: Recording, channel: str) -> tuple[Array, Array, Array]:
    """Return time and both signals of a channel on the measurement's samples, where both recordings have some.

    Raises
    ------
    BadRecording
        The recordings do not overlap in time, or the channel has two units.
    """
    units = [recording.channels[recording.index(channel)].unit for recording in (measured, simulated)]
    if units[0] != units[1]:
        raise BadRecording(
            f"channel {channel!r} is in {units[0]} where measured and in {units[1]} where simulated; convert one"
        )
    if np.array_equal(measured.time, simulated.time):
        return measured.time, measured[channel], simulated[channel]
    slack = 1e-9 * float(np.ptp(measured.time))
    inside = (measured.time >= simulated.time[0] - slack) & (measured.time <= simulated.time[-1] + slack)
    if np.count_nonzero(inside) < 2:
        raise BadRecording(
            f"the recordings do not overlap in time: measured {measured.time[0]:g} to {measured.time[-1]:g} s, "
            f"simulated {simulated.time[0]:g} to {simulated.time[-1]:g} s"
        )
    time = measured.time[inside]
    return time, measured[channel][inside], np.interp(time, simulated.time, simulated[channel])


def residual_percent(measured: Array, simulated: Array) -> float:
    """Return the rms of the residual in per cent of the rms of the measurement; infinite where that is zero."""
    scale = float(np.sqrt(np.mean(measured**2)))
    return 100.0 * float(np.sqrt(np.mean((measured - simulated) ** 2))) / scale if scale else np.inf


def bar_curve(structure: Structure, bar: Bar, points: Sequence[str], *, count: int = 41) -> tuple[Array, Array]:
    """Return points (x, z) along a bar, and the matrix that takes the deflections at named points to deflections there.

    Between the points runs the natural cubic spline, the shape of a bar that is loaded at its points only. An upright
    bar does not twist in its clamp, so the arms of a bar across it start out straight on both sides.
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
    """Say whether a bar is closer to the vertical than to the horizontal."""
    (x0, z0), (x1, z1) = structure.position(bar.points[0]), structure.position(bar.points[-1])
    return abs(z1 - z0) >= abs(x1 - x0)


def _text(words: object) -> str:
    """Return text that matplotlib draws as it stands: no mathematics, no control characters, never hidden."""
    shown = "".join(c if c.isprintable() or c == "\n" else " " for c in str(words)).replace("$", r"\$")
    return f" {shown}" if shown.startswith("_") else shown


def pretty_unit(unit: str) -> str:
    """Return a unit as it is printed: superscripts for powers, a dash for a ratio."""
    return {"": "-", "1": "-"}.get(unit, unit.replace("^2", "²").replace("^3", "³"))


def channel_label(channel: Channel) -> str:
    """Return kind and place of a channel, or its name where it has no place."""
    kind = _KIND_WORDS.get(channel.kind, channel.kind)
    return f"{kind} {channel.at}".strip() if channel.at else channel.name


def _axis(channel: Channel, *, power: str = "") -> str:
    return _text(f"{channel_label(channel)}\n[{pretty_unit(channel.unit)}{power}]")


def _line(axes: Any, x: ArrayLike, y: ArrayLike, index: int, **options: Any) -> Any:
    dash = "-" if np.size(x) > 4 * POINTS else DASHES[index % len(DASHES)]  # dashes drown in a thinned trace
    style = {"color": COLOURS[index % len(COLOURS)], "linestyle": dash, **options}
    return axes.plot(*decimate(x, y), **style)[0]


def _stack(
    rows: int, *, width: float = 7.2, each: float = 1.35, ratios: Sequence[float] | None = None
) -> tuple[Any, Any]:
    height = each * (sum(ratios) if ratios is not None else rows) + 0.8
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(rows, 1, sharex=True, squeeze=False, height_ratios=ratios)[:, 0]


def _legend(figure: Figure, handles: Sequence[Any], labels: Sequence[str], *, columns: int = 4) -> None:
    if labels:
        wide = sum(len(label) + 8 for label in labels) > 90  # characters that fit beside each other
        columns = min(2 if wide else columns, len(labels))
        figure.legend(handles, [_text(s) for s in labels], loc="outside upper center", ncols=columns)


# ---- frequency responses --------------------------------------------------------------------------------------------


@_styled
def frf_figure(
    measured: FrequencyResponse | None = None,
    analytical: FrequencyResponse | None = None,
    output: str = "",
    input: str = "",
    *,
    labels: tuple[str, str] = ("measured", "analytical"),
    overlays: Sequence[tuple[str, FrequencyResponse]] = (),
    log_frequency: bool = False,
    title: str = "",
) -> Figure:
    """Draw magnitude, phase and coherence over one frequency axis.

    Parameters
    ----------
    measured, analytical : FrequencyResponse or None
        The pair that is usually compared.
    output, input : str
        Channel names, or what stands behind the colon of one (``"base"`` finds ``"sensor:base"``); the first ones of
        the first response by default.
    labels : (str, str)
        What the two are called.
    overlays : sequence of (label, FrequencyResponse)
        More responses, for example open and closed loop.

    Raises
    ------
    BadRecording
        Nothing to draw, or responses in different units.
    UnknownName
        A response without that output or input.
    """
    pair = zip(labels, (measured, analytical), strict=True)
    curves = [(label, frf) for label, frf in (*pair, *overlays) if frf is not None]
    if not curves or any(frf.freq.size < 2 for _, frf in curves):
        raise BadRecording("no frequency response with at least two lines was given to draw")
    unit = _common_unit([frf.unit for _, frf in curves if frf.unit])
    output, input = output or curves[0][1].outputs[0], input or curves[0][1].inputs[0]
    columns = [(_column("output", frf.outputs, output), _column("input", frf.inputs, input)) for _, frf in curves]
    has_coherence = any(frf.coherence is not None for _, frf in curves)
    figure, axes = _stack(2 + has_coherence, ratios=[2.2, 1.2, 0.9][: 2 + has_coherence])
    phases = [np.degrees(np.angle(frf.H[:, i, j])) for (_, frf), (i, j) in zip(curves, columns, strict=True)]
    low = _phase_cut(phases)
    handles = []
    for k, ((_, frf), (i, j), phase) in enumerate(zip(curves, columns, phases, strict=True)):
        size = np.abs(frf.H[:, i, j])
        handles.append(_line(axes[0], frf.freq, np.where(size > 0, size, np.nan), k))
        _line(axes[1], *_unjoined(*decimate(frf.freq, _wrapped(phase, low))), k)
        if frf.coherence is not None:
            _line(axes[2], frf.freq, frf.coherence[:, i], k)
    _label_response(axes, [frf.freq for _, frf in curves], unit, low, log_frequency)
    axes[0].set_title(_text(title or f"{output} from {input}"), loc="left")
    if len(curves) > 1 or overlays:
        _legend(figure, handles, [label for label, _ in curves])
    return figure


def _label_response(axes: Any, freqs: Sequence[Array], unit: str, low: float, log_frequency: bool) -> None:
    ticks = np.arange(np.ceil(low / 90) * 90, low + 361, 90)
    axes[0].set(yscale="log", ylabel=f"magnitude\n[{unit}]")
    axes[1].set(ylabel="phase [deg]", ylim=(low - 10, low + 370), yticks=ticks)
    if len(axes) > 2:
        axes[2].set(ylabel="coherence [-]", ylim=(-0.05, 1.05), yticks=(0, 0.5, 1))
    start, stop = min(freq[freq > 0][0] if log_frequency else freq[0] for freq in freqs), max(f[-1] for f in freqs)
    if log_frequency:
        axes[-1].set_xscale("log")
    axes[-1].set(xlabel="frequency [Hz]", xlim=(start, stop))


def _common_unit(given: Sequence[str]) -> str:
    """Return the unit of an axis, or refuse responses that do not share one; ``(m/s)/N`` and ``m/s/N`` are the same."""
    bare = [re.sub(r"^\(([^()]*)\)(?=/|$)", r"\1", unit) for unit in given]
    for unit in bare[1:]:
        if unit != bare[0] and not same_dimension(unit, bare[0]):
            raise BadRecording(
                f"frequency responses in {bare[0]} and in {unit} do not share an axis; integrate() or differentiate() one"
            )
    return pretty_unit(bare[0]) if bare else "SI"


def _column(kind: str, names: Sequence[str], wanted: str) -> int:
    if wanted in names:
        return names.index(wanted)
    same = [i for i, name in enumerate(names) if name.rpartition(":")[2] == wanted.rpartition(":")[2]]
    if len(same) != 1:
        raise unknown_name(kind, wanted, names, where="frequency response")
    return same[0]


def _wrapped(degrees: Array, low: float) -> Array:
    return (degrees - low) % 360.0 + low


def _phase_cut(phases: Sequence[Array]) -> float:
    """Return where to cut the circle so that the curves jump least; the usual -180 to 180 degrees where it is as good."""
    cuts = (-180.0, -270.0, -90.0, -225.0, -135.0, -315.0, -45.0)
    jumps = [sum(np.count_nonzero(np.abs(np.diff(_wrapped(p, low))) > 180) for p in phases) for low in cuts]
    return cuts[jumps.index(min(jumps))]


def _unjoined(x: Array, degrees: Array) -> tuple[Array, Array]:
    """Break a line where it jumps across the cut."""
    at = np.flatnonzero(np.abs(np.diff(degrees)) > 180) + 1
    return np.insert(x, at, x[at]), np.insert(degrees, at, np.nan)


# ---- modes ----------------------------------------------------------------------------------------------------------


@_styled
def mode_shapes_figure(
    structure: Structure,
    fe_modes: ModalModel,
    plant_modes: ModalModel | None = None,
    *,
    labels: tuple[str, str] = ("FE", "plant"),
    columns: int = 6,
) -> Figure:
    """Draw the modes of a structure as in Figure 3 of the dissertation: one panel a mode, the deflection to the right.

    Vertical bars stand upright; horizontal ones recede obliquely from lower left to upper right, so that their
    deflection shows as an offset to the right of the undeformed bar in grey.

    Parameters
    ----------
    fe_modes, plant_modes : ModalModel
        Shapes at points of the structure. The second model's modes are paired with the first's by MAC.
    labels : (str, str)
        What the two are called.
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
        axes.set(title=title, xlim=(-1.75, 1.75), xticks=(-1, 0, 1))
    for axes in panels[:, 0]:
        axes.set_ylabel("height z [m]")
    figure.supxlabel("deflection y relative to the largest [-]", fontsize=9)
    _legend(figure, list(handles.values()), list(handles))
    return figure


def _point(structure: Structure, coordinate: str) -> str:
    """Return the point that a coordinate such as ``base``, ``v:base`` or ``sensor:base`` names, or nothing."""
    names = {p.name for p in structure.point}
    tail = coordinate.rpartition(":")[2]
    return coordinate if coordinate in names else tail if tail in names and coordinate[:2] not in ("rx", "rz") else ""


def _real(shape: NDArray[Any]) -> Array:
    """Turn a complex shape to where it is most nearly real."""
    return np.real(shape * np.exp(-0.5j * np.angle(np.sum(shape**2)))) if np.iscomplexobj(shape) else shape


def _partners(structure: Structure, first: ModalModel, second: ModalModel) -> dict[int, tuple[int, dict[str, float]]]:
    """Return for modes of the first model the column of the second and its shape, scaled and signed alike."""

    def at_points(model: ModalModel) -> ModalModel:
        names = {name: i for i, c in enumerate(model.coordinates) if (name := _point(structure, c))}
        shapes = np.array([[_real(column)[i] for column in model.shapes.T] for i in names.values()])
        return ModalModel(freq=model.freq, zeta=model.zeta, shapes=shapes, coordinates=tuple(names))

    first, second = at_points(first), at_points(second)
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
    """Return the projection of (x, z) and deflection onto paper: x recedes at an angle, deflection goes to the right."""
    at = np.array([structure.position(p.name) for p in structure.point])
    low, high = at.min(axis=0), at.max(axis=0)
    half = max((high[0] - low[0]) / 2, 1e-9)
    upright = [structure.position(b.points[0])[0] for b in structure.bar if is_upright(structure, b)]
    middle = float(np.mean(upright)) if upright else (low[0] + high[0]) / 2
    rise = 0.12 * max(high[1] - low[1], half)
    return lambda xz, y: ((xz[:, 0] - middle) / half * 0.6 + y, xz[:, 1] + (xz[:, 0] - middle) / half * rise)


@_styled
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
    rows, columns : str
        What the modes of the rows and of the columns belong to.
    row_freq, column_freq : sequence of float or None
        Their frequencies [Hz], written beside the mode numbers.
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
        xlabel=_text(f"{columns} mode {'[Hz]' if column_freq is not None else '[-]'}"),
        ylabel=_text(f"{rows} mode {'[Hz]' if row_freq is not None else '[-]'}"),
    )
    axes.invert_yaxis()
    axes.grid(visible=False)
    axes.tick_params(length=0)
    figure.colorbar(mesh, ax=axes, label="MAC [-]", shrink=0.8)
    return figure


@_styled
def frequencies_figure(
    frequencies: Mapping[str, ArrayLike], *, reference: str = "published", title: str = ""
) -> Figure:
    """Draw natural frequencies from several sources as deviations from one of them.

    Parameters
    ----------
    frequencies : mapping of label to (n_modes,) array
        Frequencies [Hz] in the same order of modes; NaN where a source has none.
    reference : str
        The label that the others are compared with.
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
        xlabel=_text(f"deviation from {reference} [%]"),
        ylabel=_text(f"mode, {reference} [Hz]"),
        ylim=(base.size + 0.5, 0.5),
        title=_text(title),
    )
    axes.set_yticks(rows, [f"{k}: {f:.3f}" for k, f in zip(rows, base, strict=True)])
    axes.grid(visible=True, axis="y", linewidth=9, color="#f4f4f4")
    axes.margins(x=0.08)
    _legend(figure, handles, list(others))
    return figure


@_styled
def pole_figure(
    poles: Sequence[tuple[str, ArrayLike]], *, damping: Sequence[float] = (), highest_hz: float | None = None
) -> Figure:
    """Draw poles in the upper half of the s-plane, the unstable half shaded.

    Parameters
    ----------
    poles : sequence of (label, complex array)
        Poles s [rad/s], for example of the open and the closed loop.
    damping : sequence of float
        Damping ratios whose lines are drawn.
    highest_hz : float or None
        Poles above this frequency are left out [Hz].
    """
    upper = []
    for label, s in poles:
        s = np.asarray(s, dtype=complex).ravel()
        keep = (s.imag >= 0) & (np.abs(s) <= 2 * np.pi * (np.inf if highest_hz is None else highest_hz))
        upper.append((label, s[keep]))
    everything = np.concatenate([s for _, s in upper]) if upper else np.array([])
    if everything.size == 0:
        raise BadRecording("no pole was given to draw")
    figure = Figure(figsize=(5.6, 4.4), layout="constrained")
    axes: Any = figure.subplots()
    handles = []
    for k, (_, s) in enumerate(upper):
        marker, face = ("x", COLOURS[0]) if k == 0 else (MARKERS[(k - 1) % len(MARKERS)], "none")
        style = {"color": COLOURS[k % len(COLOURS)], "linestyle": "none", "markerfacecolor": face, "markersize": 6}
        handles.append(axes.plot(s.real, s.imag, marker=marker, **style)[0])
    decay = np.abs(everything.real[everything.real != 0])
    if decay.size and decay.max() > 100 * decay.min():
        floor = 10.0 ** np.floor(np.log10(max(decay.min(), 1e-6 * decay.max())))
        axes.set_xscale("symlog", linthresh=floor)
    low, high = -1.5 * max(0.0, -everything.real.min()), max(1.5 * everything.real.max(), 0.0)
    room = 0.15 * max(-low, high, 1e-9) if axes.get_xscale() == "linear" else (decay.min() if decay.size else 1.0)
    low, high, top = min(low, -room), max(high, room), 1.08 * max(everything.imag.max(), 1e-9)
    axes.axvspan(0.0, high, color="#eeeeee", zorder=0)
    axes.axvline(0.0, color=INK, lw=0.8)
    _damping_lines(axes, damping, low, top)
    axes.set(xlabel="real part [rad/s]", ylabel="imaginary part [rad/s]", xlim=(low, high), ylim=(0.0, top))
    hertz = axes.secondary_yaxis("right", functions=(_per_turn, _per_second))
    hertz.set_ylabel("imaginary part / 2π [Hz]")
    _legend(figure, handles, [label for label, _ in upper])
    return figure


def _damping_lines(axes: Any, ratios: Sequence[float], low: float, top: float) -> None:
    imaginary = np.linspace(1e-9, top, 400)
    for ratio in ratios:
        if not 0 < ratio < 1:
            raise BadRecording(f"a line of damping ratio {ratio:g} cannot be drawn; accepted: between 0 and 1")
        real = -ratio / np.sqrt(1 - ratio**2) * imaginary
        axes.plot(real, imaginary, color=GREY, lw=0.8, linestyle=":")
        leaves_at_top = real[-1] > low
        place = (real[-1], 0.985 * top) if leaves_at_top else (0.985 * low, -0.985 * low * top / -real[-1])
        side = {"ha": "right", "va": "top"} if leaves_at_top else {"ha": "left", "va": "bottom"}
        axes.text(*place, f" ζ = {ratio:g} ", color="#555555", fontsize=7.5, **side)


def _per_turn(omega: Any) -> Any:
    return omega / (2 * np.pi)


def _per_second(freq: Any) -> Any:
    return freq * 2 * np.pi


# ---- traces ---------------------------------------------------------------------------------------------------------


@_styled
def traces_figure(
    recordings: Sequence[tuple[str, Recording]],
    channels: Sequence[str] | None = None,
    *,
    start: float | None = None,
    stop: float | None = None,
    limit: int = POINTS,
) -> Figure:
    """Draw time histories, one axis a channel, the recordings on top of each other.

    Parameters
    ----------
    recordings : sequence of (label, Recording)
        In drawing order.
    channels : sequence of str or None
        Which; by default all, in order of appearance. A recording without a channel has no line there.
    start, stop : float or None
        Stretch that is drawn [s].
    limit : int
        Most points of a line.
    """
    found = _channels(recordings, channels)
    figure, axes = _stack(len(found), each=1.1)
    handles: dict[str, Any] = {}
    for row, channel in zip(axes, found, strict=True):
        for k, (label, recording) in enumerate(recordings):
            if channel.name in recording.names:
                keep = _stretch(recording.time, start, stop)
                x, y = recording.time[keep], recording[channel.name][keep]
                dash = {"linestyle": "-"} if x.size > 4 * limit else {}
                handles[label] = _line(row, *decimate(x, y, limit=limit), k, lw=0.8, **dash)
        row.set_ylabel(_axis(channel))
        row.ticklabel_format(axis="y", scilimits=(-3, 4))
        row.margins(x=0)
    axes[-1].set_xlabel("time [s]")
    figure.align_ylabels(axes)
    if len(recordings) > 1:
        _legend(figure, list(handles.values()), list(handles))
    return figure


def _stretch(time: Array, start: float | None, stop: float | None) -> NDArray[np.bool_]:
    low, high = -np.inf if start is None else start, np.inf if stop is None else stop
    return np.asarray((time >= low) & (time <= high))


def _channels(recordings: Sequence[tuple[str, Recording]], names: Sequence[str] | None) -> list[Channel]:
    known = {channel.name: channel for _, recording in reversed(recordings) for channel in recording.channels}
    order = dict.fromkeys(channel.name for _, recording in recordings for channel in recording.channels)
    for name in names or ():
        if name not in known:
            raise unknown_name("channel", name, order)
    found = [known[name] for name in (order if names is None else names)]
    if not found:
        raise BadRecording("no channel was given to draw")
    return found


def _density(recording: Recording, values: Array, segment_s: float | None) -> tuple[Array, Array]:
    """Return the amplitude spectral density above 0 Hz, [unit/sqrt(Hz)]."""
    length = len(values) // 8 if segment_s is None else round(segment_s * recording.rate)
    freq, power = signal.welch(values, recording.rate, nperseg=min(max(length, 16), len(values)))
    return freq[1:], np.sqrt(power[1:])


@_styled
def spectrum_figure(
    recordings: Sequence[tuple[str, Recording]],
    channels: Sequence[str] | None = None,
    *,
    segment_s: float | None = None,
    highest_hz: float | None = None,
) -> Figure:
    """Draw amplitude spectral densities (Welch, Hann window), one axis a channel.

    Parameters
    ----------
    segment_s : float or None
        Length of a segment [s]; an eighth of the recording by default.
    highest_hz : float or None
        Where the axis ends [Hz].
    """
    found = _channels(recordings, channels)
    figure, axes = _stack(len(found), each=1.3)
    handles: dict[str, Any] = {}
    for row, channel in zip(axes, found, strict=True):
        for k, (label, recording) in enumerate(recordings):
            if channel.name in recording.names:
                freq, density = _density(recording, recording[channel.name], segment_s)
                keep = (density > 0) & (freq <= (np.inf if highest_hz is None else highest_hz))
                handles[label] = _line(row, freq[keep], density[keep], k)
        row.set(yscale="log", ylabel=_axis(channel, power="/√Hz"))
        row.margins(x=0)
    axes[-1].set_xlabel("frequency [Hz]")
    if len(recordings) > 1:
        _legend(figure, list(handles.values()), list(handles))
    return figure


@_styled
def comparison_figure(
    measured: Recording,
    simulated: Recording,
    channel: str,
    *,
    start: float | None = None,
    stop: float | None = None,
    segment_s: float | None = None,
    highest_hz: float | None = None,
) -> Figure:
    """Draw a channel as measured and as simulated, their difference, and the spectra of all three.

    Times that differ are met by linear interpolation of the simulation; the measurement must be evenly sampled.

    Parameters
    ----------
    start, stop : float or None
        Stretch of time that is drawn [s]; residual and spectra are those of all of it.
    segment_s : float or None
        Length of a segment of the spectra [s]; an eighth of the recording by default.
    highest_hz : float or None
        Where the axis of the spectra ends [Hz].
    """
    time, truth, model = aligned(measured, simulated, channel)
    label = measured.channels[measured.index(channel)]
    figure = Figure(figsize=(7.2, 5.4), layout="constrained")
    over, rest, spectra = figure.subplots(3, 1, height_ratios=[1.2, 0.9, 1.3])
    rest.sharex(over)
    keep = _stretch(time, start, stop)
    for axes, values, k in ((over, truth, 0), (over, model, 1), (rest, truth - model, 4)):
        own = {"linestyle": "-"} if axes is rest else {}
        _line(axes, time[keep], values[keep], k, lw=0.8, **own)
    rest.set_title(f"rms of the residual: {residual_percent(truth, model):.3g} % of the measurement's", loc="left")
    over.tick_params(labelbottom=False)
    for axes in (over, rest):
        axes.margins(x=0)
        axes.set_ylabel(_axis(label))
        axes.ticklabel_format(axis="y", scilimits=(-3, 4))
    handles = []
    for values, k in ((truth, 0), (model, 1), (truth - model, 4)):
        freq, density = _density(measured, values, segment_s)
        keep = (density > 0) & (freq <= (np.inf if highest_hz is None else highest_hz))
        handles.append(_line(spectra, freq[keep], density[keep], k, linestyle=DASHES[2 if k == 4 else k]))
    rest.set_xlabel("time [s]")
    spectra.set(yscale="log", xlabel="frequency [Hz]", ylabel=_axis(label, power="/√Hz"))
    spectra.margins(x=0)
    figure.align_ylabels()
    _legend(figure, handles, ["measured", "simulated", "residual"])
    return figure


# ---- files ----------------------------------------------------------------------------------------------------------


def to_svg(figure: Figure) -> str:
    """Return a figure as an ``<svg>`` element to put into HTML: equal figures give equal text, without dates.

    Text stays text; identifiers are made from the content, so that several figures in one page do not meet.
    """
    buffer = io.StringIO()
    with mpl.rc_context({**_STYLE, "svg.fonttype": "none", "svg.hashsalt": SVG_SALT, "path.simplify": True}):
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    svg = buffer.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>\s*|<!--.*?-->\s*", "", svg, flags=re.S)
    svg = re.sub(r'(?<= d=")[^"]*', _shortened, svg)
    used = set(re.findall(r'(?:url\(|href=")#([^")]+)', svg))
    mark = "f" + hashlib.sha256(svg.encode()).hexdigest()[:8]
    svg = re.sub(r'(?<=<)([A-Za-z]+)((?: [^<>]*?)?) id="([^"]*)"', lambda m: _identified(m, used, mark), svg)
    return re.sub(r'(url\(|href=")#', rf"\g<1>#{mark}-", svg)


def _shortened(path: re.Match[str]) -> str:
    """Round the coordinates of a path to a hundredth of a point, of a long one to a tenth."""
    digits = 1 if len(path[0]) > 2000 else 2
    return re.sub(r"-?\d+\.\d+", lambda number: f"{float(number[0]):.{digits}f}", path[0])


def _identified(tag: re.Match[str], used: set[str], mark: str) -> str:
    return f'{tag[1]}{tag[2]} id="{mark}-{tag[3]}"' if tag[3] in used else f"{tag[1]}{tag[2]}"


def to_png(figure: Figure, *, dpi: int = 130) -> bytes:
    """Return a figure as a PNG image."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi, metadata={"Software": None})
    return buffer.getvalue()
