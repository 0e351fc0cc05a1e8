"""Report of a diagnosis: findings, places, laws, gap closed, open alternatives."""

import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from vlab.cases.misfit import BANDS, misfit
from vlab.diagnose.advice import RATIO_OF_SEARCH, RESERVED, attempt_sentence, before_heading, format_probability
from vlab.diagnose.diagnosis import Finding, RejectedCase
from vlab.diagnose.export import CASE, Done, ExtendedModelFiles, write_extended_model
from vlab.diagnose.findings import TOLD
from vlab.diagnose.frequency_pipeline import FrequencyDiagnosed
from vlab.diagnose.pipeline import Diagnosed
from vlab.diagnose.validation.gap import gap_closed, total, whole_gap
from vlab.files.output_folder import finite
from vlab.files.text import as_sentence, in_digits
from vlab.parallel import side_by_side
from vlab.physics.catalogue import EFFECTS
from vlab.recordings.files import written_whole
from vlab.standalone.answer import FOLDER
from vlab.views.figures import pretty_unit, to_svg
from vlab.views.figures.diagnosis import calibration_figure, force_figure, ranking_figure
from vlab.views.figures.diagnosis_response import responses
from vlab.views.figures.model_drawing import model_figure
from vlab.views.figures.restoring_force import restoring_force
from vlab.views.reports.diagnosis_figures import drawn_terms, mismatch_picture, overlay, values_of, worst_first
from vlab.views.reports.diagnosis_frequency import frequency_sections, write_frequency_scene
from vlab.views.reports.diagnosis_summary import headline, summary, title_of, verdict_sentence
from vlab.views.reports.page import Section, write_report
from vlab.views.reports.rejected_case import write_stopped, write_stopped_page
from vlab.views.rerun.diagnosis import write_scene

FIGURES = {"Measured, calibrated and extended": "overlay.svg", "The missing force": "missing-force.svg"}
"""FIGURES: sections whose first figure is also a file."""
OVERLAYS = 4
"""OVERLAYS [-]: most channels drawn over time, the worst of every recording in turn."""
NOTHING = "no added physics"
OF_SHARES = "The column explains is the share of the mismatch that comes back without the effect, so the shares need not add up to 100 %."
"""OF_SHARES: note on the shares of several effects."""
VALUES = ("effect", "place", "parameter", "value", "unit", "90 % interval")
ROWS = 24
"""ROWS [-]: most rows of the mismatch picture and of the calibrated parameters."""
REPRODUCED = 0.05
"""REPRODUCED [-]: relative NRMSE difference up to which the written model reproduces the diagnosis. MuJoCo integrates
its own elements slightly differently from a law that acts as a force."""


def write_diagnosis(done: Done | RejectedCase, folder: Path) -> list[Section]:
    """Write ``diagnosis.json``, ``report.html``, main figures, ``run.rrd`` and the extended model.

    A diagnosis that ended before its search has a report only.

    Parameters
    ----------
    done : Done or RejectedCase
        Completed diagnosis, or rejected case.
    folder : Path
        Output folder.

    Returns
    -------
    list of Section
        Sections of the report.

    Raises
    ------
    OutputRefused
        A file cannot be written.
    """
    if isinstance(done, RejectedCase):
        return write_stopped(done, folder)
    files = write_extended_model(done, folder)
    document = {
        **done.diagnosis.to_json(),
        "notes": [*done.diagnosis.notes, *files.notes],
        "amended": {"files": list(files.files), "effects": list(files.tables), "nrmse_run_again": files.nrmse},
        "mujoco": None if files.mujoco is None else files.mujoco.to_json(),
    }
    with written_whole(folder / "diagnosis.json") as stream:
        stream.write((json.dumps(finite(document), indent=2, allow_nan=False) + "\n").encode())
    title = done.diagnosis.title or done.problem.case.path.parent.name
    parts = write_page(done, folder / "report.html", files)
    for part in parts:
        if part.title in FIGURES and part.figures:
            (folder / FIGURES[part.title]).write_text(part.figures[0][0], encoding="utf-8")
    if isinstance(done, FrequencyDiagnosed):
        write_frequency_scene(folder / "run.rrd", done, title=title, verdict=verdict_sentence(done))
    elif done.diagnosis.checked:
        facts = {"verdict": verdict_sentence(done), "next measurement": done.diagnosis.next_measurement}
        write_scene(folder / "run.rrd", done.diagnosis.tried, title=title, facts=facts)
    return parts


