"""Equivalence classes: effects that no experiment of a case can tell apart.

These are the limits that no algorithm removes, whatever the tool says of itself. An answer is in the right class if it
names an effect that the table puts with the true one under the conditions of the case. What the tool itself says that it
cannot tell apart (the `class` of a finding) does not count here: a class that holds everything would always be right.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

BAND_HZ = {"slider": 24.0, "shaft": 30.0, "beam": 45.0, "grid": 15.0}
"""Highest frequency that the commands of a bench hold."""
SMALL_PHASE = 0.1
"""Phase [rad] at that frequency up to which a delay and a lag are alike: a lag differs from it by half its square, half a per cent
of the amplitude, which an uncertain gain takes up in part."""


@dataclass(frozen=True, kw_only=True)
class Alike:
    """Effects that look alike.

    Parameters
    ----------
    effects : tuple of str
        Names as in `vlab effects`.
    one_level : bool
        Only where all recordings to fit have nearly one level.
    at_actuator : bool
        Only where what is hidden acts on an actuator or at the place that it pushes.
    one_sensor : bool
        Only where there is one sensor.
    small_phase : bool
        Only where the time that is hidden turns no phase by more than `SMALL_PHASE`.
    """

    effects: tuple[str, ...]
    why: str
    one_level: bool = False
    at_actuator: bool = False
    one_sensor: bool = False
    small_phase: bool = False


TABLE: tuple[Alike, ...] = (
    Alike(
        effects=("actuator-gain", "sensor-gain"),
        why="gains of a coil and of the only sensor enter as their product",
        one_sensor=True,
    ),
    Alike(
        effects=("actuator-delay", "actuator-lag"),
        why="while it is short, a delay and a first-order lag turn phases alike and leave amplitudes",
        small_phase=True,
    ),
    Alike(effects=("sensor-delay", "sensor-lag"), why="as for the actuator", small_phase=True),
    Alike(
        effects=("force-offset", "actuator-offset"),
        why="a constant force along an actuator is the actuator's own offset",
        at_actuator=True,
    ),
    Alike(effects=("viscous-damping", "quadratic-drag"), why="one level gives one damping ratio", one_level=True),
    Alike(
        effects=("cubic-stiffness", "quadratic-cubic-stiffness", "dead-band", "jenkins-slip", "bouc-wen"),
        why="near one amplitude only the frequency and the third harmonic show",
        one_level=True,
    ),
)


def right_class(truth: dict[str, Any], hidden: dict[str, Any]) -> set[str]:
    """Return all effects of the class of a hidden effect."""
    names = set(hidden["accepted"])
    out = set(names)
    for row in TABLE:
        fits = (
            (not row.one_level or truth["one_level"])
            and (not row.at_actuator or hidden["at_actuator"])
            and (not row.one_sensor or len(truth["sigma"]) == 1)
            and (not row.small_phase or _phase(truth, hidden) <= SMALL_PHASE)
        )
        if fits and names & set(row.effects):
            out |= set(row.effects)
    return out


def _phase(truth: dict[str, Any], hidden: dict[str, Any]) -> float:
    """Return the phase of a hidden delay at the highest frequency [rad].

    The phase is infinite for effects other than a pure time.
    """
    times = [hidden["parameters"].get(name) for name in ("delay", "time_constant")]
    known = [abs(time) for time in times if time is not None]
    return 2 * np.pi * BAND_HZ[truth["bench"]] * known[0] if len(known) == 1 else np.inf
