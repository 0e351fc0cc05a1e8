"""``vlab design``."""

import argparse
import json
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from controllers.catalogue import LAWS, Asked, Design, as_plain, asked_of, default_model, design_law
from controllers.law_file import write_law
from controllers.lqdrf import KINDS, LqdrfDesign
from controllers.lqg import LqgDesign
from controllers.lqr import LqrDesign
from controllers.mfdrf import MfdrfDesign
from vlab import units
from vlab.cli.common import Outcome, finite, text_table
from vlab.cli.given_law import is_given, load_given
from vlab.design.gain_search import bounded_modes
from vlab.errors import BadController, BadDesign, unknown_name
from vlab.fe.damping import driven_modes
from vlab.fe.model import FeModel
from vlab.fe.reduced import MODELS, build_reduced_model
from vlab.outputs import output_folder, write_manifest
from vlab.structure import load_structure

PRINTED = "lbf s/in"
"""Unit in which gains of direct rate feedback are printed beside SI, as in Tables 7, 11 and 15."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's arguments."""
    parser.add_argument("structure", help="a built-in structure (beam, grid) or a structure file")
    parser.add_argument(
        "--law",
        default="",
        help=f"{', '.join(LAWS)}; or one to judge: path/to/law.py:ClassName, entry:NAME, controller.toml",
    )
    parser.add_argument("--model", help=f"{', '.join(MODELS)}; by default that of the published design")
    parser.add_argument(
        "--variant", default="published", help="how the structure is modelled: published (default) or physical"
    )
    published = "; by default that of the published design"
    parser.add_argument("--weights", help="identity for Q = q I (default), energy for Q = diag(M, K)")
    for name, what in (
        ("q", "Q = q I"),
        ("r", "R = r I"),
        ("v1", "V1 = v1 I"),
        ("v2", "V2 = v2 I"),
        ("alpha", "stability margin of the filter in 1/cs"),
    ):
        parser.add_argument(f"--{name}", type=float, help=f"{what}, in inches, pounds and centiseconds{published}")
    parser.add_argument("--damping", type=float, help=f"smallest damping ratio of the first modes{published}")
    parser.add_argument("--modes", type=int, help=f"how many modes have that bound{published}")
    parser.add_argument("--shapes", type=int, help=f"how many initial shapes LQDRF minimises over{published}")
    parser.add_argument(
        "--objective", help=f"of LQDRF: {' or '.join(KINDS)} to the regulator's index (default largest)"
    )
    parser.add_argument("--starts", type=int, help="random starts of the search")
    parser.add_argument("--seed", type=int, help="seed of the random starts (default 0)")
    parser.add_argument("--rate", type=float, help="samples per second of a law with states (default 1000)")
    parser.add_argument("--out", help="folder for design.json, controller.toml and figures")


def run(arguments: argparse.Namespace) -> Outcome:
    """Design the law and say what it achieves."""
    structure = load_structure(arguments.structure)
    if not arguments.law:
        raise BadDesign(f"no law was named; give --law with one of {', '.join(LAWS)}, or a law file")
    if is_given(arguments.law):
        return _judge(arguments)
    if arguments.law not in LAWS:
        raise unknown_name("law", arguments.law, LAWS, where="design")
    if arguments.objective is not None and arguments.objective not in KINDS:
        raise unknown_name("objective", arguments.objective, KINDS, where="--objective")
    model = arguments.model or default_model(structure, arguments.law)
    names = ("weights", "q", "r", "v1", "v2", "alpha", "damping", "modes", "shapes", "starts", "seed", "rate")
    changes = {name: getattr(arguments, name) for name in names} | {"kind": arguments.objective}
    asked = asked_of(structure, model, **changes)
    fe = build_reduced_model(structure, model, arguments.variant)
    begun = time.perf_counter()
    design = design_law(fe, arguments.law, asked)
    seconds = time.perf_counter() - begun
    document = describe(fe, design, arguments.law, model, asked)
    document["seconds"] = seconds
    if arguments.out:
        with output_folder(arguments.out) as folder:
            _write(folder, fe, design, document)
            write_manifest(
                folder,
                verb="design",
                structure=structure.name,
                law=arguments.law,
                model=model,
                **{"asked": as_plain(asked)},
            )
        document["out"] = str(arguments.out)
    return Outcome(document=document, text=_text(structure.title, document))


