"""Rerun scenes: the moving structure beside its traces.

The file is written and closed; no process starts and nothing is sent. Traces hold every sample. The picture moves at
the rate of the stored configurations. Timelines are ``sim_time`` [s] and ``step``, the sample number.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from vlab.controllers import Controller
from vlab.errors import unknown_name
from vlab.hardware.laboratory import Hardware
from vlab.lab.experiment import Result
from vlab.plants.base import Plant
from vlab.signals import FrequencyResponse, Recording
from vlab.structure.model import Structure
from vlab.views.figures import aligned, channel_label, pretty_unit, residual_percent
from vlab.views.rerun.bodies import BodyScene, model_name
from vlab.views.rerun.control_law import LawScene
from vlab.views.rerun.documents import cell, fact_list, level_table, log_document, response_pictures, run_facts
from vlab.views.rerun.frames import Motion, port_deflections
from vlab.views.rerun.modes import ModalScene
from vlab.views.rerun.rrd import arranged, blueprint, identity_of, plain, role_rgb, rrd_file
from vlab.views.rerun.spectra import SpectrumScene
from vlab.views.rerun.structure import StructureScene, sensible_exaggeration
from vlab.views.rerun.traces import PEAKS, axis_unit, log_series, log_traces, plot_view, trace_views

__all__ = ["PEAKS", "port_deflections", "sensible_exaggeration", "write_bodies", "write_comparison", "write_run"]

ROWS = 5
"""ROWS [-]: channels on one page of a comparison."""


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
    controller: Controller | None = None,
    hardware: Hardware | None = None,
    facts: Mapping[str, object] | None = None,
) -> Path:
    """Write an experiment on a structure as an arranged Rerun file.

    Parameters
    ----------
    path : path
        Output ``.rrd`` file, which appears whole or not at all.
    structure : Structure
        Structure.
    plant : Plant
        Plant.
    result : Result
        Result of the run.
    frf, analytical : FrequencyResponse or None
        Overlaid responses, one image per pair of output and input.
    exaggeration : float or None
        Factor on the deflections [-]; by default a visible one, stated in the title.
    law : str
        Description of the control law.
    controller : Controller or None
        Law of the run, for its states.
    hardware : Hardware or None
        Source of delay, filter and amplifier limit.
    facts : mapping or None
        Further lines of the document.

    Returns
    -------
    Path
        Written file.

    Raises
    ------
    OutputRefused
        The file cannot be written.
    BadRecording
        The stored configurations belong to another plant.
    """
    recording = result.recording
    motion = Motion.of(structure, plant, result)
    scene, modes = StructureScene(structure, motion, exaggeration), ModalScene(structure, plant)
    text = run_document(structure, plant, result, scene, law, hardware, facts)
    inside = LawScene(plant, recording, hardware, controller)

    def log(stream: Any) -> None:
        scene.log(stream)
        scene.log_forces(stream, recording, largest_forces(recording))
        modes.log(stream, result)
        motion.log(stream)

    return _write(
        path,
        f"{structure.name} {plant.name}",
        scene.view(),
        modes.view(),
        log,
        inside,
        recording,
        text,
        (frf, analytical),
    )


def run_document(
    structure: Structure,
    plant: Plant,
    result: Result,
    scene: StructureScene,
    law: str,
    hardware: Hardware | None,
    facts: Mapping[str, object] | None = None,
) -> str:
    """Return the document of a run.

    Parameters
    ----------
    structure : Structure
        Structure.
    plant : Plant
        Plant.
    result : Result
        Result of the run.
    scene : StructureScene
        Scene of the structure.
    law : str
        Description of the control law.
    hardware : Hardware or None
        Hardware of the laboratory.
    facts : mapping or None
        Further lines of the document.

    Returns
    -------
    str
        Markdown text.
    """
    about = {"structure": structure.title, **run_facts(plant, result.recording, law, hardware)}
    about["picture"] = (
        f"{scene.title()}; largest deflection {1000 * scene.motion.largest:.3g} mm; arrows: forces of the coils"
    )
    title = f"{structure.title}: {plant.name}"
    return fact_list(title, {**about, **(facts or {})}) + "\n" + level_table(result.recording)


def largest_forces(recording: Recording) -> dict[str, float]:
    """Return the peak of every force channel, by name."""
    return {c.name: float(np.abs(recording[c.name]).max()) for c in recording.channels if c.kind == "force"}


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
    """Write an experiment on any MuJoCo model as an arranged Rerun file.

    Bodies are points, with lines from parent to child; geoms are their long axes. Deflections are not exaggerated.
    See `write_run` for the parameters.

    Parameters
    ----------
    path : Path or str
        Output file.
    plant : Plant
        Plant.
    result : Result
        Result of the run.
    frf, analytical : FrequencyResponse or None
        Overlaid responses.
    law : str
        Description of the control law.
    hardware : Hardware or None
        Hardware of the laboratory.
    facts : mapping or None
        Further lines of the document.

    Returns
    -------
    Path
        Written file.
    """
    recording = result.recording
    scene = BodyScene(plant, result)
    about = {**run_facts(plant, recording, law, hardware), "picture": "bodies, centres of mass and geoms, to scale"}
    text = fact_list(model_name(plant), {**about, **(facts or {})}) + "\n" + level_table(recording)
    inside = LawScene(plant, recording, hardware, None)
    return _write(path, model_name(plant), scene.view(), None, scene.log, inside, recording, text, (frf, analytical))


def _write(
    path: Path | str,
    name: str,
    picture: Any,
    bars: Any | None,
    log: Callable[[Any], None],
    inside: LawScene,
    recording: Recording,
    text: str,
    responses: tuple[FrequencyResponse | None, FrequencyResponse | None],
) -> Path:
    papers = [rrb.TextDocumentView(name="facts", origin="/facts")]
    pictures = response_pictures(*responses)
    if pictures:
        papers.insert(0, rrb.Tabs(*(view for _, view, _ in pictures), name="frequency responses"))
    spectra = SpectrumScene(recording) if recording.is_uniform else None
    pages = [
        ("traces", trace_views(recording)),
        ("spectra", spectra.views() if spectra is not None else []),
        ("controller", inside.views()),
    ]
    with rrd_file(path, name, blueprint(arranged(picture, bars, pages, papers)), identity_of(recording)) as stream:
        log(stream)
        log_traces(stream, recording)
        if spectra is not None:
            spectra.log(stream, recording)
        inside.log(stream, recording)
        for origin, _, image in pictures:
            stream.log(origin, rr.EncodedImage(contents=image, media_type="image/png"), static=True)
        log_document(stream, text)
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
    """Write two overlaid recordings with their difference, channel by channel.

    Parameters
    ----------
    path : Path or str
        Output file.
    measured : Recording
        Measured recording.
    simulated : Recording
        Simulated recording.
    channels : sequence of str or None
        Drawn channels; all common channels by default.
    title : str
        Title of the scene.
    facts : mapping or None
        Further lines of the document.

    Returns
    -------
    Path
        Written file.

    Raises
    ------
    BadRecording
        The recordings do not overlap in time, or a channel has two units.
    OutputRefused
        The file cannot be written.
    """
    names = [n for n in measured.names if n in simulated.names] if channels is None else list(channels)
    if not names:
        raise unknown_name("common channel", ", ".join(measured.names), simulated.names)
    found = [(measured.channels[measured.index(name)], *aligned(measured, simulated, name)) for name in names]
    rows, lines = [], ["", "| channel | unit | rms measured | rms residual | residual |", "|---|---|---|---|---|"]
    for i, (channel, _, truth, model) in enumerate(found):
        label = f"{channel_label(channel)} [{axis_unit(channel.unit)[1]}]"
        over = plot_view(label, f"/comparison/{i}", contents=["$origin/measured", "$origin/nominal"])
        rest = plot_view(f"residual [{axis_unit(channel.unit)[1]}]", f"/comparison/{i}", contents=["$origin/residual"])
        rows.append(rrb.Horizontal(over, rest, column_shares=[3, 2], name=plain(channel.name)))
        levels = f"{np.sqrt(np.mean(truth**2)):.3g} | {np.sqrt(np.mean((truth - model) ** 2)):.3g}"
        percent = f"{residual_percent(truth, model):.3g} %"
        lines.append(f"| {cell(channel.name)} | {cell(pretty_unit(channel.unit))} | {levels} | {percent} |")
    pages = [
        rrb.Vertical(*rows[i : i + ROWS], name=f"channels {i + 1} to {min(i + ROWS, len(rows))}")
        for i in range(0, len(rows), ROWS)
    ]
    document = rrb.TextDocumentView(name="facts", origin="/facts")
    layout = blueprint(rrb.Horizontal(rrb.Tabs(*pages) if len(pages) > 1 else pages[0], document, column_shares=[3, 1]))
    with rrd_file(path, title, layout, identity_of(measured, simulated)) as stream:
        for i, (channel, time, measured_si, simulated_si) in enumerate(found):
            factor, _ = axis_unit(channel.unit)
            truth, model = factor * measured_si, factor * simulated_si
            curves = (
                ("measured", truth, 2.5),
                ("nominal", model, 1.5),
                ("residual", truth - model, 1.5),
            )
            for what, values, width in curves:
                log_series(stream, f"comparison/{i}/{what}", time, values, what, role_rgb(what), width=width)
        log_document(stream, fact_list(title, facts or {}) + "\n" + "\n".join(lines))
    return Path(path)
