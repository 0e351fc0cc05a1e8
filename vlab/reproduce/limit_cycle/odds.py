"""Odds of the explanations of the 41 Hz vibration, and decisive measurements.

Each explanation is drawn many times over its unknowns, among them frequencies and damping of the structure. The loop
of each draw is solved exactly. A draw supports its explanation if it reproduces the observation. One pole then grows
faster than all others, near 41 Hz, and develops over two or three minutes. Nothing is fitted. With equal prior odds,
the shares of such draws are the posterior odds.

A measurement decides as far as the explanations predict different outcomes. Its value is the information of its
outcome about them in bits [1]_.

References
----------
.. [1] D. V. Lindley, "On a measure of the information provided by an experiment", *Annals of Mathematical Statistics*
   27 (1956) 986-1005.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vlab.controllers.catalogue import published_controller
from vlab.controllers.linear import LinearController
from vlab.controllers.lqg import RATE
from vlab.fe.assembly import build_fe_model
from vlab.fe.string_modes import add_string_modes, with_cable_mass
from vlab.hardware import load_hardware
from vlab.hardware.laboratory import Converter
from vlab.lab.prediction import LoopPole, SampledLoop, loop_on
from vlab.reproduce.limit_cycle.study import MOST_DELAY, NEAR_HZ, OBSERVED_HZ, ROPE_FILL
from vlab.signals import Array
from vlab.structure.model import Structure

DRAWS = 300
FREQUENCY_SD, DAMPING_SD, DELAY_SD = 0.014, 0.5, 0.02
"""FREQUENCY_SD, DAMPING_SD, DELAY_SD [-]: standard deviations of modes (relative, logarithmic) from Table 1, and of the
delay (relative) from the last digit of 1.35 samples."""
SHIFTED_SD = 0.07
"""SHIFTED_SD [-]: relative standard deviation of a mode with a wrong design frequency, above that of any measured mode."""
STRING_ZETA = (1e-4, 2e-3)
"""STRING_ZETA [-]: damping ratios of taut steel wires between good and poor ends; assumed."""
CABLE_MASS = (ROPE_FILL, 1.4)
"""CABLE_MASS [-]: range of a cable's mass over that of solid wire. Wire rope is lighter, a taped lead adds mass."""
GROWTH = (0.01, 0.2)
"""GROWTH [1/s]: growth rates from sensor noise by a factor of 1e2 to 1e4 in two to three minutes, with a margin of two."""
TAPE = 10.0
"""TAPE [-]: least factor on a cable's damping by a strip of tape or a hand."""
OWN_ZETA, OWN_HZ = 0.001, 1.0
"""OWN_ZETA [-], OWN_HZ [Hz]: damping and distance of a resonance visible in a test without control."""
MOVED_HZ = 0.5
"""MOVED_HZ [Hz]: unmistakable change of the vibration's frequency."""


@dataclass(frozen=True)
class _Cable:
    """Cable with its own modes in the model.

    Parameters
    ----------
    mass : float
        Factor on its mass per length [-].
    zeta : float
        Damping ratio of its own modes [-].
    """

    name: str
    mass: float
    zeta: float


@dataclass(frozen=True, eq=False)
class _Draw:
    """Draw of an explanation.

    Parameters
    ----------
    cable : _Cable or None
        Cable with own modes; None for massless wires.
    frequency, damping : (modes,) array
        Factors on the modes of the structure [-].
    delay : float
        Delay [samples].
    """

    cable: _Cable | None
    frequency: Array
    damping: Array
    delay: float

    def taped(self, cable: str) -> "_Draw":
        """Return the draw with a strip of tape on a cable."""
        if self.cable is None or self.cable.name != cable:
            return self
        return replace(self, cable=replace(self.cable, zeta=TAPE * self.cable.zeta))


Vary = Callable[[_Draw, np.random.Generator], _Draw]


def _more_delay(draw: _Draw, rng: np.random.Generator) -> _Draw:
    return replace(draw, delay=float(rng.uniform(draw.delay, MOST_DELAY)))


def _own_mode(name: str) -> Vary:
    def vary(draw: _Draw, rng: np.random.Generator) -> _Draw:
        zeta = float(np.exp(rng.uniform(*np.log(STRING_ZETA))))
        return replace(draw, cable=_Cable(name, float(rng.uniform(*CABLE_MASS)), zeta))

    return vary


def _shifted(mode: int) -> Vary:
    def vary(draw: _Draw, rng: np.random.Generator) -> _Draw:
        frequency = draw.frequency.copy()
        frequency[mode - 1] = np.exp(SHIFTED_SD * rng.standard_normal())
        return replace(draw, frequency=frequency)

    return vary


