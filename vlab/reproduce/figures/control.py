"""Figures of control tests: 4, 17-20, 22-31 and the ring-downs.

Each figure shows the analysis beside a simulated experiment.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from vlab.errors import unknown_name
from vlab.fe.second_order import Quantity
from vlab.reproduce.control_bench import ControlBench, LoopRun, dense_lines
from vlab.reproduce.peaks import average_error, peak_ratios
from vlab.reproduce.ring_down import RingDown, ring_downs
from vlab.reproduce.tables.control import BEAM_PLACE, GRID_LAWS, GRID_PLACE
from vlab.signals import FrequencyResponse

NAMES = {"": "open loop", "mfdrf": "MFDRF", "lqdrf": "LQDRF", "lqdrf-diagonal": "diagonal LQDRF", "lqg": "LQG"}
"""NAMES: laws as the dissertation writes them."""
MODELS = {"full": "full model", "exact": "exact reduction", "corrected-guyan": "corrected Guyan"}
EXPERIMENT = "simulated experiment"


@dataclass(frozen=True, kw_only=True, eq=False)
class Curve:
    """Response of a panel.

    Parameters
    ----------
    is_measured : bool
        Whether the response comes from an experiment instead of theory.
    peak_ratios : tuple of float
        Peak levels of theory over those of the panel's experiment, by mode.
    """

    label: str
    response: FrequencyResponse
    is_measured: bool
    peak_ratios: tuple[float, ...] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class Panel:
    """Responses under one law."""

    title: str
    curves: tuple[Curve, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class ControlFigure:
    """Content of a figure, without its drawing.

    Parameters
    ----------
    quantity : str
        Measured quantity per force.
    runs : dict of str to LoopRun
        Experiments by law.
    ring_downs : tuple of RingDown
        Releases, instead of panels.
    """

    number: str
    title: str
    quantity: Quantity
    plant: str
    panels: tuple[Panel, ...] = ()
    runs: dict[str, LoopRun] = field(default_factory=dict)
    ring_downs: tuple[RingDown, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Return plain data for JSON, without the curves."""
        document: dict[str, Any] = {"figure": self.number, "title": self.title, "plant": self.plant}
        if self.ring_downs:
            return document | {"ring_downs": [part.as_dict() for part in self.ring_downs]}
        document["peak_ratios"] = [
            {
                "panel": panel.title,
                "analysis": curve.label,
                "over_experiment": list(curve.peak_ratios),
                "average_error": average_error(curve.peak_ratios),
            }
            for panel in self.panels
            for curve in panel.curves
            if curve.peak_ratios
        ]
        document["effort"] = {name: [part.as_dict() for part in run.effort] for name, run in self.runs.items()}
        document["level_n_rms"] = {name: run.level for name, run in self.runs.items()}
        return document


def control_figure(
    number: str,
    *,
    plant: str = "",
    seed: int = 0,
    shorten: float = 1.0,
    progress: Callable[[str], None] = lambda text: None,
) -> ControlFigure:
    """Run the experiments of one figure.

    Parameters
    ----------
    number : str
        Number of the figure.
    plant : str
        Plant, see `ControlBench`.
    seed : int
        Seed of excitation and noise.
    shorten : float
        Divisor of all periods.
    progress : callable
        Receives the present experiment.

    Returns
    -------
    ControlFigure
        Content of the figure.

    Raises
    ------
    UnknownName
        There is no such figure.
    """
    if number not in FIGURES:
        raise unknown_name("figure", number, FIGURES, where="reproduce")
    structure, _, make = FIGURES[number]
    return make(number, ControlBench(structure, plant=plant, seed=seed, shorten=shorten, progress=progress))


def _panel(bench: ControlBench, title: str, run: LoopRun, models: tuple[str, ...], place: str, modes: int) -> Panel:
    """Return an experiment with the responses of some models."""
    measured = bench.measured(run, place)
    curves = [Curve(label=EXPERIMENT, response=measured, is_measured=True)]
    for model in models:
        at_lines = bench.analysis(model, run, measured.freq, place)
        ratios = peak_ratios(at_lines, measured, bench.modes_hz(model)[:modes], bench.modes_hz()[:modes])
        smooth = dense_lines(*bench.test.band_hz, bench.modes_hz(model))
        curves.append(
            Curve(
                label=f"analysis, {MODELS[model]}",
                response=bench.analysis(model, run, smooth, place),
                is_measured=False,
                peak_ratios=tuple(ratios.tolist()),
            )
        )
    return Panel(title=title, curves=tuple(curves))


