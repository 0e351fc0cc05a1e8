"""Designed laws by name, with defaults of the published designs.

`LAWS` is the one list of the laws: `vlab design`, `vlab experiment --law`, their help and the documents read it.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any, Literal

from vlab.controllers.delayed_lqg import DelayedLqgDesign
from vlab.controllers.designed_law import Design
from vlab.controllers.linear import LinearController
from vlab.controllers.lqdrf import Kind

from vlab.controllers import delayed_lqg, lqdrf, lqg, lqr, mfdrf
from vlab.design.published_tables import published_designs
from vlab.design.state_model import StateModel, state_model
from vlab.design.weights import noise_of, weights_of
from vlab.errors import BadController, BadDesign, unknown_name
from vlab.fe.model import FeModel
from vlab.fe.reduced import build_reduced_model
from vlab.structure.model import Structure

WEIGHTS = ("identity", "energy")
"""Kinds of weights."""


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


@dataclass(frozen=True, kw_only=True)
class CatalogueLaw:
    """One law of the catalogue.

    Parameters
    ----------
    name : str
        Name for ``--law``.
    words : str
        Meaning, for help and documents.
    design : callable
        Designs the law on a model for requirements.
    design_with_delay : callable or None
        Designs the law on a model for requirements and a delay in samples; None for a law that cannot respect one.
    on_full : frozenset of str
        Structures whose published design is on the full model (section 6.1). Every other published design is on a
        reduced model.
    estimated_by : str
        Law that estimates the states that this law needs measured; "" for a law on sensors.
    """

    name: str
    words: str
    design: Callable[[FeModel, Asked], Design]
    design_with_delay: Callable[[StateModel, Asked, float], DelayedLqgDesign] | None = None
    on_full: frozenset[str] = frozenset()
    estimated_by: str = ""

    @property
    def not_in_a_loop(self) -> str:
        """Reason why the law cannot run in a loop, or ""."""
        if not self.estimated_by:
            return ""
        return f"the law {self.name} feeds every state back, which no sensors measure"


def _search(asked: Asked) -> dict[str, Any]:
    """Return the settings of a search for gains."""
    search: dict[str, Any] = {"damping": asked.damping, "modes": asked.modes, "seed": asked.seed}
    return search if asked.starts is None else {**search, "starts": asked.starts}


def _regulator(fe: FeModel, asked: Asked) -> Design:
    model = state_model(fe)
    return lqr.design(model, weights_of(asked, model))


def _regulator_with_filter(fe: FeModel, asked: Asked) -> Design:
    model = state_model(fe)
    return lqg.design(model, weights_of(asked, model), noise_of(asked, model), rate=asked.rate)


def _with_delay(model: StateModel, asked: Asked, delay_samples: float) -> DelayedLqgDesign:
    weights, noise = weights_of(asked, model), noise_of(asked, model)
    return delayed_lqg.design(model, weights, noise, rate=asked.rate, delay_samples=delay_samples)


def _least_force(fe: FeModel, asked: Asked) -> Design:
    return mfdrf.design(fe, **_search(asked))


def _least_index(fe: FeModel, asked: Asked, *, diagonal: bool = False) -> Design:
    weights = weights_of(asked, state_model(fe))
    return lqdrf.design(fe, weights, shapes=asked.shapes, kind=asked.kind, diagonal=diagonal, **_search(asked))


ON_FULL = frozenset({"beam"})
LAWS: dict[str, CatalogueLaw] = {
    law.name: law
    for law in (
        CatalogueLaw(
            name="lqr",
            words="linear quadratic regulator; all states measured",
            design=_regulator,
            on_full=ON_FULL,
            estimated_by="lqg",
        ),
        CatalogueLaw(
            name="lqg",
            words="regulator with a Kalman filter of prescribed stability margin",
            design=_regulator_with_filter,
            design_with_delay=_with_delay,
        ),
        CatalogueLaw(name="mfdrf", words="direct rate feedback of least force", design=_least_force, on_full=ON_FULL),
        CatalogueLaw(
            name="lqdrf", words="direct rate feedback of least quadratic index", design=_least_index, on_full=ON_FULL
        ),
        CatalogueLaw(
            name="lqdrf-diagonal",
            words="direct rate feedback of least quadratic index, uncoupled coils",
            design=partial(_least_index, diagonal=True),
            on_full=ON_FULL,
        ),
    )
}
"""Laws by name."""


def laws_in_a_loop() -> list[str]:
    """Return the names of the laws that run on sensors."""
    return [law.name for law in LAWS.values() if not law.estimated_by]


def laws_with_delay() -> list[str]:
    """Return the names of the laws whose design respects a delay."""
    return [law.name for law in LAWS.values() if law.design_with_delay is not None]


def default_model(structure: Structure, law: str) -> str:
    """Return the model of a law's published design.

    The result is ``"full"`` without a published design.
    """
    published = published_designs(structure.name)
    if not published or (law in LAWS and structure.name in LAWS[law].on_full):
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
    return LAWS[law].design(fe, asked)


def published_way(
    structure: Structure, law: str, *, rate: float, variant: str = "published", model: str = ""
) -> Design:
    """Design a law as published for a structure.

    `rate` is the loop's sample rate [Hz]; `model` replaces the published model.
    """
    model = model or default_model(structure, law)
    return design_law(build_reduced_model(structure, model, variant), law, requested_of(structure, model, rate=rate))


def published_controller(
    structure: Structure, law: str, *, rate: float, variant: str = "published", model: str = ""
) -> LinearController:
    """Return a law for a loop, designed as published for a structure.

    Parameters
    ----------
    structure : Structure
        Structure with its points, bars and transducers.
    law : str
        Name in `LAWS`.
    rate : float
        Sample rate of the loop [Hz].
    variant : str
        Variant of the structure's model.
    model : str
        Design model; the published design's by default.

    Returns
    -------
    LinearController
        Law on sensors.

    Raises
    ------
    BadController
        The law needs every state measured.
    """
    known = LAWS[law]
    if known.not_in_a_loop:
        raise BadController(f"{known.not_in_a_loop}; take {known.estimated_by}, which estimates them")
    return in_a_loop(published_way(structure, law, rate=rate, variant=variant, model=model))


def in_a_loop(design: Design) -> LinearController:
    """Return the law of a design on sensors.

    Parameters
    ----------
    design : Design
        Design of a law.

    Raises
    ------
    BadController
        The law needs every state measured.
    """
    if design.in_loop is None:
        raise BadController("the designed law feeds every state back, which no sensors measure")
    return design.in_loop


def as_plain(asked: Asked) -> dict[str, Any]:
    """Return requirements as plain data, with the units of weights, noise and margin."""
    units = {name: "m, N, s" if name in asked.si else "in, lbf, cs" for name in IN_UNITS}
    return {f.name: getattr(asked, f.name) for f in fields(asked) if f.name != "si"} | {"units": units}
