"""Report of a modal test: tables and figures."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from vlab.lab.plant_modes import HZ_ERROR, LEAST_MAC, ZETA_ERROR, FoundMode
from vlab.modal.dwell import DwellResult
from vlab.modal.mac import mac, match_modes
from vlab.modal.modal_test import ModalTestResult
from vlab.signals import Array, ModalModel
from vlab.views.figures import frf_figure, mac_figure, to_svg
from vlab.views.figures.modal_test import distortion_figure, indicator_figure, shapes_figure, stabilisation_figure
from vlab.views.reports.page import Section, write_report

DRAWN = 8
"""DRAWN [-]: most drawn responses, and most outputs with drawn distortion; the JSON holds all numbers."""
DISTORTED = 2
MUCH_LEFT = 0.1
"""MUCH_LEFT [-]: relative residual above which its frequency band is reported."""
RINGING = 0.03
"""RINGING [-]: remaining transient at the start of averaging above which it is reported; it biases damping by some per
cent."""


def found_rows(found: Sequence[FoundMode]) -> list[list[Any]]:
    """Return one row per mode of the plant, under `FOUND_HEADERS`."""
    return [
        [i + 1, m.hz, m.found_hz, 100 * m.hz_error, m.zeta, m.found_zeta, 100 * m.zeta_error, m.mac, m.ok]
        for i, m in enumerate(found)
    ]


FOUND_HEADERS = ("mode", "plant Hz", "found Hz", "error %", "plant zeta", "found zeta", "error %", "MAC", "ok")
MODE_HEADERS = ("mode", "Hz", "sd", "zeta", "sd", "confidence")
LEVEL_HEADERS = ("output", "noise dB", "nonlinear dB", "even lines dB", "odd lines dB")


def mode_rows(result: ModalTestResult) -> list[list[Any]]:
    """Return one row per mode, under `MODE_HEADERS`."""
    e = result.poles
    columns = zip(e.freq, e.freq_sd, e.zeta, e.zeta_sd, e.confidence, strict=True)
    return [[i + 1, *(float(v) for v in values)] for i, values in enumerate(columns)]


def doubts(result: ModalTestResult) -> list[str]:
    """Return the reservations about the modes, one sentence each.

    Parameters
    ----------
    result : ModalTestResult
        Result of the modal test.

    Returns
    -------
    list of str
        Sentences.
    """
    out = list(result.notes)
    if result.poles.residual > MUCH_LEFT:
        low, high = result.misfit_band()
        inside = int(np.count_nonzero((result.poles.freq >= low) & (result.poles.freq <= high)))
        if inside:  # a band without these lines would lack the modes, too
            beside = f"{inside} identified mode{'s' * (inside > 1)}"
            remedy = f"beside {beside}: noise, which a longer record reduces, or a mode that the fit lacks"
        else:
            remedy = "where no mode was identified; if that is noise, exclude it with --band"
        out.append(f"90 % of the residual of the fit lies from {low:.4g} to {high:.4g} Hz, {remedy}.")
    short = {
        s.period_s
        for s, skip in zip(result.signals, result.skipped_s, strict=True)
        if s.kind == "periodic" and skip is None
    }
    for period in sorted(p for p in short if p is not None):
        out.append(
            f"Fewer than two periods of the excitation ({period:g} s) were recorded: the response leaks, and damping is biased; record "
            f"at least {2 * period:g} s."
        )
    left = result.still_ringing()
    if left.size and left.max() > RINGING:
        j = int(np.argmax(left))
        e = result.poles
        settled = np.log(1 / RINGING) / (e.zeta[j] * 2 * np.pi * e.freq[j])
        out.append(
            f"Mode {j + 1} still rang from the start, at {100 * left[j]:.2g} % of it, where the averaged periods begin: its damping is "
            f"biased; record at least {2 * settled:.3g} s, of which the first half is left out."
        )
    return out


def level_rows(levels: Sequence[dict[str, Any]]) -> list[list[Any]]:
    """Return noise and distortion relative to the linear output, under `LEVEL_HEADERS`."""
    keys = ("noise_db", "nonlinear_db", "even_db", "odd_db")
    return [[row["output"], *(_level(row[key]) for key in keys)] for row in levels]


def _level(value: float | None) -> str | None:
    if value is None:
        return None
    return f"{value:.1f}" if np.isfinite(value) else "in the noise"


def write_modal_test(
    result: ModalTestResult,
    folder: Path,
    *,
    title: str,
    found: Sequence[FoundMode] = (),
    true: ModalModel | None = None,
) -> None:
    """Write ``report.html`` and every figure as SVG.

    Parameters
    ----------
    result : ModalTestResult
        Result of the modal test.
    folder : Path
        Output folder.
    title : str
        Title of the page.
    found, true : sequence of FoundMode, and ModalModel
        Modes of the simulated plant beside those of the test.
    """
    figures: dict[str, tuple[str, str]] = {}

    def draw(name: str, figure: Any, caption: str) -> tuple[str, str]:
        figures[name] = (to_svg(figure), caption)
        return figures[name]

    sections = [_modes(result, found)]
    chart = draw("stabilisation", stabilisation_figure(result.poles), "Poles over the order of the model.")
    sections.append(Section(title="Stabilisation", figures=[chart]))
    sections.append(_shapes(result, true, draw))
    if len(result.mean.inputs) > 1:
        sections.append(_forces(result, draw))
    responses = []
    pairs = [(o, i) for i in result.mean.inputs for o in result.mean.outputs]
    for output, into in pairs[:DRAWN]:
        figure = frf_figure(result.mean, result.poles.fitted, output=output, input=into, labels=("estimated", "fitted"))
        name = f"frf-{output}" if len(result.mean.inputs) == 1 else f"frf-{output}-from-{into}"
        responses.append(draw(name, figure, f"Displacement at {output} from {into}, measured and fitted."))
    left = f" Of {len(pairs)} responses the first {DRAWN} are drawn." if len(pairs) > DRAWN else ""
    text = f"The residual of the fit is {100 * result.poles.residual:.2g} % of the responses.{left}"
    if result.mean.added_decay:
        text += (
            f" The responses are those of the windowed records, with {result.mean.added_decay:.4g} 1/s of decay added by the "
            "exponential window; it is taken out of the modes above."
        )
    sections.append(Section(title="Frequency responses", text=[text], figures=responses))
    sections += [_distortion(part, draw) for part in result.distortion]
    summary = [_origin(result)]
    write_report(folder / "report.html", title=title, sections=sections, summary=[*summary, *doubts(result)])
    for name, (svg, _) in figures.items():
        (folder / f"{''.join(c if c.isalnum() or c in '-+._' else '-' for c in name)}.svg").write_text(
            svg, encoding="utf-8"
        )


def _origin(result: ModalTestResult) -> str:
    """Return one sentence on the data."""
    inputs = ", ".join(result.mean.inputs)
    if not result.signals:
        return f"{result.n_given()} given frequency response{'s' * (result.n_given() > 1)}; inputs: {inputs}."
    kinds = ", ".join(dict.fromkeys(s.kind for s in result.signals))
    recognised = " (recognised from the samples)" if any(s.is_recognised for s in result.signals) else ""
    count = len(result.responses)
    return f"{count} recording{'s' * (count > 1)}; excitation: {kinds}{recognised}; inputs: {inputs}."


def _modes(result: ModalTestResult, found: Sequence[FoundMode]) -> Section:
    tables: list[tuple[Sequence[str], Sequence[Sequence[Any]]]] = [(MODE_HEADERS, mode_rows(result))]
    text = []
    if found:
        good = sum(m.ok for m in found)
        text.append(
            f"{good} of {len(found)} modes of the plant are found within {100 * HZ_ERROR:g} % of the frequency, "
            f"{100 * ZETA_ERROR:g} % of the damping ratio and with a MAC of at least {LEAST_MAC:g}."
        )
        tables.append((FOUND_HEADERS, found_rows(found)))
    return Section(title="Modes", text=text, tables=tables)


def _shapes(result: ModalTestResult, true: ModalModel | None, draw: Any) -> Section:
    estimated, peaks, freq = result.poles.real_shapes(), result.peak_shapes(), result.poles.freq.tolist()
    beside = None if true is None else _paired(result, true)
    shapes = draw(
        "shapes",
        shapes_figure(result.poles.freq, estimated, peaks, result.mean.outputs, true=beside),
        "Mode shapes from the fit and from the levels at the peaks, largest deflection 1.",
    )
    likeness = draw(
        "mac-peak",
        mac_figure(mac(estimated, peaks), rows="fit", columns="peak level", row_freq=freq, column_freq=freq),
        "MAC of the shapes from the fit with those from the peaks: where modes are close, peaks mix their shapes.",
    )
    figures = [shapes, likeness]
    own = mac_figure(mac(estimated, estimated), rows="fit", columns="fit", row_freq=freq, column_freq=freq)
    figures.append(
        draw("mac", own, "MAC of the shapes from the fit with each other: how well the sensors tell them apart.")
    )
    if true is not None:
        against = mac_figure(
            mac(estimated, true.shapes), rows="fit", columns="plant", row_freq=freq, column_freq=true.freq.tolist()
        )
        figures.append(draw("mac-plant", against, "MAC of the shapes from the fit with the plant's own."))
    if len(result.mean.inputs) == 1:
        return Section(title="Mode shapes", figures=figures)
    rows = [[i + 1, freq[i], *shape] for i, shape in enumerate(result.poles.real_participation().T.tolist())]
    text = (
        "Shapes at the inputs, from the participation of each input: by reciprocity those at the places of the forces."
    )
    return Section(
        title="Mode shapes", text=[text], tables=[(("mode", "Hz", *result.mean.inputs), rows)], figures=figures
    )


def _paired(result: ModalTestResult, true: ModalModel) -> Array:
    """Return the plant's shape of each identified mode."""
    out = np.full((len(result.mean.outputs), result.poles.freq.size), np.nan)
    pairing = match_modes(true, result.poles.to_modal_model())
    for a, b in zip(pairing.a, pairing.b, strict=True):
        shape = true.shapes[:, a] / true.shapes[np.argmax(np.abs(true.shapes[:, a])), a]
        out[:, b] = shape.real
    return out


