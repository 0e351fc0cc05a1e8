"""Which effects no experiment of the kind in a case can tell apart: the one table of equivalence classes.

These are the limits that no algorithm removes, whatever the tool says of itself. An answer is in the right class if it
names an effect that the table puts with the true one under the conditions of the case, or if the tool itself lists the
true effect among those that it cannot tell from its answer (the `class` of a finding).
"""

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, kw_only=True)
class Alike:
    """Effects that look alike.

    Parameters
    ----------
    effects : tuple of str
        Names as in `vlab effects`.
    benches : tuple of str
        On which benches; empty for all.
    one_level : bool
        Only where all recordings to fit have nearly one level.
    at_actuator : bool
        Only where what is hidden acts on an actuator or at the place that it pushes.
    """

    effects: tuple[str, ...]
    why: str
    benches: tuple[str, ...] = ()
    one_level: bool = False
    at_actuator: bool = False


TABLE: tuple[Alike, ...] = (
    Alike(effects=("actuator-gain", "sensor-gain"), why="gains of coil and sensor enter as their product"),
    Alike(
        effects=("actuator-delay", "actuator-lag"), why="over 0 to 50 Hz a delay and a first-order lag agree to .995"
    ),
    Alike(effects=("sensor-delay", "sensor-lag"), why="as for the actuator"),
    Alike(
        effects=("added-mass", "lost-stiffness"),
        why="at mid-span the changes of the frequencies agree to .96",
        benches=("beam", "grid"),
    ),
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
    """Return all effects that are right answers in class to something hidden in a case."""
    names = set(hidden["accepted"])
    out = set(names)
    for row in TABLE:
        fits = (
            (not row.benches or truth["bench"] in row.benches)
            and (not row.one_level or truth["one_level"])
            and (not row.at_actuator or hidden["at_actuator"])
        )
        if fits and names & set(row.effects):
            out |= set(row.effects)
    return out
