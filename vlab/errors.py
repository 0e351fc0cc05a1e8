"""Exceptions of vlab.

Each exception is also the built-in kind that a caller expects. The text is one line with the given value, its location,
the accepted values and the likely fix. The command line prints exactly that line.
"""

import difflib
import re
from collections.abc import Iterable

NUMBERED = re.compile(r"(?P<before>.*?)(?P<number>\d+(?:\.\d+)?)(?P<after>\D*)")
"""NUMBERED: name with a number, such as ``coil:40in``."""


class VlabError(Exception):
    """Base of all exceptions; exit status 2 on the command line."""


class BadStructure(VlabError, ValueError):
    """Invalid description of a structure, model or hardware."""


class BadUnit(VlabError, ValueError):
    """Unknown unit or unit of wrong dimension."""


class BadRecording(VlabError, ValueError):
    """Damaged, empty, inconsistent or mislabelled recording."""


class BadCase(VlabError, ValueError):
    """Case that does not fit its model or recordings."""


class BadExperiment(VlabError, ValueError):
    """Impossible experiment (rate, channels, excitation, place)."""


class BadController(VlabError, ValueError):
    """Control law that does not fit its loop."""


class BadDesign(VlabError, ValueError):
    """Impossible control design (weights, sizes, reach of coils and sensors)."""


class BadProof(VlabError, ValueError):
    """Sealed cases, truth or answers that break their commitment."""


class UnknownName(VlabError, LookupError):
    """Name without a match."""


class Diverged(VlabError, ArithmeticError):
    """Simulation that became nonfinite or was reset by MuJoCo."""


class OutputRefused(VlabError, OSError):
    """An output folder that cannot be written."""


MOST_NAMES = 24
"""MOST_NAMES [-]: accepted names that an error lists beside a suggestion; more of them hide it."""


def unknown_name(kind: str, given: str, known: Iterable[str], *, where: str = "") -> UnknownName:
    """Return the error for a name without a match.

    Parameters
    ----------
    kind : str
        Kind of name.
    given : str
        Name as given.
    known : iterable of str
        Accepted names; the nearest is suggested.
    where : str
        Location, for the message.

    Returns
    -------
    UnknownName
        Exception to raise.
    """
    names = list(known)
    near = _nearest_numbers(given, names) or difflib.get_close_matches(given, names, n=1, cutoff=0.5)
    hint = f"; did you mean {' or '.join(map(repr, near))}?" if near else ""
    place = f"{where}: " if where else ""
    is_long = bool(near) and len(names) > MOST_NAMES
    listed = f"{len(names)} names are accepted" if is_long else f"accepted: {', '.join(names) or 'none'}"
    return UnknownName(f"{place}unknown {kind} {given!r}{hint} ({listed})")


def _nearest_numbers(given: str, names: Iterable[str]) -> list[str]:
    """Return the nearest names that differ in their number only.

    A missing part before a colon does not count, as in ``40in`` for ``coil:40in``. A number beyond all known ones is a
    slip of the keys instead.
    """
    own = NUMBERED.fullmatch(given)
    if own is None or not (own["before"] or own["after"]):  # a bare number is no place
        return []
    numbers: dict[str, float] = {}
    for name in names:
        other = NUMBERED.fullmatch(name)
        if other is None or other["after"] != own["after"]:
            continue
        if own["before"] in (other["before"], other["before"].rpartition(":")[2]):
            numbers[name] = float(other["number"])
    asked = float(own["number"])
    if not (numbers and min(numbers.values()) <= asked <= max(numbers.values())):
        return difflib.get_close_matches(given, numbers, n=1, cutoff=0.5)
    least = min(abs(number - asked) for number in numbers.values())
    return [name for name, number in numbers.items() if abs(number - asked) == least][:2]