def _figure(number: str, bench: ControlBench, panels: list[Panel], runs: dict[str, LoopRun]) -> ControlFigure:
    return ControlFigure(
        number=number,
        title=FIGURES[number][1],
        quantity=bench.test.quantity,
        plant=bench.plant_name,
        panels=tuple(panels),
        runs=runs,
    )


def _beam(*laws: str) -> Callable[[str, ControlBench], ControlFigure]:
    def make(number: str, bench: ControlBench) -> ControlFigure:
        runs = {NAMES[law]: bench.run(law, "full" if law else "") for law in laws}
        panels = [_panel(bench, name, run, ("full",), BEAM_PLACE, 6) for name, run in runs.items()]
        return _figure(number, bench, panels, runs)

    return make


def _grid(law: str, designed_on: str, models: tuple[str, ...], place: str = GRID_PLACE) -> Any:
    def make(number: str, bench: ControlBench) -> ControlFigure:
        run = bench.run(law, designed_on)
        return _figure(number, bench, [_panel(bench, NAMES[law], run, models, place, 4)], {NAMES[law]: run})

    return make


def _ring_down(laws: tuple[str, ...], model: str) -> Callable[[str, ControlBench], ControlFigure]:
    def make(number: str, bench: ControlBench) -> ControlFigure:
        found = ring_downs(bench, {NAMES[law]: bench.law(law, model) if law else None for law in laws})
        return ControlFigure(
            number=number,
            title=FIGURES[number][1],
            quantity=bench.test.quantity,
            plant=bench.plant_name,
            ring_downs=found,
        )

    return make


def _grid_figures() -> dict[str, tuple[str, str, Callable[[str, ControlBench], ControlFigure]]]:
    made: dict[str, tuple[str, str, Any]] = {}
    for i, joint in enumerate(("joint1", "joint2", "joint3", "joint4")):
        title = f"Velocity of {joint} per force at joint4, open loop"
        made[str(17 + i)] = ("grid", title, _grid("", "", ("exact",), place=joint))
    both, where = ("exact", "corrected-guyan"), "Velocity of joint4 per force there"
    made["23"] = ("grid", f"{where}, open loop", _grid("", "", both))
    order = ("mfdrf", "lqdrf", "lqdrf-diagonal", "lqg")
    for i, law in enumerate(order):
        title = f"{where}, {NAMES[law]} of the exact reduction"
        made[str(24 + i)] = ("grid", title, _grid(law, "exact", both))
    for i, law in enumerate(order):
        title = f"{where}, {NAMES[law]} of the corrected Guyan reduction"
        made[str(28 + i)] = ("grid", title, _grid(law, "corrected-guyan", ("corrected-guyan",)))
    return made


FIGURES: dict[str, tuple[str, str, Callable[[str, ControlBench], ControlFigure]]] = {
    "4": ("beam", "Displacement of 30in per force at the base, open loop", _beam("")),
    "22": (
        "beam",
        "Displacement of 30in per force at the base, open loop and controlled",
        _beam("", "mfdrf", "lqdrf", "lqg"),
    ),
    **_grid_figures(),
    "ring-down-beam": (
        "beam",
        "Release of the beam, open loop and controlled",
        _ring_down(("", "mfdrf", "lqdrf", "lqg"), "full"),
    ),
    "ring-down-grid": (
        "grid",
        "Release of the grid, open loop and controlled",
        _ring_down(("", *GRID_LAWS), "exact"),
    ),
}
FIGURES = dict(
    sorted(FIGURES.items(), key=lambda item: (not item[0].isdigit(), int(item[0]) if item[0].isdigit() else 0))
)
"""FIGURES: structure, content and function of each figure, by number."""