def write_page(done: Done | RejectedCase, path: Path, files: ExtendedModelFiles | None = None) -> list[Section]:
    """Write the report of a diagnosis to a file.

    Parameters
    ----------
    done : Done or RejectedCase
        Completed diagnosis, or rejected case.
    path : Path
        HTML file.
    files : ExtendedModelFiles or None
        Files of the extended model, if written.

    Returns
    -------
    list of Section
        Sections of the report.

    Raises
    ------
    OutputRefused
        The file cannot be written.
    """
    if isinstance(done, RejectedCase):
        return write_stopped_page(done, path)
    title = title_of(done.diagnosis.title, done.problem.case)
    parts, head = sections(done, files), headline(done, is_in_folder=files is not None)
    write_report(path, title=title, summary=summary(done), sections=parts, headline=head)
    return parts


def _number(value: float) -> str:
    return f"{value:.4g}"


# ---- sections -------------------------------------------------------------------------------------------------------


def sections(done: Done, files: ExtendedModelFiles | None = None) -> list[Section]:
    """Return the sections of the report in reading order.

    Parameters
    ----------
    done : Done
        Completed diagnosis.
    files : ExtendedModelFiles or None
        Files of the extended model, if written.

    Returns
    -------
    list of Section
        Sections of the report.
    """
    diagnosis = done.diagnosis
    makers: list[Callable[[], list[Section]]] = [lambda: [_found(done)], lambda: [_drawing(done)]]
    if isinstance(done, FrequencyDiagnosed):
        makers.append(lambda: frequency_sections(done))
    else:
        if diagnosis.checked:
            makers.append(lambda: [_overlays(done)])
        if drawn_terms(done):
            makers.append(lambda: [_forces(done)])
    if diagnosis.checked:
        makers.append(lambda: [_errors(done)])
    makers.append(lambda: [_alternatives(done)])
    if not isinstance(done, FrequencyDiagnosed) and any(c.standing is not None for c in diagnosis.checked):
        makers.append(lambda: [_mismatch(done)])
    if done.problem.parameters:
        makers.append(lambda: [_calibration(done)])
    out = [section for part in side_by_side(lambda make: make(), makers) for section in part]
    out.append(
        Section(
            title="Not excluded",
            text=tuple(map(as_sentence, diagnosis.not_excluded))
            or ("No other effect and no other place that was tried fits as well.",),
        )
    )
    out.append(Section(title="Next measurement", text=(as_sentence(diagnosis.next_measurement),)))
    out.append(Section(title="Quality of the recordings", text=diagnosis.quality or ("No damage was found.",)))
    if files is not None:
        out.append(_files(done, files))
        out += _without_vlab(files)
    out.append(Section(title="How long it took", text=(f"{diagnosis.seconds:.1f} s.",)))
    return out


def _found(done: Done) -> Section:
    diagnosis = done.diagnosis
    if not diagnosis.findings:
        attempt = diagnosis.attempt
        rows = () if attempt is None else _values(attempt.findings)
        return Section(title="What was found", text=_nothing(done), tables=[(VALUES, rows)] if rows else [])
    table = [
        [
            f.name,
            f.family,
            f.site,
            ", ".join(f.places_90),
            format_probability(f.probability),
            None if not math.isfinite(f.explained) else 100.0 * f.explained,
            ", ".join(f.alike[1:]) or None,
            ", ".join(f.verified_by) or "none",
        ]
        for f in diagnosis.findings
    ]
    heads = (
        "effect",
        "family",
        "place",
        "90 % credible set",
        "probability",
        "explains %",
        "indistinguishable from",
        "verified by",
    )
    return Section(
        title="What was found",
        text=(
            *(f"{f.name}: {f.law}" for f in diagnosis.findings),
            *([OF_SHARES] if len(diagnosis.findings) > 1 else []),
        ),
        tables=[(heads, table), (VALUES, _values(diagnosis.findings))],
    )


def _values(findings: Sequence[Finding]) -> list[list[Any]]:
    """Return the parameters of findings, one row each."""
    return [
        [f.name, place, name, _number(p["value"]), pretty_unit(p["unit"]), " to ".join(map(_number, p["ci90"]))]
        for f in findings
        for place, parameters in f.places
        for name, p in parameters.items()
    ]


