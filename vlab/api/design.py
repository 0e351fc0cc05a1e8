"""Design or judgement of a control law on a structure."""

import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from vlab.api.law_argument import is_given, laboratory_for, linear_gains, load_law_argument
from vlab.controllers import DirectRateFeedback, LinearController, LinearLaw
from vlab.controllers.catalogue import (
    LAWS,
    Asked,
    CatalogueLaw,
    as_plain,
    default_model,
    design_law,
    laws_with_delay,
    requested_of,
)
from vlab.controllers.designed_law import Design
from vlab.controllers.law_file import write_law
from vlab.controllers.lqdrf import KINDS
from vlab.controllers.lqg import estimator
from vlab.design.gain_search import bounded_modes
from vlab.design.performance import shared_modes
from vlab.design.state_model import StateModel, state_model
from vlab.design.weights import weights_of
from vlab.errors import BadDesign, unknown_name
from vlab.fe.assembly import build_fe_model
from vlab.fe.model import FeModel
from vlab.fe.reduced import build_reduced_model
from vlab.files.arguments import checked
from vlab.files.output_folder import finite, output_folder, write_manifest
from vlab.hardware.array_controller import array_report
from vlab.lab.prediction import ClosedLoop, SampledLoop, loop_on
from vlab.lab.robustness import robustness_report
from vlab.structure import load_structure
from vlab.structure.model import Structure

UNITS = ("si", "published")
"""UNITS: systems of units of weights, noise and margin."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class DesignedLaw:
    """Law on a model with its performance.

    Parameters
    ----------
    structure : Structure
        Structure of the law.
    fe : FeModel
        Design model.
    law : LinearController or None
        Law in the loop; None for the regulator, which has no sensors.
    document : dict
        Gains, damping ratios and indices as plain data, as in ``design.json``.
    asked : Asked
        Settings of the design.
    figures : callable
        Returns the figures of the law by name, up to a frequency [Hz].
    modelled : StateModel or None
        State model of the design.
    continuous : array or None
        Roots of the continuous law before sampling [rad/s].
    loop : SampledLoop or None
        Sampled loop on the full model, if margins were computed.
    """

    structure: Structure
    fe: FeModel
    law: LinearController | None
    document: dict[str, Any]
    asked: Asked
    figures: Callable[[float], dict[str, Any]]
    modelled: StateModel | None = None
    continuous: Any = None
    loop: SampledLoop | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the design as plain data, as in ``design.json``."""
        return dict(self.document)

    def __repr__(self) -> str:
        """Return law, model and objective in one line."""
        found, objective = self.document, self.document["objective"]
        value = f"{objective['name']} {objective['value']:.4g} {objective['unit']}".removesuffix(" 1")
        return f"<DesignedLaw: {found['law']} on the {found['model']} model of {self.structure.name}; {value}>"

    def save(self, folder: Path | str, *, overwrite: bool = False) -> Path:
        """Write ``design.json``, figures, and ``controller.toml`` of a law for loops.

        Parameters
        ----------
        folder : Path or str
            Output folder.
        overwrite : bool
            Whether a folder that vlab wrote is replaced.

        Returns
        -------
        Path
            Written folder.

        Raises
        ------
        OutputRefused
            The folder exists, or cannot be written.
        """
        from vlab.views.figures.design import robustness_figures, write_figures

        document = self.document
        with output_folder(folder, overwrite=overwrite) as fresh:
            text = json.dumps(document, allow_nan=False, indent=2)
            (fresh / "design.json").write_text(text + "\n", encoding="utf-8")
            if isinstance(self.law, DirectRateFeedback | LinearLaw):
                labels = {"name": document["law"], "structure": document["structure"], "model": document["model"]}
                write_law(self.law, fresh / "controller.toml", **labels)
            figures = self.figures(1.3 * max(document["frequencies_hz"]))
            if self.loop is not None:
                figures |= robustness_figures(self.loop, document["robustness"], document["law"])
            write_figures(fresh, figures)
            settings = {key: document[key] for key in ("law", "structure", "model")}
            write_manifest(fresh, verb="design", **settings, asked=as_plain(self.asked))
        return Path(folder)