def _both(first: Vary, second: Vary) -> Vary:
    return lambda draw, rng: second(first(draw, rng), rng)


EXPLANATIONS: dict[str, tuple[str, Vary]] = {
    "as modelled": ("nothing is missing; frequencies, damping and delay as far off as they may be", lambda d, rng: d),
    "more delay": (f"the loop is later than was measured, by up to {MOST_DELAY:g} samples in all", _more_delay),
    "lower cable": (
        "the lower cable's own mode, from wire rope to wire with a lead along it",
        _own_mode("cable-lower"),
    ),
    "upper cable": (
        "the upper cable's own mode, from wire rope to wire with a lead along it",
        _own_mode("cable-upper"),
    ),
    "mode 7": ("the structure's seventh mode is not where the design has it", _shifted(7)),
    "lower cable and delay": (
        "the lower cable's own mode, and more delay",
        _both(_own_mode("cable-lower"), _more_delay),
    ),
    "upper cable and delay": (
        "the upper cable's own mode, and more delay",
        _both(_own_mode("cable-upper"), _more_delay),
    ),
    "mode 7 and delay": (
        "the seventh mode is not where the design has it, and more delay",
        _both(_shifted(7), _more_delay),
    ),
}
MEASUREMENTS = {
    "one sample more delay": f"with one sample more delay the vibration moves by more than {MOVED_HZ:g} Hz or is gone",
    "response without control": f"without control there is a resonance lighter than {100 * OWN_ZETA:g} % within {OWN_HZ:g} Hz of it",
    "tape on the lower cable": "a strip of tape on the lower cable ends it",
    "tape on the upper cable": "a strip of tape on the upper cable ends it",
}
"""MEASUREMENTS: possible measurements of one hour in the laboratory, and their outcome."""


class _Bench:
    """LQG loop on the beam, for any draw."""

    def __init__(self, structure: Structure, law: LinearController, converter: Converter) -> None:
        self.structure, self.law, self.converter = structure, law, converter
        self.modes = len(build_fe_model(structure).linear.freq)

    def loop(self, draw: _Draw) -> SampledLoop:
        structure, cable = self.structure, draw.cable
        if cable is None:
            fe = build_fe_model(structure)
        else:
            fe = build_fe_model(with_cable_mass(structure, cable.name, cable.mass))
            fe = add_string_modes(fe, 1, zeta=cable.zeta)
        loop = loop_on(fe, self.law, replace(self.converter, delay_samples=draw.delay))
        frequency, damping = (_padded(f, len(loop.omega)) for f in (draw.frequency, draw.damping))
        share = np.sqrt(damping)
        return replace(loop, omega=loop.omega * frequency, damping=share[:, None] * loop.damping * share)

    def nominal(self, rng: np.random.Generator) -> _Draw:
        """Return a draw of the complete model.

        Parameters
        ----------
        rng : Generator
            Random numbers.

        Returns
        -------
        _Draw
            Draw.
        """
        return _Draw(
            cable=None,
            frequency=np.exp(FREQUENCY_SD * rng.standard_normal(self.modes)),
            damping=np.exp(DAMPING_SD * rng.standard_normal(self.modes)),
            delay=self.converter.delay_samples * float(np.exp(DELAY_SD * rng.standard_normal())),
        )

    def outcomes(self, draw: _Draw, loop: SampledLoop, seen: LoopPole) -> dict[str, bool]:
        """Return the outcome of every measurement for a supporting draw.

        Parameters
        ----------
        draw : _Draw
            Draw.
        loop : SampledLoop
            Its loop.
        seen : LoopPole
            Observed pole.

        Returns
        -------
        dict
            Outcome by measurement.
        """
        later = _fastest(self.loop(replace(draw, delay=draw.delay + 1.0)))
        own_hz, own_zeta = loop.omega / (2 * np.pi), np.diag(loop.damping) / (2 * loop.omega)
        return {
            "one sample more delay": later.growth <= 0 or abs(later.hz - seen.hz) > MOVED_HZ,
            "response without control": bool(np.any((abs(own_hz - seen.hz) < OWN_HZ) & (own_zeta < OWN_ZETA))),
            "tape on the lower cable": _ends(self.loop(draw.taped("cable-lower"))),
            "tape on the upper cable": _ends(self.loop(draw.taped("cable-upper"))),
        }


