"""Rerun file and report of a run."""

from dataclasses import dataclass
from pathlib import Path

from vlab.lab.analysis import analytical_response, measured_response
from vlab.lab.experiment import Result
from vlab.lab.run_folder import DoneRun, PreparedRun
from vlab.modal.frf import MeasuredFrequencyResponse
from vlab.signals import FrequencyResponse
from vlab.views.reports.run import write_run_report
from vlab.views.rerun.documents import PICTURES
from vlab.views.rerun.scene import write_bodies, write_run


@dataclass(frozen=True, kw_only=True, eq=False)
class Responses:
    """Measured and analytical responses of the first few sensors of a run."""

    measured: MeasuredFrequencyResponse | None = None
    analytical: FrequencyResponse | None = None


def responses(prepared: PreparedRun, result: Result) -> Responses:
    """Return the responses of a periodic run.

    Parameters
    ----------
    prepared : PreparedRun
        Prepared run.
    result : Result
        Result of the run.

    Returns
    -------
    Responses
        Responses of the first sensors; empty for other excitations.
    """
    recording = result.recording
    sensors = [c.name for c in recording.channels if c.kind == "velocity"][:PICTURES]
    shown = recording.select([*recording.inputs, *sensors])
    frf = measured_response(shown)
    if frf is None:
        return Responses()
    high = prepared.settings.high_hz
    frf = frf.between(0.0, high if high is not None else frf.freq[-1])
    analytical = None if prepared.structure is None else analytical_response(prepared, shown, frf.freq)
    return Responses(measured=frf, analytical=analytical)


def write_run_view(path: Path, prepared: PreparedRun, result: Result, found: Responses | None = None) -> None:
    """Write structure, traces, spectra, controller and responses as a Rerun file."""
    found = responses(prepared, result) if found is None else found
    if prepared.structure is None:
        write_bodies(
            path, prepared.plant, result, frf=found.measured, law=prepared.settings.law, hardware=prepared.hardware
        )
        return
    write_run(
        path,
        prepared.structure,
        prepared.plant,
        result,
        frf=found.measured,
        analytical=found.analytical,
        law=prepared.settings.law or "none",
        controller=prepared.law,
        hardware=prepared.hardware,
    )


def write_run_views(folder: Path, done: DoneRun, *, report: bool) -> None:
    """Write ``run.rrd`` and, on request, ``report.html`` of a run."""
    found = responses(done.prepared, done.result)
    write_run_view(folder / "run.rrd", done.prepared, done.result, found)
    if report:
        write_run_report(folder / "report.html", done, found.measured, found.analytical)