@checked(BadDesign)
def design(
    structure: str,
    law: str,
    *,
    model: str = "",
    variant: str = "published",
    weights: Literal["identity", "energy"] | None = None,
    q: float | None = None,
    r: float | None = None,
    v1: float | None = None,
    v2: float | None = None,
    alpha: float | None = None,
    damping: float | None = None,
    modes: int | None = None,
    shapes: int | None = None,
    objective: str | None = None,
    starts: int | None = None,
    seed: int | None = None,
    rate_hz: float | None = None,
    with_delay: bool = False,
    robustness: bool = False,
    array: bool = False,
    units: Literal["si", "published"] = "si",
) -> DesignedLaw:
    """Design a control law, or judge a finished one.

    None means the value of the published design, which is in inches, pounds and centiseconds.

    Parameters
    ----------
    structure : str
        Built-in structure (``"beam"``, ``"grid"``) or structure file.
    law : str
        Law of the catalogue to design, or a finished law: ``"path/to/law.py:CLASS"``, ``"entry:NAME"`` or a
        ``controller.toml``.
    model : str
        Design model; that of the published design by default, for a finished law the full one.
    variant : str
        Variant of the structure.
    weights : str, optional
        ``"identity"``: Q = q I. ``"energy"``: Q = diag(M, K).
    q, r, v1, v2, alpha : float, optional
        Q = q I, R = r I, V1 = v1 I, V2 = v2 I, stability margin of the filter.
    damping : float, optional
        Smallest damping ratio of the first modes.
    modes, shapes : int, optional
        Number of bounded modes; number of initial shapes of LQDRF.
    objective : str, optional
        LQDRF: ``"largest"`` index, or largest ``"ratio"`` to the regulator's index.
    starts, seed : int, optional
        Number of random starts, and their seed.
    rate_hz : float, optional
        Sample rate of a law with states [Hz].
    with_delay : bool
        LQG: design for the loop with its delay and hold.
    robustness : bool
        Whether margins of the sampled loop are computed.
    array : bool
        Whether the law is checked on the array controller.
    units : str
        Units of the given q, r, v1, v2 and alpha: ``"si"``, with states in m, m/s, rad and rad/s, forces in N and time in s;
        or ``"published"``, in inches, pounds and centiseconds.

    Returns
    -------
    DesignedLaw
        Law, its gains and its performance.

    Raises
    ------
    BadDesign
        The design is impossible, or a setting does not belong to the law.
    BadController
        A finished law fails or does not fit the structure.
    UnknownName
        No such law, model or objective.
    """
    built = load_structure(structure)
    if not law:
        raise BadDesign(f"no law was named; give one of {', '.join(LAWS)}, or a law file")
    if with_delay and law not in laws_with_delay():
        known = ", ".join(laws_with_delay())
        raise BadDesign(f"the delay is for the law {known}; {law!r} has no model that the delay could be in")
    if units not in UNITS:
        raise unknown_name("units", units, UNITS, where="design")
    begun = time.perf_counter()
    in_units = {"q": q, "r": r, "v1": v1, "v2": v2, "alpha": alpha}
    si = frozenset(name for name, value in in_units.items() if value is not None and units == "si")
    if is_given(law):
        given = {"weights": weights, "q": q, "r": r, "modes": modes, "si": si}
        made = _judge(built, law, model or "full", variant, rate_hz, given)
    else:
        changes = {
            "weights": weights, **in_units, "damping": damping, "modes": modes, "shapes": shapes, "starts": starts,
            "seed": seed, "rate": rate_hz, "kind": objective, "si": si,
        }  # fmt: skip
        made = _design(built, law, model, variant, changes, with_delay=with_delay)
    made.document["seconds"] = time.perf_counter() - begun
    return _with_checks(made, variant, rate_hz, robustness=robustness, array=array)


def _with_checks(
    made: DesignedLaw, variant: str, rate_hz: float | None, *, robustness: bool, array: bool
) -> DesignedLaw:
    """Return the law with margins and array controller."""
    if not (robustness or array):
        return made
    law, loop = law_in_a_loop(made), None
    hardware = laboratory_for(law, rate_hz)
    if array:
        made.document["array"] = finite(array_report(law, hardware, continuous=made.continuous))
    if robustness:
        full = build_fe_model(made.structure, variant)
        loop = loop_on(full, law, hardware.converter)
        made.document["robustness"] = finite(robustness_report(loop, modelled=_modelled(full, made.modelled)))
    return replace(made, loop=loop)


def _modelled(full: FeModel, designed_on: StateModel | None) -> list[int] | None:
    """Return the modes in the design model."""
    return None if designed_on is None else (shared_modes(state_model(full), designed_on) + 1).tolist()


