"""``vlab experiment``."""

import argparse
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from vlab.api.experiment import run_prepared
from vlab.api.law_argument import file_of
from vlab.cases.description import ModelTable
from vlab.cli.common import Outcome, add_seed, progress_bar, share_bar
from vlab.cli.destination import add_out, check_out, destination
from vlab.cli.loop_summary import loop_facts, loop_text, period_text, periods_of
from vlab.controllers.catalogue import laws_in_a_loop
from vlab.errors import BadExperiment
from vlab.fe.reduced import MODELS
from vlab.hardware.interlock import ORDER
from vlab.lab.excitation import EXCITATIONS
from vlab.lab.model_bench import bench_words
from vlab.lab.plan import DonePlan, Plan, load_plan, perform_plan
from vlab.lab.run_folder import DoneRun, RunSettings
from vlab.lab.suited import Suited, suited
from vlab.physics.attach import Attached
from vlab.physics.spec import parse_effect
from vlab.plants.base import Plant
from vlab.units import at_rotation
from vlab.views.rerun.viewer import PORT, listening, viewer_at

RUN_OUT, PLAN_OUT = "out/run", "out/plan"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments, those of `RunSettings`."""
    default = RunSettings(structure="beam")
    parser.add_argument(
        "structure",
        nargs="?",
        help="simulate this built-in structure (beam, grid), structure file, or MJCF model of your own (.xml)",
    )
    parser.add_argument(
        "--plan",
        metavar="PLAN.toml",
        help="run a test plan of several records instead, and write run folders and a case; an interrupted plan continues "
        "(for example example:plan.toml)",
    )
    parser.add_argument(
        "--code",
        action="append",
        default=[],
        metavar="FILE.py",
        help="with --plan: allow laws and effects of this Python file (or entry:NAME); runs its code and no other code of "
        "the plan; may be repeated (default: none)",
    )
    _add_plant_and_law(parser, default)
    _add_excitation(parser, default)
    _add_loop(parser, default)
    _add_effects_and_hardware(parser, default)
    _add_outputs(parser)


def _add_plant_and_law(parser: argparse.ArgumentParser, default: RunSettings) -> None:
    """Add the arguments of the plant and its control law."""
    parser.add_argument(
        "--plant",
        default=default.plant,
        help="simulate this plant: composite (default), fe, modal, or linear (exact steps, the fastest; linear laws "
        "and no effects)",
    )
    parser.add_argument(
        "--variant",
        default=default.variant,
        help="model this variant of the structure: published (default) or physical",
    )
    parser.add_argument(
        "--law",
        help=f"close the loop with this law: {', '.join(laws_in_a_loop())} (printed gains where the structure has them, else "
        "designed for the rate of the loop); a controller.toml of vlab design; or your own as path/to/law.py:ClassName or "
        "entry:NAME (default: none)",
    )
    parser.add_argument(
        "--model",
        default=default.model,
        help=f"design the law again on this model: {', '.join(MODELS)} (default: that of the published design)",
    )


def _add_excitation(parser: argparse.ArgumentParser, default: RunSettings) -> None:
    """Add the arguments of the excitation."""
    parser.add_argument(
        "--excite",
        default=default.excite,
        help=f"excite by {', '.join(EXCITATIONS)} (default {default.excite}); append settings as NAME:setting=value,..., "
        "for example stepped-sine:steps=40,zoom_hz=1.85/4.8",
    )
    parser.add_argument(
        "--at",
        default=default.at,
        help="excite at this coil; COIL,COIL: a dwell at both, any other signal in turn (default: exciter of the structure, "
        "and in turn the coils that see its nodes; own model: every actuator with a random signal, the first with sines)",
    )
    parser.add_argument(
        "--level",
        type=float,
        help="set the level of the excitation in N, or the actuator's unit of an own model: rms, peak for sines and blows, "
        "static force for a release (default: from the plant)",
    )
    parser.add_argument(
        "--band",
        type=float,
        nargs=2,
        metavar=("LOW", "HIGH"),
        help="excite this band in Hz (default: that of the excitation; own model: up to twice its fastest pole)",
    )
    parser.add_argument(
        "--period",
        type=float,
        help="set the period of a periodic excitation or of one sweep in s (default: that of the excitation)",
    )
    parser.add_argument(
        "--odd",
        action="store_const",
        const=True,
        help="multisine: excite odd lines only, with detection lines between them (default: all lines)",
    )


def _add_loop(parser: argparse.ArgumentParser, default: RunSettings) -> None:
    """Add duration, rate, seed and noise."""
    parser.add_argument(
        "--seconds",
        type=float,
        help="simulate this duration in s (default: from the slowest mode of the plant; 60 with a law)",
    )
    parser.add_argument(
        "--rate", type=float, help="sample loop and recording at this rate in Hz (default 2000; own model: every step)"
    )
    add_seed(parser, "draw excitation and noise with this seed (default 0)", default=default.seed)
    parser.add_argument(
        "--noise",
        type=float,
        default=default.noise,
        help="add noise of this rms in m/s to the velocity sensors; own model: to every sensor in its unit (default 0)",
    )


def _add_effects_and_hardware(parser: argparse.ArgumentParser, default: RunSettings) -> None:
    """Add the arguments of hidden effects and hardware."""
    parser.add_argument(
        "--effect",
        action="append",
        default=[],
        metavar="NAME@PLACE:PARAM=VALUE,...",
        help="add an effect of vlab effects to the plant, for example coulomb-friction@20in:force=0.05lbf, or your own as "
        "path/to/effect.py:ClassName@PLACE:...; may be repeated (default: none)",
    )
    parser.add_argument(
        "--hardware",
        default=default.hardware,
        help="use this hardware file (default: that of the laboratory; own model: ideal)",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="TABLE.KEY=VALUE",
        help="replace a value of the hardware file, for example leads.shielded=false, velocity_sensor.buffered=false, "
        "coil.limit=0.2lbf; may be repeated (default: none)",
    )
    parser.add_argument(
        "--power-up",
        default=default.power_up,
        metavar="ORDER",
        help=f"power up in this order, without interlock and with its faults; correct: {','.join(ORDER)} (default: interlocked)",
    )


def _add_outputs(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of files and views."""
    parser.add_argument("--csv", action="store_true", help="write recording.csv, too (default: no)")
    parser.add_argument(
        "--report", action="store_true", help="write report.html, too; takes some seconds (default: no)"
    )
    parser.add_argument(
        "--live",
        nargs="?",
        type=int,
        const=PORT,
        metavar="PORT",
        help="show the running experiment in a viewer on this machine; an open viewer at the port is used "
        f"(default port {PORT})",
    )
    parser.add_argument(
        "--pace",
        type=float,
        help="with --live: limit the simulated seconds per second (default 1: real time; inf: no limit)",
    )
    add_out(
        parser,
        f"to this run folder (default {RUN_OUT}-001, or the next number), or folder of a plan, which continues there (default {PLAN_OUT})",
    )


