"""Suites of concealed cases: effects, sizes, benches."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from vlab.errors import BadExperiment, unknown_name
from vlab.proof.generator import built_structure, laboratory
from vlab.proof.generator.arm import conceal_arm
from vlab.proof.generator.arm_effects import ARM_FORMS, ARM_LIBRARY, ARM_STRANGE
from vlab.proof.generator.bench import Blueprint
from vlab.proof.generator.concealed import Concealed, Wanted, conceal
from vlab.proof.generator.forms import FORMS
from vlab.proof.generator.hidden import Kind
from vlab.proof.generator.library import LIBRARY
from vlab.proof.generator.out_of_library import STRANGE
from vlab.proof.generator.pendulum import conceal_pendulum
from vlab.proof.generator.pendulum_effects import SWING_FORMS, SWING_LIBRARY, SWING_STRANGE
from vlab.proof.generator.rigs import shaft, slider

OWN_FE, SHARED_FE = "own-fe", "shared-fe"
"""OWN_FE, SHARED_FE: sources of beam and grid. The own FE code of the generator, with deviations that the nominal model
cannot take up; or the FE code of the diagnosed plants. Cases sealed without a named source are of `SHARED_FE`, and their
rigs have exact statements and accurate steps."""
SOURCES: dict[str, dict[str, Callable[[], Blueprint]]] = {
    OWN_FE: {
        "slider": partial(slider, is_varied=True),
        "shaft": partial(shaft, is_varied=True),
        "beam": built_structure.beam,
        "grid": built_structure.grid,
    },
    SHARED_FE: {"slider": slider, "shaft": shaft, "beam": laboratory.beam, "grid": laboratory.grid},
}
"""SOURCES: benches by the source of the structures."""
ARM = "arm"
"""ARM: bench of arms on position servos, see `vlab.proof.generator.arm`."""
SWINGS = ("pendulum", "cart")
"""SWINGS: benches of free pendulums and of carts with a hanging one, see `vlab.proof.generator.pendulum`."""
BENCHES = (*SOURCES[OWN_FE], ARM, *SWINGS)
OPEN_LOOP = {OWN_FE: ("slider", "beam", "grid", ARM, *SWINGS), SHARED_FE: ("slider", ARM, *SWINGS)}
"""OPEN_LOOP: benches without cases in a loop; the slider has no velocity sensor, and an arm closes its own loops."""
SHARES = {"slider": 0.44, "shaft": 0.44, "beam": 0.09, "grid": 0.03, ARM: 0.09, "pendulum": 0.09, "cart": 0.09}
"""SHARES [-]: frequency of each bench; a case of a structure or a mechanism takes as long as ten of a rig."""
DETECTABLE, OBVIOUS = 1.5, 30.0
"""DETECTABLE, OBVIOUS [-]: range of sizes after calibration, in units of the noise, of all suites but near-threshold."""
NEAR = (0.1, 1.5)
"""NEAR [-]: range of sizes of near-threshold."""
EXPLAINED_AWAY, ABSORBED = (1.0, 10.0), 0.5
"""EXPLAINED_AWAY, ABSORBED [-]: range of sizes of explained-away, and least share of the change absorbed by calibration."""
IN_LOOP, ONE_LEVEL = 0.15, 0.15
"""IN_LOOP, ONE_LEVEL [-]: frequencies of loops and of single levels without a known hidden effect. They equal those of
all suites together, so that neither indicates a hidden effect."""
ATTEMPTS = 8
"""ATTEMPTS [-]: draws of bench and physics before a case is given up."""
CHAIN = ("actuator", "sensor", "sensor and coil", "two sensors")
LOOK_ALIKE = (
    "cubic-stiffness",
    "quadratic-drag",
    "quadratic-stiffness",
    "jenkins-slip",
    "dead-band",
    "coulomb-friction",
    "soft-saturation",
    "actuator-dead-zone",
)
"""LOOK_ALIKE: effects that calibration absorbs if all recordings have nearly one level."""

_STRUCTURAL = tuple(k for k in LIBRARY if k.on not in CHAIN)
_CHAIN = tuple(k for k in LIBRARY if k.on in CHAIN)


def _masked(rng: np.random.Generator) -> Wanted:
    if rng.random() < 0.5:
        kinds = tuple(k for k in LIBRARY if k.name in LOOK_ALIKE)
        low, high = EXPLAINED_AWAY
        return Wanted(suite="masked", kinds=(kinds,), low=low, high=high, one_level=True, absorbed=ABSORBED)
    return Wanted(suite="masked", kinds=(_STRUCTURAL,), in_loop=True, veiled=True)


def _null(rng: np.random.Generator) -> Wanted:
    return Wanted(suite="null", in_loop=rng.random() < IN_LOOP, one_level=rng.random() < ONE_LEVEL)


def _strange(rng: np.random.Generator) -> Wanted:
    in_loop, one_level = rng.random() < IN_LOOP, rng.random() < ONE_LEVEL
    # the law of a case reads the true sensors
    kinds = tuple(k for k in STRANGE if not in_loop or k.on not in CHAIN)
    return Wanted(suite="out-of-library", kinds=(kinds,), in_loop=in_loop, one_level=one_level)


_AT_SERVOS = tuple(k for k in ARM_LIBRARY if k.on in ("servo", "all servos"))
_AT_JOINTS = tuple(k for k in ARM_LIBRARY if k.on in ("joint", "all joints", "tip"))
ON_ARMS: dict[str, tuple[tuple[Kind, ...], ...]] = {
    "in-library": (ARM_LIBRARY,),
    "other-form": (ARM_FORMS,),
    "out-of-library": (ARM_STRANGE,),
    "null": (),
    "near-threshold": (ARM_LIBRARY,),
    "two-effects": (_AT_JOINTS, ARM_LIBRARY),
    "chain-only": (_AT_SERVOS,),
    "masked": (ARM_LIBRARY,),
}
"""ON_ARMS: kinds of hidden effects on the bench of arms, by suite."""
_IN_CHAIN = tuple(k for k in SWING_LIBRARY if k.on in ("actuator", "sensor"))
_ON_BODIES = tuple(k for k in SWING_LIBRARY if k.on in ("joint", "tip"))
ON_SWINGS: dict[str, tuple[tuple[Kind, ...], ...]] = {
    "in-library": (SWING_LIBRARY,),
    "other-form": (SWING_FORMS,),
    "out-of-library": (SWING_STRANGE,),
    "null": (),
    "near-threshold": (SWING_LIBRARY,),
    "two-effects": (_ON_BODIES, SWING_LIBRARY),
    "chain-only": (_IN_CHAIN,),
    "masked": (SWING_LIBRARY,),
}
"""ON_SWINGS: kinds of hidden effects on pendulums and carts, by suite."""


SUITES: dict[str, Callable[[np.random.Generator], Wanted]] = {
    "in-library": lambda rng: Wanted(suite="in-library", kinds=(LIBRARY,)),
    "other-form": lambda rng: Wanted(suite="other-form", kinds=(FORMS,)),
    "out-of-library": _strange,
    "null": _null,
    "near-threshold": lambda rng: Wanted(suite="near-threshold", kinds=(LIBRARY,), low=NEAR[0], high=NEAR[1]),
    "two-effects": lambda rng: Wanted(suite="two-effects", kinds=(_STRUCTURAL, LIBRARY)),
    "chain-only": lambda rng: Wanted(suite="chain-only", kinds=(_CHAIN,)),
    "masked": _masked,
}
_LETTERS = {"i": "in-library", "n": "null", "o": "out-of-library", "t": "two-effects", "f": "other-form"}
_OF_MECHANISMS = tuple(_LETTERS[letter] for letter in "iniotifnioitniifoitn")
MIXTURES = {
    "quick": ("in-library",) * 4
    + ("null",) * 3
    + ("other-form", "out-of-library", "chain-only", "two-effects", "masked"),
    "campaign": ("in-library",) * 6
    + ("null",) * 3
    + ("other-form", "out-of-library") * 2
    + ("two-effects", "masked", "near-threshold", "chain-only"),
    "structures": ("out-of-library", "null", "in-library", "in-library", "other-form", "two-effects")
    + ("null", "in-library") * 3,
    "servo": _OF_MECHANISMS,
    "pendulums": _OF_MECHANISMS,
    "all": tuple(SUITES),
}
"""MIXTURES: mixed suites; the seed shuffles their order."""


def drawn_suites(names: Sequence[str], count: int, seed: int) -> list[str]:
    """Return the suite of every case, in shuffled order.

    Parameters
    ----------
    names : sequence of str
        Names of suites or mixtures.
    count : int
        Number of cases.
    seed : int
        Seed of the order.

    Returns
    -------
    list of str
        Name of a suite per case.

    Raises
    ------
    UnknownName
        There is no suite or mixture of that name.
    """
    pool: list[str] = []
    for name in names:
        if name not in SUITES and name not in MIXTURES:
            raise unknown_name("suite", name, [*SUITES, *MIXTURES])
        pool += MIXTURES.get(name, (name,))
    rng = np.random.default_rng([seed, 2**20])
    order = [pool[i % len(pool)] for i in range(count)]
    return [order[i] for i in rng.permutation(count)]


def make_case(suite: str, benches: Sequence[str], seed: int, index: int, *, structures: str = OWN_FE) -> Concealed:
    """Make the case of an index, reproducible by its seed.

    Parameters
    ----------
    suite : str
        Name of the suite.
    benches : sequence of str
        Possible benches, with frequencies of `SHARES`.
    seed : int
        Seed of all cases.
    index : int
        Index of the case.
    structures : str
        Source of beam and grid, one of `SOURCES`.

    Returns
    -------
    Concealed
        Finished case.

    Raises
    ------
    BadExperiment
        No attempt gave an effect of the wanted size.
    """
    last: BadExperiment | None = None
    for attempt in range(ATTEMPTS):
        rng = np.random.default_rng([seed, index, attempt])
        wanted = SUITES[suite](rng)
        possible = [b for b in benches if not wanted.in_loop or b not in OPEN_LOOP[structures]]
        if not possible:
            continue
        shares = np.array([SHARES[b] for b in possible])
        bench = str(rng.choice(possible, p=shares / shares.sum()))
        try:
            if bench == ARM:
                made = conceal_arm(_on_mechanism(wanted, ON_ARMS), rng)
            elif bench in SWINGS:
                made = conceal_pendulum(bench, _on_mechanism(wanted, ON_SWINGS), rng)
            else:
                made = conceal(SOURCES[structures][bench](), wanted, rng)
            return replace(made, truth={**made.truth, "attempt": attempt})
        except BadExperiment as error:
            last = error
    raise last or BadExperiment(f"the suite {suite!r} has no case on {', '.join(benches)}; add another bench")


def _on_mechanism(wanted: Wanted, kinds: Mapping[str, tuple[tuple[Kind, ...], ...]]) -> Wanted:
    """Return the content with the kinds of a mechanism.

    Masked effects are those that calibration absorbs.
    """
    absorbed = ABSORBED if wanted.suite == "masked" else wanted.absorbed
    return replace(wanted, kinds=kinds[wanted.suite], one_level=False, absorbed=absorbed)


def check_benches(names: Sequence[str]) -> None:
    """Refuse an unknown bench."""
    for name in names:
        if name not in BENCHES:
            raise unknown_name("bench", name, BENCHES)


def check_source(name: str) -> None:
    """Refuse an unknown source of the structures."""
    if name not in SOURCES:
        raise unknown_name("source of structures", name, SOURCES)


def kinds() -> tuple[Kind, ...]:
    """Return all kinds of hidden effects of the linear benches."""
    return (*LIBRARY, *FORMS, *STRANGE)


def arm_kinds() -> tuple[Kind, ...]:
    """Return all kinds of hidden effects of arms."""
    return (*ARM_LIBRARY, *ARM_FORMS, *ARM_STRANGE)


def swing_kinds() -> tuple[Kind, ...]:
    """Return all kinds of hidden effects of pendulums and carts."""
    return (*SWING_LIBRARY, *SWING_FORMS, *SWING_STRANGE)
