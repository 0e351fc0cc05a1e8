"""Export of the extended model with its case."""

import copy
import math
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
import pyarrow.parquet

from vlab.cases.case import Case, load_case
from vlab.cases.clock import plan_clock
from vlab.cases.compare import compare_run
from vlab.diagnose.frequency_pipeline import FrequencyDiagnosed
from vlab.diagnose.model_kinds.model_kind import CalibratedModel
from vlab.diagnose.parameters.terms import attached
from vlab.diagnose.pipeline import Diagnosed
from vlab.diagnose.predictors.frequency_problem import FrequencyProblem
from vlab.diagnose.settings import EXPORT
from vlab.diagnose.validation.frequency import checked_again
from vlab.errors import BadExperiment, OutputRefused, VlabError
from vlab.files.toml_writer import toml_text
from vlab.physics.attach import Attached, written
from vlab.physics.catalogue import effect_named
from vlab.plants.base import Plant
from vlab.plants.mjcf import MjcfPlant
from vlab.signals import Array
from vlab.standalone.answer import FOLDER, StandaloneAnswer, write_answer

CASE = "amended.toml"
"""Name of the written case."""
RECORDINGS = "recordings"
"""Folder of the copied recordings."""
NOT_WRITTEN = "The answer for MuJoCo alone is not written"
"""Beginning of the note on a failure to write for plain MuJoCo."""
Done = Diagnosed | FrequencyDiagnosed
"""Diagnosis with its models."""


@dataclass(frozen=True, kw_only=True)
class ExtendedModelFiles:
    """Written files and their error.

    Parameters
    ----------
    files : tuple of str
        Names in the output folder.
    tables : tuple of str
        Effects stated in the case, without an element in the model file.
    nrmse : float or None
        Error on the checked recordings from the written files; None if the simulation fails.
    reported : float
        Error reported by the diagnosis.
    note : str
        Reason of a failure, or "".
    mujoco : StandaloneAnswer or None
        The same for plain MuJoCo; None without findings, or for a structure.
    mujoco_note : str
        Reason of a failure to write for plain MuJoCo, or "".
    """

    files: tuple[str, ...]
    tables: tuple[str, ...]
    nrmse: float | None
    reported: float
    note: str = ""
    mujoco: StandaloneAnswer | None = None
    mujoco_note: str = ""

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks on files that are not written."""
        return (f"{NOT_WRITTEN}: {self.mujoco_note}",) if self.mujoco_note else ()


def write_extended_model(done: Done, folder: Path) -> ExtendedModelFiles:
    """Write the extended model and simulate the files.

    The files are a model, a case and its recordings. Without findings the calibrated model is written.

    Parameters
    ----------
    done : Diagnosed or FrequencyDiagnosed
        Diagnosis with its models.
    folder : Path
        Output folder.

    Returns
    -------
    ExtendedModelFiles
        Written files and their error.

    Raises
    ------
    OutputRefused
        A file cannot be written.
    """
    case, found = done.problem.case, bool(done.diagnosis.findings)
    effects, theta = _added(done)
    raw = copy.deepcopy(dict(case.raw))
    earlier = _earlier(done, raw)
    try:
        model = done.problem.model_kind.write(_calibrated_model(done, effects, theta), effects, folder)
        raw["model"].update(model.entries)
        further = [*_calibrated(done, theta, found), *_ranges(done)]
        tables = [*earlier, *model.beside, *further]
        for given, table in zip(raw.get("recording", ()), case.table.recording, strict=True):
            for channel, known in zip(given["channel"], table.channel, strict=True):
                channel.update({"offset": known.offset} if known.offset else {})
                channel.update({"hold": known.hold} if known.hold else {})
                channel.update({"delay_s": known.delay_s} if known.delay_s else {})
                channel.update({} if known.noise is None else {"noise": known.noise})
        raw["title"] = f"{case.table.title} (extended)"
        raw["model"]["effect"] = [
            {"name": e.effect.name, "place": e.place, "parameters": {k: float(v) for k, v in e.values.items()}}
            for e in tables
        ]
        _tell_limit(done, raw)
        _tell_force_gains(done, raw)
        _copy_recordings(case, raw, folder)
        (folder / CASE).write_text(toml_text(raw), encoding="utf-8")
    except OSError as error:
        raise OutputRefused(f"the extended model cannot be written into {folder}: {error.strerror or error}") from error
    nrmse, note = _run_again(done, folder)
    plain, plain_note = _for_mujoco(done, [*effects, *further], earlier, theta, folder) if found else (None, "")
    reported = done.diagnosis.heldout["nrmse_after" if found else "nrmse_refitted"]
    return ExtendedModelFiles(
        files=(model.file, CASE),
        tables=tuple(e.label for e in tables),
        nrmse=nrmse,
        reported=math.nan if reported is None else float(reported),
        note=note,
        mujoco=plain,
        mujoco_note=plain_note,
    )


def _for_mujoco(
    done: Done, effects: Sequence[Attached], earlier: Sequence[Attached], theta: Array, folder: Path
) -> tuple[StandaloneAnswer | None, str]:
    """Write the answer for plain MuJoCo, or return the failure's reason."""
    case = done.problem.case
    if not done.problem.model_kind.has_mjcf_file:
        return None, ""
    plant = _calibrated_plant(done, effects, theta)
    assert isinstance(plant, MjcfPlant)
    source = case.folder / case.table.model.mjcf
    if not source.is_file():
        return None, "the model was given without a file"
    sample = 0.0
    if isinstance(done, Diagnosed):
        clock = plan_clock(plant.timestep, done.problem.runs[0])
        sample = clock.steps * clock.timestep
    try:
        answer = write_answer(
            source,
            plant,
            effects,
            folder / FOLDER,
            channels=done.problem.names,
            sample=sample,
            earlier=earlier,
            findings=[finding.to_json() for finding in done.diagnosis.findings],
        )
    except OutputRefused:
        raise
    except VlabError as error:
        return None, str(error)
    return answer, ""