def run(arguments: argparse.Namespace) -> Outcome:
    """Run an experiment or a plan, and write its folder.

    Parameters
    ----------
    arguments : Namespace
        Parsed arguments of the command.

    Returns
    -------
    Outcome
        Document and text of the command.
    """
    if arguments.plan:
        return _run_plan(arguments)
    if not arguments.structure:
        raise BadExperiment("the following is required: structure, or a test plan with --plan")
    if arguments.code:
        raise BadExperiment("--code is for --plan; without one the code is named by --law and --effect")
    if arguments.pace is not None and arguments.live is None:
        raise BadExperiment("--pace is for --live; without it a run goes as fast as it is computed")
    check_out(arguments, read=[arguments.structure, arguments.hardware, file_of(arguments.law or "")])
    settings = _settings(arguments)
    fitting = Suited(settings=settings)
    if arguments.seconds is None:
        fitting = suited(settings)
        settings = fitting.settings
    prepared = settings.prepare()
    live = None
    if arguments.live is not None:
        from vlab.views.rerun.live import LiveView

        pace = 1.0 if arguments.pace is None else arguments.pace
        live = LiveView(prepared, pace=pace, connect=lambda: viewer_at(arguments.live))

    def leave_the_viewer(done: DoneRun) -> None:
        if live is None:
            return
        live.finish(done.result)
        if not listening(arguments.live):
            print("vlab experiment: the viewer was closed before the run ended; the run is whole", file=sys.stderr)

    with destination(arguments, RUN_OUT) as out:
        with progress_bar("experiment", settings.seconds) as report:
            done = run_prepared(
                prepared,
                out,
                overwrite=arguments.overwrite,
                report=arguments.report,
                csv=arguments.csv,
                progress=report,
                watch=live.watch if live is not None else None,
                finished=leave_the_viewer,
            )
        files = sorted(path.name for path in out.iterdir())
    names = done.result.recording.names
    document: dict[str, Any] = {
        "out": str(out),
        "real_time_factor": done.real_time_factor,
        "is_compiled": done.result.is_compiled,
        "channels": list(names),
    }
    document["faults"] = [asdict(fault) for fault in prepared.faults]
    document["periods"] = periods_of(prepared.experiment.excitation, settings.seconds)
    document |= loop_facts(done)
    text = "".join(f"powering up, after {fault.time:.0f} s: {fault.words}\n" for fault in prepared.faults)
    applied = [parse_effect(effect, code=settings.named_code) for effect in settings.effect]
    text += "".join(f"effect in the plant: {_applied(one, prepared.plant)}\n" for one in applied)
    text += loop_text(document)
    text += period_text(prepared.experiment.excitation, settings.seconds)
    text += f"{fitting.words}\n" if fitting.words else ""
    if settings.is_own_model and prepared.experiment.excitation is not None:
        text += bench_words(prepared.experiment.excitation, prepared.plant, prepared.experiment.excite) + "\n"
    loop = "in the compiled loop" if done.result.is_compiled else "in the Python loop"
    text += (
        f"{settings.seconds:g} s simulated at {done.real_time_factor:.0f} x real time {loop}; {len(names)} channels: {', '.join(names)}\n"
        f"written to {out}: {', '.join(files)}   (vlab show {out})"
    )
    return Outcome(document=document, text=text)