def _nothing(done: Done) -> tuple[str, ...]:
    attempt = done.diagnosis.attempt
    if done.diagnosis.verdict == "nothing-missing":
        return (
            "No physics was added. The residual of the calibrated model is compared with the noise below; "
            f"on the fit recordings the residual is {in_digits(done.found.before.normalised_residual)} times the noise.",
        )
    if done.diagnosis.verdict == "bad-recording":
        if all(a["effect"] == "nothing" for a in done.diagnosis.alternatives):
            return ("These recordings were not searched.",)
        return ("An effect may look like this damage, so these recordings were searched: no effect explains them.",)
    if attempt is not None and attempt.is_of_the_fit_alone:
        return (attempt_sentence(attempt), *(f"{f.name}: {f.law}" for f in attempt.findings))
    rest = "No effect of the catalogue explains the residual, shown below by channel, frequency and time."
    if attempt is None:
        return (f"{rest} No fit held on the checked recordings.",)
    return (rest, attempt_sentence(attempt), *(f"{f.name}: {f.law}" for f in attempt.findings))


def _drawing(done: Done) -> Section:
    marks = _marks(done)
    if marks:
        caption = "The model at rest with the places found: filled the likeliest of each finding, rings where else it may be, with probabilities."
    else:
        caption = "The model at rest. No place is marked, because nothing was found."
    caption += (
        " Dashed: tendons; small circles: joints, with an arrow where they slide."
        if done.problem.case.structure is None
        else ""
    )
    drawing = model_figure(done.problem.plant, marks, structure=done.problem.case.structure)
    return Section(title="Where", figures=[(to_svg(drawing), caption)])


def _marks(done: Done) -> list[tuple[str, float]]:
    """Return the marked places with probabilities.

    The first finding has its 90 % credible set, each further finding its best place.
    """
    marks: dict[str, float] = {}
    for finding in done.diagnosis.findings:
        first = done.choice.best.terms[0].effect.name if done.choice.best.terms else ""
        places = done.choice.places if finding.form == first else {}
        for place in finding.places_90:
            marks.setdefault(place, finding.probability * places.get(place, 1.0))
    return list(marks.items())


def _overlays(done: Diagnosed) -> Section:
    checked, figures, text = done.diagnosis.tried, [], []
    what = (
        "Held-out recordings: the search never saw them."
        if done.diagnosis.is_held_out
        else "Recordings that the models were fitted to: none was held out."
    )
    pairs, drawn = worst_first(checked), set()
    for run, name in pairs[:OVERLAYS]:
        calibrated = run.standing
        if calibrated is None:
            text.append(f"{run.name}: neither the nominal nor the calibrated model can follow this recording.")
            continue
        errors = run.channels[name]
        drawing = overlay(run, calibrated, name)
        caption = f"{run.name} ({run.role}), {name}. NRMSE: {run.stands} {errors[1]:.3g}, extended {errors[2]:.3g}, noise {errors[3]:.3g}."
        if run.extended is not None and not done.diagnosis.findings:
            caption += " The extended model is the best attempt, which is not reported as a finding."
        figures.append((to_svg(drawing), caption))
        if run.name not in drawn:
            drawn.add(run.name)
            figures += responses(run, name)
    if len(pairs) > OVERLAYS:
        text.append(f"Channels of these recordings in run.rrd and in the table below alone: {len(pairs) - OVERLAYS}.")
    return Section(title="Measured, calibrated and extended", text=(what, *text), figures=figures)


def _forces(done: Diagnosed) -> Section:
    figures = []
    attempt = done.diagnosis.attempt
    text = "The best force law that was tried, in colour, does not explain enough. The estimated force, in grey, remains unnamed."
    if attempt is not None and attempt.is_of_the_fit_alone:
        text = "The force law of the fit recordings alone, in colour, which no held-out recording verifies; the estimated force, in grey."
    for term in drawn_terms(done):
        found = restoring_force(done, term)
        values = values_of(term, done.problem)
        drawing = force_figure(found.curves, found.label, series=found.series)
        figures.append((to_svg(drawing), f"{found.words} Law: {term.effect.law}; {values}. Below: a stretch in time."))
    return Section(title="The missing force", text=() if done.diagnosis.findings else (text,), figures=figures)