def _calibrated_model(done: Done, effects: Sequence[Attached], theta: Array) -> CalibratedModel:
    """Return the calibrated model for its file."""
    problem, plant = done.problem, _calibrated_plant(done, effects, theta)
    own = problem.model_kind.for_plant(problem.reduced_model, problem.plant, problem.parameters, theta)
    return CalibratedModel(case=problem.case, plant=plant, parameters=problem.parameters, theta=own)


def _earlier(done: Done, raw: Mapping[str, Any]) -> list[Attached]:
    """Return the case's effects outside the model file."""
    at_work = [(a.effect.name, dict(a.values)) for a in done.problem.plant.physics]
    given = [
        Attached(effect=effect_named(e["name"], code=()), place=e["place"], values=e["parameters"])
        for e in raw["model"].get("effect", ())
    ]
    return [e for e in given if (e.effect.name, dict(e.values)) in at_work]


def native_model(done: Done) -> Any:
    """Return the extended model as an `MjModel`.

    Without findings the calibrated model is returned. Gains, offsets and ranges of sensors are no part of the model.

    Parameters
    ----------
    done : Diagnosed or FrequencyDiagnosed
        Diagnosis with its models.

    Returns
    -------
    MjModel
        Compiled model, which holds all findings.

    Raises
    ------
    BadExperiment
        A finding has no MuJoCo element, or the model is a structure.
    """
    if not done.problem.model_kind.has_mjcf_file:
        raise BadExperiment(
            "the extended model of a structure is a structure file, not an MjModel; write it with Diagnosis.save(folder)"
        )
    effects, theta = _added(done)
    spec, left = written(_calibrated_plant(done, effects, theta), effects)
    beside = [effect.label for effect in (*_earlier(done, done.problem.case.raw), *left)]
    native = {effect.effect.name for effect in effects}
    beside += [f"{f.name} at {f.site}" for f in done.diagnosis.findings if f.form not in native]
    if beside:
        raise BadExperiment(
            f"MuJoCo has no element for {', '.join(beside)}; write model and effects as a case with Diagnosis.save(folder)"
        )
    return spec.compile()


def _added(done: Done) -> tuple[list[Attached], Array]:
    """Return the effects of the findings, and the calibrated log factors."""
    found = bool(done.diagnosis.findings)
    terms = done.fit.terms if found else ()
    is_final = found or isinstance(done, Diagnosed) or not done.choice.best.terms
    return attached(terms), done.fit.theta if is_final else done.found.before.fit.theta


def _calibrated_plant(done: Done, effects: Sequence[Attached], theta: Array) -> Plant:
    """Return the calibrated plant without the effects."""
    return done.problem.adjusted(theta) if effects else done.before.plant