def _judge(arguments: argparse.Namespace) -> Outcome:
    """Say what a law that was made elsewhere achieves, in the laboratory's sampled loop."""
    if arguments.out:
        raise BadController(
            f"the law {arguments.law} is not designed here; leave --out away, its numbers come with --json"
        )
    structure = load_structure(arguments.structure)
    model = arguments.model or "full"
    fe = build_reduced_model(structure, model, arguments.variant)
    begun = time.perf_counter()
    asked = asked_of(structure, model, **{name: getattr(arguments, name) for name in ("weights", "q", "r", "modes")})
    modes = _shown(fe, asked)
    document: dict[str, Any] = {"law": arguments.law, "structure": structure.name, "model": model}
    document |= load_given(fe, arguments.law, arguments.rate).describe(modes, asked)
    document = finite(document | {"modes": [mode + 1 for mode in modes], "seconds": time.perf_counter() - begun})
    return Outcome(document=document, text=_text(structure.title, document))


def _shown(fe: FeModel, asked: Asked) -> tuple[int, ...]:
    """Return the modes that are reported: as many as have measured damping ratios, or are bounded."""
    driven = len(driven_modes(fe.coils.T @ fe.linear.eigen[1]))
    return bounded_modes(fe, min(max(len(fe.structure.damping.ratios), asked.modes), driven))


def describe(fe: FeModel, design: Design, law: str, model: str, asked: Asked) -> dict[str, Any]:
    """Return a design as plain data: gains, damping ratios, indices, objective, and how far the search may be trusted."""
    modes = _shown(fe, asked)
    if isinstance(design, LqrDesign | LqgDesign):
        found = design.poles
        zeta, freq = found.zeta[list(modes)], found.freq[list(modes)]
        indices = design.indices(modes)
    else:
        tracked = design.loop.track(design.D, max(modes) + 1)
        zeta, freq = tracked.zeta[0, list(modes)], tracked.freq[0, list(modes)]
        indices = design.indices(asked.weights_for(design.model), modes)
    document: dict[str, Any] = {
        "law": law,
        "structure": fe.structure.name,
        "model": model,
        "asked": as_plain(asked),
        "gains": _gains(design),
        "modes": [mode + 1 for mode in modes],
        "frequencies_hz": freq,
        "damping_ratios": zeta,
        "performance_indices": indices,
        "objective": _objective(design, indices, asked),
    }
    if isinstance(design, MfdrfDesign | LqdrfDesign):
        document["search"] = asdict(design.search)
    result: dict[str, Any] = finite(document)
    return result


def _gains(design: Design) -> dict[str, Any]:
    channels = list(design.model.channels)
    if isinstance(design, LqrDesign | LqgDesign):
        parts: dict[str, Any] = {
            "actuators": channels,
            "states": list(design.model.states),
            "F": design.F,
            "unit": "SI",
        }
        if isinstance(design, LqgDesign):
            parts |= {"sensors": channels, "K": design.K}
        return parts
    return {"actuators": channels, "sensors": channels, "D": design.D, "unit": "N s/m"}


def _objective(design: Design, indices: Any, asked: Asked) -> dict[str, Any]:
    if isinstance(design, MfdrfDesign):
        printed = units.from_si(design.objective, PRINTED, "N s/m")
        return {
            "name": "gamma, largest force ratio",
            "value": design.objective,
            "unit": "N s/m",
            f"value_{PRINTED}": printed,
        }
    if isinstance(design, LqdrfDesign):
        ratio = design.kind == "ratio"
        name = "beta, largest ratio to the regulator's index" if ratio else "beta, largest index"
        return {"name": name, "value": design.objective, "unit": "1"}
    return {"name": "largest index of the bounded modes", "value": float(np.max(indices[: asked.modes])), "unit": "1"}


