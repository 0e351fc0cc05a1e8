"""Report sections and Rerun file of a diagnosis in frequency."""

import hashlib
import uuid
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from matplotlib.figure import Figure

from vlab.diagnose.data.responses import Modes, Response
from vlab.diagnose.frequency_pipeline import FORMS, FrequencyDiagnosed
from vlab.diagnose.validation.frequency import CheckedFrequency, ModalAnswer
from vlab.views.figures import to_png, to_svg
from vlab.views.figures.diagnosis_frequency import modes_figure, response_overlay
from vlab.views.reports.page import Section
from vlab.views.rerun.documents import fact_list, log_document
from vlab.views.rerun.rrd import blueprint, plain, rrd_file

DRAWN = 6
"""DRAWN [-]: most drawn responses, the worst output of every data set in turn."""
MODELS = ("nominal", "calibrated", "extended")


def frequency_sections(done: FrequencyDiagnosed) -> list[Section]:
    """Return overlays and mismatch of the checked data.

    Parameters
    ----------
    done : FrequencyDiagnosed
        Completed diagnosis in frequency.

    Returns
    -------
    list of Section
        Sections in reading order.
    """
    what = (
        "Held-out data: the search never saw them."
        if done.diagnosis.is_held_out
        else "Data that the models were fitted to: none were held out."
    )
    text = [
        what,
        "The responses are those of the MuJoCo model near rest, with the effects found. Delays and effects of channels are factors in frequency.",
        "Errors of responses are relative: the difference over the mean magnitude of both, root mean square over the lines that stand above "
        "their noise. Errors of modes are relative differences; in their total, damping ratios and shapes count by their uncertainty.",
    ]
    pictures = figures(done)
    overlays = Section(
        title="Measured, calibrated and extended",
        text=text,
        figures=[(to_svg(f), caption) for _, f, caption in pictures],
    )
    return [overlays, _mismatch(done)]


def figures(done: FrequencyDiagnosed) -> list[tuple[str, Figure, str]]:
    """Return name, figure and caption of each drawing.

    Parameters
    ----------
    done : FrequencyDiagnosed
        Completed diagnosis in frequency.

    Returns
    -------
    list of (name, Figure, caption)
        Drawings.
    """
    diagnosis = done.diagnosis
    is_extended = bool(diagnosis.findings) or diagnosis.attempt is not None
    models = MODELS if is_extended else MODELS[:2]
    out = []
    responses = [c for c in diagnosis.tried if isinstance(c.measured, Response)]
    orders = [sorted(c.channels, key=lambda n, c=c: -c.channels[n][1]) for c in responses]  # type: ignore[misc]
    depth = max((len(order) for order in orders), default=0)
    pairs = [(c, order[k]) for k in range(depth) for c, order in zip(responses, orders, strict=True) if k < len(order)]
    for c, name in pairs[:DRAWN]:
        out.append(
            (f"{name} from {c.measured.input}", _response(c, name, models), _caption(c, name, is_extended, done))
        )
    for c in diagnosis.tried:
        if isinstance(c.measured, Modes):
            caption = f"{c.name} ({c.role}): measured over model, in per cent; grey: one standard deviation."
            out.append((c.name, _modes(c, c.measured, models), caption))
    return out


def _caption(c: CheckedFrequency, name: str, is_extended: bool, done: FrequencyDiagnosed) -> str:
    given, before, extended, noise = c.channels[name]
    text = f"{c.name} ({c.role}), {name}. Relative error: nominal {given:.3g}"
    text += ", smaller than the calibrated error" if c.is_spoilt else f", calibrated {before:.3g}"
    text += f", extended {extended:.3g}" if is_extended else ""
    text += f", noise {noise:.3g}."
    if is_extended and not done.diagnosis.findings:
        text += " The extended model is the best attempt, which is not reported as a finding."
    return text


def _response(c: CheckedFrequency, name: str, models: tuple[str, ...]) -> Figure:
    data = c.measured
    assert isinstance(data, Response)
    k = data.outputs.index(name)
    curves = [("measured", data.H[:, k])]
    for model, own in zip(models, c.answers, strict=False):
        assert isinstance(own, np.ndarray)
        curves.append((model, own[:, k]))
    return response_overlay(
        data.freq,
        curves,
        data.spread[:, k],
        unit=FORMS[data.order],
        title=f"{c.name}: {name} from {data.input}",
        has_phase=not data.is_magnitude,
    )


def _modes(c: CheckedFrequency, data: Modes, models: tuple[str, ...]) -> Figure:
    answers = [own for own in c.answers if isinstance(own, ModalAnswer)]
    named = list(zip(models, answers, strict=False))
    panels: list[Any] = [
        (
            "frequency [%]",
            [(name, 100 * np.log(data.freq / own.freq)) for name, own in named],
            100 * np.minimum(data.freq_sd, 1.0),
        )
    ]
    if np.isfinite(data.zeta).any():
        panels.append(
            (
                "damping ratio [%]",
                [(name, 100 * (data.zeta / own.zeta - 1)) for name, own in named],
                100 * np.minimum(data.zeta_sd, 1.0),
            )
        )
    if data.shapes.shape[1]:
        sd = 100 * data.shape_sd**2
        panels.append(("1 - MAC [%]", [(name, 100 * (1 - own.mac)) for name, own in named], sd))
    return modes_figure(data.freq, panels, title=f"{c.name}: measured beside the models")


def _mismatch(done: FrequencyDiagnosed) -> Section:
    found = done.diagnosis.mismatch
    rows = [
        [
            f"{b['low_hz']:.4g}" if b["low_hz"] == b["high_hz"] else f"{b['low_hz']:.4g} to {b['high_hz']:.4g}",
            100 * b["share"],
        ]
        for b in found["where_frequency_hz"]
    ]
    channels = [[c["channel"], c["nrmse"]] for c in found["where_channel"]]
    return Section(
        title="Where the mismatch is",
        text=("Residual of the nominal or calibrated model, without any hypothesis.",),
        tables=[(("frequency [Hz]", "share of the residual %"), rows), (("channel", "relative error"), channels)],
    )


def write_frequency_scene(path: Path, done: FrequencyDiagnosed, *, title: str, verdict: str) -> None:
    """Write figures and facts of a diagnosis in frequency.

    Parameters
    ----------
    path : Path
        Output file.
    done : FrequencyDiagnosed
        Completed diagnosis in frequency.
    title : str
        Title of the scene.
    verdict : str
        Verdict in one sentence.

    Raises
    ------
    OutputRefused
        The file cannot be written.
    """
    pictures = [(f"frequency/{k}", name, to_png(figure)) for k, (name, figure, _) in enumerate(figures(done))]
    views = [
        rrb.Spatial2DView(name=plain(name), origin=f"/{origin}", background=[255, 255, 255])
        for origin, name, _ in pictures
    ]
    facts = rrb.TextDocumentView(name="facts", origin="/facts")
    layout = blueprint(rrb.Horizontal(rrb.Tabs(*views), facts, column_shares=[3, 1]) if views else facts)
    content = hashlib.sha256(b"".join(image for _, _, image in pictures) + verdict.encode())
    identity = uuid.UUID(bytes=content.digest()[:16], version=4)
    with rrd_file(path, title, layout, identity) as stream:
        for origin, _, image in pictures:
            stream.log(origin, rr.EncodedImage(contents=image, media_type="image/png"), static=True)
        log_document(
            stream, fact_list(title, {"verdict": verdict, "next measurement": done.diagnosis.next_measurement})
        )