def _calibrated(done: Done, theta: Array, found: bool) -> list[Attached]:
    """Return calibrated gains and offsets as effects."""
    out, problem = [], done.problem
    if not problem.model_kind.holds_actuator_gains:
        for parameter, value in zip(problem.parameters, theta, strict=True):
            index = parameter.actuator
            if index is not None and index < len(problem.plant.actuators) and abs(value) > EXPORT.least:
                place = f"actuator:{problem.plant.actuators[index].name.removeprefix('coil:')}"
                out.append(
                    Attached(effect=effect_named("actuator-gain"), place=place, values={"gain": float(np.expm1(value))})
                )
    model = done.after if found else done.before
    if model.sensor_gain is None:
        return out
    for i, name in enumerate(model.names):
        place = name if name.startswith("sensor:") else f"sensor:{name}"
        gain = float(model.sensor_gain[i])
        if abs(gain - 1.0) > EXPORT.least:
            out.append(Attached(effect=effect_named("sensor-gain"), place=place, values={"gain": gain - 1.0}))
        if isinstance(problem, FrequencyProblem) or model.offset is None:
            continue
        offset = float(model.offset[i])
        scale = max(float(np.abs(r.measured[name]).max()) for r in problem.runs)
        if abs(offset) > EXPORT.least * scale:
            out.append(Attached(effect=effect_named("sensor-offset"), place=place, values={"offset": offset}))
    return out


def _ranges(done: Done) -> list[Attached]:
    """Return limits and quantisation as effects."""
    if not isinstance(done, Diagnosed):
        return []
    model = done.after
    out = [
        Attached(
            effect=effect_named("sensor-clipping"),
            place=f"sensor:{stop.channel.removeprefix('sensor:')}",
            values={"limit": stop.limit},
        )
        for stop in model.stops
    ]
    out += [
        Attached(
            effect=effect_named("sensor-quantisation"),
            place=f"sensor:{step.channel.removeprefix('sensor:')}",
            values={"step": step.step},
        )
        for step in model.steps
    ]
    limit, law = model.limit, next((run.law for run in done.problem.runs if run.law is not None), None)
    if limit is not None and law is not None and not limit.is_known:
        index = done.problem.plant.actuator_index(limit.actuator)
        scale = float(law.per_actuator[list(law.actuators).index(index)])
        place = f"actuator:{limit.actuator.removeprefix('coil:')}"
        out.append(
            Attached(effect=effect_named("actuator-clipping"), place=place, values={"limit": limit.limit * scale})
        )
    return out


def _tell_limit(done: Done, raw: dict[str, Any]) -> None:
    """Write the command limit to laws with an observer."""
    if not isinstance(done, Diagnosed) or done.after.limit is None or not done.after.limit.is_known:
        return
    for table in raw.get("recording", ()):
        if "controller" in table:
            table["controller"]["limit"] = float(done.after.limit.limit)


def _tell_force_gains(done: Done, raw: dict[str, Any]) -> None:
    """Write the gains of forces measured at ports to the responses.

    A larger force gives a larger response per stated force, and a higher level.
    """
    if not isinstance(done, FrequencyDiagnosed):
        return
    problem = done.problem
    model = done.after if done.diagnosis.findings else done.before
    for given, table in zip(raw.get("frf", ()), done.problem.case.table.frf, strict=True):
        if table.input not in problem.wires.inputs:
            continue
        gain = float(model.input_gain[problem.view.columns[problem.wires.inputs.index(table.input)]])
        if abs(gain - 1.0) > EXPORT.least:
            given["scale"] = table.scale / gain
            given.update({} if table.level is None else {"level": table.level * gain})


def _copy_recordings(case: Case, raw: dict[str, Any], folder: Path) -> None:
    """Copy every file of the case once, and write recordings in memory."""
    known: dict[str, str] = {}
    for table in (*raw.get("recording", ()), *raw.get("frf", ())):
        given = table["file"]
        if given not in known:
            given_name = f"{given}.parquet" if given in case.in_memory else given
            name, stem, number = Path(given_name).name, Path(given_name).stem, 1
            while f"{RECORDINGS}/{name}" in known.values():
                number += 1
                name = f"{stem}-{number}{Path(given_name).suffix}"
            known[given] = f"{RECORDINGS}/{name}"
            (folder / RECORDINGS).mkdir(exist_ok=True)
            if given in case.in_memory:
                columns = {column: np.asarray(values) for column, values in case.in_memory[given].columns.items()}
                pyarrow.parquet.write_table(pyarrow.table(columns), folder / known[given])
            else:
                shutil.copyfile(case.folder / given, folder / known[given])
        table["file"] = known[given]


def _run_again(done: Done, folder: Path) -> tuple[float | None, str]:
    """Return the error of the written files."""
    roles = sorted({c.role for c in done.diagnosis.checked})
    names = {c.name for c in done.diagnosis.checked}
    if not names:
        return None, "no recording was checked"
    try:
        case = load_case(folder / CASE)
        if isinstance(done, FrequencyDiagnosed):
            return checked_again(case, names), ""
        runs = [compare_run(case.plant, run) for run in case.runs(roles) if run.name in names]
    except VlabError as error:
        return None, str(error)
    squares = [np.mean([m.nrmse**2 for m in run.misfits]) for run in runs]
    return float(np.sqrt(np.mean(squares))), ""