def _settings(arguments: argparse.Namespace) -> RunSettings:
    """Return the settings that the arguments state."""
    return RunSettings(
        structure=arguments.structure,
        plant=arguments.plant,
        variant=arguments.variant,
        law=arguments.law or "",
        model=arguments.model,
        excite=arguments.excite,
        at=arguments.at,
        level=arguments.level,
        low_hz=arguments.band[0] if arguments.band else None,
        high_hz=arguments.band[1] if arguments.band else None,
        period_s=arguments.period,
        odd=arguments.odd,
        seconds=RunSettings.seconds if arguments.seconds is None else arguments.seconds,
        rate_hz=arguments.rate,
        seed=arguments.seed,
        noise=arguments.noise,
        hardware=arguments.hardware,
        hardware_values=tuple(arguments.set),
        effect=tuple(arguments.effect),
        power_up=arguments.power_up,
    )


def _applied(attached: Attached, plant: Plant) -> str:
    """Return an effect with its place and its values in SI."""
    port = plant.ports.get(attached.place)
    is_angular = port is not None and port.unit == "rad"
    own = {p.name: at_rotation(p.unit) if is_angular else p.unit for p in attached.effect.parameters}
    units = {name: "" if unit == "1" else f" {unit}" for name, unit in own.items()}
    values = ", ".join(f"{name} = {value:.4g}{units[name]}" for name, value in attached.values.items())
    return f"{attached.effect.name} at {attached.place}: {values}"


def _write_views(folder: Path, done: DoneRun, *, report: bool) -> None:
    from vlab.views.reports.run_files import write_run_views

    write_run_views(folder, done, report=report)


def _run_plan(arguments: argparse.Namespace) -> Outcome:
    """Perform the missing records of a plan."""
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    default = vars(parser.parse_args([]))
    for name, value in default.items():
        if name not in ("plan", "out", "report", "code") and getattr(arguments, name) != value:
            given = "a structure" if name == "structure" else f"--{name.replace('_', '-')}"
            raise BadExperiment(f"{given} was given besides --plan; everything that is run stands in {arguments.plan}")
    plan, folder = load_plan(arguments.plan), Path(arguments.out or PLAN_OUT)
    ModelTable(**plan.model_table())  # refuse settings that a case cannot express
    with share_bar("plan") as bar:
        done = perform_plan(
            plan,
            folder,
            code=arguments.code,
            views=lambda fresh, run: _write_views(fresh, run, report=arguments.report),
            progress=lambda p: bar(p.share, p.record),
        )
    text = _plan_text(plan, done, folder, reports=arguments.report)
    return Outcome(document=_plan_document(plan, done, folder), text=text)


def _plan_document(plan: Plan, done: DonePlan, folder: Path) -> dict[str, Any]:
    records = [
        {"name": r.name, "role": r.role, "folder": str(folder / r.name), "performed": r.name in done.performed}
        for r in plan.record
    ]
    return {"out": str(folder), "case": str(folder / "case.toml"), "concealed": plan.concealed, "records": records}


def _plan_text(plan: Plan, done: DonePlan, folder: Path, *, reports: bool) -> str:
    before = f", {len(done.kept)} had been there" if done.kept else ""
    text = f"{len(done.performed)} of {len(plan.record)} records performed{before}; written to {folder}"
    if plan.concealed:
        text += f"; what they conceal: {folder}-truth"
    bare = [name for name in done.kept if not (folder / name / "report.html").exists()] if reports else []
    if bare:
        text += f"\nno page was made for what had been there: {', '.join(bare)}; a record's page is written while it is performed"
    if all(record.role == "fit" for record in plan.record):
        text += "\nno record is held out: a diagnosis of this case is not checked on data that it has not seen"
    return text + f"\nvlab compare {folder}   vlab diagnose {folder}"
