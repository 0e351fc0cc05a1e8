"""``vlab design``."""

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vlab import units
from vlab.cli.common import Outcome, text_table
from vlab.cli.destination import add_out, check_out
from vlab.cli.law_argument import file_of, is_given, laboratory_for, linear_gains, load_law_argument
from vlab.controllers import DirectRateFeedback, LinearController, LinearLaw, delayed_lqg
from vlab.controllers.catalogue import LAWS, Asked, Design, as_plain, default_model, design_law, requested_of
from vlab.controllers.law_file import write_law
from vlab.controllers.lqdrf import KINDS, LqdrfDesign
from vlab.controllers.lqg import LqgDesign
from vlab.controllers.lqr import LqrDesign
from vlab.controllers.mfdrf import MfdrfDesign
from vlab.design.gain_search import bounded_modes
from vlab.design.performance import shared_modes
from vlab.design.state_model import StateModel, state_model
from vlab.design.weights import noise_of, weights_of
from vlab.errors import BadDesign, unknown_name
from vlab.fe.assembly import build_fe_model
from vlab.fe.damping import driven_modes
from vlab.fe.model import FeModel
from vlab.fe.reduced import MODELS, build_reduced_model
from vlab.files.output_folder import finite, output_folder, write_manifest
from vlab.files.text import in_line
from vlab.hardware.array_controller import array_report, array_text
from vlab.lab.prediction import ClosedLoop, SampledLoop, loop_on
from vlab.lab.robustness import robustness_report, robustness_text
from vlab.structure import load_structure
from vlab.structure.model import Structure

