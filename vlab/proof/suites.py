"""Suites of concealed cases by name: what is hidden, how large, on which bench."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from vlab.errors import BadExperiment, unknown_name
from vlab.proof.generator.bench import Blueprint
from vlab.proof.generator.concealed import Concealed, Wanted, conceal
from vlab.proof.generator.forms import FORMS
from vlab.proof.generator.hidden import Kind
from vlab.proof.generator.laboratory import beam, grid
from vlab.proof.generator.library import LIBRARY
from vlab.proof.generator.out_of_library import STRANGE
from vlab.proof.generator.rigs import shaft, slider

BENCHES: dict[str, Callable[[], Blueprint]] = {"slider": slider, "shaft": shaft, "beam": beam, "grid": grid}
SHARES = {"slider": 0.44, "shaft": 0.44, "beam": 0.09, "grid": 0.03}
"""How often each bench comes up: the structures seldom, for a case of theirs takes as long as ten of a rig."""
DETECTABLE, OBVIOUS = 1.5, 30.0
"""What a refit leaves of something hidden, in units of the noise: range of all suites but near-threshold."""
NEAR = (0.1, 1.5)
"""The same of near-threshold."""
EXPLAINED_AWAY, ABSORBED = (1.0, 10.0), 0.5
"""The same where a linear refit explains it away, and the share of the change that the refit takes up at least."""
IN_LOOP, ONE_LEVEL = 0.15, 0.15
"""How often a law is in the loop, or all recordings to fit have nearly one level, where nothing known is hidden: as often as in all
suites together, for loops and single levels must not tell that something is hidden."""
ATTEMPTS = 8
"""Draws of bench and physics for one case before it is given up."""
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
"""What a linear refit explains away where all recordings have nearly one level."""

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
    # the law of a case sees its sensors as they are
    kinds = tuple(k for k in STRANGE if not in_loop or k.on not in CHAIN)
    return Wanted(suite="out-of-library", kinds=(kinds,), in_loop=in_loop, one_level=one_level)


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
MIXTURES = {
    "quick": ("in-library",) * 4
    + ("null",) * 3
    + ("other-form", "out-of-library", "chain-only", "two-effects", "masked"),
    "campaign": ("in-library",) * 6
    + ("null",) * 3
    + ("other-form", "out-of-library") * 2
    + ("two-effects", "masked", "near-threshold", "chain-only"),
    "all": tuple(SUITES),
}
"""Suites that are mixed in these shares, in an order that the seed shuffles."""


def drawn_suites(names: Sequence[str], count: int, seed: int) -> list[str]:
    """Return the suite of every case, shuffled so that a case's number says nothing.

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


def make_case(suite: str, benches: Sequence[str], seed: int, index: int) -> Concealed:
    """Make the case of an index; the same seed gives the same bits.

    Parameters
    ----------
    benches : sequence of str
        Benches that may come up, in their shares of `SHARES`.

    Raises
    ------
    BadExperiment
        None of the attempts gave something of the wanted size.
    """
    last: BadExperiment | None = None
    for attempt in range(ATTEMPTS):
        rng = np.random.default_rng([seed, index, attempt])
        wanted = SUITES[suite](rng)
        possible = [b for b in benches if not wanted.in_loop or b != "slider"]  # nothing there measures velocity
        if not possible:
            continue
        shares = np.array([SHARES[b] for b in possible])
        bench = str(rng.choice(possible, p=shares / shares.sum()))
        try:
            made = conceal(BENCHES[bench](), wanted, rng)
            return replace(made, truth={**made.truth, "attempt": attempt})
        except BadExperiment as error:
            last = error
    raise last or BadExperiment(f"the suite {suite!r} has no case on {', '.join(benches)}; add another bench")


def check_benches(names: Sequence[str]) -> None:
    """Refuse the name of a bench that there is none of."""
    for name in names:
        if name not in BENCHES:
            raise unknown_name("bench", name, BENCHES)


def kinds() -> tuple[Kind, ...]:
    """Return everything that can be hidden."""
    return (*LIBRARY, *FORMS, *STRANGE)
