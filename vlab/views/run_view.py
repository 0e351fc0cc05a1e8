"""The Rerun file of a run on a structure."""

from pathlib import Path

from vlab.lab.analysis import analytical_response, measured_response
from vlab.lab.experiment import Result
from vlab.lab.run_folder import PreparedRun
from vlab.views.scene import write_run


def write_run_view(path: Path, prepared: PreparedRun, result: Result) -> None:
    """Write the moving structure, its traces, and the measured response beside the analytical one."""
    frf = measured_response(result.recording)
    high = prepared.settings.high_hz
    if frf is not None:
        frf = frf.between(0.0, high if high is not None else frf.freq[-1])
    analytical = None if frf is None else analytical_response(prepared, result.recording, frf.freq)
    write_run(
        path,
        prepared.structure,
        prepared.plant,
        result,
        frf=frf,
        analytical=analytical,
        law=prepared.settings.law or "none",
        hardware=prepared.hardware,
    )