def _text(title: str, document: dict[str, Any]) -> str:
    objective = document["objective"]
    lines = [f"{title}: {document['law']} on the {document['model']} model, {document['seconds']:.2f} s", ""]
    gains = document["gains"]
    if gains["unit"] == "N s/m":
        D = units.from_si(np.array(gains["D"]), PRINTED, "N s/m")
        rows = [
            [name, *(round(float(d), 6) + 0.0 for d in row)] for name, row in zip(gains["actuators"], D, strict=True)
        ]
        lines += [text_table([f"D [{PRINTED}]", *gains["sensors"]], rows), ""]
    keys = ("modes", "frequencies_hz", "damping_ratios", "performance_indices")
    rows = [list(row) for row in zip(*(document[key] for key in keys), strict=True)]
    lines += [text_table(["mode", "Hz", "damping ratio", "index"], rows), ""]
    shown = f"{objective['value']:.6g} {objective['unit']}".removesuffix(" 1")
    printed = objective.get(f"value_{PRINTED}")
    lines.append(f"{objective['name']}: {shown}" + (f" ({printed:.5f} {PRINTED})" if printed is not None else ""))
    if "search" in document:
        search = document["search"]
        bound = f"; nothing lies below {search['lower_bound']:.6g}" if search["lower_bound"] is not None else ""
        rest = "" if search["converged"] else " (not at rest: modes meet there, more may be had)"
        lines += [
            f"{search['reached']} of {search['starts']} starts reached it; the last step promised {search['local_gap']:.1e} of it{rest}{bound}",
            f"a better optimum that attracts more than {search['unseen_share']:.0%} of the starts would have been seen with 95 % probability",
            "optima found: " + ", ".join(f"{value:.6g}" for value in search["local_minima"]),
            "active: " + (", ".join(f"{name} ({price:.3g})" for name, price in search["active"].items()) or "nothing"),
        ]
    if "out" in document:
        lines.append(
            f"written to {document['out']}: design.json, figures; controller.toml where the law can run in a loop"
        )
    return "\n".join(lines)


def _write(folder: Path, fe: FeModel, design: Design, document: dict[str, Any]) -> None:
    """Write everything but the manifest."""
    from controllers.loop_matrices import loops_of, response
    from vlab.signals import FrequencyResponse
    from vlab.views.figures import frf_figure, nyquist_figure, pole_figure, to_png, to_svg

    text = json.dumps(document, allow_nan=False, indent=2)
    (folder / "design.json").write_text(text + "\n", encoding="utf-8")
    if not isinstance(design, LqrDesign):
        labels = {"name": document["law"], "structure": document["structure"], "model": document["model"]}
        write_law(design.controller, folder / "controller.toml", **labels)
    loops, channels = loops_of(design), design.model.channels
    top = 1.3 * max(document["frequencies_hz"])
    freq = _lines(
        0.3 * float(fe.linear.freq[fe.linear.freq > 0].min()), top, [loops.plant.poles(), loops.closed.poles()]
    )

    def frf(system: Any) -> FrequencyResponse:
        outputs = tuple(f"velocity:{name}" for name in channels)
        inputs = tuple(f"force:{name}" for name in channels)
        return FrequencyResponse(freq=freq, H=response(system, freq), outputs=outputs, inputs=inputs, unit="m/s/N")

    exciter = fe.structure.exciter if fe.structure.exciter in channels else channels[0]
    title = f"{document['law']} on the {document['model']} model"
    figures = {
        "bode": frf_figure(
            frf(loops.plant),
            frf(loops.closed),
            exciter,
            exciter,
            labels=("open loop", "closed loop"),
            title=title,
            log_frequency=True,
        ),
        "nyquist": nyquist_figure(freq, response(loops.gain, freq), title=title),
        "poles": pole_figure(
            [("open loop", loops.plant.poles()), ("closed loop", loops.closed.poles())],
            damping=(document["asked"]["damping"],),
            highest_hz=top,
        ),
    }
    for name, figure in figures.items():
        (folder / f"{name}.svg").write_text(to_svg(figure), encoding="utf-8")
        (folder / f"{name}.png").write_bytes(to_png(figure))


def _lines(low: float, high: float, poles: list[Any]) -> Any:
    """Return frequencies [Hz] that are dense around every resonance, so that the circles of a Nyquist plot are round."""
    lines = [np.geomspace(low, high, 800)]
    around = np.sinh(np.linspace(-4, 4, 81))  # half widths of the resonance
    for s in np.concatenate(poles):
        if 0 < s.imag < 2 * np.pi * high:
            lines.append((s.imag + abs(s.real) * around) / (2 * np.pi))
    freq = np.unique(np.concatenate(lines))
    return freq[(freq >= low) & (freq <= high)]
