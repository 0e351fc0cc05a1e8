"""Report of a run: traces, spectra, frequency responses, actuator effort, settings."""

from dataclasses import asdict
from pathlib import Path

import numpy as np

from vlab.lab.run_folder import DoneRun
from vlab.signals import Channel, FrequencyResponse, Recording, rms
from vlab.views.figures import frf_figure, pretty_unit, spectrum_figure, to_svg, traces_figure
from vlab.views.reports.page import Section, write_report
from vlab.views.rerun.documents import PICTURES, run_facts

CHANNELS = 8
"""CHANNELS [-]: most drawn channels; the page states their total."""
POINTS = 800
"""POINTS [-]: points of a drawn trace, its extremes at twice the resolution of the page."""
STRETCH_S = 2.0
"""STRETCH_S [s]: enlarged stretch at the end of a long run."""
EFFORT = ("actuator", "unit", "command, rms", "largest", "force with excitation, rms", "largest", "at the limit %")


def write_run_report(
    path: Path, done: DoneRun, frf: FrequencyResponse | None, analytical: FrequencyResponse | None
) -> Path:
    """Write the report of a run.

    Parameters
    ----------
    path : Path
        Output file.
    done : DoneRun
        Completed run.
    frf, analytical : FrequencyResponse or None
        Measured response, and the FE model's response in the same loop.

    Returns
    -------
    Path
        Written file.

    Raises
    ------
    OutputRefused
        The file cannot be written.
    """
    prepared, recording = done.prepared, done.result.recording
    settings = prepared.settings
    law = settings.law or "open loop"
    summary = (
        f"{settings.seconds:g} s on the {prepared.plant.name} plant, {law}, excitation {settings.excite}; "
        f"simulated at {done.real_time_factor:.0f} times real time.",
    )
    sections = [_facts(done), _effort(done), *_responses(frf, analytical), _histories(recording, settings.high_hz)]
    return write_report(path, title=f"{prepared.title}: {law}", sections=sections, summary=summary)


def _facts(done: DoneRun) -> Section:
    prepared, recording = done.prepared, done.result.recording
    facts = run_facts(prepared.plant, recording, prepared.settings.law, prepared.hardware)
    given = {key: value for key, value in asdict(prepared.settings).items() if value not in (None, "", ())}
    levels = [
        [c.name, pretty_unit(c.unit), rms(recording[c.name]), float(np.abs(recording[c.name]).max())]
        for c in recording.channels
    ]
    text = (
        "; ".join(f"{key}: {value}" for key, value in facts.items() if str(value)) + ".",
        "Settings: " + ", ".join(f"{key} = {_said(value)}" for key, value in given.items()) + ".",
    )
    return Section(title="What was run", text=text, tables=[(("channel", "unit", "rms", "largest"), levels)])


def _effort(done: DoneRun) -> Section:
    rows = [
        [e.at, e.unit, e.command_rms, e.command_peak, e.force_rms, e.force_peak, 100 * e.saturated_share]
        for e in done.result.effort
    ]
    limit = done.prepared.hardware.coil.limit
    text = f"The amplifiers give at most {limit:g} N." if limit else "The amplifiers have no limit in this run."
    return Section(title="Effort of the actuators", text=(text,), tables=[(EFFORT, rows)])


def _responses(frf: FrequencyResponse | None, analytical: FrequencyResponse | None) -> list[Section]:
    if frf is None:
        return []
    beside = "" if analytical is None else ", and the FE model's of the same loop with hold, delay and filter"
    figures = [
        (
            to_svg(frf_figure(frf, analytical, output, source, labels=("simulated", "FE model"))),
            f"{output} per {source}, estimated from the simulated record{beside}.",
        )
        for source in frf.inputs[:1]
        for output in frf.outputs[:PICTURES]
    ]
    return [Section(title="Frequency responses", figures=figures)]


def _histories(recording: Recording, high_hz: float | None) -> Section:
    shown = _shown(recording)
    names = [c.name for c in shown]
    left = len(recording.channels) - len(names)
    text = (f"Channels in the recording alone: {left}.",) if left else ()
    figures = [(to_svg(traces_figure([("run", recording)], names, limit=POINTS)), "The whole run.")]
    end = float(recording.time[-1])
    if end > 2 * STRETCH_S:
        zoom = traces_figure([("run", recording)], names, start=end - STRETCH_S, limit=POINTS)
        figures.append((to_svg(zoom), f"Its last {STRETCH_S:g} s."))
    responses = [c.name for c in shown if c.kind not in ("command", "excitation", "force")]
    if responses and recording.is_uniform:
        highest = None if high_hz is None else 1.2 * high_hz
        spectra = spectrum_figure([("run", recording)], responses, highest_hz=highest)
        figures.append((to_svg(spectra), "Amplitude spectral densities (Welch, Hann window)."))
    return Section(title="Time histories and spectra", text=text, figures=figures)


def _shown(recording: Recording) -> list[Channel]:
    """Return the drawn channels: drives, largest forces, first sensors."""
    driving = [c for c in recording.channels if c.is_input]
    forces = [c for c in recording.channels if c.kind == "force"]
    forces.sort(key=lambda c: -rms(recording[c.name]))
    sensors = [c for c in recording.channels if c.kind not in ("command", "excitation", "force")]
    chosen = {c.name for c in [*driving[:1], *forces[:2], *sensors[: CHANNELS - 3]]}
    return [c for c in recording.channels if c.name in chosen]


def _said(value: object) -> str:
    return "; ".join(map(str, value)) if isinstance(value, (tuple, list)) else str(value)
