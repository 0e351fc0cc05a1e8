"""Designed laws by name, with defaults of the published designs."""

import math
from dataclasses import dataclass, fields, replace
from typing import Any, Literal

from vlab.controllers.lqdrf import Kind, LqdrfDesign
from vlab.controllers.lqg import LqgDesign
from vlab.controllers.lqr import LqrDesign
from vlab.controllers.mfdrf import MfdrfDesign

from vlab.controllers import lqdrf, lqg, lqr, mfdrf
from vlab.design.published_tables import published_designs
from vlab.design.state_model import state_model
from vlab.design.weights import noise_of, weights_of
from vlab.errors import BadDesign, unknown_name
from vlab.fe.model import FeModel
from vlab.fe.reduced import build_reduced_model
from vlab.structure.model import Structure

WEIGHTS = ("identity", "energy")
"""Kinds of weights."""
LAWS = ("lqr", "lqg", "mfdrf", "lqdrf", "lqdrf-diagonal")
"""Names of the laws: regulator, regulator with filter, and direct rate feedback of least force and of least index
(coupled or diagonal)."""

DESIGNED_ON_FULL = {"beam": ("lqr", "mfdrf", "lqdrf", "lqdrf-diagonal")}
"""Published designs on the full model (section 6.1), by structure. Every other design is on the published design's
reduced model."""

Design = LqrDesign | LqgDesign | MfdrfDesign | LqdrfDesign


IN_UNITS = ("q", "r", "v1", "v2", "alpha")
"""IN_UNITS: requirements whose value depends on the units of state, force and time."""


@dataclass(frozen=True, kw_only=True)
class Asked:
    """Requirements of a design.

    Weights, noise and margin are in inches, pounds and centiseconds, as published, except those named in `si`.

    Parameters
    ----------
    weights : str
        ``"identity"`` for Q = q I, ``"energy"`` for Q = diag(M, K).
    q, r, v1, v2, alpha : float
        Q = q I, R = r I, V_1 = v1 I, V_2 = v2 I, stability margin of the filter.
    damping : float
        Smallest damping ratio of the first `modes` coil-driven modes.
    modes, shapes : int
        Number n_m of bounded modes; number n_f of initial shapes of LQDRF.
    kind : str
        Objective of LQDRF: the ``"largest"`` index or the largest ``"ratio"`` to the regulator's.
    starts : int or None
        Random starts of the search; None for the law's own number.
    seed : int
        Seed of the random starts.
    rate : float
        Sample rate of a law with states [Hz].
    si : frozenset of str
        Names among q, r, v1, v2 and alpha of the values in SI.
    """

    weights: Literal["identity", "energy"] = "identity"
    q: float = 1.0
    r: float
    v1: float
    v2: float
    alpha: float
    damping: float = 0.03
    modes: int
    shapes: int
    kind: Kind = "largest"
    starts: int | None = None
    seed: int = 0
    rate: float = lqg.RATE
    si: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        if self.weights not in WEIGHTS:
            raise unknown_name("weights", self.weights, WEIGHTS)
        if self.seed < 0:
            raise BadDesign(f"the seed {self.seed} is negative; accepted: whole numbers from 0")
        for name in ("q", "r", "v1", "v2", "alpha", "damping", "rate"):  # also where the law does not use the number
            if not math.isfinite(getattr(self, name)):
                raise BadDesign(f"{name} = {getattr(self, name)} is not a positive number")
        for name, what in (("modes", "modes cannot be bounded"), ("shapes", "initial shapes cannot be used")):
            if getattr(self, name) < 1:
                raise BadDesign(f"{getattr(self, name)} {what}; accepted: whole numbers from 1")


def default_model(structure: Structure, law: str) -> str:
    """Return the model of a law's published design.

    The result is ``"full"`` without a published design.
    """
    published = published_designs(structure.name)
    if not published or law in DESIGNED_ON_FULL.get(structure.name, ()):
        return "full"
    return published[0].model


def requested_of(structure: Structure, model: str, **changes: Any) -> Asked:
    """Return the requirements of the published design on a model.

    Parameters
    ----------
    structure : Structure
        Structure.
    model : str
        Name of the model.
    changes : object
        Replaced requirements; None keeps the published value.

    Returns
    -------
    Asked
        Requirements.

    Raises
    ------
    BadDesign
        No design was published for the structure, and the changes are incomplete.
    """
    given = {key: value for key, value in changes.items() if value is not None}
    weights = given.get("weights", "identity")
    if weights not in WEIGHTS:
        raise unknown_name("weights", weights, WEIGHTS)
    published = [part for part in published_designs(structure.name) if part.weights == weights]
    if published:
        part = next((p for p in published if p.model == model), published[0])
        base = Asked(
            weights=part.weights,
            q=part.q,
            r=part.r,
            v1=part.v1,
            v2=part.v2,
            alpha=part.alpha,
            damping=part.zeta_min,
            modes=part.damped_modes,
            shapes=part.index_modes,
        )
        return replace(base, **given)
    needed = ("r", "v1", "v2", "alpha", "modes")
    missing = [name for name in needed if name not in given]
    if missing:
        raise BadDesign(
            f"no design with {weights} weights was published for structure {structure.name!r}, so it must be said what is asked "
            f"for: {', '.join(missing)} (all of {', '.join(needed)})"
        )
    return Asked(**{"shapes": given["modes"], **given})


def design_law(fe: FeModel, law: str, asked: Asked) -> Design:
    """Design a law of the catalogue on a model.

    Parameters
    ----------
    fe : FeModel
        Model for the design.
    law : str
        Name in `LAWS`.
    asked : Asked
        Requirements.

    Returns
    -------
    Design
        Design of the law's class.

    Raises
    ------
    UnknownName
        No such law.
    BadDesign
        The requirements cannot be met.
    """
    if law not in LAWS:
        raise unknown_name("law", law, LAWS)
    model = state_model(fe)
    search: dict[str, Any] = {"damping": asked.damping, "modes": asked.modes, "seed": asked.seed}
    if asked.starts is not None:
        search["starts"] = asked.starts
    if law == "mfdrf":
        return mfdrf.design(fe, **search)
    weights = weights_of(asked, model)
    if law == "lqr":
        return lqr.design(model, weights)
    if law == "lqg":
        return lqg.design(model, weights, noise_of(asked, model), rate=asked.rate)
    diagonal = law == "lqdrf-diagonal"
    return lqdrf.design(fe, weights, shapes=asked.shapes, kind=asked.kind, diagonal=diagonal, **search)


def published_way(
    structure: Structure, law: str, *, rate: float, variant: str = "published", model: str = ""
) -> Design:
    """Design a law as published for a structure.

    `rate` is the loop's sample rate [Hz]; `model` replaces the published model.
    """
    model = model or default_model(structure, law)
    return design_law(build_reduced_model(structure, model, variant), law, requested_of(structure, model, rate=rate))


def as_plain(asked: Asked) -> dict[str, Any]:
    """Return requirements as plain data, with the units of weights, noise and margin."""
    units = {name: "m, N, s" if name in asked.si else "in, lbf, cs" for name in IN_UNITS}
    return {f.name: getattr(asked, f.name) for f in fields(asked) if f.name != "si"} | {"units": units}