def _forces(result: ModalTestResult, draw: Any) -> Section:
    headers = ("mode", "Hz", "indicator", *result.mean.inputs)
    rows = [[i + 1, f.hz, f.indicator, *f.forces.tolist()] for i, f in enumerate(result.forces)]
    figure = draw(
        "indicator", indicator_figure(result.poles.fitted, result.poles.freq), "Multivariate mode indicators."
    )
    text = (
        "Forces in phase or in opposition that hold each mode alone; the nearer the indicator is to 0, the purer it is."
    )
    return Section(title="Force appropriation", text=[text], tables=[(headers, rows)], figures=[figure])


def _distortion(part: Any, draw: Any) -> Section:
    text = [
        f"From {part.realisations} realisation{'s' * (part.realisations > 1)} of {part.periods} periods. What differs from "
        "period to period is noise; what differs between realisations beyond it is nonlinear distortion; what comes out at "
        "lines that are not excited is even or odd distortion. Powers relative to the linear output, in one realisation."
    ]
    if part.total_sd is None:
        text.append(
            "One realisation does not tell noise-like distortion from the linear response; record others with other seeds."
        )
    names = part.outputs[:DISTORTED]
    figures = [
        draw(f"distortion-{name}-from-{part.input}", distortion_figure(part, name), f"Output at {name}, line by line.")
        for name in names
    ]
    return Section(
        title=f"Noise and distortion, {part.input}",
        text=text,
        tables=[(LEVEL_HEADERS, level_rows(part.levels()))],
        figures=figures,
    )


def write_dwells(dwells: Sequence[DwellResult], folder: Path, *, title: str) -> None:
    """Write ``report.html`` of modes held by dwells."""
    headers = ("mode", "driven Hz", "indicator", "decay Hz", "decay zeta", "decay residual")
    rows = [[i + 1, d.hz, d.indicator, d.decay_hz, d.decay_zeta, d.decay_residual] for i, d in enumerate(dwells)]
    shapes = [[name, *(float(d.shape[k]) for d in dwells)] for k, name in enumerate(dwells[0].outputs)]
    sections = [
        Section(title="Modes held by dwells", tables=[(headers, rows)]),
        Section(title="Mode shapes", tables=[(("output", *(f"{d.hz:.4g} Hz" for d in dwells)), shapes)]),
    ]
    write_report(folder / "report.html", title=title, sections=sections)
