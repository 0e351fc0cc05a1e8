"""Families of effects, and the traits that their effects share.

A family groups laws that look alike in recordings. Screening, fits, reports and advice read a family's traits here and
nowhere else. A user's file may define a family of its own: ``family = Family(name=..., ...)`` in the class of the effect.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Literal


@dataclass(frozen=True, kw_only=True)
class Family:
    """One family and its traits.

    Parameters
    ----------
    name : str
        Name in reports.
    is_nonsmooth : bool
        Whether the laws have edges: integration steps are halved, and small differences of a Jacobian are noise.
    is_dry_friction : bool
        Whether sticking balances all other forces, so that the law is evaluated last in a step.
    is_slip : bool
        Whether the laws describe slip. Two slip laws at one place describe one friction.
    needs_rest : bool
        Whether the law is plausible at an element with a position of rest only.
    is_linear : bool
        Whether the effect is linear in the motion, as a gain.
    is_shared : bool
        Whether all actuators or sensors can have the effect together.
    is_usually_single : bool
        Whether the effect usually concerns one actuator or sensor.
    shows_without_drive : bool
        Whether a sensor effect shows in a free decay that one sensor records.
    hardware : {"amplifier", "coil", "chain"}
        Part of an actuator that a report names.
    related : frozenset of str
        Families whose laws look alike in a linear regression.
    accompanied_by : str
        Effect that machines usually have at the same place; "" for none.
    separated_by : mapping of str to str
        By another family's name, the measurement that separates the two; by the own name, the measurement that separates
        effects within the family.
    separates_ends : str
        Measurement that tells an effect of a sensor from one of an actuator; "" for the one of the family.
    tested_by : str
        Measurement that can refute a single finding; "" for none.
    """

    name: str
    is_nonsmooth: bool = False
    is_dry_friction: bool = False
    is_slip: bool = False
    needs_rest: bool = False
    is_linear: bool = False
    is_shared: bool = False
    is_usually_single: bool = False
    shows_without_drive: bool = False
    hardware: Literal["amplifier", "coil", "chain"] = "amplifier"
    related: frozenset[str] = frozenset()
    accompanied_by: str = ""
    separated_by: Mapping[str, str] = field(default_factory=dict)
    separates_ends: str = ""
    tested_by: str = ""


def register_family(family: Family) -> None:
    """Add a family to `FAMILIES`.

    Parameters
    ----------
    family : Family
        A new family, or one that is registered with the same traits.

    Raises
    ------
    ValueError
        Another family has the name.
    """
    if FAMILIES.setdefault(family.name, family) != family:
        raise ValueError(f"the family {family.name!r} has other traits already; give the new family a name of its own")


def separating_measurement(names: Collection[str], *, is_of_both_ends: bool = False) -> str:
    """Return the measurement that separates families, or effects within one.

    Parameters
    ----------
    names : collection of str
        Names of families.
    is_of_both_ends : bool
        Whether a sensor and an actuator remain as places.

    Returns
    -------
    str
        The first measurement in the order of `FAMILIES`; "" if no family names one.
    """
    for family in FAMILIES.values():
        if is_of_both_ends and family.separates_ends and set(names) == {family.name}:
            return family.separates_ends
        for other, measurement in family.separated_by.items():
            if {family.name, other} <= set(names) and (family.name != other or len(set(names)) == 1):
                return measurement
    return ""


_CALIBRATE = "a calibration of one actuator against a known force, or of one sensor against a known motion"

_LISTED = (
    Family(
        name="friction",
        is_nonsmooth=True,
        is_dry_friction=True,
        is_slip=True,
        related=frozenset({"hysteresis"}),
        # friction of joints and guides is dry and viscous at once: Armstrong-Helouvry, Dupont and Canudas de Wit,
        # Automatica 30, 1994, section 2
        accompanied_by="viscous-damping",
        separated_by={
            "hysteresis": "a slow quasi-static sweep through several amplitudes: the loop of dry friction has "
            "vertical sides at every amplitude, that of micro-slip a slope"
        },
        tested_by="the same excitation at a third of the level: dry friction must take three times its share",
    ),
    Family(
        name="damping",
        accompanied_by="coulomb-friction",
        separated_by={
            "friction": "releases or sine dwells at three amplitudes a factor of three apart: damping ratios that rise "
            "with amplitude speak for drag, falling ones for dry friction, constant ones for viscous damping"
        },
        tested_by="releases from two heights: they tell how the decay changes with amplitude",
    ),
    Family(
        name="nonlinear-stiffness",
        needs_rest=True,
        related=frozenset({"contact", "clearance"}),
        separated_by={
            "clearance": "sine dwells at three amplitudes below and above the gap, harmonics recorded",
            "contact": "sine dwells at three amplitudes, harmonics recorded: a stop sets in at one amplitude",
        },
        tested_by="sine dwells near the resonance at two levels: its frequency must move as the law says",
    ),
    Family(
        name="mass",
        separated_by={
            "stiffness": "the same test with a known mass added at the place, or modes with a node there",
            "mass": "the same test with a known mass moved along the structure",
        },
        tested_by="the same test with a known mass added at the place: the frequencies must fall as with both",
    ),
    Family(
        name="gain",
        is_linear=True,
        is_shared=True,
        hardware="coil",
        separated_by={
            "mass": _CALIBRATE,
            "stiffness": "a static test: a known force and the deflection it gives",
        },
        tested_by=_CALIBRATE,
    ),
    Family(
        name="servo",
        is_linear=True,
        separated_by={
            "gain": "a joint held against two known loads under one command: a position gain shows in the droop, a gain "
            "of commands does not",
            "mass": "a joint held against two known loads: only a position gain changes the droop",
            "stiffness": "the droop under a known load with the drive on and off: a spring acts in both",
            "damping": "the joint moved by hand with the drive off: only a damper still brakes",
            "servo": "a joint held against two known loads, then a step of the command without load: the droop gives "
            "the position gain, the overshoot the velocity gain",
        },
        tested_by="a joint held against two known loads under one command: the droop per load is one over the position "
        "gain",
    ),
    Family(
        name="timing",
        is_shared=True,
        hardware="chain",
        related=frozenset({"sensor-dynamics"}),
        separated_by={
            "timing": "excitation up to frequencies where a delay turns the phase by much more than a first-order lag"
        },
        separates_ends="a second sensor beside the first one, read by another path: a late sensor is late beside the second "
        "one, a late actuator makes both late",
        tested_by="a step of the command and its answer, sampled ten times as fast",
    ),
    Family(
        name="saturation",
        is_shared=True,
        is_usually_single=True,
        shows_without_drive=True,
        related=frozenset({"clearance"}),
        separated_by={
            "saturation": "the same excitation at a level that is twice as large, the actuator's own force recorded"
        },
        tested_by="the same excitation at half the level, which stays clear of the limit: what was found must be gone",
    ),
    Family(
        name="stiffness",
        separated_by={
            "stiffness": "mode shapes at more points: a local loss of stiffness shows as a kink where its curvature is large"
        },
        tested_by="a known force at the place, and the deflection that it gives",
    ),
    Family(
        name="clearance",
        is_nonsmooth=True,
        is_shared=True,
        is_usually_single=True,
        related=frozenset({"nonlinear-stiffness", "contact"}),
        tested_by="sine dwells with less and with more motion than the gap: the response must change its kind there",
    ),
    Family(
        name="contact",
        is_nonsmooth=True,
        related=frozenset({"nonlinear-stiffness", "clearance"}),
        tested_by="the same excitation at a level that does not reach the contact: what was found must be gone",
    ),
    Family(
        name="unknown-law",
        tested_by="force and motion recorded at the place itself, in slow cycles at three amplitudes: the table must follow",
    ),
    Family(name="bias", shows_without_drive=True, tested_by="readings at rest with the drive switched off and on"),
    Family(
        name="disturbance",
        shows_without_drive=True,
        tested_by="a recording with the drive switched off: what was found must still be there",
    ),
    Family(
        name="hysteresis",
        is_nonsmooth=True,
        is_slip=True,
        related=frozenset({"friction"}),
        tested_by="slow cycles to and fro at two amplitudes, force and motion recorded: their loops must open as the law says",
    ),
    Family(
        name="input-hysteresis",
        is_shared=True,
        hardware="coil",
        related=frozenset({"timing", "clearance", "saturation", "gain"}),
        separated_by={
            "timing": "sine commands of one level at three frequencies: the lag of hysteresis is the same at each, the "
            "lag of a delay grows with frequency",
            "clearance": "slow sine commands at three levels: the gain of hysteresis grows steadily, a dead zone has a "
            "threshold",
            "saturation": "slow sine commands at three levels: the gain of hysteresis grows with the level",
            "gain": "slow sine commands at three levels: a wrong gain is the same at each",
        },
        tested_by="slow triangular commands at two levels, command and force recorded: their loops must open as the law "
        "says",
    ),
    Family(name="time-variation", tested_by="the same recording again, an hour later"),
    Family(name="substructure", tested_by="a sensor on what swings along, or the same test with it held"),
    Family(
        name="resolution",
        is_shared=True,
        shows_without_drive=True,
        hardware="chain",
        tested_by="the same excitation at ten times the level, where steps no longer matter",
    ),
    Family(
        name="actuator-position",
        tested_by="a known current in the coil at three positions of its travel, and the force that it gives",
    ),
    Family(
        name="sensor-dynamics",
        related=frozenset({"timing"}),
        tested_by="a second sensor of another make beside it, over the whole band",
    ),
    Family(
        name="pick-up", tested_by="the same commands with the structure held: what the sensor still reads is not motion"
    ),
)

FAMILIES: dict[str, Family] = {family.name: family for family in _LISTED}
"""All families by name; a user's file may add its own."""
