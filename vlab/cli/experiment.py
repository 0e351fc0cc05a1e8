"""``vlab experiment``."""

import argparse
from dataclasses import asdict
from typing import Any

from vlab.cli.common import Outcome, progress_bar
from vlab.fe.reduced import MODELS
from vlab.hardware.interlock import ORDER
from vlab.lab.excitation import EXCITATIONS
from vlab.lab.run_folder import RunSettings, perform
from vlab.outputs import output_folder
from vlab.recordings import write_recording


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's arguments; they are those of `RunSettings`."""
    default = RunSettings(structure="beam")
    parser.add_argument("structure", help="a built-in structure (beam, grid) or a structure file")
    parser.add_argument("--plant", default=default.plant, help="composite (default), fe (of the grid) or modal")
    parser.add_argument("--variant", default=default.variant, help="published (default) or physical")
    parser.add_argument(
        "--law",
        help="control law in the loop: mfdrf, lqdrf and the grid's lqdrf-diagonal with printed gains; lqg and the beam's "
        "lqdrf-diagonal designed for the loop's rate; a controller.toml of vlab design; or your own as "
        "path/to/law.py:ClassName or entry:NAME; none by default",
    )
    parser.add_argument(
        "--model", default=default.model, help=f"design the law anew, on this model: {', '.join(MODELS)}"
    )
    parser.add_argument(
        "--excite", default=default.excite, help=f"excitation: {', '.join(EXCITATIONS)} (default {default.excite})"
    )
    parser.add_argument(
        "--at",
        default=default.at,
        help="the coil that excites besides controlling (by default the structure's exciter)",
    )
    parser.add_argument(
        "--level",
        type=float,
        help="size of the excitation in N: rms, peak for sines and blows, static force for a release",
    )
    parser.add_argument("--band", type=float, nargs=2, metavar=("LOW", "HIGH"), help="band of the excitation in Hz")
    parser.add_argument("--period", type=float, help="period of a periodic excitation or of one sweep in s")
    parser.add_argument(
        "--odd", action="store_const", const=True, help="multisine: odd lines only, with detection lines in between"
    )
    parser.add_argument("--seconds", type=float, default=default.seconds, help="duration in s (default 60)")
    parser.add_argument("--rate", type=float, help="samples per second of loop and recording (default 2000)")
    parser.add_argument("--seed", type=int, default=default.seed, help="seed of excitation and noise (default 0)")
    parser.add_argument(
        "--noise", type=float, default=default.noise, help="rms noise of the velocity sensors in m/s (default 0)"
    )
    parser.add_argument(
        "--effect",
        action="append",
        default=[],
        metavar="NAME@PLACE:PARAM=VALUE,...",
        help="physics that the model has not, for example coulomb-friction@20in:force=0.05lbf; may be given several times (see "
        "vlab effects; your own as path/to/effect.py:ClassName@PLACE:...)",
    )
    parser.add_argument("--hardware", default=default.hardware, help="a hardware file instead of the laboratory's own")
    parser.add_argument(
        "--power-up",
        default=default.power_up,
        metavar="ORDER",
        help=f"switch the bench on in an order of your own, without its interlock and with its faults; right is {','.join(ORDER)}",
    )
    parser.add_argument("--csv", action="store_true", help="write the recording as recording.csv, too")
    parser.add_argument("--out", default="out/run", help="run folder (default out/run)")


def run(arguments: argparse.Namespace) -> Outcome:
    """Run the experiment and write its folder."""
    settings = RunSettings(
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
        seconds=arguments.seconds,
        rate_hz=arguments.rate,
        seed=arguments.seed,
        noise=arguments.noise,
        hardware=arguments.hardware,
        effect=tuple(arguments.effect),
        power_up=arguments.power_up,
    )
    prepared = settings.prepare()
    with output_folder(arguments.out) as folder:
        with progress_bar("experiment", settings.seconds) as report:
            done = perform(prepared, folder, progress=report)
        from vlab.views.run_view import write_run_view

        write_run_view(folder / "run.rrd", prepared, done.result)
        if arguments.csv:
            write_recording(done.result.recording, folder / "recording.csv")
        done.finish(folder)
    names = done.result.recording.names
    document: dict[str, Any] = {
        "out": str(arguments.out),
        "real_time_factor": done.real_time_factor,
        "channels": list(names),
    }
    document["faults"] = [asdict(fault) for fault in prepared.faults]
    text = "".join(f"powering up, after {fault.time:.0f} s: {fault.words}\n" for fault in prepared.faults)
    text += (
        f"{settings.seconds:g} s simulated at {done.real_time_factor:.0f} x real time; {len(names)} channels: {', '.join(names)}\n"
        f"written to {arguments.out}: recording.parquet, run.toml, manifest.json, run.rrd   (vlab show {arguments.out})"
    )
    return Outcome(document=document, text=text)
