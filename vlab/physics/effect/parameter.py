"""Parameters of an effect's law: units, ranges of the priors, trial values."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

Values = Mapping[str, Any]
"""Parameter values by name: floats or arrays that broadcast against the signals."""

Scan = Literal["", "delay", "period", "slope", "step", "resonance", "pitch"]
Reference = Literal[
    "",
    "displacement",
    "travel",
    "velocity",
    "input",
    "input-slope",
    "output",
    "duration",
    "step",
    "error",
    "servo-force",
    "servo-gain",
]

TIMES = (1e-4, 3e-4, 1e-3, 3e-3, 0.01, 0.03, 0.1)
"""TIMES [s]: trial delays and time constants, in half decades from 0.1 ms."""


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A parameter of an effect's law.

    Parameters
    ----------
    unit : str
        SI unit at a translation. At a rotation N stands for N m, and m for rad. For an actuator N stands for the
        command's unit; for a sensor m stands for the channel's unit.
    low, high : float
        Range of the prior, in `unit`, or in multiples of `reference`.
    role : str
        ``"amplitude"``: the law is proportional to the parameter and the screening solves for the value. ``"shape"``:
        the screening tries the values of `grid`.
    reference : str
        Scale of `grid`, `low` and `high`: the largest recorded displacement or velocity at the place, the largest
        input, the largest slope of input or output, the duration, or the sample period. ``"travel"``:
        half of the range of the displacement, at most half a revolution. Of a servo: the largest
        position error or force, or the position gain. "" for no scale.
    grid : tuple of float
        Trial values of the screening.
    scan : str
        Further trial values that the screening derives from the recordings, "" for none. ``"delay"``: the whole range;
        ``"period"``: whole sample periods; ``"slope"``: down to that of a slow command; ``"step"``: steps of a converter;
        ``"resonance"``: frequencies over the recorded band; ``"pitch"``: the whole range, as positions over which a force
        repeats.
    signed : bool
        Whether negative values are allowed. An unsigned parameter is fitted in its logarithm.
    grain : float
        Relative distance within which an unsigned parameter may leave the law unchanged; this distance bounds the
        parameter's precision, because the Jacobian vanishes within. 0 if the law changes with every change of the
        parameter.
    """

    name: str
    unit: str
    low: float
    high: float
    role: Literal["amplitude", "shape"] = "amplitude"
    reference: Reference = ""
    grid: tuple[float, ...] = ()
    scan: Scan = ""
    signed: bool = False
    words: str = ""
    grain: float = 0.0