def _errors(done: Done) -> Section:
    checked = done.diagnosis.tried
    before, after = before_heading(checked), "extended" if done.diagnosis.attempt is None else "best attempt"
    rows: list[list[Any]] = []
    for run in checked:
        rows.append([run.name, run.role, "all", *_row(run.nominal, run.before, run.after, run.noise, run.gap_closed)])
        if len(run.channels) > 1:
            for name, errors in run.channels.items():
                gap = None if run.is_idle else gap_closed(*errors[1:])
                rows.append(["", "", name, *_row(*errors, gap)])
    keys = ("nominal", "before", "after", "noise")
    rows.append(["all", "", "", *_row(*(total(checked, key) for key in keys), whole_gap(checked))])
    headers = ("recording", "role", "channel", "nominal", before, after, "noise", "gap closed %")
    is_in_time = not isinstance(done, FrequencyDiagnosed)
    error = "rms over that of the recording about its mean (NRMSE)" if is_in_time else "relative, as defined above"
    text = (
        f"Error: {error}. Nominal: the model of the case. Calibrated: its uncertain "
        "parameters fitted to the fit recordings. Extended: with the physics found. Gap closed: (calibrated - extended)/(calibrated - noise). The "
        "nominal error replaces a larger calibrated one. A dash: no gap beyond the noise, or no effect of the physics found.",
    )
    return Section(title="How far the models are from the recordings", text=text, tables=[(headers, rows)])


def _row(*values: float | None) -> list[Any]:
    *errors, gap = values
    return [
        *("cannot follow" if e is None or not math.isfinite(e) else float(e) for e in errors),
        None if gap is None or not math.isfinite(gap) else 100.0 * gap,
    ]


def _alternatives(done: Done) -> Section:
    diagnosis, choice, before = done.diagnosis, done.choice, done.found.before.normalised_residual
    is_told = diagnosis.verdict in TOLD
    key = "probability" if is_told else "remaining_share"
    options = [(_option(a["effect"], a["place"]), float(a[key]), float(a["remaining"])) for a in diagnosis.alternatives]
    best = choice.best
    is_listed = bool(best.terms) and not diagnosis.is_naming
    own = choice.probability if best.terms else max(0.0, 1.0 - sum(p for _, p, _ in options))
    if not is_listed:
        share = own if is_told else best.normalised_residual / max(before, 1e-300)
        options.insert(0, (best.label if best.terms else NOTHING, share, best.normalised_residual))
    text = (
        f"Probabilities of the effects that were fitted, from the fit recordings alone ({RESERVED}), and the residual of each in multiples of "
        f"the noise. The residual of the calibrated model without any effect is {in_digits(before)} times the noise."
        if is_told
        else "Residual of each fitted effect on the fit recordings, as a share of the residual of the calibrated model, and in multiples "
        f"of the noise. The residual of the calibrated model without any effect is {in_digits(before)} times the noise.",
        as_sentence(RATIO_OF_SEARCH),
    )
    is_reported = any(f.form == t.effect.name for f in diagnosis.findings for t in best.terms)
    chosen = 0 if is_reported or (diagnosis.verdict == "nothing-missing" and not best.terms) else -1
    if chosen == 0:
        caption = "Ranking; dark: what is reported."
    elif diagnosis.findings:
        read_off = ", ".join(f.name for f in diagnosis.findings)
        caption = f"Ranking of what was fitted beside what the recordings themselves show ({read_off}), which stands first in this report."
    else:
        caption = "Ranking; nothing of it is reported: see the verdict."
    return Section(
        title="Alternatives",
        text=text,
        figures=[(to_svg(ranking_figure(options, chosen, is_probability=is_told)), caption)],
    )


def _option(effect: str, place: str) -> str:
    if effect == "nothing":
        return NOTHING
    parts = list(zip(effect.split(" + "), place.split(" + "), strict=False))
    return " + ".join(f"{e}@{p}" if p else e for e, p in parts) or effect


