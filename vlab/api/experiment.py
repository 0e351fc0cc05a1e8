"""Simulated experiment on a structure, in memory or in a run folder."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from vlab.api.design import DesignedLaw, law_in_a_loop
from vlab.api.progress import Progress, reported
from vlab.errors import BadExperiment
from vlab.files.arguments import checked
from vlab.files.output_folder import check_output, output_folder
from vlab.lab.experiment import Result
from vlab.lab.given_law import given_law
from vlab.lab.run_folder import DoneRun, PreparedRun, RunSettings, simulate_run
from vlab.lab.suited import suited
from vlab.recordings import write_recording

Watch = Callable[[float, Callable[[], Result]], None]
"""Receives the simulated seconds done and a function that returns the result so far."""
_DEFAULT = RunSettings(structure="beam")


@checked(
    BadExperiment,
    options={"--rate": "rate_hz", "--seconds": "seconds", "--plant": "plant", "--at": "at", "--level": "level"},
    structure="for arrays of measurements, see vlab.Case.from_arrays",
)
def experiment(
    structure: str = "beam",
    *,
    law: Any = _DEFAULT.law,
    plant: str = _DEFAULT.plant,
    variant: str = _DEFAULT.variant,
    model: str = _DEFAULT.model,
    excite: str = _DEFAULT.excite,
    at: str = _DEFAULT.at,
    level: float | None = _DEFAULT.level,
    band_hz: tuple[float, float] | None = None,
    period_s: float | None = _DEFAULT.period_s,
    odd: bool | None = _DEFAULT.odd,
    seconds: float | None = None,
    rate_hz: float | None = _DEFAULT.rate_hz,
    seed: int = _DEFAULT.seed,
    noise: float = _DEFAULT.noise,
    hardware: str = _DEFAULT.hardware,
    hardware_values: Sequence[str] = (),
    effects: Sequence[str] = (),
    power_up: str = _DEFAULT.power_up,
    out: Path | str | None = None,
    overwrite: bool = False,
    progress: Progress = True,
) -> DoneRun:
    """Simulate an experiment, with the defaults of ``vlab experiment``.

    Parameters
    ----------
    structure : str
        Built-in structure (``"beam"``, ``"grid"``), structure file, or MJCF file of a model of your own.
    law : str, Path, DesignedLaw, Controller or callable
        Control law in the loop: a published name, a ``controller.toml``, ``"path/to/law.py:CLASS"`` or ``"entry:NAME"``;
        a result of `vlab.design` or its `law`; an object or class with `sensors`, `actuators`, `reset` and `step`; or a
        function u = f(y). None by default. A law takes y and gives u in SI, in the order of its channels. A function
        drives all actuators in the order of the structure, and reads the velocity sensors beside them; without such
        sensors, all sensors.
    plant, variant : str
        Plant (``"composite"``, ``"fe"``, ``"linear"``, ``"modal"``) and variant of the structure.
    model : str
        Model on which the law is designed again; by default the published design applies.
    excite : str
        Excitation, with settings as ``"NAME:setting=value,..."``.
    at : str
        Coil of the excitation; the exciter of the structure by default. Of a model of your own, actuators with commas
        between; all by default.
    level : float, optional
        Level of the excitation [N, or the actuator's unit]; from the plant by default.
    band_hz : (low, high), optional
        Excited band [Hz].
    period_s : float, optional
        Period of the excitation or of one sweep [s].
    odd : bool, optional
        Multisine: odd lines only.
    seconds : float, optional
        Simulated duration [s]; without a law, duration and period follow from the slowest mode of the plant. With a law
        60 s.
    rate_hz : float, optional
        Sample rate of loop and recording [Hz]; that of the hardware by default.
    seed : int
        Seed of excitation and noise.
    noise : float
        Noise of the velocity sensors, rms [m/s].
    hardware, hardware_values : str, sequence of str
        Hardware file, and changes such as ``"coil.limit=0.2lbf"``.
    effects : sequence of str
        Effects of the plant, as ``"NAME@PLACE:parameter=value,..."``.
    power_up : str
        Order of powering up, without interlock.
    out : Path or str, optional
        Run folder to write; in memory alone by default.
    overwrite : bool
        Whether a run folder of vlab is replaced.
    progress : bool or callable
        True shows a bar on a terminal. A function receives the completed share and the present step.

    Returns
    -------
    DoneRun
        Completed run; its `recording` holds all channels.

    Raises
    ------
    BadExperiment
        A setting is impossible.
    BadController
        The law does not fit the loop, or its code fails.
    Diverged
        The simulation became nonfinite.
    OutputRefused
        The run folder exists, or cannot be written.
    """
    law = "" if law is None else str(law) if isinstance(law, Path) else law
    given = None
    if not isinstance(law, str):
        given = given_law(law_in_a_loop(law) if isinstance(law, DesignedLaw) else law)
    settings = RunSettings(
        structure=structure,
        plant=plant,
        variant=variant,
        law=law if given is None else given.name,
        model=model,
        excite=excite,
        at=at,
        level=level,
        low_hz=band_hz[0] if band_hz else None,
        high_hz=band_hz[1] if band_hz else None,
        period_s=period_s,
        odd=odd,
        seconds=_DEFAULT.seconds if seconds is None else seconds,
        rate_hz=rate_hz,
        seed=seed,
        noise=noise,
        hardware=hardware,
        hardware_values=tuple(hardware_values),
        effect=tuple(effects),
        power_up=power_up,
    )
    if seconds is None:
        settings = suited(settings).settings
    with reported(progress, "experiment") as report:
        advance = None if report is None else lambda done_s: report(done_s / settings.seconds, "simulating")
        return run_prepared(settings.prepare(given=given), out, overwrite=overwrite, progress=advance)


def run_prepared(
    prepared: PreparedRun,
    out: Path | str | None = None,
    *,
    overwrite: bool = False,
    report: bool = False,
    csv: bool = False,
    progress: Callable[[float], None] | None = None,
    watch: Watch | None = None,
    finished: Callable[[DoneRun], None] | None = None,
) -> DoneRun:
    """Run a prepared experiment, and write its run folder if named.

    Parameters
    ----------
    prepared : PreparedRun
        Prepared run.
    out : Path or str, optional
        Run folder.
    overwrite : bool
        Whether a run folder of vlab is replaced.
    report, csv : bool
        Whether ``report.html`` and ``recording.csv`` are written, too.
    progress : callable, optional
        Receives the simulated seconds done.
    watch : callable, optional
        Live view.
    finished : callable, optional
        Called with the run before its views are written.

    Returns
    -------
    DoneRun
        Completed run.

    Raises
    ------
    OutputRefused
        The folder exists, or cannot be written.
    """
    if out is None:
        return simulate_run(prepared, progress=progress, watch=watch)
    check_output(out, overwrite=overwrite, remedy="name another, or allow overwrite")
    with output_folder(out, overwrite=overwrite) as folder:
        done = simulate_run(prepared, progress=progress, watch=watch)
        done.write(folder)
        if finished is not None:
            finished(done)
        from vlab.views.reports.run_files import write_run_views

        write_run_views(folder, done, report=report)
        if csv:
            write_recording(done.recording, folder / "recording.csv")
        done.finish(folder)
    return done