def law_in_a_loop(made: DesignedLaw) -> LinearController:
    """Return the law of a design for a sampled loop.

    Parameters
    ----------
    made : DesignedLaw
        Designed law.

    Returns
    -------
    LinearController
        Law from sensors to actuators.

    Raises
    ------
    BadDesign
        The law needs every state, which no sensor gives.
    """
    if made.law is None:
        known = LAWS[made.document["law"]]
        raise BadDesign(f"{known.not_in_a_loop}, so it has no sampled loop; take {known.estimated_by}")
    return made.law


def _design(
    structure: Structure, name: str, model: str, variant: str, changes: dict[str, Any], *, with_delay: bool
) -> DesignedLaw:
    """Design a law of the catalogue."""
    if name not in LAWS:
        raise unknown_name("law", name, LAWS, where="design")
    if changes["kind"] is not None and changes["kind"] not in KINDS:
        raise unknown_name("objective", changes["kind"], KINDS, where="design")
    model = model or default_model(structure, name)
    asked = requested_of(structure, model, **changes)
    fe = build_reduced_model(structure, model, variant)
    if with_delay:
        return _with_delay(structure, fe, LAWS[name], model, asked)
    design = design_law(fe, name, asked)
    document = describe(fe, design, name, model, asked)
    title = f"{name} on the {model} model"

    def figures(top: float) -> dict[str, Any]:
        from vlab.views.figures.design import design_figures

        return design_figures(fe, design, title=title, top=top, damping=asked.damping)

    F, K = design.state_gain, design.filter_gain
    continuous = None if K is None else np.linalg.eigvals(estimator(design.model, F, K))
    return DesignedLaw(
        structure=structure,
        fe=fe,
        law=design.in_loop,
        document=document,
        asked=asked,
        modelled=design.model,
        continuous=continuous,
        figures=figures,
    )


def _with_delay(structure: Structure, fe: FeModel, law_kind: CatalogueLaw, model: str, asked: Asked) -> DesignedLaw:
    """Design a law for the sampled plant with delay."""
    assert law_kind.design_with_delay is not None
    state, converter = state_model(fe), laboratory_for(None, asked.rate).converter
    design = law_kind.design_with_delay(state, asked, converter.delay_samples)
    law, modes = design.controller, _shown(fe, asked)
    z = design.regulator_poles
    z = z[np.abs(z) > 1e-9]  # states of the delay alone
    freq, zeta = ClosedLoop(z, np.log(z.astype(complex)) * asked.rate).modes(fe.linear.freq[list(modes)])
    least = float(zeta[: asked.modes].min())
    document = {
        "law": f"{law_kind.name} with delay",
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
    figures = _loop_figures(fe, loop_on(fe, law, converter), f"{law_kind.name} with delay on the {model} model", asked)
    return DesignedLaw(
        structure=structure, fe=fe, law=law, document=finite(document), asked=asked, modelled=state, figures=figures
    )


def _judge(
    structure: Structure, name: str, model: str, variant: str, rate_hz: float | None, changes: dict[str, Any]
) -> DesignedLaw:
    """Load a finished law and evaluate it."""
    fe = build_reduced_model(structure, model, variant)
    asked = requested_of(structure, model, **changes)
    modes, given = _shown(fe, asked), load_law_argument(fe, name, rate_hz)
    document: dict[str, Any] = {"law": name, "structure": structure.name, "model": model}
    document |= given.describe(modes, asked)
    document["modes"] = [mode + 1 for mode in modes]
    figures = _loop_figures(fe, given.loop, f"{name} on the {model} model", asked)
    return DesignedLaw(
        structure=structure, fe=fe, law=given.law, document=finite(document), asked=asked, figures=figures
    )


def _loop_figures(fe: FeModel, loop: SampledLoop, title: str, asked: Asked) -> Callable[[float], dict[str, Any]]:
    def figures(top: float) -> dict[str, Any]:
        from vlab.views.figures.design import loop_figures

        return loop_figures(fe, loop, title=title, top=top, damping=asked.damping)

    return figures


def _shown(fe: FeModel, asked: Asked) -> tuple[int, ...]:
    """Return the reported modes."""
    driven = len(fe.measured)
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
    freq, zeta = design.closed_modes(modes)
    indices = design.shape_indices(modes, weights_of(asked, design.model))
    document: dict[str, Any] = {
        "law": law,
        "structure": fe.structure.name,
        "model": model,
        "asked": as_plain(asked),
        "gains": design.gains(),
        "modes": [mode + 1 for mode in modes],
        "frequencies_hz": freq,
        "damping_ratios": zeta,
        "performance_indices": indices,
        "objective": design.goal(indices[: asked.modes]),
    }
    if design.search is not None:
        document["search"] = asdict(design.search)
    result: dict[str, Any] = finite(document)
    return result