def _mismatch(done: Diagnosed) -> Section:
    followed = [(run, run.standing) for run in done.diagnosis.checked]
    pairs = [(run, own, name) for run, own in followed if own is not None for name in run.channels][:ROWS]
    found = [(run, name, misfit(run.measured, own, name)) for run, own, name in pairs]
    common = max(m.band_edges_hz[0] for _, _, m in found), min(m.band_edges_hz[-1] for _, _, m in found)
    text = []
    if common[0] >= common[1]:  # no common frequency band
        others = {run.name for run, _, _ in found} - {found[0][0].name}
        found = [f for f in found if f[0] is found[0][0]]
        text.append(f"Other frequencies, not shown: {', '.join(sorted(others))}.")
    low, high = max(m.band_edges_hz[0] for _, _, m in found), min(m.band_edges_hz[-1] for _, _, m in found)
    edges = np.geomspace(low, high, BANDS + 1).tolist()
    is_nominal = any(c.stands == "nominal" for c in done.diagnosis.checked)
    what = "the nominal or calibrated model" if is_nominal else "the calibrated model"
    parts = [
        (r, n, misfit(r.measured, r.standing, n, band_edges_hz=edges)) for r, n, _ in found if r.standing is not None
    ]
    scale = max((float(np.max(m.window_nrmse, initial=m.nrmse)) for _, _, m in parts), default=None)
    figures = [
        (
            mismatch_picture(parts, edges, what, scale),
            f"Residual of {what}, without any hypothesis: by frequency band and over time.",
        )
    ]
    if done.diagnosis.findings:
        with_physics = [
            (r, n, misfit(r.measured, r.extended, n, band_edges_hz=edges))
            for r, n, _ in found
            if r.extended is not None
        ]
        if with_physics:
            figures.append(
                (
                    mismatch_picture(with_physics, edges, "extended model", scale),
                    "The same with the physics found, on the same colours.",
                )
            )
    return Section(title="Where the mismatch is", text=text, figures=figures)


def _calibration(done: Done) -> Section:
    rows = [(p.name, float(v), p.sd) for p, v in zip(done.problem.parameters, done.fit.theta, strict=True)]
    order = sorted(rows, key=lambda r: -abs(r[1]) / r[2])[:ROWS]
    text = [
        "Uncertain parameters of the model, calibrated together with the reported physics: the factor on the nominal value, and its prior."
    ]
    far = [name for name, value, sd in rows if abs(value) > 2.5 * sd]
    if far:
        text.append(
            f"At the edge of what the case allows: {', '.join(far)}. Check these numbers of the model, or state a wider [model.uncertain]."
        )
    if len(rows) > len(order):
        text.append(f"{len(rows) - len(order)} more moved less.")
    caption = "Grey bands: one and three prior standard deviations; diamonds: beyond 2.5."
    return Section(title="Calibrated parameters", text=text, figures=[(to_svg(calibration_figure(order)), caption)])


def _files(done: Done, files: ExtendedModelFiles) -> Section:
    what = "the physics found" if done.diagnosis.findings else "the calibrated parameters, no physics added"
    verb = "diagnose" if isinstance(done, FrequencyDiagnosed) else "compare"
    text = [
        f"{', '.join(files.files)}: the model with {what}, and a case with the recordings, for the command vlab {verb} {CASE}."
    ]
    checked = done.diagnosis.checked
    if not done.diagnosis.findings and total(checked, "calibrated") > total(checked, "nominal"):
        text.append("On the checked recordings the nominal model is nearer than this one.")
    if files.tables:
        text.append(
            f"Stated in the case, because the model file has no element for them: {', '.join(files.tables)}. "
            f"{CASE} is the complete model; the model file alone lacks these."
        )
    own = [t.effect.name for t in done.fit.terms if t.effect.name not in EFFECTS]
    if own:
        text.append(
            f"A case runs nobody's code, so {CASE} cannot be loaded: {', '.join(own)} is an effect of your own."
        )
    elif files.nrmse is None:
        text.append(f"The files could not be run again: {files.note}.")
    else:
        same = abs(files.nrmse - files.reported) <= REPRODUCED * max(files.reported, 1e-12)
        verdict = "the same" if same else "not the same; the diagnosis above is what was checked"
        text.append(
            f"Run again from these files alone: NRMSE {files.nrmse:.4g}; reported {files.reported:.4g} ({verdict})."
        )
    return Section(title="The extended model", text=text)


def _without_vlab(files: ExtendedModelFiles) -> list[Section]:
    """Return the section on files for MuJoCo alone, if any."""
    title, answer = "The answer without vlab", files.mujoco
    if answer is None:
        return [Section(title=title, text=tuple(f"{note}." for note in files.notes))] if files.notes else []
    named = ", ".join(f"{FOLDER}/{name}" for name in answer.files)
    text = [f"{named}: your model file with its changes, for MuJoCo alone."]
    if answer.uses:
        calls = ", ".join(f"law.{name}" for name in answer.uses)
        text.append(f"Call {calls} of {FOLDER}/law.py, whose first lines show how.")
    rows = [[label, "model.xml", element, None] for label, element in answer.native.items()]
    rows += [[label, "law.py", None, reason] for label, reason in answer.laws.items()]
    rows += [[label, "nowhere", None, reason] for label, reason in answer.not_written.items()]
    return [Section(title=title, text=text, tables=[(("effect", "stands in", "as", "why"), rows)] if rows else [])]