PRINTED = "lbf s/in"
"""PRINTED: unit of printed rate feedback gains beside SI, as in Tables 7, 11 and 15."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("structure", help="use this built-in structure (beam, grid) or structure file")
    parser.add_argument(
        "--law",
        default="",
        help=f"design this law: {', '.join(LAWS)}; or judge a law: path/to/law.py:ClassName, entry:NAME, controller.toml (required)",
    )
    parser.add_argument(
        "--model", help=f"design on this model: {', '.join(MODELS)} (default: that of the published design)"
    )
    parser.add_argument(
        "--variant", default="published", help="model this variant of the structure: published (default) or physical"
    )
    published = " (default: that of the published design)"
    parser.add_argument("--weights", help="weight the state by identity, Q = q I (default), or energy, Q = diag(M, K)")
    for name, what in (
        ("q", "set Q = q I"),
        ("r", "set R = r I"),
        ("v1", "set V1 = v1 I"),
        ("v2", "set V2 = v2 I"),
        ("alpha", "set the stability margin of the filter"),
    ):
        parser.add_argument(f"--{name}", type=float, help=f"{what}, in inches, pounds and centiseconds{published}")
    parser.add_argument(
        "--damping", type=float, help=f"bound the damping ratio of the first modes from below [-]{published}"
    )
    parser.add_argument("--modes", type=int, help=f"apply that bound to this number of modes{published}")
    parser.add_argument("--shapes", type=int, help=f"minimise LQDRF over this number of initial shapes{published}")
    parser.add_argument(
        "--objective",
        help="lqdrf: minimise the largest index (largest) or the largest ratio to the regulator's index (ratio) (default largest)",
    )
    parser.add_argument(
        "--starts", type=int, help="search from this number of random starts (default: that of the law)"
    )
    parser.add_argument("--seed", type=int, help="draw the random starts with this seed (default 0)")
    parser.add_argument("--rate", type=float, help="sample a law with states at this rate in Hz (default 1000)")
    parser.add_argument(
        "--with-delay", action="store_true", help="lqg: design for the loop with its delay and hold (default: without)"
    )
    parser.add_argument(
        "--robustness",
        action="store_true",
        help="compute margins of the sampled loop and the first unstable mode (default: no)",
    )
    parser.add_argument("--array", action="store_true", help="check the law on the array controller (default: no)")
    add_out(parser, "design.json, controller.toml and figures to this folder (default: print only)")


@dataclass(frozen=True, kw_only=True, eq=False)
class Made:
    """Law on a model, ready for the report.

    Parameters
    ----------
    law : LinearController or None
        Law in the loop; None for the regulator, which has no sensors.
    modelled : StateModel or None
        Design model.
    continuous : array or None
        Roots of the continuous law before sampling [rad/s].
    figures : callable
        Returns the figures of the law, up to a frequency [Hz].
    """

    fe: FeModel
    law: LinearController | None
    document: dict[str, Any]
    asked: Asked
    modelled: StateModel | None = None
    continuous: Any = None
    figures: Callable[[float], dict[str, Any]]


def run(arguments: argparse.Namespace) -> Outcome:
    """Design a law, or load one, and report its performance.

    Parameters
    ----------
    arguments : Namespace
        Parsed arguments of the command.

    Returns
    -------
    Outcome
        Document and text of the command.
    """
    structure = load_structure(arguments.structure)
    if not arguments.law:
        raise BadDesign(f"no law was named; give --law with one of {', '.join(LAWS)}, or a law file")
    if arguments.with_delay and arguments.law != "lqg":
        raise BadDesign(f"--with-delay is for the law lqg; {arguments.law!r} has no model that the delay could be in")
    check_out(arguments, read=[arguments.structure, file_of(arguments.law)])
    begun = time.perf_counter()
    made = _judge(arguments, structure) if is_given(arguments.law) else _design(arguments, structure)
    document = made.document
    document["seconds"] = time.perf_counter() - begun
    loop = None
    if arguments.array or arguments.robustness:
        law = _in_a_loop(made.law)
        hardware = laboratory_for(law, arguments.rate)
        if arguments.array:
            document["array"] = finite(array_report(law, hardware, continuous=made.continuous))
        if arguments.robustness:
            full = build_fe_model(structure, arguments.variant)
            loop = loop_on(full, law, hardware.converter)
            document["robustness"] = finite(robustness_report(loop, modelled=_modelled(full, made.modelled)))
    if arguments.out:
        with output_folder(arguments.out, overwrite=arguments.overwrite) as folder:
            _write(folder, made, loop)
            settings = {key: document[key] for key in ("law", "structure", "model")}
            write_manifest(folder, verb="design", **settings, asked=as_plain(made.asked))
        document["out"] = str(arguments.out)
    return Outcome(document=document, text=_text(structure.title, document))


def _modelled(full: FeModel, designed_on: StateModel | None) -> list[int] | None:
    """Return the modes in the design model."""
    return None if designed_on is None else (shared_modes(state_model(full), designed_on) + 1).tolist()


def _in_a_loop(law: LinearController | None) -> LinearController:
    if law is None:
        raise BadDesign(
            "the law lqr feeds every state back, which no sensors measure, so it has no sampled loop; take lqg"
        )
    return law


def _design(arguments: argparse.Namespace, structure: Structure) -> Made:
    """Design a law of the catalogue."""
    if arguments.law not in LAWS:
        raise unknown_name("law", arguments.law, LAWS, where="design")
    if arguments.objective is not None and arguments.objective not in KINDS:
        raise unknown_name("objective", arguments.objective, KINDS, where="--objective")
    model = arguments.model or default_model(structure, arguments.law)
    names = ("weights", "q", "r", "v1", "v2", "alpha", "damping", "modes", "shapes", "starts", "seed", "rate")
    changes = {name: getattr(arguments, name) for name in names} | {"kind": arguments.objective}
    asked = requested_of(structure, model, **changes)
    fe = build_reduced_model(structure, model, arguments.variant)
    if arguments.with_delay:
        return _with_delay(fe, model, asked)
    design = design_law(fe, arguments.law, asked)
    document = describe(fe, design, arguments.law, model, asked)
    title = f"{arguments.law} on the {model} model"

    def figures(top: float) -> dict[str, Any]:
        from vlab.views.figures.design import design_figures

        return design_figures(fe, design, title=title, top=top, damping=asked.damping)

    law = None if isinstance(design, LqrDesign) else design.controller
    continuous = np.linalg.eigvals(design.A_estimator) if isinstance(design, LqgDesign) else None
    return Made(
        fe=fe,
        law=law,
        document=document,
        asked=asked,
        modelled=design.model,
        continuous=continuous,
        figures=figures,
    )


def _with_delay(fe: FeModel, model: str, asked: Asked) -> Made:
    """Design LQG for the sampled plant with delay."""
    state, converter = state_model(fe), laboratory_for(None, asked.rate).converter
    design = delayed_lqg.design(
        state,
        weights_of(asked, state),
        noise_of(asked, state),
        rate=asked.rate,
        delay_samples=converter.delay_samples,
    )
    law, modes = design.controller, _shown(fe, asked)
    z = design.regulator_poles
    z = z[np.abs(z) > 1e-9]  # states of the delay alone
    freq, zeta = ClosedLoop(z, np.log(z.astype(complex)) * asked.rate).modes(fe.linear.freq[list(modes)])
    least = float(zeta[: asked.modes].min())
    document = {
        "law": "lqg with delay",
        "structure": fe.structure.name,
        "model": model,
        "asked": as_plain(asked),
        "gains": linear_gains(law, asked.rate),
        "modes": [mode + 1 for mode in modes],
        "frequencies_hz": freq,
        "damping_ratios": zeta,
        "performance_indices": [None] * len(modes),
        "objective": {"name": "smallest damping ratio of the bounded modes", "value": least, "unit": "1"},
    }
    figures = _loop_figures(fe, loop_on(fe, law, converter), f"lqg with delay on the {model} model", asked)
    return Made(fe=fe, law=law, document=finite(document), asked=asked, modelled=state, figures=figures)


def _judge(arguments: argparse.Namespace, structure: Structure) -> Made:
    """Load a finished law and evaluate it."""
    model = arguments.model or "full"
    fe = build_reduced_model(structure, model, arguments.variant)
    asked = requested_of(
        structure, model, **{name: getattr(arguments, name) for name in ("weights", "q", "r", "modes")}
    )
    modes, given = _shown(fe, asked), load_law_argument(fe, arguments.law, arguments.rate)
    document: dict[str, Any] = {"law": arguments.law, "structure": structure.name, "model": model}
    document |= given.describe(modes, asked)
    document["modes"] = [mode + 1 for mode in modes]
    figures = _loop_figures(fe, given.loop, f"{arguments.law} on the {model} model", asked)
    return Made(fe=fe, law=given.law, document=finite(document), asked=asked, figures=figures)


def _loop_figures(fe: FeModel, loop: SampledLoop, title: str, asked: Asked) -> Callable[[float], dict[str, Any]]:
    def figures(top: float) -> dict[str, Any]:
        from vlab.views.figures.design import loop_figures

        return loop_figures(fe, loop, title=title, top=top, damping=asked.damping)

    return figures


def _shown(fe: FeModel, asked: Asked) -> tuple[int, ...]:
    """Return the reported modes."""
    driven = len(driven_modes(fe.coils.T @ fe.linear.eigen[1]))
    return bounded_modes(fe, min(max(len(fe.structure.damping.ratios), asked.modes), driven))


def describe(fe: FeModel, design: Design, law: str, model: str, asked: Asked) -> dict[str, Any]:
    """Return a design as plain data.

    Parameters
    ----------
    fe : FeModel
        FE model.
    design : Design
        Design.
    law : str
        Name of the law.
    model : str
        Name of the design model.
    asked : Asked
        Settings of the design.

    Returns
    -------
    dict
        Plain data for JSON.
    """
    modes = _shown(fe, asked)
    if isinstance(design, LqrDesign | LqgDesign):
        found = design.poles
        zeta, freq = found.zeta[list(modes)], found.freq[list(modes)]
        indices = design.indices(modes)
    else:
        tracked = design.loop.track(design.D, max(modes) + 1)
        zeta, freq = tracked.zeta[0, list(modes)], tracked.freq[0, list(modes)]
        indices = design.indices(weights_of(asked, design.model), modes)
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
    lines = [f"{in_line(title)}: {document['law']} on the {document['model']} model, {document['seconds']:.2f} s", ""]
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
    if "array" in document:
        lines += ["", array_text(document["array"])]
    if "robustness" in document:
        lines += ["", "in the sampled loop on the full model:", robustness_text(document["robustness"])]
    if "out" in document:
        lines.append(
            f"written to {document['out']}: design.json, figures; controller.toml where the law can run in a loop"
        )
    return "\n".join(lines)


def _write(folder: Path, made: Made, loop: SampledLoop | None) -> None:
    """Write all files but the manifest."""
    from vlab.views.figures.design import robustness_figures, write_figures

    document = made.document
    text = json.dumps(document, allow_nan=False, indent=2)
    (folder / "design.json").write_text(text + "\n", encoding="utf-8")
    if isinstance(made.law, DirectRateFeedback | LinearLaw):
        labels = {"name": document["law"], "structure": document["structure"], "model": document["model"]}
        write_law(made.law, folder / "controller.toml", **labels)
    figures = made.figures(1.3 * max(document["frequencies_hz"]))
    if loop is not None:
        figures |= robustness_figures(loop, document["robustness"], document["law"])
    write_figures(folder, figures)