def limit_cycle_odds(
    structure: Structure,
    *,
    draws: int = DRAWS,
    seed: int = 0,
    progress: Callable[[float, str], None] = lambda share, what: None,
) -> dict[str, Any]:
    """Return odds of explanations and information of measurements.

    Parameters
    ----------
    structure : Structure
        Structure.
    draws : int
        Draws per explanation.
    seed : int
        Seed of the draws.
    progress : callable
        Receives the completed share and the present step.

    Returns
    -------
    dict
        Plain data with sentences.
    """
    law = published_controller(structure, "lqg", rate=RATE)
    bench = _Bench(structure, law, load_hardware().at_rate(RATE).converter)
    rows: list[dict[str, Any]] = []
    ends: dict[str, list[dict[str, bool]]] = {}
    for i, (name, (words, vary)) in enumerate(EXPLANATIONS.items()):
        progress(i / len(EXPLANATIONS), name)
        rng = np.random.default_rng([seed, i])
        grows, slowly, outcomes = 0, 0, []
        for _ in range(draws):
            draw = vary(bench.nominal(rng), rng)
            loop = bench.loop(draw)
            pole = _fastest(loop)
            if pole.growth <= 0 or not NEAR_HZ[0] <= pole.hz <= NEAR_HZ[1]:
                continue
            grows += 1
            if GROWTH[0] <= pole.growth <= GROWTH[1]:
                slowly += 1
                outcomes.append(bench.outcomes(draw, loop, pole))
        ends[name] = outcomes
        rows.append({"name": name, "words": words, "draws": draws, "grows": grows, "as_seen": slowly})
    weights = np.array([(row["as_seen"] + 0.5) / (draws + 1) for row in rows])  # Jeffreys' estimate of a share
    for row, odds in zip(rows, weights / weights.sum(), strict=True):
        row["probability"] = float(odds)
    measurements = _informative(rows, ends)
    return {"explanations": rows, "measurements": measurements, "sentences": _sentences(rows, measurements)}


def _padded(factors: Array, size: int) -> Array:
    """Return factors for all modes of a loop, one beyond the structure's."""
    return np.concatenate([factors[:size], np.ones(max(size - len(factors), 0))])


def _fastest(loop: SampledLoop) -> LoopPole:
    return max(loop.poles(), key=lambda pole: pole.growth)


def _ends(loop: SampledLoop) -> bool:
    return not any(pole.growth > 0 and NEAR_HZ[0] <= pole.hz <= NEAR_HZ[1] for pole in loop.poles())


def _informative(rows: Sequence[dict[str, Any]], ends: dict[str, list[dict[str, bool]]]) -> list[dict[str, Any]]:
    """Return the measurements by information about supported explanations."""
    able = [row for row in rows if ends[row["name"]]]
    if not able:
        return []
    odds = np.array([row["probability"] for row in able])
    odds = odds / odds.sum()
    out = []
    for name, words in MEASUREMENTS.items():
        yes = np.array([(sum(o[name] for o in ends[r["name"]]) + 0.5) / (len(ends[r["name"]]) + 1.0) for r in able])
        bits = _entropy(np.array([odds @ yes, odds @ (1 - yes)])) - float(
            odds @ np.array([_entropy(np.array([p, 1 - p])) for p in yes])
        )
        expected = {row["name"]: float(p) for row, p in zip(able, yes, strict=True)}
        out.append({"name": name, "words": words, "bits": float(bits), "expected": expected})
    return sorted(out, key=lambda row: -row["bits"])


def _entropy(p: Array) -> float:
    return float(-np.sum(p * np.log2(np.maximum(p, 1e-300))))


def _sentences(rows: Sequence[dict[str, Any]], measurements: Sequence[dict[str, Any]]) -> list[str]:
    lines = [
        f"{row['name']}: {row['words']}: {row['as_seen']} of {row['draws']} draws grow near {OBSERVED_HZ:g} Hz before all else and as slowly "
        f"as reported ({row['grows']} at any rate); probability {row['probability']:.2g} among these explanations."
        for row in sorted(rows, key=lambda row: -row["probability"])
        if row["as_seen"]
    ]
    never = [row for row in rows if not row["as_seen"]]
    if never:
        names = ", ".join(row["name"] for row in never)
        lines.append(f"{names}: none of {never[0]['draws']} draws each; {never[0]['probability']:.2g} each.")
    if measurements:
        best = measurements[0]
        told = ", ".join(f"{p:.0%} if {name}" for name, p in best["expected"].items())
        lines.append(
            f"What would have told most of it: {best['name']} ({best['bits']:.2g} bit): {best['words']}: {told}."
        )
    return lines
