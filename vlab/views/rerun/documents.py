"""Documents of a scene: facts, levels and responses."""

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from vlab.hardware.laboratory import Hardware
from vlab.plants.base import Plant
from vlab.signals import FrequencyResponse, Recording
from vlab.views.figures import frf_figure, pretty_unit, to_png
from vlab.views.rerun.rrd import plain

PICTURES = 4
"""PICTURES [-]: most drawn pairs of output and input of a frequency response."""


def cell(words: object) -> str:
    """Return text without links, images and HTML in Markdown."""
    return re.sub(r"([\\`*_{}\[\]()<>#+!|~$&])", r"\\\1", plain(words))


def fact_list(title: str, facts: Mapping[str, object]) -> str:
    """Return a heading and one line per fact with a value."""
    lines = [f"- **{cell(key)}**: {cell(value)}" for key, value in facts.items() if str(value)]
    return "\n".join([f"## {cell(title)}", "", *lines, ""])


def level_table(recording: Recording) -> str:
    """Return a table of rms and peak of every channel.

    Parameters
    ----------
    recording : Recording
        Recording.

    Returns
    -------
    str
        Markdown table.
    """
    lines = ["", "| channel | unit | rms | largest |", "|---|---|---|---|"]
    for channel in recording.channels:
        values = recording[channel.name]
        numbers = f"{np.sqrt(np.mean(values**2)):.3g} | {np.abs(values).max():.3g}"
        lines.append(f"| {cell(channel.name)} | {cell(pretty_unit(channel.unit))} | {numbers} |")
    return "\n".join(lines)


def run_facts(plant: Plant, recording: Recording, law: str, hardware: Hardware | None) -> dict[str, object]:
    """Return the main facts of a run.

    Parameters
    ----------
    plant : Plant
        Plant.
    recording : Recording
        Recording of the run.
    law : str
        Name of the law.
    hardware : Hardware or None
        Hardware of the laboratory.

    Returns
    -------
    dict
        Facts by heading.
    """
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


def log_document(stream: Any, text: str) -> None:
    """Log the document of the scene."""
    stream.log("facts", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)


def response_pictures(
    measured: FrequencyResponse | None, analytical: FrequencyResponse | None
) -> list[tuple[str, Any, bytes]]:
    """Return entity, view and image of the first channel pairs.

    Parameters
    ----------
    measured : FrequencyResponse or None
        Measured response.
    analytical : FrequencyResponse or None
        Analytical response.

    Returns
    -------
    list of (entity, view, image)
        Pictures.
    """
    first = measured if measured is not None else analytical
    if first is None:
        return []
    pairs = [(output, into) for into in first.inputs for output in first.outputs][:PICTURES]
    out = []
    for k, (output, into) in enumerate(pairs):
        view = rrb.Spatial2DView(name=plain(f"{output} from {into}"), origin=f"/frf/{k}", background=[255, 255, 255])
        figure = frf_figure(measured, analytical, output, into, labels=("simulated", "FE model"))
        out.append((f"frf/{k}", view, to_png(figure)))
    return out
