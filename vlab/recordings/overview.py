"""Overview of a file: possible meanings of each column.

Units come from the file, from a name or from the range of values. Guesses are named as guesses and change nothing.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from vlab import units
from vlab.recordings.table import Table
from vlab.signals import Array

REPEATED = "time, repeats"
"""REPEATED: kind of a time column with equal neighbours that never goes back."""
WORDS = {
    "time": (
        *("time", "timestamp", "stamp", "t", "x_value", "times", "timestamps", "seconds", "secs", "sec"),
        *("datetime", "date", "clock", "utc", "elapsed"),
    ),
    "temperature": ("temperature", "temp", "temps"),
    "error": ("error", "err", "errors"),
    "flag": ("flag", "status", "mode", "enabled", "valid", "id", "flags"),
    "command": (
        *("command", "cmd", "action", "target", "goal", "ctrl", "setpoint", "ref", "desired", "u"),
        *("commanded", "cmds", "actions", "des", "reference", "tgt", "sp", "control", "pwm", "duty"),
        *("demand", "demanded", "demands"),
    ),
    "moment": ("torque", "effort", "tau", "moment", "trq"),
    "force": ("force",),
    "current": ("current", "amp", "amps"),
    "voltage": ("voltage", "volt", "volts"),
    "acceleration": ("acc", "accel", "acceleration", "qacc", "accelerometer"),
    "velocity": ("vel", "velocity", "speed", "qvel", "dq", "qd", "rpm", "omega", "gyro"),
    "position": (
        *("pos", "position", "qpos", "q", "angle", "state", "displacement", "x", "y", "z"),
        *("ang", "theta", "angles", "positions", "encoder", "enc"),
    ),
    "frequency": ("freq", "frequency", "f", "hz"),
    "load": ("load",),
}
"""WORDS: parts of names by the quantity that they suggest; the first match counts. A load is a force where no other word
counts, for a body may have that name."""
UNIT_KINDS = {
    "N m": "moment",
    "N": "force",
    "A": "current",
    "V": "voltage",
    "m/s^2": "acceleration",
    "rad/s^2": "acceleration",
    "m/s": "velocity",
    "rad/s": "velocity",
    "m": "position",
    "rad": "position",
}
"""UNIT_KINDS: quantity that a stated unit suggests, where the name suggests none."""
COMPOUND = ("m/s", "m/s^2", "rad/s", "rad/s^2", "N m")
"""COMPOUND: quantities whose unit may stand in several words of a name."""
TURNING = ("rad", "deg", "rpm")
"""TURNING: units of turning that are names of columns as well."""
TIMES = {
    "min": "min",
    "minutes": "min",
    "ms": "ms",
    "millis": "ms",
    "us": "us",
    "micros": "us",
    "ns": "ns",
    "nanos": "ns",
}
"""TIMES: units by names of a column of times."""
TURN = 2.0 * np.pi
"""TURN [rad]: largest angle of a joint that is read as radians; a larger number suggests degrees."""
_SPLIT = re.compile(r"[^a-zA-Z]+|(?<=[a-z])(?=[A-Z])")
_BRACKETED = re.compile(r"[\[(]\s*([A-Za-z][A-Za-z0-9/^*_]*)\s*[\])]\s*$")
_RATE = re.compile(r"(\w+?)_(?:(?:per_)?(s(?:\^?2)?)|per_(min))")


@dataclass(frozen=True, kw_only=True)
class ColumnOverview:
    """Probable meaning of a column.

    Parameters
    ----------
    name : str
        Name in the file.
    rows, blank : int
        Number of samples, and of those without a value.
    least, greatest : float
        Range of the values.
    unit : str
        Unit stated in the file or in the name; empty if unknown.
    guess : str
        Unit that the range suggests, where none is stated.
    kind : str
        Quantity that the name suggests; empty if unknown.
    rate_hz : float or None
        Sample rate of a column of times.
    """

    name: str
    rows: int
    blank: int
    least: float
    greatest: float
    unit: str
    guess: str
    kind: str
    rate_hz: float | None = None

    def to_json(self) -> dict[str, Any]:
        """Return plain values for a JSON document."""
        return {
            "name": self.name,
            "rows": self.rows,
            "blank": self.blank,
            "least": self.least,
            "greatest": self.greatest,
            "unit": self.unit,
            "unit_guess": self.guess,
            "kind": self.kind,
            "rate_hz": self.rate_hz,
        }


def overview(table: Table) -> tuple[ColumnOverview, ...]:
    """Return an overview of the real columns of a table.

    Parameters
    ----------
    table : Table
        Columns of a file.

    Returns
    -------
    tuple of ColumnOverview
        Columns in file order; complex columns by their magnitude.
    """
    return tuple(_of_column(table, name) for name in table.names)


def kind_of(name: str) -> str:
    """Return the quantity that a name suggests, or an empty text.

    Parameters
    ----------
    name : str
        Name of a column.

    Returns
    -------
    str
        Key of `WORDS`. A unit in the name that belongs to another quantity than the words decides.
    """
    kind, unit = _kind_by_words(name), _unit_in_name(name)
    is_doubtful = len(unit) == 1 and not name.rstrip().endswith(("]", ")"))  # pos_A may be a position of a part A
    if kind == "temperature" and unit and not is_doubtful and units.same_dimension(unit, "s"):
        return "time"  # French: temps
    if kind not in UNIT_KINDS.values() or is_doubtful:
        return kind
    return kind_of_unit(unit) or kind


def _kind_by_words(name: str) -> str:
    """Return the quantity that the words of a name suggest."""
    if name.lower() in TIMES:
        return "time"
    parts = [name.lower(), *(part.lower() for part in _SPLIT.split(name) if part)]
    kind = next((kind for kind, words in WORDS.items() if set(parts) & set(words)), "")
    return "force" if kind == "load" else kind


def kind_of_unit(unit: str) -> str:
    """Return the quantity that a unit suggests, or an empty text.

    Parameters
    ----------
    unit : str
        Unit as stated.

    Returns
    -------
    str
        Key of `WORDS`.
    """
    if not unit or units.same_dimension(unit, "1") or "hz" in unit.lower():
        return ""
    return next((kind for si, kind in UNIT_KINDS.items() if units.same_dimension(unit, si)), "")


def _of_column(table: Table, name: str) -> ColumnOverview:
    values = table[name]
    unit = table.units.get(name, "") or _unit_in_name(name)
    kind = "complex" if np.iscomplexobj(values) else kind_of(name) or kind_of_unit(unit)
    real = np.abs(values) if np.iscomplexobj(values) else values
    there = real[np.isfinite(real)]
    rate = _rate(there, unit) if kind == "time" else None
    if kind == "time" and there.size > 1 and not np.all(np.diff(there) > 0):
        backward = int(np.sum(np.diff(there) < 0))
        kind = f"time, starts again {backward} times" if backward else REPEATED
    return ColumnOverview(
        name=name,
        rows=len(values),
        blank=int(len(values) - there.size),
        least=float(there.min(initial=np.inf)) if there.size else 0.0,
        greatest=float(there.max(initial=-np.inf)) if there.size else 0.0,
        unit=unit,
        guess="" if unit else _guess(kind, there),
        kind=kind,
        rate_hz=rate if kind == "time" else None,
    )


def _unit_in_name(name: str) -> str:
    """Return the unit in a name, such as ``force_N`` or ``rpm``."""
    if name.lower() in TIMES:
        return TIMES[name.lower()]
    bracketed = _BRACKETED.search(name)
    if bracketed is not None:
        return bracketed[1] if units.same_dimension(bracketed[1], bracketed[1]) else ""
    words = [word for word in re.split(r"[_\s]+", name) if word]
    if len(words) < 2:
        return name.lower() if name.lower() in TURNING else ""
    return _compound_unit(words) or _unit_word(words[-1], _kind_by_words(name), words[-2])


def _compound_unit(words: Sequence[str]) -> str:
    """Return the unit in several words of a name, as in ``acc_m_s2``."""
    if len(words[-1]) > 1 and any(units.same_dimension(words[-1], si) for si in COMPOUND):
        return words[-1]
    for count in (3, 2):
        end, rate = words[-count:], _RATE.fullmatch("_".join(words[-count:]))
        if len(words) <= count:
            continue
        is_preposition = end[0] == "in" and "per" not in end  # time in s
        if rate and not is_preposition and rate[1] in (*units.WRITTEN["m"], *units.WRITTEN["rad"]):
            return f"{rate[1]}/{rate[2] or rate[3]}"
        if count == 2 and end[0] in units.WRITTEN["N"] and end[1] in units.WRITTEN["m"]:
            return " ".join(end)
    return ""


def _unit_word(word: str, quantity: str, before: str) -> str:
    """Return the last word of a name if it is a unit.

    A single letter may name a part, as in ``pos_A``: the unit must be one of the quantity that the other words suggest. A
    time after another unit is a part of a unit, as in ``level_V_s``, and of a position ``min`` is the minimum.
    """
    is_of_time = units.same_dimension(word, "s") or units.same_dimension(word, "s^2")
    if is_of_time and (quantity in UNIT_KINDS.values() or (before != "in" and kind_of_unit(before))):
        return ""
    if len(word) == 1:
        is_of_words = kind_of_unit(word) == quantity != "" or (word == "h" and quantity == "time")  # acc_g is no mass
        is_usual = word in "NVAsm" and quantity not in UNIT_KINDS.values()
        return word if is_of_words or is_usual else ""
    is_quantity = word.lower() in sum(WORDS.values(), ()) and word.lower() not in TURNING
    return word if not is_quantity and units.same_dimension(word, word) else ""


def _guess(kind: str, values: Array) -> str:
    if not values.size:
        return ""
    if kind == "time":
        step = float(np.median(np.diff(values))) if values.size > 1 else 0.0
        return next((unit for unit, least in (("ns", 1e5), ("us", 500.0), ("ms", 0.5), ("s", 0.0)) if step > least), "")
    if kind in ("position", "command"):
        return "deg" if float(np.abs(values).max()) > TURN else "rad or m" if kind == "position" else ""
    return {"moment": "N m", "force": "N", "current": "A", "voltage": "V", "frequency": "Hz"}.get(kind, "")


def _rate(times: Array, unit: str) -> float | None:
    """Return the sample rate of times [Hz], in stated or guessed unit."""
    if times.size < 2 or not np.all(np.diff(times) > 0):
        return None
    said = unit or _guess("time", times)
    if not units.same_dimension(said or "s", "s"):
        return None
    return float((times.size - 1) / ((times[-1] - times[0]) * units.factor(said or "s", "s")))
