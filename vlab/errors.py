"""The errors that vlab raises on purpose.

Each one is also the built-in kind that a caller would expect, and its text is one line that says what was
given, where, what is accepted and the likely fix; the command line prints exactly that line.
"""

import difflib
from collections.abc import Iterable


class VlabError(Exception):
    """Anything that vlab refuses; the command line turns it into exit status 2."""


class BadStructure(VlabError, ValueError):
    """A structure, rig or hardware description that does not describe something buildable."""


class BadUnit(VlabError, ValueError):
    """A unit that is unknown or of the wrong dimension."""


class BadRecording(VlabError, ValueError):
    """A recording that is damaged, empty, inconsistent or not what its labels say."""


class BadCase(VlabError, ValueError):
    """A case whose description does not fit its model or its recordings."""


class BadExperiment(VlabError, ValueError):
    """An experiment that cannot be run as asked (rate, channels, excitation, place)."""


class BadController(VlabError, ValueError):
    """A control law that does not fit the loop it is put into."""


class BadDesign(VlabError, ValueError):
    """A control design that cannot be made as asked (weights, sizes, what coils and sensors can reach)."""


class BadProof(VlabError, ValueError):
    """Sealed cases, truth or answers that are not what was committed to."""


class UnknownName(VlabError, LookupError):
    """A name that matches nothing."""


class Diverged(VlabError, ArithmeticError):
    """A simulation that left the finite world or was reset by MuJoCo; never a result."""


class OutputRefused(VlabError, OSError):
    """An output folder that cannot be written."""


def unknown_name(kind: str, given: str, known: Iterable[str], *, where: str = "") -> UnknownName:
    """Build the error for a name that matches nothing: what was given, the nearest, and all that are accepted."""
    names = list(known)
    near = difflib.get_close_matches(given, names, n=1, cutoff=0.5)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    place = f"{where}: " if where else ""
    return UnknownName(f"{place}unknown {kind} {given!r}{hint} (accepted: {', '.join(names) or 'none'})")
